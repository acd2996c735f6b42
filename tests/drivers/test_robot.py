import numpy as np
import pytest
from gtsam import Pose2
from scipy.stats import chi2
from slam.drivers.simulators.path import Leg, MotionConfig
from slam.drivers.simulators.robot import (
    ODOMETRY_NOISE,
    OdometryNoise,
    drive,
    quantised,
    track_of,
    wheel_increments,
)
from slam.drivers.simulators.worlds import SCENARIOS, scenario

SEEDS = 300


def straight(length: float = 10.0):
    return track_of((0.0, 0.0, 0.0), np.tile([length / 1000, 0.0, 0.0], (1000, 1)), 0.02)


def spin(turn: float = 10.0):
    return track_of((0.0, 0.0, 0.0), np.tile([0.0, 0.0, turn / 1000], (1000, 1)), 0.02)


def assert_sigma(samples, sigma):
    """Variance of zero-mean samples against chi-square bounds that fail once in a million."""
    low, high = chi2.ppf([5e-7, 1 - 5e-7], len(samples))
    assert low < np.sum(np.square(samples)) / sigma**2 < high


def sums(truth, noise):
    """The summed increments less the truth's, one row for every seed."""
    rows = [
        wheel_increments(truth, noise, np.random.default_rng(seed)).sum(axis=0)
        for seed in range(SEEDS)
    ]
    return np.array(rows) - truth.increments.sum(axis=0)


@pytest.mark.parametrize("name", ["optimistic", "typical", "pessimistic"])
def test_errors_grow_as_the_noise_says(name):
    noise = ODOMETRY_NOISE[name]
    ahead, turned = sums(straight(), noise), sums(spin(), noise)
    assert_sigma(ahead[:, 0], np.hypot(10 * noise.distance_scale, 10**0.5 * noise.distance_random))
    assert_sigma(ahead[:, 2], np.hypot(10 * noise.drift, 10**0.5 * noise.heading_random))
    assert_sigma(turned[:, 2], np.hypot(10 * noise.turn_scale, 10**0.5 * noise.turn_random))
    assert not turned[:, 0].any()  # no distance, no distance error


@pytest.mark.parametrize("field", ["distance_scale", "drift", "distance_random", "heading_random"])
def test_each_term_alone_has_its_stated_size(field):
    quiet = dict.fromkeys(OdometryNoise.__slots__, 0.0)
    errors = sums(straight(), OdometryNoise(**{**quiet, field: 0.02}))
    grows = 10.0 if field in ("distance_scale", "drift") else 10.0**0.5
    column = 2 if field in ("drift", "heading_random") else 0
    assert_sigma(errors[:, column], 0.02 * grows)


def test_random_error_does_not_depend_on_the_length_of_a_step():
    noise = OdometryNoise(distance_scale=0.0, distance_random=0.02)
    coarse = track_of((0.0, 0.0, 0.0), np.tile([0.1, 0.0, 0.0], (100, 1)), 0.2)
    assert_sigma(sums(coarse, noise)[:, 0], 0.02 * 10**0.5)


def test_without_noise_or_motion_the_wheels_are_right():
    truth = drive(scenario("office").path)
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(
        wheel_increments(truth, ODOMETRY_NOISE["none"], rng), truth.increments
    )
    resting = track_of((1.0, 2.0, 3.0), np.zeros((50, 3)), 0.02)
    assert not wheel_increments(resting, ODOMETRY_NOISE["pessimistic"], rng).any()


def test_packets_carry_whole_millimetres_and_encoder_angles():
    poses = quantised(np.array([[1.23456, -0.00049, 0.5]]), OdometryNoise())
    np.testing.assert_allclose(poses, [[1.235, 0.0, 326 * 2 * np.pi / 4096]], atol=1e-12)
    exact = np.array([[1.23456, -0.00049, 0.5]])
    np.testing.assert_array_equal(quantised(exact, ODOMETRY_NOISE["none"]), exact)


def test_a_track_is_the_product_of_exponential_maps():
    rng = np.random.default_rng(0)
    increments = rng.normal(0.0, 0.3, (40, 3))
    track = track_of((1.0, 2.0, 3.0), increments, 0.5)
    pose = Pose2(1.0, 2.0, 3.0)
    for increment in increments[:7]:
        pose = pose * Pose2.Expmap(increment)
    assert Pose2(*track.at(np.array([3.5]))[0]).equals(pose, 1e-9)
    halfway = pose * Pose2.Expmap(0.5 * increments[7])
    assert Pose2(*track.at(np.array([3.75]))[0]).equals(halfway, 1e-9)


def test_a_robot_stands_still_outside_its_track():
    track = straight()
    np.testing.assert_allclose(track.at(np.array([-1.0, 99.0])), [[0, 0, 0], [10, 0, 0]], atol=1e-9)


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_drive_respects_its_limits_and_reaches_its_end(name):
    place, limits = scenario(name), MotionConfig()
    truth = drive(place.path)
    speeds = truth.increments[:, [0, 2]] / truth.step_s
    jerks = np.abs(np.diff(speeds, axis=0)) / truth.step_s
    assert np.all(np.abs(speeds).max(axis=0) <= [limits.speed + 1e-9, limits.turn_rate + 1e-9])
    assert np.all(
        jerks.max(axis=0) <= [limits.acceleration + 1e-6, limits.turn_acceleration + 1e-6]
    )
    assert not truth.increments[[0, -1]].any()  # it starts and ends at rest
    np.testing.assert_allclose(truth.poses[-1, :2], place.path[-1].points[-1], atol=0.06)


def test_a_robot_turns_on_the_spot_at_a_hairpin():
    truth = drive((Leg(((0.0, 0.0), (4.0, 0.0), (1.0, 0.0))),))
    assert truth.poses[:, 0].max() < 4.05
    assert np.abs(truth.poses[:, 1]).max() < 0.1
    assert truth.poses[-1, 0] == pytest.approx(1.0, abs=0.02)


def test_bad_paths_and_configs_are_refused():
    with pytest.raises(ValueError, match="two different points"):
        Leg(((1.0, 1.0),))
    with pytest.raises(ValueError, match="positive"):
        MotionConfig(speed=0.0)
    with pytest.raises(ValueError, match="negative"):
        OdometryNoise(drift=-0.1)
