"""Pairs of scans with the wheels' step between them, taken from a log of any length.

At most a fixed number of pairs is kept, in blocks of neighbours spread evenly over the log:
when there are too many blocks, every second one goes.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from gtsam import Pose2

from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry
from slam.mapping.message_checks import validate_message

BLOCK = 6  # neighbours that are kept or dropped together
STEP_M, STEP_RAD = 0.3, 0.2  # by the wheels: then a pair is complete
STEP_S = 1.0  # likewise: wheels may stand or stall
STILL_M, STILL_RAD = 0.03, 0.03  # less is no motion
FARTHEST_M, FARTHEST_RAD = 1.0, 0.8  # no match is sure of itself over more
GAP_S = 0.5  # between two odometry readings that a scan lies between
_BEAMS_LIMIT = 8192
_WAITING = 256  # scans that wait for the odometry behind them


Speed = tuple[float, float]  # m/s without sign, rad/s with it


@dataclass(frozen=True, eq=False, slots=True)
class Pair:
    """Two scans, and the base's step from the first to the second by the wheels."""

    serial: int  # neighbours follow each other without a gap
    first: LaserScan
    second: LaserScan
    step: Pose2  # first_T_second of the base, by odometry
    distance_m: float  # along the path
    turn_rad: float
    seconds: float
    between: LaserScan | None = None  # taken about half-way
    speed: Speed = (0.0, 0.0)  # by the wheels at the first scan: what a late stamp is worth
    speed_after: Speed = (0.0, 0.0)  # likewise at the second


class Blocks:
    """Pairs in blocks, sampled evenly."""

    def __init__(self, most: int) -> None:
        self.seen = 0
        self._most, self._stride = most, 1
        self._blocks: list[list[Pair]] = []

    def add(self, pair: Pair) -> None:
        """Take in the next pair, whose serial number is `seen`."""
        block, place = divmod(pair.serial, BLOCK)
        self.seen = pair.serial + 1
        if block % self._stride:
            return
        if place == 0:
            self._blocks.append([])
        self._blocks[-1].append(pair)
        if len(self._blocks) > self._most:
            self._blocks = self._blocks[::2]
            self._stride *= 2

    def pairs(self) -> list[Pair]:
        """Return what was kept, in order."""
        return [pair for block in self._blocks for pair in block]


@dataclass(frozen=True, eq=False, slots=True)
class _Placed:
    scan: LaserScan
    pose: Pose2  # odom_T_base
    speed: Speed
    distance_m: float  # along the path, since the log began
    turn_rad: float


class PairCollector:
    """Takes in a log message by message; `moving` and `still` hold the pairs."""

    def __init__(self, most_moving: int = 100, most_still: int = 20) -> None:
        """Keep at most this many blocks."""
        self.extrinsics: LaserExtrinsics | None = None
        self.moving, self.still = Blocks(most_moving), Blocks(most_still)
        self._waiting: deque[LaserScan] = deque(maxlen=_WAITING)
        self._last: WheelOdometry | None = None
        self._start: _Placed | None = None
        self._before: _Placed | None = None
        self._since: list[LaserScan] = []  # the start, which are candidates for `between`

    def feed(self, message: Message) -> None:
        """Take in one message; unusable ones are passed over."""
        if isinstance(message, LaserExtrinsics) and not validate_message(message):
            self.extrinsics = message
        elif isinstance(message, LaserScan):
            if len(message.ranges) <= _BEAMS_LIMIT and not validate_message(message):
                self._waiting.append(message)
        elif isinstance(message, WheelOdometry) and not validate_message(message):
            self._odometry(message)

    def _odometry(self, odometry: WheelOdometry) -> None:
        last, self._last = self._last, odometry
        unbroken = last is not None and 0 < odometry.stamp_ns - last.stamp_ns <= GAP_S * 1e9
        if not unbroken:
            self._start = self._before = None
        while self._waiting and self._waiting[0].stamp_ns <= odometry.stamp_ns:
            scan = self._waiting.popleft()
            if last is not None and unbroken and scan.stamp_ns >= last.stamp_ns:
                pose = _between(last, odometry, scan.stamp_ns)
                self._place(scan, pose, _speed(last, odometry))

    def _place(self, scan: LaserScan, pose: Pose2, speed: Speed) -> None:
        before = self._before
        if before is None:
            self._start = self._before = _Placed(scan, pose, speed, 0.0, 0.0)
            self._since.clear()
            return
        if scan.stamp_ns <= before.scan.stamp_ns:
            return
        moved = before.pose.between(pose)
        here = self._before = _Placed(
            scan,
            pose,
            speed,
            before.distance_m + math.hypot(moved.x(), moved.y()),
            before.turn_rad + abs(moved.theta()),
        )
        start = self._start
        assert start is not None
        distance, turn = here.distance_m - start.distance_m, here.turn_rad - start.turn_rad
        seconds = (scan.stamp_ns - start.scan.stamp_ns) * 1e-9
        if distance < STEP_M and turn < STEP_RAD and seconds < STEP_S:
            self._since.append(scan)
            return
        self._start = here
        between = self._since[len(self._since) // 2] if self._since else None
        self._since.clear()
        if distance <= FARTHEST_M and turn <= FARTHEST_RAD and seconds <= 2.0 * STEP_S:
            stands = distance < STILL_M and turn < STILL_RAD
            blocks = self.still if stands else self.moving
            step = start.pose.between(pose)
            blocks.add(
                Pair(
                    blocks.seen, start.scan, scan, step, distance, turn, seconds, between,
                    start.speed, speed,
                )
            )  # fmt: skip


def _speed(last: WheelOdometry, odometry: WheelOdometry) -> Speed:
    """What the wheels did from one reading to the next."""
    seconds = (odometry.stamp_ns - last.stamp_ns) * 1e-9
    turn = math.remainder(odometry.theta - last.theta, math.tau)
    return math.hypot(odometry.x - last.x, odometry.y - last.y) / seconds, turn / seconds


def _between(last: WheelOdometry, odometry: WheelOdometry, stamp_ns: int) -> Pose2:
    """odom_T_base at a stamp between two readings."""
    start = Pose2(last.x, last.y, last.theta)
    share = (stamp_ns - last.stamp_ns) / (odometry.stamp_ns - last.stamp_ns)
    step = start.between(Pose2(odometry.x, odometry.y, odometry.theta))
    return start * Pose2.Expmap(share * Pose2.Logmap(step))
