"""Motion commands under guard: limits, ramps and a dead-man's handle.  Off by default."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class MotionConfig:
    """How far software may move the robot; having one at all is the operator's consent."""

    speed_max: float = 0.4  # m/s
    turn_max: float = 0.6  # rad/s
    acceleration: float = 0.3  # m/s^2, ARCOS default TRANSACCEL
    turn_acceleration: float = 1.0  # rad/s^2
    dead_man_s: float = 0.5  # s without a new request until the robot is ramped to a stop
    period_s: float = 0.1  # s between commands, well within the robot's watchdog

    def __post_init__(self) -> None:
        """Refuse limits that are none."""
        if min(self.speed_max, self.turn_max, self.acceleration, self.turn_acceleration) <= 0.0:
            raise ValueError("limits of speed and acceleration must be positive")
        if not 0.0 < self.period_s < self.dead_man_s <= 2.0:
            raise ValueError("need 0 < period_s < dead_man_s <= 2 s, the robot's watchdog")


class MotionGuard:
    """Turns requests into ramped commands; pure, time is an argument in ns."""

    def __init__(self, config: MotionConfig) -> None:
        self.config = config
        self._wanted = (0.0, 0.0)
        self._current = (0.0, 0.0)
        self._requested_ns: int | None = None
        self._stepped_ns: int | None = None

    def request(self, speed: float, turn_rate: float, now_ns: int) -> None:
        """Ask for m/s and rad/s; must be repeated within `dead_man_s`.

        Raises:
            ValueError: if a number is not finite.
        """
        if not (math.isfinite(speed) and math.isfinite(turn_rate)):
            raise ValueError(f"cannot drive at {speed} m/s, {turn_rate} rad/s")
        config = self.config
        self._wanted = (
            min(max(speed, -config.speed_max), config.speed_max),
            min(max(turn_rate, -config.turn_max), config.turn_max),
        )
        self._requested_ns = now_ns

    def due(self, now_ns: int) -> tuple[int, int] | None:
        """Return the arguments of VEL (mm/s) and RVEL (deg/s) if it is time to send them."""
        if self._requested_ns is None:
            return None
        elapsed = self.config.period_s
        if self._stepped_ns is not None:
            elapsed = (now_ns - self._stepped_ns) * 1e-9
            if elapsed < self.config.period_s:
                return None
        self._stepped_ns = now_ns
        held = now_ns - self._requested_ns <= self.config.dead_man_s * 1e9
        speed, turn = self._wanted if held else (0.0, 0.0)
        # A gap in time is no licence for a leap in speed.
        elapsed = min(elapsed, 2.0 * self.config.period_s)
        self._current = (
            _towards(self._current[0], speed, self.config.acceleration * elapsed),
            _towards(self._current[1], turn, self.config.turn_acceleration * elapsed),
        )
        if not held and self._current == (0.0, 0.0):
            self._requested_ns = None
        return round(self._current[0] * 1000.0), round(math.degrees(self._current[1]))


def _towards(value: float, target: float, most: float) -> float:
    return value + min(max(target - value, -most), most)
