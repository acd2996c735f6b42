"""Finds odometry that is older than its stamp says, by the jump back and forth that it makes.

Loggers take the last pose that they have: now and then one is seconds old.  The robot seems to be
back at a place that it left a while ago, and at the next reading where it belongs.  A robot that
really goes back passes what lies between, and goes on from there.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence

from gtsam import Pose2

from slam.logs.messages import WheelOdometry

# s; what is younger is jitter of stamps (to 0.9 s in logs that come in bursts), and a pose that is
# right at a stamp that is not must not be left out.
LEAST_AGE_S = 0.9
GREATEST_AGE_S = 5.0  # s of the way that are remembered
# How near to the way driven a stale pose lies: between two readings the way is taken as straight.
ON_THE_WAY_M, ON_THE_WAY_RAD = 0.02, 0.02
# A shorter jump is left to the scan match, whose prior is as wide.
LEAST_JUMP_M, LEAST_JUMP_RAD = 0.03, 0.03


class StaleOdometryFilter:
    """Hands readings on in their order, but for stale ones; one in doubt waits for the next."""

    def __init__(self) -> None:
        self._way: deque[WheelOdometry] = deque()  # that the readings handed on describe
        self._held: WheelOdometry | None = None
        self.dropped = 0

    def add(self, reading: WheelOdometry) -> Sequence[WheelOdometry]:
        """The readings that are now known to be sound; none while this one is in doubt."""
        held, self._held = self._held, None
        if held is not None:
            if self._returns(held, reading):
                self.dropped += 1
                held = None
            else:
                self._hand_on(held)
        if self._is_back(reading):
            self._held = reading
            return [] if held is None else [held]
        self._hand_on(reading)
        return [reading] if held is None else [held, reading]

    def flush(self) -> Sequence[WheelOdometry]:
        """The reading that waits: no other will come."""
        held, self._held = self._held, None
        return [] if held is None else [held]

    def _hand_on(self, reading: WheelOdometry) -> None:
        self._way.append(reading)
        while reading.stamp_ns - self._way[0].stamp_ns > GREATEST_AGE_S * 1e9:
            self._way.popleft()

    def _is_back(self, reading: WheelOdometry) -> bool:
        """Whether it is where the robot was a while ago, and no longer is."""
        if not self._way:
            return False
        x, y, turn = _step(pose_of(self._way[-1]), pose_of(reading))
        if math.hypot(x, y) < LEAST_JUMP_M and abs(turn) < LEAST_JUMP_RAD:
            return False
        until_ns = reading.stamp_ns - round(LEAST_AGE_S * 1e9)
        return any(_lies_between(a, b, pose_of(reading)) for a, b in self._legs(until_ns))

    def _legs(self, until_ns: int) -> Iterator[tuple[Pose2, Pose2]]:
        before: WheelOdometry | None = None
        for reading in self._way:
            if reading.stamp_ns > until_ns:
                return
            if before is not None:
                yield pose_of(before), pose_of(reading)
            before = reading

    def _returns(self, held: WheelOdometry, reading: WheelOdometry) -> bool:
        """Whether the robot comes back from where the held reading has it."""
        back = _step(pose_of(held), pose_of(reading))
        onward = _step(pose_of(self._way[-1]), pose_of(reading))
        return _size(onward) < _size(back)  # one that was reset goes on in small steps


def pose_of(reading: WheelOdometry) -> Pose2:
    """odom_T_base."""
    return Pose2(reading.x, reading.y, reading.theta)


def _step(a: Pose2, b: Pose2) -> tuple[float, float, float]:
    step = a.between(b)
    return step.x(), step.y(), step.theta()


def _size(step: tuple[float, float, float]) -> float:
    """Of a step, with a radian as long as half a metre."""
    return math.hypot(step[0], step[1], 0.5 * step[2])


def _lies_between(a: Pose2, b: Pose2, pose: Pose2) -> bool:
    """Whether a robot that goes straight from a to b passes the pose."""
    x, y, turn = _step(a, b)
    to_x, to_y, to_turn = _step(a, pose)
    length2 = x * x + y * y + turn * turn
    share = (x * to_x + y * to_y + turn * to_turn) / length2 if length2 else 0.0
    share = min(max(share, 0.0), 1.0)
    off = math.hypot(to_x - share * x, to_y - share * y)
    return off <= ON_THE_WAY_M and abs(to_turn - share * turn) <= ON_THE_WAY_RAD
