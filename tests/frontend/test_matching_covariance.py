"""The covariance against the truth: noise repeated at one place, and whole campaigns."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.robot import drive
from slam.drivers.simulators.world import World
from slam.drivers.simulators.worlds import scenario
from slam.frontend.match_types import MatchConfig

from benchmarks.matcher.consistency import WORLDS, consistency
from tests.frontend.scans import ENDLESS, HOKUYO, error_of, match_one, prior_at, see

MOTION = Pose2(0.3, 0.02, 0.1)
REPEATS = 150


def campaign(world, pose, laser=HOKUYO, repeats=REPEATS):
    """Errors (n, 3) and mean covariance of matches whose noise alone differs."""
    errors, covariances = [], []
    for k in range(repeats):
        target = see(pose, laser, 2 * k, world)
        source = see(pose * MOTION, laser, 2 * k + 1, world)
        result = match_one(target, source, MOTION, prior_at(MOTION), floor_trans=0, floor_rot=0)
        assert result.converged
        errors.append(error_of(result, MOTION))
        covariances.append(result.covariance)
    return np.array(errors), np.mean(covariances, axis=0)


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_in_an_office_the_claimed_variance_is_the_real_one(share):
    place = scenario("office", 5)
    track = drive(place.path)
    pose = Pose2(*track.at(np.array([share * track.duration_s]))[0])
    errors, covariance = campaign(place.world, pose)
    ratio = errors.var(axis=0) / np.diag(covariance)
    # 150 repeats know a variance to 12 %.
    assert (ratio > 0.70).all()
    assert (ratio < 1.30).all()


def test_errors_are_correlated_as_the_covariance_says():
    place = scenario("office", 5)
    track = drive(place.path)
    errors, covariance = campaign(place.world, Pose2(*track.at(np.array([20.0]))[0]))
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), (errors - errors.mean(axis=0)).T)
    assert np.abs(np.cov(whitened) - np.eye(3)).max() < 0.5


def test_twice_the_noise_gives_twice_the_sigma():
    target, source = see(Pose2(), seed=1), see(MOTION, seed=2)
    wide = prior_at(MOTION, [1.0, 1.0, 1.0])
    sigmas = [
        match_one(
            target, source, MOTION, wide, range_noise=noise, floor_trans=0, floor_rot=0
        ).sigmas
        for noise in (0.01, 0.02)
    ]
    np.testing.assert_allclose(np.divide(*sigmas[::-1]), 2.0, rtol=0.25)


def test_the_floor_bounds_what_is_claimed():
    target, source = see(Pose2(), seed=1), see(MOTION, seed=2)
    result = match_one(target, source, MOTION, floor_trans=0.01, floor_rot=0.005)
    assert min(result.sigmas[:2]) >= 0.01
    assert result.sigmas[2] >= 0.005


def bare_corridor(sigma, repeats=60):
    """Errors along a corridor without features and the sigmas claimed for them, m."""
    rough, odometry = replace(HOKUYO, sigma=sigma), np.array([0.1, 0.03, 0.02])
    errors, sigmas = [], []
    for k in range(repeats):
        guess = MOTION * Pose2(*np.random.default_rng(900 + k).normal(size=3) * odometry)
        target = see(Pose2(), rough, 2 * k, ENDLESS)
        source = see(MOTION, rough, 2 * k + 1, ENDLESS)
        result = match_one(target, source, guess, prior_at(guess, odometry))
        errors.append(error_of(result, MOTION)[0])
        sigmas.append(result.sigmas[0])
    return np.array(errors), np.array(sigmas)


def test_rough_walls_do_not_tell_where_along_them_the_robot_is():
    """Twice the noise that the matcher knows of: normals feign four times what is expected.

    Believing them claims 10 mm, and is wrong by 100.
    """
    errors, sigmas = bare_corridor(sigma=0.020)
    assert np.median(sigmas) > 0.05  # the odometry's 0.1 m, or near it
    assert np.mean(np.abs(errors) < 3.0 * sigmas) > 0.85
    errors, sigmas = bare_corridor(sigma=0.010)
    assert sigmas.min() > 0.09
    assert np.mean(np.abs(errors) < 3.0 * sigmas) > 0.98


def test_one_end_wall_is_proof_enough():
    walls = [[-90.0, 1.0, 5.0, 1.0], [-90.0, -1.0, 5.0, -1.0], [5.0, -1.0, 5.0, 1.0]]
    world = World(np.array(walls))
    target, source = see(Pose2(), seed=1, world=world), see(MOTION, seed=2, world=world)
    off = MOTION * Pose2(0.15, 0.0, 0.0)
    result = match_one(target, source, off, prior_at(off, [0.1, 0.03, 0.02]))
    assert result.degenerate_direction is None
    assert result.sigmas[0] < 0.004
    assert abs(error_of(result, MOTION)[0]) < 3.0 * result.sigmas[0]


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
def test_errors_are_as_large_as_claimed(world):
    """A thousand matches on worlds that calibration never saw: every axis within its 95 % band."""
    found = consistency(world, 1000, config=MatchConfig())
    assert found["matches"] > 950
    assert min(found["inside_3_sigma"]) > 0.985
    assert all(found["within_band"]), found["anees"]


def test_the_heading_does_not_rest_on_one_far_board():
    """In a round room only a slanted board 25 m off, met by two beams, tells the heading.

    At its word the heading is known to half a milliradian, twenty times better than by the room.
    """
    at = np.radians(np.arange(20.0, 341.0, 16.0))
    corners = 2.0 * np.column_stack([np.cos(at), np.sin(at)])
    room = np.hstack([corners[:-1], corners[1:]])
    sigmas, pairs = [], []
    for walls in (room, np.vstack([room, [24.0, -1.0, 26.0, 1.0]])):
        world = World(walls)
        target, source = see(Pose2(), seed=1, world=world), see(MOTION, seed=2, world=world)
        result = match_one(target, source, MOTION, prior_at(MOTION), floor_trans=0, floor_rot=0)
        sigmas.append(result.sigmas[2])
        pairs.append(result.pairs)
    assert pairs[1] > pairs[0]
    assert sigmas[1] > 0.5 * sigmas[0]
