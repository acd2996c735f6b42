"""Scans of a seeded simulated building, for the tests of the matcher."""

from dataclasses import replace

import numpy as np
from gtsam import Pose2
from slam.drivers.simulators.laser import LASERS, LaserConfig, take_scan
from slam.drivers.simulators.world import World
from slam.frontend.match_arrays import References
from slam.frontend.match_types import MatchConfig, Prior, Reference
from slam.frontend.matching import match
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics

CENTRED = LaserExtrinsics(0, 0.0, 0.0, 0.0)
SCAN = ScanConfig()
HOKUYO = LASERS["hokuyo-181"]
FINE = LASERS["utm-30lx"]
ALL_ROUND = LaserConfig(beams=720, angle_min=-np.pi, angle_step=np.pi / 360)

# Two rooms and a niche: every direction has walls, and no part looks like another.
BUILDING = World.joined(
    [
        World.from_polygon(
            [(-4, -3), (6, -3), (6, -1), (7, -1), (7, 1.5), (6, 1.5), (6, 4), (1, 4), (-4, 2.5)]
        ),
        World.from_polygon([(2.0, 1.0), (2.5, 1.2), (2.2, 1.6)]),
        World.from_polygon([(1.5, -2.0), (2.0, -2.0), (2.0, -1.5), (1.5, -1.5)]),
    ]
)
# Its ends are out of the laser's reach, and nothing breaks its walls.
ENDLESS = World(np.array([[-90.0, 1.0, 90.0, 1.0], [-90.0, -1.0, 90.0, -1.0]]))

SIGMAS = np.array([0.05, 0.05, 0.03])  # m, m, rad


def see(pose, laser=HOKUYO, seed=0, world=BUILDING, extrinsics=CENTRED):
    """A prepared scan from a pose of the base."""
    base_T_laser = Pose2(extrinsics.x, extrinsics.y, extrinsics.theta)
    return prepare(
        take_scan(world, pose * base_T_laser, laser, np.random.default_rng(seed)), extrinsics, SCAN
    )


def silent(laser=HOKUYO):
    """The same laser without noise."""
    return replace(laser, sigma=0.0, quantum=0.0)


def prior_at(pose, sigmas=SIGMAS):
    return Prior(pose, np.diag(np.square(sigmas)))


def match_one(target, source, guess, prior=None, **settings):
    return match([Reference(Pose2(), target)], source, guess, MatchConfig(**settings), prior)


def error_of(result, truth):
    """(x, y, theta) of the error in the source frame."""
    return np.asarray(Pose2.Logmap(truth.between(result.target_T_source)))


def stacked(scans):
    """Scans end to end, all at the origin, as the kernels take them."""
    points, lines, windows, flags = (
        np.concatenate([getattr(scan, name) for scan in scans])
        for name in ("points", "lines", "windows", "flags")
    )
    return References(
        points, lines, windows, flags,
        starts=np.cumsum([0, *(len(scan.points) for scan in scans)]),
        geometries=np.array([scan.geometry for scan in scans]),
        reach2=np.array([scan.reach2 for scan in scans]),
        poses=np.zeros((len(scans), 3)),
    )  # fmt: skip
