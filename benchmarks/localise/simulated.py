"""A simulated building: mapped once, driven again with moved things and after a kidnapping."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gtsam import Pose2
from slam.backend.se2 import compose
from slam.drivers.simulators.changes import with_things_moved
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.worlds import scenario
from slam.logs.messages import LaserScan, Message, TruePose, WheelOdometry

from benchmarks.localise.judge import errors, is_wrong, located, start_from, starts_row, track_row
from slam.evaluation.metrics import align
from slam.mapping.config import SlamConfig
from slam.mapping.relocalise import PriorMap
from slam.runs.offline import run_offline

MOVED = 0.3  # share of the things that have been moved when the robot comes again
LASER = replace(LASERS["hokuyo-181"], rate_hz=5.0)
KIDNAPPED = (0.35, 0.6)  # of the drive: from here to there it is carried


@dataclass(frozen=True, eq=False, slots=True)
class Building:
    """A map, and a later drive."""

    prior: PriorMap
    messages: list[Message]
    truth: dict[int, Pose2]  # by stamp, in the frame of the map


def build(name: str, seed: int, moved: float, config: SlamConfig) -> Building:
    """Map a building, and drive in it again when a share of its things has been moved."""
    plan = scenario(name, seed)
    result = run_offline(lambda: simulate(plan, LASER, seed=seed), config)
    true = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    at = np.array([true[stamp] for stamp in result.keyframes.stamps_ns.tolist()])
    world_T_map = align(result.keyframes.poses, at)
    prior = PriorMap(
        result.slam.keyframes, compose(world_T_map, result.keyframes.poses), [], [], [],
        result.slam.extrinsics, [], None,
    )  # fmt: skip
    later = with_things_moved(plan, moved, seed)
    messages: list[Message] = list(simulate(later, LASER, seed=seed + 1000))
    truth = {m.stamp_ns: Pose2(m.x, m.y, m.theta) for m in messages if isinstance(m, TruePose)}
    return Building(prior, messages, truth)


def kidnapped(building: Building) -> tuple[Building, int]:
    """The drive without a part of it, of which neither wheels nor stamps tell; where it goes on."""
    messages = building.messages
    scans = [m.stamp_ns for m in messages if isinstance(m, LaserScan)]
    first, last = (scans[int(share * len(scans))] for share in KIDNAPPED)
    gap_ns = scans[scans.index(last) + 1] - scans[scans.index(first) + 1]
    odometry = [m for m in messages if isinstance(m, WheelOdometry)]
    before = _pose([m for m in odometry if m.stamp_ns <= first][-1])
    joined = before * _pose([m for m in odometry if m.stamp_ns <= last][-1]).inverse()
    kept: list[Message] = []
    for message in messages:
        if message.stamp_ns <= first:
            kept.append(message)
        elif message.stamp_ns > last:
            if isinstance(message, WheelOdometry):
                pose = joined * _pose(message)
                message = replace(message, x=pose.x(), y=pose.y(), theta=pose.theta())
            kept.append(replace(message, stamp_ns=message.stamp_ns - gap_ns))
    truth = {m.stamp_ns: Pose2(m.x, m.y, m.theta) for m in kept if isinstance(m, TruePose)}
    return replace(building, messages=kept, truth=truth), first


def _pose(odometry: WheelOdometry) -> Pose2:
    return Pose2(odometry.x, odometry.y, odometry.theta)


def simulated_row(name: str, seed: int, starts: int, config: SlamConfig) -> dict[str, Any]:
    """Figures of one building: the whole drive, a kidnapping, and starts from nothing."""
    building = build(name, seed, MOVED, config)
    found = located(building.messages, config, building.prior)
    row = {"log": f"{name} {seed}", **track_row(found, building.truth, building.prior.poses)}
    row |= kidnapping(building, config)
    stamps = sorted(building.truth)
    rng = np.random.default_rng([seed, 31])
    chosen = rng.choice(stamps[: int(0.9 * len(stamps))], starts, replace=False)
    tried = [
        start_from(building.messages, int(s), building.truth, config, building.prior)
        for s in np.sort(chosen)
    ]
    return row | starts_row(tried)


def kidnapping(building: Building, config: SlamConfig) -> dict[str, Any]:
    """When a robot that was carried away knows that it is lost, and when it has found itself."""
    cut, ns = kidnapped(building)
    found = located(cut.messages, config, cut.prior)
    off = errors(found, cut.truth)
    wrong, lost = is_wrong(off), np.array([s.lost for s in found])
    after = np.array([s.stamp_ns > ns for s in found])
    seconds = np.array([(s.stamp_ns - ns) * 1e-9 for s in found])
    noticed = np.flatnonzero(after & (lost | ~wrong))
    again = np.flatnonzero(after & ~lost & ~wrong)
    return {
        "kidnap_noticed_s": float(seconds[noticed[0]]) if len(noticed) else None,
        "kidnap_found_s": float(seconds[again[0]]) if len(again) else None,
        "kidnap_wrong_after_5s": float((wrong & ~lost & (seconds > 5.0)).sum() / after.sum()),
    }
