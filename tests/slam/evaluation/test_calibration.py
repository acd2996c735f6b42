"""Calibration: exact where there is no noise, honest where there is, silent where nothing shows."""

import math
from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.se2 import between
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.miscalibration import Miscalibration
from slam.drivers.simulators.robot import ODOMETRY_NOISE
from slam.drivers.simulators.worlds import scenario
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import ScanConfig
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry

from benchmarks.calibration import CASES, LASER_POSE, NOISE, WORLD, Case, drive
from slam.evaluation.calibration.fit import Fit, fit_calibration
from slam.evaluation.calibration.intervals import DriveData, Interval, IntervalCollector, planned_s
from slam.evaluation.calibration.model import OFFSET, Model
from slam.evaluation.calibration.noise import fit_noise
from slam.evaluation.calibration.odometry_track import OdometryTrack, expmap
from slam.evaluation.calibration.result import (
    LEAST_INTERVALS,
    calibrate,
    calibrate_sources,
    combined,
    stated_values,
)
from slam.mapping.calibration import CalibrationConfig, Corrector, wheel_matrix

TRACK_M = 0.357
TRUTH = np.array([0.16, 0.03, 0.035, 1.03, 1.01, -0.08, -0.04])


def track(seed=0, seconds=60.0, period_s=0.05):
    """A winding drive with changes of pace, as true poses of the base."""
    times = np.arange(0.0, seconds, period_s)
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, math.tau, 4)
    forward = 0.4 + 0.3 * np.sin(0.7 * times + phases[0]) * np.sin(0.23 * times + phases[1])
    turn = 0.6 * np.sin(0.5 * times + phases[2]) * np.cos(0.31 * times + phases[3])
    twists = np.column_stack([forward, 0.0 * forward, turn])[:-1] * period_s
    poses = np.zeros((len(times), 3))
    exact = OdometryTrack(times, poses)
    exact.__dict__["twists"] = twists
    return exact.corrected(np.eye(2))


def exact_model(truth=TRUTH, track_m=TRACK_M, noise=0.0, seed=0):
    """Odometry and laser of a robot whose calibration is `truth`, to the last digit."""
    wheels = wheel_matrix(*truth[3:6], track_m)
    true = track(seed)
    counted = true.corrected(np.linalg.inv(wheels))
    mount = truth[:3]
    rng = np.random.default_rng(seed)
    intervals = []
    for start in np.arange(2.0, 57.0, 1.0):
        ends = true.at(np.array([start, start + 1.0]))
        base = between(ends[0], ends[1])
        laser = Pose2(*mount).inverse() * Pose2(*base) * Pose2(*mount)
        motion = np.array([laser.x(), laser.y(), laser.theta()]) + noise * rng.standard_normal(3)
        covariance = max(noise, 1e-4) ** 2 * np.eye(3)
        intervals.append(Interval(start, start + 1.0, tuple(motion), covariance))
    stamped = OdometryTrack(counted.times_s - truth[OFFSET], counted.poses)
    return Model.of(DriveData(stamped, intervals, LaserExtrinsics(0, 0.0, 0.0, 0.0), 0, 0), track_m)


def test_nothing_is_left_where_all_is_known():
    assert np.abs(exact_model().residuals(TRUTH)).max() < 1e-6


def test_an_exact_drive_is_recovered_exactly():
    found = fit_calibration(exact_model(), stated_values(LaserExtrinsics(0, 0.1, 0.0, 0.0)))
    assert np.all(np.abs(found.values - TRUTH) < [*[1e-4] * 6, 5e-4])
    assert not found.offset_held


@pytest.mark.parametrize("yaw", [math.pi, math.pi / 2, -2.0])
def test_a_laser_may_look_anywhere(yaw):
    truth = TRUTH.copy()
    truth[2] = yaw
    found = fit_calibration(
        exact_model(truth, noise=1e-3), stated_values(LaserExtrinsics(0, 0, 0, 0))
    )
    assert math.remainder(found.values[2] - yaw, math.tau) == pytest.approx(0.0, abs=0.01)
    assert found.values[0] == pytest.approx(0.16, abs=0.01)


