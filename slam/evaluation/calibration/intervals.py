"""Pieces of a drive over which wheels and laser can be compared, matched without the wheels' say.

A match with a prior leans towards the odometry, so that every error of the wheels would look
smaller than it is: these have none.  The wheels give the start of the search alone.  For the same
reason an interval ends at a time that was fixed at its start, by the speed before: intervals of
equal length by the wheels would be those in which the wheels count too much.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.evaluation.calibration.odometry_track import OdometryTrack
from slam.frontend.deskew import deskew, sweep_ns
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan, ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry
from slam.mapping.calibration import CalibrationConfig
from slam.mapping.message_checks import validate_message
from slam.mapping.odometry import OdometryBuffer

Array = NDArray[np.float64]

LENGTH_M, TURN_RAD = 0.5, 0.35  # planned for an interval: far over a match's error, much in view
LONGEST_S = 2.0  # of an interval: a robot that stands may start
AMPLE_M, AMPLE_RAD = 1.0, 0.7  # ends an interval before its time, after a sudden start
FARTHEST_M, FARTHEST_RAD = 1.6, 1.0  # where scans are sparse; no match is sure of itself over more
SPARSE_S = 15.0  # between two scans: the laser was off
STILL_M, STILL_RAD = 0.03, 0.03  # by wheels and laser: shows nothing
MARGIN_S = 1.2  # of odometry on both sides of a scan: the time offset looked for
GAP_S = 1.5  # between two readings within an interval
_INLIERS, _PAIR_INLIERS = 0.5, 0.6
_SEES_M = 0.02  # sigma along the axis that the scans see worst: no corridors
_NO_MOUNT = LaserExtrinsics(0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Interval:
    """The laser's motion between two scans."""

    start_s: float  # since the first reading of the odometry
    end_s: float
    motion: tuple[float, float, float]  # first_T_second of the laser: x, y (m), theta (rad)
    covariance: Array  # (3, 3) of it, in the second frame


@dataclass(frozen=True, eq=False, slots=True)
class DriveData:
    """What a calibration is made from."""

    track: OdometryTrack
    intervals: list[Interval]
    stated: LaserExtrinsics  # where the log says that the laser sits
    scans: int
    unmatched: int  # intervals whose scans do not determine the motion
    sweeps: int = 0  # of the scans that were compared, with timing


@dataclass(frozen=True, eq=False, slots=True)
class _Placed:
    scan: PreparedScan
    pose: Pose2  # odom_T_base
    stamp_ns: int


