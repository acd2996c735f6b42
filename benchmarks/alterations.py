"""Real logs made worse on purpose: each function takes a log's messages and gives them altered.

Nothing is drawn but from the seed: equal arguments give equal messages.  The truth of the log
still holds, but for `mirrored`, whose result is to be mirrored back (`mirrored_back`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.drivers.simulators.traits import with_stale_odometry
from slam.logs.messages import LaserExtrinsics, LaserScan, Message, WheelOdometry

NS = 1_000_000_000
Messages = Sequence[Message]
Alteration = Callable[[Messages, int], list[Message]]  # messages, seed


def odometry_withheld(
    messages: Messages, seed: int, places: int = 10, seconds: float = 3.0
) -> list[Message]:
    """Leave the odometry out at so many places, drawn by chance."""
    stamps = [m.stamp_ns for m in messages if isinstance(m, WheelOdometry)]
    begins = np.random.default_rng(seed).choice(stamps[1:-1], places, replace=False)
    gaps = [(int(begin), int(begin) + round(seconds * NS)) for begin in np.sort(begins)]
    return [
        m for m in messages
        if not isinstance(m, WheelOdometry) or not any(a <= m.stamp_ns < b for a, b in gaps)
    ]  # fmt: skip


def odometry_changed(
    messages: Messages, seed: int, scale: float = 1.0, yaw_per_m: float = 0.0
) -> list[Message]:
    """Scale the way of every step, and turn the robot by so many rad for each metre of it."""

    def changed(step: Pose2) -> Pose2:
        way = math.hypot(step.x(), step.y())
        return Pose2(scale * step.x(), scale * step.y(), step.theta() + yaw_per_m * way)

    return _with_steps(messages, lambda step, _: changed(step))


def _with_steps(messages: Messages, change: Callable[[Pose2, int], Pose2]) -> list[Message]:
    """Chain the odometry anew from changed steps; `change` also gets the stamp of their ends."""
    altered: list[Message] = []
    before: Pose2 | None = None
    told = Pose2()
    for message in messages:
        if not isinstance(message, WheelOdometry):
            altered.append(message)
            continue
        here = Pose2(message.x, message.y, message.theta)
        step = before.between(here) if before else None
        told = told * change(step, message.stamp_ns) if step else here
        before = here
        altered.append(WheelOdometry(message.stamp_ns, told.x(), told.y(), told.theta()))
    return altered


def every_nth_scan(messages: Messages, seed: int, n: int = 3) -> list[Message]:
    """Keep the first of every `n` scans."""
    altered: list[Message] = []
    count = 0
    for message in messages:
        if isinstance(message, LaserScan):
            count += 1
            if (count - 1) % n:
                continue
        altered.append(message)
    return altered


def ranges_cut(messages: Messages, seed: int, reach: float = 8.0) -> list[Message]:
    """A laser that reaches so many metres; farther walls bring nothing back."""

    def cut(scan: LaserScan) -> LaserScan:
        ranges = np.where(scan.ranges > reach, np.float32(np.inf), scan.ranges)
        return replace(scan, ranges=ranges, range_max=min(scan.range_max, reach))

    return [cut(m) if isinstance(m, LaserScan) else m for m in messages]


def beams_deleted(messages: Messages, seed: int, share: float = 0.25) -> list[Message]:
    """Take that share of the beams out of every scan, drawn anew for each."""
    rng = np.random.default_rng(seed)

    def thinned(scan: LaserScan) -> LaserScan:
        gone = rng.random(len(scan.ranges)) < share
        return replace(scan, ranges=np.where(gone, np.float32(np.inf), scan.ranges))

    return [thinned(m) if isinstance(m, LaserScan) else m for m in messages]


def odometry_stale(messages: Messages, seed: int, share: float = 0.02) -> list[Message]:
    """Let that share of the odometry be one to three seconds older than its stamp says."""
    return list(with_stale_odometry(iter(messages), share, seed, lag_s=0.0))  # type: ignore[arg-type]


def kidnapped(messages: Messages, seed: int, metres: float = 10.0) -> list[Message]:
    """Carry the robot on by so many metres of its way: no scan, and the wheels at rest."""
    way: list[float] = []
    at: list[int] = []
    before: tuple[float, float] | None = None
    for message in messages:
        if isinstance(message, WheelOdometry):
            step = math.dist((message.x, message.y), before) if before else 0.0
            before = (message.x, message.y)
            way.append(way[-1] + step if way else 0.0)
            at.append(message.stamp_ns)
    begin = np.random.default_rng(seed).uniform(0.3, 0.7) * way[-1]
    first = at[int(np.searchsorted(way, begin))]
    last = at[min(int(np.searchsorted(way, begin + metres)), len(at) - 1)]

    def carried(step: Pose2, stamp_ns: int) -> Pose2:
        return Pose2() if first < stamp_ns <= last else step

    return [
        m for m in _with_steps(messages, carried)
        if not isinstance(m, LaserScan) or not first < m.stamp_ns <= last
    ]  # fmt: skip


def mirrored(messages: Messages, seed: int) -> list[Message]:
    """The world in a mirror: left is right."""

    def seen(message: Message) -> Message:
        if isinstance(message, LaserScan):
            return replace(message, angle_min=-message.angle_min, angle_step=-message.angle_step)
        if isinstance(message, WheelOdometry | LaserExtrinsics):
            return replace(message, y=-message.y, theta=-message.theta)
        return message

    return [seen(m) for m in messages]


def mirrored_back(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (n, 3) made from mirrored messages, as the truth has them."""
    return poses * [1.0, -1.0, -1.0]


def unaltered(messages: Messages, seed: int) -> list[Message]:
    """The log as it is."""
    return list(messages)


ALTERATIONS: Mapping[str, Alteration] = MappingProxyType(
    {
        "none": unaltered,
        "odometry-withheld": odometry_withheld,
        "odometry-0.9": partial(odometry_changed, scale=0.9),
        "odometry-1.1": partial(odometry_changed, scale=1.1),
        "every-third-scan": every_nth_scan,
        "reach-8m": ranges_cut,
        "stale-2%": odometry_stale,
        "stale-5%": partial(odometry_stale, share=0.05),
        "yaw-bias": partial(odometry_changed, yaw_per_m=math.radians(0.3)),
        "mirrored": mirrored,
        "beams-75%": beams_deleted,
        "kidnapped": kidnapped,
    }
)