def test_wheels_and_track_make_the_matrix_of_the_simulator():
    wrong = Miscalibration(left_scale=1.03, right_scale=0.98, track_scale=1.02)
    wheels = wrong.true_from_counted
    np.testing.assert_allclose(
        wheel_matrix(wheels[0, 0], wheels[1, 1], wheels[1, 0], wrong.track_m), wheels, atol=1e-12
    )


def test_a_correction_undoes_what_is_wrong():
    wrong = Miscalibration(
        left_scale=1.03, right_scale=0.98, track_scale=1.02, odometry_delay_s=0.04,
        stated=(0.5, 0.0, 0.0),
    )  # fmt: skip
    wheels = wrong.true_from_counted
    config = CalibrationConfig(
        laser_x=0.16, translation_scale=wheels[0, 0], rotation_scale=wheels[1, 1],
        curvature=wheels[1, 0], odometry_track_m=wrong.track_m, time_offset_s=-0.04,
    )  # fmt: skip
    place, none = scenario("office", 1), ODOMETRY_NOISE["none"]
    corrector = Corrector(config)
    corrected = [corrector(m) for m in wrong.apply(simulate(place, noise=none, seed=1))]
    truth = {m.stamp_ns: m for m in corrected if isinstance(m, TruePose)}
    first = next(iter(truth.values()))
    start = Pose2(first.x, first.y, first.theta)
    compared = 0
    for message in corrected:
        if isinstance(message, WheelOdometry) and message.stamp_ns in truth:
            at = truth[message.stamp_ns]
            step = Pose2(message.x, message.y, message.theta).between(
                start.between(Pose2(at.x, at.y, at.theta))
            )
            assert np.abs(Pose2.Logmap(step)).max() < 1e-5
            compared += 1
    assert compared > 1000
    mount = next(m for m in corrected if isinstance(m, LaserExtrinsics))
    assert (mount.x, mount.y, mount.theta) == (0.16, 0.0, 0.0)


def test_without_a_calibration_messages_are_the_same_objects():
    corrector = Corrector(CalibrationConfig())
    odometry = WheelOdometry(5, 1.0, 2.0, 0.5)
    assert corrector(odometry) is odometry


@pytest.mark.parametrize("case", CASES[:3], ids=lambda case: case.name)
def test_a_simulated_robot_is_recovered_within_its_sigmas(case):
    found = calibrate_sources([lambda: drive(case, 1)], MatchConfig(), ScanConfig(), TRACK_M)
    truth = case.truth()
    useful = {"laser_x": 0.01, "laser_y": 0.01, "laser_yaw_deg": 0.3, "time_offset_s": 0.005}
    for one in (*found.found, *found.wheels):
        assert not one.refused, one
        assert abs(one.value - truth[one.name]) < 3.0 * one.sigma, one
        assert one.sigma < useful.get(one.name, 0.005), one


def test_a_straight_drive_shows_neither_x_nor_track():
    found = calibrate_sources([lambda: drive(CASES[3], 1)], MatchConfig(), ScanConfig(), TRACK_M)
    refused = {one.name for one in (*found.found, *found.wheels) if one.refused}
    assert refused == {"laser_x", "laser_y", "rotation_scale", "track_m"}
    reasons = {one.name: one for one in found.found}
    assert "turns" in reasons["laser_x"].refused
    assert "turn on the spot" in reasons["laser_x"].drive
    assert found.as_config().laser_x is None
    assert found.as_config().rotation_scale == 1.0


def test_a_drive_of_which_nothing_is_seen_refuses_all():
    nothing = DriveData(track(), [], LaserExtrinsics(0, 0.0, 0.0, 0.0), 10, 3)
    found = calibrate([nothing])
    assert found.intervals < LEAST_INTERVALS
    assert all(one.refused for one in found.found)
    assert found.as_config().laser_x is None


