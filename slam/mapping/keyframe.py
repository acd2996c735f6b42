"""A keyframe: a scan that became a node of the graph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.se2 import placed
from slam.frontend.scan import PreparedScan, ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan

Preparer = Callable[[LaserScan, LaserExtrinsics], PreparedScan]
REMEMBERED = 512  # prepared scans; the robot's surroundings and a few old places


def preparer(config: ScanConfig) -> Preparer:
    """`prepare` that remembers the scans asked for last.

    A prepared scan is twenty times as large as its ranges, and made anew in less time than one
    match takes: an hour's drive keeps only those in memory that are about to be used.
    """
    return lru_cache(maxsize=REMEMBERED)(partial(prepare, config=config))


@dataclass(frozen=True, eq=False, slots=True)
class Keyframe:
    """A scan in the graph; its pose is held by the graph."""

    index: int
    scan_index: int  # position among the scans of the log
    scan: LaserScan
    extrinsics: LaserExtrinsics  # base_T_laser when it was taken
    prepare: Preparer
    centre: NDArray[np.float64]  # (2,) m, what the scan looks at, in the base frame
    odom_T_base: Pose2
    travelled_m: float  # by odometry and matches, from the first keyframe
    number: int  # counts all keyframes ever made; pruning makes the index fall behind

    @property
    def prepared(self) -> PreparedScan:
        """The scan ready for matching."""
        return self.prepare(self.scan, self.extrinsics)


def view_centres(keyframes: Sequence[Keyframe], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2) what each keyframe looks at, in the map frame, at poses (n, 3).

    Two scans see the same things if these points are near each other, whatever the field of
    view: with 180 degrees, two robots at one spot that face apart share nothing.
    """
    return placed(np.array([k.centre for k in keyframes]), poses)
