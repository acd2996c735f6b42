"""Traits of real recordings put upon a simulated drive, message by message.

Each function takes the messages of a drive in order and gives them changed; equal arguments give
equal bits.  Truth is left alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.logs.messages import LaserExtrinsics, LaserScan, SensorMessage, WheelOdometry

Array = NDArray[np.float64]
NS = 1_000_000_000
BODY_M = 0.2  # radius of a person as a laser at knee or hip height meets them
_PEOPLE, _NOTHING, _STALE, _TAILS = 11, 12, 13, 14  # streams of chance, apart from a drive's own


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody who walks along: where they keep themselves, in the robot's frame."""

    x: float  # m ahead
    y: float  # m to the left
    jitter: float = 0.02  # m, one sigma, from scan to scan


def with_people(
    messages: Iterable[SensorMessage], people: Sequence[Person], seed: int, sigma: float = 0.01
) -> Iterator[SensorMessage]:
    """Put people who walk along with the robot into every scan; `sigma` is its range noise, m."""
    rng = np.random.default_rng([seed, _PEOPLE])
    mount = Pose2()
    for message in messages:
        if isinstance(message, LaserExtrinsics):
            mount = Pose2(message.x, message.y, message.theta)
        if not isinstance(message, LaserScan):
            yield message
            continue
        ranges: Array = message.ranges.astype(np.float64)
        bearings = np.asarray(
            message.angle_min + message.angle_step * np.arange(len(ranges)), dtype=np.float64
        )
        for person in people:
            at = np.array([person.x, person.y]) + person.jitter * rng.standard_normal(2)
            seen = mount.transformTo(at)
            hit = _disc(bearings, float(seen[0]), float(seen[1]), BODY_M)
            hit += sigma * rng.standard_normal(len(hit))
            nearer = hit < message.range_max
            ranges[nearer] = np.fmin(ranges, hit)[nearer]
        ranges[ranges < message.range_min] = np.nan
        yield replace(message, ranges=ranges.astype(np.float32))


def _disc(bearings: Array, x: float, y: float, radius: float) -> Array:
    """Range along each bearing to a disc at (x, y), inf where the beam misses it."""
    distance, bearing = math.hypot(x, y), math.atan2(y, x)
    across = distance * np.sin(bearings - bearing)
    along = distance * np.cos(bearings - bearing)
    with np.errstate(invalid="ignore"):
        near = along - np.sqrt(radius**2 - across**2)
    return np.where((np.abs(across) < radius) & (near > 0.0), near, np.inf)


def with_nothing_code(
    messages: Iterable[SensorMessage], code: float, share: float, seed: int
) -> Iterator[SensorMessage]:
    """Report `share` of the beams that brought nothing back as a wall at `code` metres."""
    rng = np.random.default_rng([seed, _NOTHING])
    for message in messages:
        if not isinstance(message, LaserScan):
            yield message
            continue
        ranges = message.ranges.copy()
        coded = rng.random(len(ranges)) < share
        ranges[np.isinf(ranges) & coded] = code
        yield replace(message, ranges=ranges)


def with_stale_odometry(
    messages: Iterable[SensorMessage],
    share: float,
    seed: int,
    lag_s: float = 0.08,
    stale_s: tuple[float, float] = (1.0, 3.0),
) -> Iterator[SensorMessage]:
    """Give odometry out under later stamps than its own, as loggers do that embed it in scans.

    All of it is `lag_s` old, and `share` of it a uniform draw from `stale_s` seconds.
    """  # fmt: skip
    rng = np.random.default_rng([seed, _STALE])
    past: list[WheelOdometry] = []
    for message in messages:
        if not isinstance(message, WheelOdometry):
            yield message
            continue
        past.append(message)
        stale, age = rng.random() < share, rng.uniform(*stale_s)
        old = message.stamp_ns - round((age if stale else lag_s) * NS)
        while len(past) > 1 and past[0].stamp_ns < message.stamp_ns - round(1.5 * stale_s[1] * NS):
            past.pop(0)
        then = max(
            (m for m in past if m.stamp_ns <= old), key=lambda m: m.stamp_ns, default=past[0]
        )
        yield replace(then, stamp_ns=message.stamp_ns)


def with_heavy_tails(
    messages: Iterable[SensorMessage], seed: int, turn: float = 0.03, freedom: float = 2.0
) -> Iterator[SensorMessage]:
    """Add heading errors with heavy tails to odometry: `turn` rad per root metre, Student's t.

    Two degrees of freedom: one error in a hundred is seven times the usual.
    """
    rng = np.random.default_rng([seed, _TAILS])
    before: WheelOdometry | None = None
    told = Pose2()
    for message in messages:
        if not isinstance(message, WheelOdometry):
            yield message
            continue
        if before is None:
            told = Pose2(message.x, message.y, message.theta)
        else:
            moved = _pose(before).between(_pose(message))
            way = math.sqrt(math.hypot(moved.x(), moved.y()))
            error = turn * way * float(rng.standard_t(freedom))
            told = told * Pose2(moved.x(), moved.y(), moved.theta() + error)
        before = message
        yield WheelOdometry(message.stamp_ns, told.x(), told.y(), told.theta())


def _pose(odometry: WheelOdometry) -> Pose2:
    return Pose2(odometry.x, odometry.y, odometry.theta)


def with_sparse_scans(
    messages: Iterable[SensorMessage], spacing_m: float, spacing_s: float
) -> Iterator[SensorMessage]:
    """Keep a scan only after so many metres (by odometry) and seconds; its truth stays, too."""
    latest: WheelOdometry | None = None
    kept: tuple[Pose2, int] | None = None
    for message in messages:
        if isinstance(message, WheelOdometry):
            latest = message
        if isinstance(message, LaserScan):
            here = _pose(latest) if latest else Pose2()
            if kept is not None:
                moved = kept[0].between(here)
                if math.hypot(moved.x(), moved.y()) < spacing_m:
                    continue
                if message.stamp_ns - kept[1] < spacing_s * NS:
                    continue
            kept = here, message.stamp_ns
        yield message


def with_creeping_heading(
    messages: Iterable[SensorMessage], rate: float
) -> Iterator[SensorMessage]:
    """Let the odometry's heading creep by `rate` (rad/s) all the time, also at rest."""
    before: WheelOdometry | None = None
    told = Pose2()
    for message in messages:
        if not isinstance(message, WheelOdometry):
            yield message
            continue
        if before is None:
            told = _pose(message)
        else:
            moved = _pose(before).between(_pose(message))
            crept = rate * (message.stamp_ns - before.stamp_ns) / NS
            told = told * Pose2(moved.x(), moved.y(), moved.theta() + crept)
        before = message
        yield WheelOdometry(message.stamp_ns, told.x(), told.y(), told.theta())