def test_stamps_that_jitter_are_no_offset():
    """Odometry of a scan's own stamp, wrong by the same error, is right as it is."""
    rng = np.random.default_rng(3)
    case = Case("", 1.0, 1.0, 1.0)
    shift: dict[int, int] = {}
    messages = []
    simulated = simulate(
        scenario(WORLD, 1), LASERS["hokuyo-181"], NOISE, 1, base_T_laser=Pose2(*LASER_POSE),
        odometry_rate_hz=0.01,
    )  # fmt: skip
    for m in simulated:
        if isinstance(m, (WheelOdometry, LaserScan)):
            jitter = shift.setdefault(m.stamp_ns, int(rng.integers(-45, 45)) * 1_000_000)
            messages.append(replace(m, stamp_ns=m.stamp_ns + jitter))
    messages.sort(key=lambda m: m.stamp_ns)
    found = calibrate_sources([lambda: messages], MatchConfig(), ScanConfig())
    offset = next(one for one in found.found if one.name == "time_offset_s")
    assert "stamps" in offset.refused
    assert case.truth()["translation_scale"] == 1.0


def test_several_drives_count_together_and_contradictions_widen():
    one = fit_calibration(exact_model(noise=1e-3, seed=1), TRUTH)
    other = fit_calibration(exact_model(noise=1e-3, seed=2), TRUTH)
    values, covariance = combined([one, other])
    assert np.all(np.sqrt(np.diag(covariance)) <= 1.5 * np.minimum(one.sigmas, other.sigmas))
    assert np.all(np.abs(values - TRUTH) < 5.0 * np.sqrt(np.diag(covariance)) + 1e-3)
    elsewhere = Fit(
        one.values + 20.0 * one.sigmas, one.covariance, one.noise, one.residuals, one.weights, 0.0
    )
    assert combined([one, elsewhere])[1][0, 0] > 10.0 * covariance[0, 0]


def test_noise_components_are_found():
    rng = np.random.default_rng(0)
    metres, radians = rng.uniform(0.1, 1.0, (2, 4000))
    variances = np.column_stack([0.02**2 * metres, 1e-4 * metres, 0.03**2 * radians])
    residuals = np.sqrt(variances) * rng.standard_normal((4000, 3))
    found = fit_noise(residuals, np.full((4000, 3), 1e-8), metres, radians)
    expected = np.sqrt(found.variances(metres, radians) / 0.6297)
    assert np.median(expected[:, 0] / np.sqrt(variances[:, 0])) == pytest.approx(1.0, abs=0.05)
    assert np.median(expected[:, 2] / np.sqrt(variances[:, 2])) == pytest.approx(1.0, abs=0.05)


def test_arcs_and_their_interpolation():
    path = track()
    apart = between(path.at(path.times_s), path.poses)
    np.testing.assert_allclose(apart, 0.0, atol=1e-12)
    quarter = expmap(np.array([[math.pi / 2, 0.0, math.pi / 2]]))
    np.testing.assert_allclose(quarter, [[1.0, 1.0, math.pi / 2]], atol=1e-12)


def test_an_interval_is_planned_by_the_last_speed():
    assert planned_s(Pose2(0.5, 0.0, 0.0), 1.0) == pytest.approx(1.0)
    assert planned_s(Pose2(0.0, 0.0, 0.7), 1.0) == pytest.approx(0.5)
    assert planned_s(Pose2(), 1.0) == planned_s(Pose2(0.01, 0.0, 0.0), 1.0) == 2.0


def test_what_cannot_be_used_is_passed_over():
    collector = IntervalCollector()
    ranges = np.full(20, np.nan, dtype=np.float32)
    for k in range(50):
        stamp = k * 100_000_000
        collector.feed(WheelOdometry(stamp, 0.05 * k, math.nan if k == 7 else 0.0, 0.0))
        collector.feed(LaserScan(stamp, -1.0, 0.1, ranges))
    data = collector.data()
    assert data.intervals == []
    assert len(data.track.times_s) == 49
