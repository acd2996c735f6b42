"""How a simulated robot moves: along a planned track, or as it is commanded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from slam.drivers.simulators.drive import dead_reckoning
from slam.drivers.simulators.faults import OdometryFault
from slam.drivers.simulators.path import MotionConfig, along_arc
from slam.drivers.simulators.robot import ODOMETRY_NOISE, OdometryNoise, Track, drive
from slam.drivers.simulators.worlds import Scenario

Array = NDArray[np.float64]
Pose = tuple[float, float, float]  # x, y (m), theta (rad)


class Motion(Protocol):
    """The robot's body, shared by the simulated controller and the simulated laser.

    Times are seconds of simulation.
    """

    def truth(self, times_s: Array) -> Array:
        """Return `world_T_base` at (n,) times, (n, 3)."""
        ...

    def odometry(self, time_s: float) -> Pose:
        """Return `odom_T_base` as the wheels have it."""
        ...

    def speeds(self, time_s: float) -> tuple[float, float]:
        """Return m/s and rad/s as the wheels have them."""
        ...

    def command(self, time_s: float, speed: float, turn_rate: float) -> None:
        """Take the controller's setpoints, m/s and rad/s."""
        ...

    def power(self, time_s: float, on: bool) -> None:
        """Give the wheels power, or take it: then the robot stands."""
        ...


class TrackMotion:
    """Driven by somebody at the joystick: along a track, whatever is commanded."""

    def __init__(self, truth: Track, wheels: Track, starts_s: float = 0.0) -> None:
        """Stand still until `starts_s`; `wheels` is what dead reckoning makes of `truth`."""
        self.starts_s = starts_s
        self._truth, self._wheels = truth, wheels
        self._stands: list[list[float]] = []  # begin and end, s of simulation

    @property
    def ends_s(self) -> float:
        """When the robot has arrived, s of simulation."""
        return self.starts_s + self._truth.duration_s + sum(b - a for a, b in self._stands)

    def _driven_s(self, times_s: Array) -> Array:
        """Return how long the robot has been driving, s."""
        driven = times_s - self.starts_s
        for begin, end in self._stands:
            driven = driven - np.clip(times_s - begin, 0.0, end - begin)
        return driven

    def truth(self, times_s: Array) -> Array:
        """See `Motion`."""
        return self._truth.at(self._driven_s(times_s))

    def odometry(self, time_s: float) -> Pose:
        """See `Motion`."""
        x, y, theta = self._wheels.at(self._driven_s(np.array([time_s])))[0].tolist()
        return x, y, theta

    def speeds(self, time_s: float) -> tuple[float, float]:
        """See `Motion`."""
        if any(begin <= time_s < end for begin, end in self._stands):
            return 0.0, 0.0
        step = math.floor(float(self._driven_s(np.array([time_s]))[0]) / self._wheels.step_s)
        if not 0 <= step < len(self._wheels.increments):
            return 0.0, 0.0
        forward, _, turn = self._wheels.increments[step].tolist()
        return forward / self._wheels.step_s, turn / self._wheels.step_s

    def command(self, time_s: float, speed: float, turn_rate: float) -> None:
        """The joystick wins."""

    def power(self, time_s: float, on: bool) -> None:
        """See `Motion`; the drive goes on where it was when power is back."""
        standing = bool(self._stands) and self._stands[-1][1] == math.inf
        if not on and not standing:
            self._stands.append([time_s, math.inf])
        elif on and standing:
            self._stands[-1][1] = time_s


def scenario_motion(
    scenario: Scenario,
    noise: OdometryNoise = ODOMETRY_NOISE["typical"],
    seed: int = 0,
    faults: Sequence[OdometryFault] = (),
    *,
    motion: MotionConfig | None = None,
    starts_s: float = 0.0,
) -> TrackMotion:
    """Return the drive through a scenario, with the noise and the faults of its wheels."""
    truth = drive(scenario.path, motion)
    return TrackMotion(truth, dead_reckoning(truth, noise, seed, faults), starts_s)


class CommandedMotion:
    """Obeys setpoints with the accelerations of the firmware; there are no walls to hit."""

    STEP_S = 0.01  # s; poses in between are those of the step before

    def __init__(self, start: Pose = (0.0, 0.0, 0.0), config: MotionConfig | None = None) -> None:
        self._config = config or MotionConfig()
        self._poses = [start]  # one a step
        self._speeds = (0.0, 0.0)
        self._wanted = (0.0, 0.0)

    def truth(self, times_s: Array) -> Array:
        """See `Motion`."""
        self._advance(float(times_s.max(initial=0.0)))
        steps = np.clip((times_s / self.STEP_S).astype(np.int64), 0, len(self._poses) - 1)
        return np.array([self._poses[step] for step in steps.tolist()])

    def odometry(self, time_s: float) -> Pose:
        """See `Motion`."""
        x, y, theta = self.truth(np.array([time_s]))[0].tolist()
        return x, y, theta

    def speeds(self, time_s: float) -> tuple[float, float]:
        """See `Motion`."""
        self._advance(time_s)
        return self._speeds

    def command(self, time_s: float, speed: float, turn_rate: float) -> None:
        """See `Motion`."""
        self._advance(time_s)
        self._wanted = (speed, turn_rate)

    def power(self, time_s: float, on: bool) -> None:
        """See `Motion`."""
        if not on:
            self.command(time_s, 0.0, 0.0)

    def _advance(self, time_s: float) -> None:
        config, dt = self._config, self.STEP_S
        while len(self._poses) * dt <= time_s:
            speed = _towards(self._speeds[0], self._wanted[0], config.acceleration * dt)
            turn = _towards(self._speeds[1], self._wanted[1], config.turn_acceleration * dt)
            self._speeds = (speed, turn)
            self._poses.append(along_arc(*self._poses[-1], speed * dt, turn * dt))


def _towards(value: float, target: float, most: float) -> float:
    return value + min(max(target - value, -most), most)
