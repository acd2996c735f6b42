"""The vocabulary every package shares: what sensors say and what the system decides.

Stamps are integer nanoseconds of UTC; lengths are metres, angles radians, both in
right-handed frames after REP-103 (x forward, y left, theta anticlockwise).  Frames are
named after REP-105: `map`, `odom`, `base`, `laser`; `a_T_b` takes points of b into a.
Poses are plain floats here, so that this module needs numpy alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False, slots=True)
class LaserScan:
    """One sweep in the laser frame; beam i points at `angle_min + i * angle_step`.

    `ranges` is made read-only.  A beam that brought nothing back is inf; a beam whose
    reading is unusable (sensor error code, nearer than the sensor can see) is nan.
    """

    stamp_ns: int  # when the first beam was measured
    angle_min: float  # rad, bearing of beam 0, anticlockwise from the laser's x axis
    angle_step: float  # rad, negative for a laser that turns clockwise
    ranges: NDArray[np.float32]  # (n,) m
    range_min: float = 0.0  # m, nearer readings are not measurements
    range_max: float = float("inf")  # m, the sensor's reach
    beam_period_s: float = 0.0  # s from one beam to the next, 0 if unknown

    def __post_init__(self) -> None:
        """Freeze the ranges: a message is shared and must not change under its reader."""
        self.ranges.setflags(write=False)


@dataclass(frozen=True, slots=True)
class WheelOdometry:
    """`odom_T_base` by the robot's own dead reckoning."""

    stamp_ns: int
    x: float  # m
    y: float  # m
    theta: float  # rad


@dataclass(frozen=True, slots=True)
class LaserExtrinsics:
    """`base_T_laser`: where the laser sits on the robot."""

    stamp_ns: int
    x: float  # m
    y: float  # m
    theta: float  # rad


@dataclass(frozen=True, slots=True)
class TruePose:
    """`world_T_base` as a simulator or a survey knows it; SLAM never reads it."""

    stamp_ns: int
    x: float  # m
    y: float  # m
    theta: float  # rad


@dataclass(frozen=True, slots=True)
class RawBytes:
    """Bytes that went to (`tx`) or came from (`rx`) a device in one system call."""

    stamp_ns: int
    device: Literal["p3dx", "laser"]
    direction: Literal["rx", "tx"]
    data: bytes


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """`map_T_base` with the covariance of (x, y, theta) in the base frame, row by row."""

    stamp_ns: int
    x: float  # m
    y: float  # m
    theta: float  # rad
    covariance: tuple[float, ...] = ()  # 9 numbers: m^2, m rad, rad^2; empty if unknown
    lost: bool = False  # neither odometry nor match could be trusted here


@dataclass(frozen=True, slots=True)
class KeyframeDecision:
    """Why a scan became keyframe `index`."""

    stamp_ns: int
    index: int
    scan_index: int  # position of the scan in the log, from 0
    reason: str  # "first", "distance", "turn", "time", ...
    axis: str  # the axis that decided: "x", "y", "theta", or "" where none did
    travelled_m: float  # since the keyframe before
    turned_rad: float
    interval_m: float  # the interval that was chosen for this step
    t_pe: float  # Equation 2 of the seed paper; nan for other methods
    sums: tuple[float, ...]  # |diff_L|, |diff2_L|, |diff_R|, |diff2_R| (m); empty if none
    achieved_sigmas: tuple[float, ...]  # of the match: x (m), y (m), theta (rad); empty if none
    predicted_sigmas: tuple[float, ...] = ()  # likewise, foreseen at the keyframe before


@dataclass(frozen=True, slots=True)
class FactorRecord:
    """One measurement of the pose graph, as it entered; covariance is in frame j."""

    stamp_ns: int
    kind: Literal["prior", "odometry", "icp", "loop"]
    i: int
    j: int
    x: float  # i_T_j
    y: float
    theta: float
    covariance: tuple[float, ...]  # 9 numbers, row by row
    used: bool = True  # False where the factor was refused or withdrawn
    note: str = ""  # why, in words


@dataclass(frozen=True, slots=True)
class LoopResult:
    """What became of the loop candidate between keyframes i (old) and j (new)."""

    stamp_ns: int
    i: int
    j: int
    accepted: bool
    reason: str  # "accepted" or what spoke against it
    score: float  # share of beams explained, 0 to 1
    second_score: float  # the best score elsewhere in the search window
    chi_square: float  # of the closure against the graph, 3 degrees of freedom; nan if unknown


@dataclass(frozen=True, eq=False, slots=True)
class OccupancyMap:
    """Occupancy probability in percent; row 0 lies at the origin, -1 is unknown."""

    stamp_ns: int
    resolution: float  # m per cell
    origin_x: float  # m, map frame, outer corner of cell (0, 0)
    origin_y: float
    cells: NDArray[np.int8]  # (rows, columns), 0 to 100 or -1

    def __post_init__(self) -> None:
        """Freeze the cells."""
        self.cells.setflags(write=False)


@dataclass(frozen=True, slots=True)
class FrameTransform:
    """`parent_T_child` for viewers alone, which hang scans and maps on it; never read back."""

    stamp_ns: int
    parent: str
    child: str
    x: float  # m
    y: float  # m
    theta: float  # rad


@dataclass(frozen=True, slots=True)
class LogLine:
    """Something that happened, in words: a device came, was lost, is back."""

    stamp_ns: int
    level: Literal["debug", "info", "warning", "error", "fatal"]
    name: str  # who says it: "p3dx", "laser"
    text: str


@dataclass(frozen=True, slots=True)
class DeviceHealth:
    """How a device stands: its link, and figures such as loss counters, value for name."""

    stamp_ns: int
    device: str
    link: str  # "connected", "lost", ...: the last thing that happened to it
    names: tuple[str, ...]
    values: tuple[str, ...]  # as many


SensorMessage = LaserScan | WheelOdometry | LaserExtrinsics | TruePose | RawBytes
ResultMessage = (
    PoseEstimate | KeyframeDecision | FactorRecord | LoopResult | OccupancyMap | FrameTransform
)
StatusMessage = LogLine | DeviceHealth
Message = SensorMessage | ResultMessage | StatusMessage
