"""Pairs of scans with a known motion between them, simulated and real."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gtsam import Pose2
from slam.drivers.simulators.laser import LaserConfig, take_scan
from slam.drivers.simulators.robot import drive
from slam.drivers.simulators.worlds import scenario
from slam.frontend.scan import PreparedScan, ScanConfig, prepare
from slam.logs.importers.carmen import read_carmen
from slam.logs.messages import LaserExtrinsics, LaserScan

from slam.evaluation.relations import MATCH_TOLERANCE_S, nearest_rows, read_relations

CENTRED = LaserExtrinsics(0, 0.0, 0.0, 0.0)
BEAMS = {  # beams: (first bearing, step) in degrees, of the lasers that the paper and we know
    181: (-90.0, 1.0),
    361: (-90.0, 0.5),
    1081: (-135.0, 0.25),
}
WORLDS = ("testbed", "office", "clutter")
LOGS = ("intel", "mit-csail", "mit-killian")
ROOM_TO_STAND = 0.15  # m to the nearest wall
LARGEST_STEP = (0.6, np.radians(30.0))  # m, rad: relations that join farther scans are left out


@dataclass(frozen=True, eq=False, slots=True)
class Pair:
    """Two scans, the motion between them, and where a match starts: for accuracy, and far off."""

    raw: tuple[LaserScan, LaserScan]
    target: PreparedScan
    source: PreparedScan
    target_T_source: Pose2
    guess: Pose2  # up to 0.3 m and 10 degrees off
    far_guess: Pose2  # up to 0.5 m and 20 degrees off
    fixed_guess: Pose2  # 0.3 m and 15 degrees off

    def error(self, found: Pose2) -> tuple[float, float]:
        """Distance (m) and turn (rad, positive) between the truth and what was found."""
        rest = self.target_T_source.between(found)
        return float(np.hypot(rest.x(), rest.y())), abs(float(rest.theta()))


def laser_of(beams: int) -> LaserConfig:
    """A range finder of 10 mm noise, millimetre steps and some lost beams."""
    first, step = np.radians(BEAMS[beams])
    return LaserConfig(beams=beams, angle_min=first, angle_step=step, dropout=0.005)


def synthetic_pairs(beams: int, count: int, seed: int) -> list[Pair]:
    """Pairs up to 0.4 m and 15 degrees apart on the way through each of WORLDS, in turn."""
    rng = np.random.default_rng((seed, beams))
    laser = laser_of(beams)
    pairs: list[Pair] = []
    places = [scenario(name, seed) for name in WORLDS]
    tracks = [drive(place.path) for place in places]
    while len(pairs) < count:
        k = len(pairs) % len(WORLDS)
        world, track = places[k].world, tracks[k]
        pose = Pose2(*track.at(rng.uniform(0.0, track.duration_s, 1))[0])
        turn = np.radians(rng.uniform(-15.0, 15.0))
        moved = Pose2(rng.uniform(-0.4, 0.4), rng.uniform(-0.1, 0.1), turn)
        there = pose * moved
        if world.clearance(np.array([[there.x(), there.y()]]))[0] < ROOM_TO_STAND:
            continue
        scans = take_scan(world, pose, laser, rng), take_scan(world, there, laser, rng)
        pairs.append(_pair(*scans, CENTRED, moved, rng))
    return pairs


def real_pairs(folder: Path, name: str, count: int, seed: int) -> list[Pair]:
    """Scans of a public log that a near relation joins, drawn at random."""
    messages = read_carmen(folder / f"{name}.clf.gz").messages
    relations = read_relations(folder / f"{name}.relations")
    extrinsics = next((m for m in messages if isinstance(m, LaserExtrinsics)), CENTRED)
    scans = [m for m in messages if isinstance(m, LaserScan)]
    stamps = np.array([scan.stamp_ns for scan in scans])
    first, first_found = nearest_rows(stamps, relations.first_ns, MATCH_TOLERANCE_S)
    second, second_found = nearest_rows(stamps, relations.second_ns, MATCH_TOLERANCE_S)
    x, y, turn = relations.first_T_second.T
    near = (np.hypot(x, y) <= LARGEST_STEP[0]) & (np.abs(turn) <= LARGEST_STEP[1])
    usable = np.flatnonzero(first_found & second_found & near & (first != second))
    rng = np.random.default_rng((seed, len(scans)))
    return [
        _pair(scans[first[k]], scans[second[k]], extrinsics, Pose2(x[k], y[k], turn[k]), rng)
        for k in rng.permutation(usable)[:count]
    ]


def _pair(
    first: LaserScan,
    second: LaserScan,
    extrinsics: LaserExtrinsics,
    moved: Pose2,
    rng: np.random.Generator,
) -> Pair:
    config = ScanConfig()
    far = astray(rng, rng.uniform(0.0, 0.5), np.radians(rng.uniform(-20.0, 20.0)))
    return Pair(
        raw=(first, second),
        target=prepare(first, extrinsics, config),
        source=prepare(second, extrinsics, config),
        target_T_source=moved,
        guess=moved * astray(rng, rng.uniform(0.0, 0.3), np.radians(rng.uniform(-10.0, 10.0))),
        far_guess=moved * far,
        fixed_guess=moved * astray(rng, 0.3, np.radians(rng.choice([-15.0, 15.0]))),
    )


def astray(rng: np.random.Generator, distance: float, turn: float) -> Pose2:
    """A pose `distance` (m) off in a random direction, turned by `turn` (rad)."""
    direction = rng.uniform(-np.pi, np.pi)
    return Pose2(distance * np.cos(direction), distance * np.sin(direction), turn)