class IntervalCollector:
    """Messages in file order; scans are matched as soon as an interval is complete."""

    def __init__(
        self,
        matcher: MatchConfig | None = None,
        scan: ScanConfig | None = None,
        known: CalibrationConfig | None = None,
        most: int | None = None,
    ) -> None:
        """Collect with settings of a run.

        Args:
            matcher: how scans are matched.
            scan: how they are prepared.
            known: with which the motion within a sweep is taken out of it: wheels that pull to
                one side turn each sweep, which looks like a laser that is mounted turned.
            most: intervals, after which nothing more is taken in; None: as many as there are.
        """
        self._most = most
        self.sweeps = 0  # scans with timing
        self._known = known or CalibrationConfig()
        self.unmatched = self.scans = 0
        self._intervals: list[tuple[int, int, Pose2, Array]] = []
        self._matcher, self._scan_config = matcher or MatchConfig(), scan or ScanConfig()
        self._stamps: list[int] = []
        self._poses: list[tuple[float, float, float]] = []
        self._buffer = OdometryBuffer()
        self._waiting: deque[LaserScan] = deque()
        self._start: _Placed | None = None
        self._due_ns = 0  # when the interval that has begun shall end
        self._stated = _NO_MOUNT
        self._gap_ns = 0  # end of the last gap in the odometry

    def feed(self, message: Message) -> None:
        """Take in one message; what cannot be used is passed over."""
        if self._most is not None and len(self._intervals) >= self._most:
            return
        if validate_message(message):
            return
        if isinstance(message, LaserExtrinsics):
            self._stated = message
        elif isinstance(message, LaserScan):
            self.scans += 1
            self._waiting.append(message)
        elif isinstance(message, WheelOdometry):
            self._odometry(message)

    def data(self) -> DriveData:
        """All that came so far."""
        stamps = np.array(self._stamps, dtype=np.int64)
        zero = int(stamps[0]) if len(stamps) else 0
        times_s = (stamps - zero).astype(np.float64) * 1e-9
        track = OdometryTrack(times_s, np.array(self._poses).reshape(-1, 3))
        intervals = [
            Interval(
                (start - zero) * 1e-9, (end - zero) * 1e-9, (at.x(), at.y(), at.theta()), covariance
            )
            for start, end, at, covariance in self._intervals
        ]
        return DriveData(
            track, intervals, self._stated, self.scans, self.unmatched, self.sweeps
        )  # fmt: skip

    def _odometry(self, message: WheelOdometry) -> None:
        if self._stamps and message.stamp_ns <= self._stamps[-1]:
            return  # the first reading of a stamp counts
        if self._stamps and message.stamp_ns - self._stamps[-1] > GAP_S * 1e9:
            self._gap_ns = message.stamp_ns
        self._stamps.append(message.stamp_ns)
        self._poses.append((message.x, message.y, message.theta))
        self._buffer.add(message)
        while self._waiting and self._latest_ns(self._waiting[0]) <= message.stamp_ns:
            self._place(self._waiting.popleft())

    def _latest_ns(self, scan: LaserScan) -> int:
        return scan.stamp_ns + sweep_ns(scan) + round(MARGIN_S * 1e9)

    def _place(self, scan: LaserScan) -> None:
        if scan.stamp_ns - MARGIN_S * 1e9 < self._stamps[0]:
            return
        start, pose = self._start, self._buffer.at(scan.stamp_ns)
        if start is not None and scan.stamp_ns <= start.stamp_ns:
            return
        if start is None or self._gap_ns > start.stamp_ns:
            self._begin(self._placed(scan, pose), LONGEST_S)
            return
        moved = start.pose.between(pose)
        length, turn = _size(moved)
        if scan.stamp_ns < self._due_ns and length < AMPLE_M and turn < AMPLE_RAD:
            return
        here = self._placed(scan, pose)
        seconds = (scan.stamp_ns - start.stamp_ns) * 1e-9
        seen = None
        if length < FARTHEST_M and turn < FARTHEST_RAD and seconds < SPARSE_S:
            seen = self._match(start, here, moved)
        self._begin(here, planned_s(seen or moved, seconds))

    def _begin(self, start: _Placed, seconds: float) -> None:
        self._start, self._due_ns = start, start.stamp_ns + round(seconds * 1e9)

    def _placed(self, scan: LaserScan, pose: Pose2) -> _Placed:
        if sweep := sweep_ns(scan):
            self.sweeps += 1
            scan = deskew(scan, self._known.mount(self._stated), self._moved(scan.stamp_ns, sweep))
        return _Placed(prepare(scan, _NO_MOUNT, self._scan_config), pose, scan.stamp_ns)

    def _moved(self, stamp_ns: int, sweep: int) -> tuple[float, float, float]:
        """x, y (m) and theta (rad) of the base during a sweep, by the odometry as it is known."""
        then_ns = stamp_ns - round(self._known.time_offset_s * 1e9)
        step = self._buffer.at(then_ns).between(self._buffer.at(then_ns + sweep))
        moved = self._known.true_step(step)
        return moved.x(), moved.y(), moved.theta()

    def _match(self, start: _Placed, end: _Placed, moved: Pose2) -> Pose2 | None:
        """The laser's motion, which is kept; None where the scans do not determine it."""
        base_T_laser = Pose2(self._stated.x, self._stated.y, self._stated.theta)
        guess = base_T_laser.inverse() * moved * base_T_laser
        found = match([Reference(Pose2(), start.scan)], end.scan, guess, self._matcher)
        sees = found.converged and found.inlier_fraction >= _INLIERS
        sees = sees and found.pair_inlier_fraction >= _PAIR_INLIERS
        if not sees or np.linalg.eigvalsh(found.covariance[:2, :2])[-1] > _SEES_M**2:
            self.unmatched += 1
            return None
        if not (_stands(moved) and _stands(found.target_T_source)):
            self._intervals.append(
                (start.stamp_ns, end.stamp_ns, found.target_T_source, found.covariance)
            )
        return found.target_T_source


def planned_s(step: Pose2, seconds: float) -> float:
    """How long the next interval shall last, by the last step and the time it took."""
    length, turn = _size(step)
    share = max(length / LENGTH_M, turn / TURN_RAD)  # of an interval that the step made
    return min(seconds / share, LONGEST_S) if share > 0.0 else LONGEST_S


def _size(step: Pose2) -> tuple[float, float]:
    return math.hypot(step.x(), step.y()), abs(step.theta())


def _stands(step: Pose2) -> bool:
    length, turn = _size(step)
    return length < STILL_M and turn < STILL_RAD
