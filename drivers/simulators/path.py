"""Where a simulated robot is asked to go, and the motion with which it goes there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Leg:
    """A polyline driven without stopping on purpose; the robot halts at its end."""

    points: tuple[tuple[float, float], ...]  # m, world frame, at least two
    reverse: bool = False  # driven backwards, as out of a dead end

    def __post_init__(self) -> None:
        """Refuse a leg that leads nowhere."""
        if len(self.points) < 2 or math.dist(self.points[0], self.points[-1]) == 0.0 == self.length:
            raise ValueError("a leg needs two different points")

    @property
    def length(self) -> float:
        """Metres along the polyline."""
        return sum(math.dist(a, b) for a, b in pairwise(self.points))


@dataclass(frozen=True, kw_only=True, slots=True)
class MotionConfig:
    """How the P3-DX is driven: below its 1.2 m/s and 300 deg/s, at a pace fit for mapping."""

    speed: float = 0.6  # m/s, top speed on a straight
    acceleration: float = 0.3  # m/s^2, ARCOS default TRANSACCEL
    turn_rate: float = 0.8  # rad/s, top rate, also on the spot
    turn_acceleration: float = 1.7  # rad/s^2, about ARCOS default ROTACCEL of 100 deg/s^2
    lookahead: float = 0.4  # m, how far ahead on the path the robot aims
    turn_first: float = 0.9  # rad, off by more than this it turns before it drives on
    creep: float = 0.03  # m/s, slowest approach to the end of a leg
    rest_s: float = 1.0  # s, standing still at the start and at the end
    step_s: float = 0.02  # s, control period; truth is exact arcs of this length

    def __post_init__(self) -> None:
        """Refuse what cannot move."""
        if min(self.speed, self.acceleration, self.turn_rate, self.turn_acceleration) <= 0.0:
            raise ValueError("speeds and accelerations must be positive")
        if self.step_s <= 0.0 or self.lookahead <= 0.0 or self.rest_s < 0.0:
            raise ValueError("step_s and lookahead must be positive, rest_s not negative")


@dataclass(slots=True)
class _Motion:
    """State of the robot while a drive is planned."""

    x: float
    y: float
    theta: float
    speed: float = 0.0
    turn_rate: float = 0.0


def twists(path: tuple[Leg, ...], config: MotionConfig) -> tuple[tuple[float, float, float], Array]:
    """Drive along `path`: the first pose (x, y, theta) and (n, 2) speed and turn rate per step.

    A leg is cut where it bends by more than 100 degrees; the robot stops there and turns
    on the spot.  Gentler corners are rounded by aiming `lookahead` metres ahead.
    """
    (x, y), (next_x, next_y) = path[0].points[:2]
    theta = math.atan2(next_y - y, next_x - x) + (math.pi if path[0].reverse else 0.0)
    robot = _Motion(x, y, math.remainder(theta, math.tau))
    rest = [(0.0, 0.0)] * round(config.rest_s / config.step_s)
    start, rows = (robot.x, robot.y, robot.theta), list(rest)
    for leg in path:
        for piece in _cut_at_hairpins(leg):
            rows.extend(_follow(robot, piece, config))
    return start, np.array(rows + rest, dtype=np.float64).reshape(-1, 2)


def _cut_at_hairpins(leg: Leg) -> Iterator[Leg]:
    start = 0
    for i in range(1, len(leg.points) - 1):
        (ax, ay), (bx, by), (cx, cy) = leg.points[i - 1 : i + 2]
        bend = math.atan2(cy - by, cx - bx) - math.atan2(by - ay, bx - ax)
        if abs(math.remainder(bend, math.tau)) > math.radians(100.0):
            yield Leg(leg.points[start : i + 1], leg.reverse)
            start = i
    yield Leg(leg.points[start:], leg.reverse)


def _follow(robot: _Motion, leg: Leg, config: MotionConfig) -> Iterator[tuple[float, float]]:
    """Move `robot` to the end of `leg`, yielding speed and turn rate of each step."""
    samples = _sampled(leg, 0.02)
    end, heading = samples[-1], math.atan2(*(samples[-1] - samples[-2])[::-1])
    ahead = max(1, round(config.lookahead / 0.02))
    run_out = end + np.outer(np.arange(1, ahead + 1) * 0.02, [math.cos(heading), math.sin(heading)])
    track = [(float(px), float(py)) for px, py in np.vstack([samples, run_out])]
    nearest, last = 0, len(samples) - 1
    limit = int((60.0 + 20.0 * leg.length / config.speed) / config.step_s)
    for _ in range(limit):
        here = (robot.x, robot.y)
        while nearest < last and math.dist(track[nearest + 1], here) <= math.dist(
            track[nearest], here
        ):
            nearest += 1
        to_go = (last - nearest) * 0.02
        if nearest == last:
            to_go = (end[0] - robot.x) * math.cos(heading) + (end[1] - robot.y) * math.sin(heading)
            if to_go < 0.005:
                break
        aim_x, aim_y = track[nearest + ahead]
        bearing = math.atan2(aim_y - robot.y, aim_x - robot.x) - robot.theta
        error = math.remainder(bearing + (math.pi if leg.reverse else 0.0), math.tau)
        yield _advance(robot, error, to_go, -1.0 if leg.reverse else 1.0, config)
    else:
        raise ValueError(f"the robot cannot follow the leg that ends at {leg.points[-1]}")
    while robot.speed != 0.0 or robot.turn_rate != 0.0:
        yield _move(robot, 0.0, 0.0, config)


def _sampled(leg: Leg, spacing: float) -> Array:
    """Return points on the leg about `spacing` apart, (n, 2), both ends included."""
    pieces = [np.array(leg.points[:1])]
    for a, b in pairwise(leg.points):
        count = max(1, round(math.dist(a, b) / spacing))
        pieces.append(np.linspace(a, b, count + 1)[1:])
    return np.vstack(pieces)


def _advance(
    robot: _Motion, error: float, to_go: float, sense: float, config: MotionConfig
) -> tuple[float, float]:
    """Steer `robot` by `error` (rad), at a pace that still stops it after `to_go` metres."""
    # Braking is planned a third gentler than allowed, so that the steps never fall behind it.
    braking = math.sqrt(2.0 * 0.7 * config.acceleration * max(to_go, 0.0))
    pace = min(config.speed, braking) * max(0.0, 1.0 - abs(error) / config.turn_first)
    if abs(error) < 0.5 * config.turn_first:
        pace = max(pace, config.creep)
    turn = min(max(2.0 * error, -config.turn_rate), config.turn_rate)
    return _move(robot, sense * pace, turn, config)


def _move(
    robot: _Motion, speed: float, turn_rate: float, config: MotionConfig
) -> tuple[float, float]:
    """Move `robot` by one step, as near to the wanted speeds as its accelerations allow."""
    dt = config.step_s
    robot.speed = _towards(robot.speed, speed, config.acceleration * dt)
    robot.turn_rate = _towards(robot.turn_rate, turn_rate, config.turn_acceleration * dt)
    pose = along_arc(robot.x, robot.y, robot.theta, robot.speed * dt, robot.turn_rate * dt)
    robot.x, robot.y, robot.theta = pose
    return robot.speed, robot.turn_rate


def _towards(value: float, target: float, most: float) -> float:
    return value + min(max(target - value, -most), most)


def along_arc(
    x: float, y: float, theta: float, distance: float, turn: float
) -> tuple[float, float, float]:
    """Move a pose by `distance` m while turning by `turn` rad: the exponential map of SE(2)."""
    chord = distance * (math.sin(0.5 * turn) / (0.5 * turn) if abs(turn) > 1e-9 else 1.0)
    x += chord * math.cos(theta + 0.5 * turn)
    y += chord * math.sin(theta + 0.5 * turn)
    return x, y, math.remainder(theta + turn, math.tau)
