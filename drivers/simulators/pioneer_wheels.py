"""What a simulated P3-DX makes of its setpoints: limits, headings to turn to, encoder counts."""

from __future__ import annotations

import math

from gtsam import Pose2
from slam.drivers.arcos_reports import EncoderReport
from slam.drivers.simulators.faults import TRACK_WIDTH_M
from slam.drivers.simulators.motion import Motion

_TICKS_PER_M = 128_000.0  # what users set (docs/devices.md, section 3)
_GAIN = 2.0  # 1/s, speed per metre or turn rate per rad that are left
_THERE_M, _THERE_RAD = 0.003, math.radians(0.3)


class Encoders:
    """Counts of both wheels since power-on, from the poses that they have led to."""

    def __init__(self, pose: Pose2) -> None:
        self._pose = pose
        self._left_m = self._right_m = 0.0

    def roll_to(self, pose: Pose2) -> None:
        """Roll on along the arc from the last pose, which must be less than half a turn."""
        step = self._pose.between(pose)
        turn = step.theta()
        chord = math.cos(0.5 * turn) * step.x() + math.sin(0.5 * turn) * step.y()
        arc = chord if turn == 0.0 else chord * 0.5 * turn / math.sin(0.5 * turn)
        self._left_m += arc - 0.5 * turn * TRACK_WIDTH_M
        self._right_m += arc + 0.5 * turn * TRACK_WIDTH_M
        self._pose = pose

    def report(self) -> EncoderReport:
        """Return the counts, which wrap at 32 bits."""
        return EncoderReport(_signed32(self._left_m), _signed32(self._right_m))


def _signed32(metres: float) -> int:
    return (round(metres * _TICKS_PER_M) + (1 << 31)) % (1 << 32) - (1 << 31)


class Wheels:
    """Setpoints of the controller: speeds, or a distance and a heading to be reached."""

    def __init__(self, motion: Motion, most: tuple[float, float], top: tuple[float, float]) -> None:
        """`most` and `top` are m/s and rad/s: the limits set, and those that cannot be."""
        self._motion, self._top = motion, top
        self._most = (min(most[0], top[0]), min(most[1], top[1]))
        self._speeds = (0.0, 0.0)
        self._way_m: float | None = None  # still to drive
        self._heading: float | None = None  # to turn to, of the odometry
        self._seen: Pose2 | None = None
        self._held = False

    def limit(self, speed: float | None, turn_rate: float | None) -> None:
        """Set the limits, within those of the controller."""
        self._most = (
            min(speed or self._most[0], self._top[0]),
            min(turn_rate or self._most[1], self._top[1]),
        )

    def go(self, now_s: float, speed: float | None = None, turn_rate: float | None = None) -> None:
        """Set m/s, rad/s or both; a distance or a heading that was asked for is given up."""
        if speed is not None:
            self._way_m = None
        if turn_rate is not None:
            self._heading = None
        wanted = (
            self._speeds[0] if speed is None else speed,
            self._speeds[1] if turn_rate is None else turn_rate,
        )
        self._set(now_s, wanted)

    def move(self, now_s: float, metres: float) -> None:
        """Drive so far at most speed."""
        self._way_m, self._seen = metres, self._pose(now_s)
        self.steer(now_s)

    def head(self, now_s: float, heading: float) -> None:
        """Turn to a heading of the odometry, rad."""
        self._heading = heading
        self.steer(now_s)

    def hold(self, now_s: float, held: bool) -> None:
        """Stand while held, by the watchdog; setpoints are resumed behind it (section 1.2)."""
        self._held = held
        self._set(now_s, self._speeds)

    def heading(self, now_s: float) -> float:
        """Return the heading of the odometry, rad."""
        return self._motion.odometry(now_s)[2]

    def wanted_heading(self, now_s: float) -> float:
        """Return the heading that is turned to, or the one of the moment."""
        return self.heading(now_s) if self._heading is None else self._heading

    def steer(self, now_s: float) -> None:
        """Come nearer to the distance and the heading that were asked for, if any."""
        speed, turn_rate = self._speeds
        if self._way_m is not None and self._seen is not None:
            pose = self._pose(now_s)
            self._way_m -= self._seen.between(pose).x()
            self._seen = pose
            speed = _GAIN * self._way_m
            if abs(self._way_m) < _THERE_M:
                self._way_m, speed = None, 0.0
        if self._heading is not None:
            left = math.remainder(self._heading - self.heading(now_s), math.tau)
            turn_rate = _GAIN * left
            if abs(left) < _THERE_RAD:
                self._heading, turn_rate = None, 0.0
        if (speed, turn_rate) != self._speeds:
            self._set(now_s, (speed, turn_rate))

    def _pose(self, now_s: float) -> Pose2:
        return Pose2(*self._motion.odometry(now_s))

    def _set(self, now_s: float, wanted: tuple[float, float]) -> None:
        bounds = zip(wanted, self._most, strict=True)
        speed, turn_rate = (min(max(value, -most), most) for value, most in bounds)
        self._speeds = (speed, turn_rate)
        if self._held:
            speed, turn_rate = 0.0, 0.0
        self._motion.command(now_s, speed, turn_rate)
