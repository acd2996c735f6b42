"""A keyframe: a scan that became a node of the graph."""

from __future__ import annotations

from dataclasses import dataclass

from gtsam import Pose2

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
