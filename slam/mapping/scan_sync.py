"""Scans with their odometry: a scan waits until there is odometry after it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2

from slam.frontend.deskew import sweep_ns
from slam.logs.messages import LaserScan, WheelOdometry
from slam.mapping.odometry import OdometryBuffer
from slam.mapping.stale_odometry import StaleOdometryFilter

MAX_WAIT_NS = 2_000_000_000  # a scan waits this long (in message time) for odometry after it
STAMP_JITTER_S = 0.15  # between neighbouring scans; intel's stamps come in bursts


@dataclass(frozen=True, eq=False, slots=True)
class ScanWithOdometry:
    """A scan, where the odometry has the robot then, and how far it moved during the sweep."""

    scan: LaserScan
    odom_T_base: Pose2
    moved: tuple[float, float, float]  # x, y (m), theta (rad); zero if scans are not deskewed
    late: bool  # its odometry did not come in time; the last reading stands in
    unknown_s: float = 0.0  # s from the scan to what nearest tells where it was taken
    broken_s: float = 0.0  # s so far after which nothing told how the robot had moved meanwhile


class ScanSync:
    """Holds scans, in their order, until there is odometry after them."""

    def __init__(self, deskews: bool) -> None:
        self._deskews = deskews  # then the odometry of the sweep's end is needed, too
        self._waiting: deque[LaserScan] = deque()
        self._odometry = OdometryBuffer()
        self._stale = StaleOdometryFilter()
        self._newest_ns: int | None = None  # stamp of the odometry that came last

    def __len__(self) -> int:
        return len(self._waiting)

    def add_scan(self, scan: LaserScan) -> None:
        """Take in a scan that shall get its odometry."""
        self._waiting.append(scan)

    def add_odometry(self, message: WheelOdometry) -> bool:
        """Take in a reading; False if its stamp runs backwards (and it is ignored)."""
        if self._newest_ns is not None and message.stamp_ns < self._newest_ns:
            return False
        self._newest_ns = message.stamp_ns
        for sound in self._stale.add(message):
            self._odometry.add(sound)
        return True

    @property
    def has_odometry(self) -> bool:
        """Some odometry has come in."""
        return self._newest_ns is not None

    def pop(self) -> LaserScan | None:
        """The oldest scan, whatever is known of it."""
        return self._waiting.popleft() if self._waiting else None

    @property
    def stale(self) -> int:
        """Readings left out so far because they were older than their stamps said."""
        return self._stale.dropped

    def finish(self) -> None:
        """No more messages will come."""
        for sound in self._stale.flush():
            self._odometry.add(sound)

    def next(self, wait: bool) -> ScanWithOdometry | None:
        """The oldest scan that is ready; None if there is none.

        Without `wait`, no more odometry will come, and every scan is ready.
        """
        if not self._waiting:
            return None
        scan, late = self._waiting[0], False
        sweep = sweep_ns(scan) if self._deskews else 0
        end_ns = scan.stamp_ns + sweep
        if wait and (not self._odometry or self._odometry.last_ns < end_ns):
            if self._waiting[-1].stamp_ns - scan.stamp_ns < MAX_WAIT_NS:
                return None
            late = True
        self._waiting.popleft()
        if not self._odometry:
            return ScanWithOdometry(scan, Pose2(), (0.0, 0.0, 0.0), late)
        odom_T_base = self._odometry.at(scan.stamp_ns)
        moved = odom_T_base.between(self._odometry.at(end_ns)) if sweep else Pose2()
        return ScanWithOdometry(scan, odom_T_base, (moved.x(), moved.y(), moved.theta()), late)


@dataclass(frozen=True, eq=False, slots=True)
class StampedScan:
    """A scan with its odometry, and how far the wheels had come by then."""

    scan: LaserScan
    index: int  # among the scans of the log
    odom_T_base: Pose2
    path_m: float  # since the start of the log, by odometry
    path_rad: float
    speed: float  # m/s of the step that led here
    turn_rate: float  # rad/s
    unknown_s: float  # as in `ScanWithOdometry`
    broken_s: float


ZERO_BIAS = (0.0, 0.0)  # m/s and rad/s by which the odometry is suspected to be off


@dataclass(frozen=True, eq=False, slots=True)
class OdometryIncrement:
    """The motion by odometry from one stamped scan to a later one."""

    first: StampedScan
    last: StampedScan
    bias: tuple[float, float] = ZERO_BIAS

    @property
    def moved(self) -> Pose2:
        """first_T_last."""
        return self.first.odom_T_base.between(self.last.odom_T_base)

    @property
    def seconds(self) -> float:
        """Between the two scans."""
        return (self.last.scan.stamp_ns - self.first.scan.stamp_ns) * 1e-9

    @property
    def scans(self) -> int:
        """Scans of the log from one to the other."""
        return self.last.index - self.first.index

    @property
    def unknown_s(self) -> float:
        """Time (s) of which nothing tells how the robot moved."""
        broken = self.last.broken_s - self.first.broken_s
        return broken + self.first.unknown_s + self.last.unknown_s

    @property
    def path_m(self) -> float:
        """Length of the way, m."""
        return self.last.path_m - self.first.path_m

    @property
    def path_rad(self) -> float:
        """Turns on the way, rad without sign."""
        return self.last.path_rad - self.first.path_rad


def next_stamped_scan(
    scan: LaserScan, odom_T_base: Pose2, index: int, last: StampedScan | None,
    unknown_s: float = 0.0, broken_s: float = 0.0,
) -> StampedScan:  # fmt: skip
    """The stamped scan after `last`, which is None for the first of a log."""
    if last is None:
        return StampedScan(scan, index, odom_T_base, 0.0, 0.0, 0.0, 0.0, unknown_s, broken_s)
    step = last.odom_T_base.between(odom_T_base)
    # Stamps jitter by more than the time between them in some logs.
    seconds = (scan.stamp_ns - last.scan.stamp_ns) * 1e-9 + STAMP_JITTER_S
    length, turn = float(np.hypot(step.x(), step.y())), abs(step.theta())
    return StampedScan(
        scan, index, odom_T_base, last.path_m + length, last.path_rad + turn,
        length / seconds, turn / seconds, unknown_s, broken_s,
    )  # fmt: skip
