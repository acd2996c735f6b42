"""A keyframe: a scan that became a node of the graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from frontend.scan import PreparedScan
from logs.messages import LaserScan


@dataclass(frozen=True, eq=False, slots=True)
class Keyframe:
    """What is kept of a scan in the graph; its pose lives in the graph."""

    index: int
    scan_index: int  # position among the scans of the log
    scan: LaserScan
    prepared: PreparedScan
    odom_T_base: Pose2
    travelled_m: float  # by odometry and matches, from the first keyframe


def view_centres(keyframes: Sequence[Keyframe], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) what each keyframe looks at, in the map frame, at poses (n, 3).

    Two scans see the same things if these points are near each other, whatever the field of
    view: with 180 degrees, two robots at one spot that face apart share nothing.
    """
    return placed(np.array([k.prepared.centre for k in keyframes]), poses)


def placed(points: NDArray[np.float64], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) points in the map frame, each given in the frame of its own pose of (n, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return np.column_stack(
        [
            poses[:, 0] + c * points[:, 0] - s * points[:, 1],
            poses[:, 1] + s * points[:, 0] + c * points[:, 1],
        ]
    )
