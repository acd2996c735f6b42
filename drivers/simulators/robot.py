"""A differential-drive robot: its true track, and the one its wheels believe in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from slam.drivers.simulators.path import Leg, MotionConfig, twists

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """A motion in equal time steps, each an arc; poses in between are exact."""

    step_s: float  # s
    poses: Array  # (n + 1, 3) x, y, theta at the step boundaries, theta not wrapped
    increments: Array  # (n, 3) m forward, m to the left, rad turned in each step

    @property
    def duration_s(self) -> float:
        """Seconds from the first pose to the last."""
        return len(self.increments) * self.step_s

    def at(self, times_s: Array) -> Array:
        """Return the (m, 3) poses at `times_s`, (m,) s since the start, theta in (-pi, pi].

        Before the start and after the end the robot stands still.
        """
        steps = np.clip(times_s / self.step_s, 0.0, float(len(self.increments)))
        whole = np.minimum(steps.astype(np.int64), len(self.increments) - 1)
        part = self.increments[whole] * (steps - whole)[:, None]
        poses = self.poses[whole] + _displacement(self.poses[whole, 2], part)
        poses[:, 2] = np.pi - (np.pi - poses[:, 2]) % (2.0 * np.pi)
        return poses


def track_of(start: tuple[float, float, float], increments: Array, step_s: float) -> Track:
    """Chain (n, 3) increments from `start` (x, y, theta) into a track."""
    theta = start[2] + np.concatenate([[0.0], np.cumsum(increments[:, 2])])
    moves = _displacement(theta[:-1], increments)
    poses = np.vstack([[start], np.asarray(start) + np.cumsum(moves, axis=0)])
    poses[:, 2] = theta
    return Track(step_s, poses, increments)


def _displacement(theta: Array, increments: Array) -> Array:
    """Return the (n, 3) change of x, y, theta when each increment starts at heading `theta`."""
    forward, left, turn = increments.T
    middle = theta + 0.5 * turn
    chord = np.sinc(0.5 * turn / np.pi)  # of an arc of length one; numpy's sinc has the pi in it
    x = chord * (forward * np.cos(middle) - left * np.sin(middle))
    y = chord * (forward * np.sin(middle) + left * np.cos(middle))
    return np.column_stack([x, y, turn])


def drive(path: tuple[Leg, ...], motion: MotionConfig | None = None) -> Track:
    """Return the true track `world_T_base` of a robot that is driven along `path`."""
    motion = motion or MotionConfig()
    start, speeds = twists(path, motion)
    increments = np.zeros((len(speeds), 3))
    increments[:, [0, 2]] = speeds * motion.step_s
    return track_of(start, increments, motion.step_s)


def to_and_fro(track: Track, passes: int) -> Track:
    """Return a drive along `track` and back in reverse, as many times in all as there are passes.

    Raises:
        ValueError: for less than one pass.
    """
    if passes < 1:
        raise ValueError(f"a drive has a pass at least, got {passes}")
    back = -track.increments[::-1]
    parts = [back if k % 2 else track.increments for k in range(passes)]
    x, y, theta = track.poses[0].tolist()
    return track_of((x, y, theta), np.concatenate(parts), track.step_s)


@dataclass(frozen=True, kw_only=True, slots=True)
class OdometryNoise:
    """How far dead reckoning strays; the scale and drift errors are drawn once a drive.

    No controlled figure for the P3-DX is known: 0.75 % is what its vendor's simulator
    assumes, 3 % and 5 % what Stage does (docs/devices.md, section 3).
    """

    distance_scale: float = 0.015  # m per m, sigma of the scale error (wheel size)
    turn_scale: float = 0.02  # rad per rad, sigma of the scale error (wheel base)
    drift: float = 0.003  # rad per m, sigma of the pull to one side (unequal wheels); our estimate
    distance_random: float = 0.015  # m per root m, sigma of the random part
    turn_random: float = 0.02  # rad per root rad, sigma of the random part
    heading_random: float = 0.003  # rad per root m, sigma of the random part; our estimate
    quantum_m: float = 0.001  # m, an ARCOS packet gives whole millimetres
    quantum_rad: float = 2.0 * np.pi / 4096.0  # rad, AngleConvFactor 0.001534

    def __post_init__(self) -> None:
        """Refuse negative spreads."""
        if min(getattr(self, name) for name in self.__slots__) < 0.0:
            raise ValueError(f"noise cannot be negative: {self}")


ODOMETRY_NOISE: Mapping[str, OdometryNoise] = MappingProxyType(
    {
        "none": OdometryNoise(
            distance_scale=0.0,
            turn_scale=0.0,
            drift=0.0,
            distance_random=0.0,
            turn_random=0.0,
            heading_random=0.0,
            quantum_m=0.0,
            quantum_rad=0.0,
        ),
        "optimistic": OdometryNoise(
            distance_scale=0.0075,
            turn_scale=0.0075,
            drift=0.001,
            distance_random=0.0075,
            turn_random=0.0075,
            heading_random=0.001,
        ),
        "typical": OdometryNoise(),
        "pessimistic": OdometryNoise(
            distance_scale=0.03,
            turn_scale=0.05,
            drift=0.01,
            distance_random=0.03,
            turn_random=0.05,
            heading_random=0.01,
        ),
    }
)


def wheel_increments(truth: Track, noise: OdometryNoise, rng: np.random.Generator) -> Array:
    """Return what the wheels measured in each step of `truth`, (n, 3), before quantisation."""
    scale, turn_scale, drift = rng.standard_normal(3) * [
        noise.distance_scale,
        noise.turn_scale,
        noise.drift,
    ]
    random = rng.standard_normal((len(truth.increments), 3))
    distance, turn = truth.increments[:, 0], truth.increments[:, 2]
    root_m, root_rad = np.sqrt(np.abs(distance)), np.sqrt(np.abs(turn))
    measured = np.zeros_like(truth.increments)
    measured[:, 0] = distance * (1.0 + scale) + noise.distance_random * root_m * random[:, 0]
    measured[:, 2] = turn * (1.0 + turn_scale) + drift * np.abs(distance)
    measured[:, 2] += noise.turn_random * root_rad * random[:, 1]
    measured[:, 2] += noise.heading_random * root_m * random[:, 2]
    return measured


def quantised(poses: Array, noise: OdometryNoise) -> Array:
    """Round (n, 3) odometry poses to what a packet can carry."""
    quanta = np.array([noise.quantum_m, noise.quantum_m, noise.quantum_rad])
    steps = np.where(quanta > 0.0, quanta, 1.0)
    return np.where(quanta > 0.0, np.round(poses / steps) * steps, poses)
