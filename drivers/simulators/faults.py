"""What goes wrong on a drive: the faults that real logs show, put where a test wants them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from slam.drivers.simulators.robot import Track

Array = NDArray[np.float64]
TRACK_WIDTH_M = 2.0 / 5.6  # effective, by DiffConvFactor 0.0056 (docs/devices.md, section 2.1)
FaultKind = Literal["sign-flip", "stall", "stuck-encoder", "jump", "slip", "scan-gap"]

# Duration in s and size (m for a jump, rad for a slip) where a fault states none.  A jump
# takes as long as those of the mit-csail log, 0.2 s.
_USUAL: Mapping[FaultKind, tuple[float, float]] = MappingProxyType(
    {
        "sign-flip": (math.inf, 0.0),  # reversing is reported as going forward
        "stall": (2.0, 0.0),  # odometry is frozen while the robot moves
        "stuck-encoder": (2.0, 0.0),  # the left wheel counts nothing
        "jump": (0.2, 1.0),  # odometry leaps by `size` metres towards `bearing`
        "slip": (0.5, math.radians(20.0)),  # odometry turns by `size` more than the robot
        "scan-gap": (3.0, 0.0),  # no scan comes in; the odometry goes on
    }
)


@dataclass(frozen=True, slots=True)
class OdometryFault:
    """One thing that goes wrong, `at_s` seconds after the first stamp of the drive."""

    kind: FaultKind
    at_s: float  # s since the start of the drive
    duration_s: float | None = None  # s, None for the usual one of its kind
    size: float | None = None  # m of a jump, rad of a slip; None for the usual one
    bearing: float = 0.0  # rad, direction of a jump in the base frame

    def __post_init__(self) -> None:
        """Refuse unknown kinds and times that cannot be."""
        if self.kind not in _USUAL:
            raise ValueError(f"unknown fault {self.kind!r}, known are {', '.join(_USUAL)}")
        if self.at_s < 0.0 or self.lasts_s <= 0.0:
            raise ValueError(f"a fault needs a start at 0 or later and a duration, got {self}")

    @property
    def lasts_s(self) -> float:
        """Seconds from its beginning to its end."""
        return _USUAL[self.kind][0] if self.duration_s is None else self.duration_s

    @property
    def amount(self) -> float:
        """Metres of a jump, radians of a slip."""
        return _USUAL[self.kind][1] if self.size is None else self.size


def corrupted(increments: Array, truth: Track, faults: Sequence[OdometryFault]) -> Array:
    """Return the wheel increments, (n, 3), as they come out after `faults` in turn."""
    bad = increments.copy()
    backwards = truth.increments[:, 0] < 0.0
    for fault in faults:
        cover = _cover(fault, truth)
        share = fault.amount * cover * truth.step_s / fault.lasts_s
        if fault.kind == "stall":
            bad *= (1.0 - cover)[:, None]
        elif fault.kind == "stuck-encoder":
            left = (bad[:, 0] - 0.5 * TRACK_WIDTH_M * bad[:, 2]) * cover
            bad[:, 0] -= 0.5 * left
            bad[:, 2] += left / TRACK_WIDTH_M
        elif fault.kind == "sign-flip":
            bad[:, 0] *= 1.0 - 2.0 * cover * backwards
        elif fault.kind == "jump":
            bad[:, 0] += share * math.cos(fault.bearing)
            bad[:, 1] += share * math.sin(fault.bearing)
        elif fault.kind == "slip":
            bad[:, 2] += share
    return bad


def _cover(fault: OdometryFault, truth: Track) -> Array:
    """Return, (n,), how much of each step of `truth` the fault covers, 0 to 1."""
    starts = np.arange(len(truth.increments)) * truth.step_s
    begins = np.maximum(starts, fault.at_s)
    ends = np.minimum(starts + truth.step_s, fault.at_s + fault.lasts_s)
    cover: Array = np.clip((ends - begins) / truth.step_s, 0.0, 1.0)
    return cover


def has_scan(times_s: Array, faults: Sequence[OdometryFault]) -> NDArray[np.bool_]:
    """Return, (n,), whether a scan due at each of `times_s` comes in."""
    due = np.ones(len(times_s), np.bool_)
    for fault in faults:
        if fault.kind == "scan-gap":
            due &= (times_s < fault.at_s) | (times_s >= fault.at_s + fault.lasts_s)
    return due
