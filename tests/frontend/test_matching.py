"""The matcher finds known motions, and says so when there is nothing to find."""

import subprocess
import sys

import numpy as np
import pytest
from gtsam import Pose2
from scipy.stats import chi2
from slam.drivers.simulators.laser import LaserConfig
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.matching import match
from slam.frontend.scan import prepare
from slam.logs.messages import LaserExtrinsics, LaserScan

from slam.mapping.registration import disagreement
from tests.frontend.scans import (
    ALL_ROUND,
    BUILDING,
    CENTRED,
    ENDLESS,
    FINE,
    HOKUYO,
    SCAN,
    error_of,
    match_one,
    prior_at,
    see,
    silent,
)  # fmt: skip

START = Pose2(0.0, 0.0, 0.3)
MOTIONS = [Pose2(0.3, 0.05, 0.1), Pose2(-0.2, 0.1, -0.25), Pose2(0.0, 0.0, 0.4), Pose2()]
GUESS_ERROR = Pose2(0.1, -0.08, 0.08)


@pytest.mark.parametrize("motion", MOTIONS, ids=str)
@pytest.mark.parametrize("laser", [HOKUYO, FINE, ALL_ROUND], ids=["181", "1081", "720 round"])
def test_known_motions_are_found(motion, laser):
    target, source = see(START, laser, 1), see(START * motion, laser, 2)
    result = match_one(target, source, motion * GUESS_ERROR)
    assert result.converged, result.reason
    assert (np.abs(error_of(result, motion)) < 5 * np.array(result.sigmas)).all()
    assert np.abs(error_of(result, motion)).max() < 0.01


@pytest.mark.parametrize("motion", MOTIONS, ids=str)
def test_without_noise_the_error_is_a_fraction_of_a_millimetre(motion):
    laser = silent(FINE)
    result = match_one(see(START, laser), see(START * motion, laser), motion * GUESS_ERROR)
    assert np.abs(error_of(result, motion)).max() < 1e-3


def test_a_laser_off_the_middle_gives_the_motion_of_the_base():
    extrinsics, motion = LaserExtrinsics(0, 0.2, -0.05, 0.4), Pose2(0.25, 0.0, 0.3)
    target, source = (
        see(START, seed=1, extrinsics=extrinsics),
        see(START * motion, seed=2, extrinsics=extrinsics),
    )
    assert np.abs(error_of(match_one(target, source, Pose2(0.2, 0, 0.2)), motion)).max() < 0.01


def test_scans_may_differ_in_beams_field_of_view_and_start_angle():
    motion = Pose2(0.3, 0.05, 0.1)
    lasers = [
        HOKUYO,
        FINE,
        ALL_ROUND,
        LaserConfig(beams=400, angle_min=-1.9, angle_step=0.0091),
        LaserConfig(beams=400, angle_min=1.8, angle_step=-0.0093),
    ]
    for one in lasers:
        for other in lasers:
            result = match_one(see(START, one, 1), see(START * motion, other, 2), motion)
            assert result.converged
            assert np.abs(error_of(result, motion)).max() < 0.015


def test_converges_from_far_without_a_prior():
    rng, found = np.random.default_rng(5), []
    target = see(START, seed=1)
    for k in range(40):
        motion = Pose2(rng.uniform(-0.3, 0.4), rng.uniform(-0.1, 0.1), rng.uniform(-0.25, 0.25))
        bearing = rng.uniform(-np.pi, np.pi)
        off = Pose2(0.3 * np.cos(bearing), 0.3 * np.sin(bearing), rng.choice([-0.26, 0.26]))
        result = match_one(target, see(START * motion, seed=k), motion * off)
        found.append(np.abs(error_of(result, motion)).max() < 0.03)
    assert np.mean(found) >= 0.95


def test_several_references_together_beat_one():
    rng, alone, joint = np.random.default_rng(8), [], []
    motion = Pose2(0.3, 0.0, 0.05)
    places = [Pose2(-0.2 * i, 0.02 * i, 0.1 * i) for i in range(6)]
    for k in range(60):
        references = [
            Reference(place, see(START * place, seed=100 * k + i)) for i, place in enumerate(places)
        ]
        source = see(START * motion, seed=100 * k + 50)
        prior = prior_at(motion * Pose2.Expmap(rng.normal(size=3) * 0.02))
        for count, errors in ((1, alone), (6, joint)):
            guess = prior.target_T_source
            result = match(references[:count], source, guess, MatchConfig(), prior)
            errors.append(error_of(result, motion))
    rms = [np.sqrt(np.mean(np.square(errors), axis=0)) for errors in (alone, joint)]
    # The source's own noise stays: no more than a factor of 0.76 can be gained.
    assert np.mean(rms[1] / rms[0]) < 0.92
    assert (rms[1] < 1.05 * rms[0]).all()


class TestRefusals:
    @pytest.mark.parametrize("method", ["point_to_line", "point_to_point", "ndt", "psm"])
    @pytest.mark.parametrize(
        "ranges",
        [
            [],
            [2.0],
            [2.0, 2.0, 2.1, 2.2, 2.3],
            np.full(181, np.inf),
            np.full(181, np.nan),
            np.zeros(181),
            np.full(181, -1.0),
        ],
        ids=["0 beams", "1 beam", "5 beams", "all inf", "all nan", "all zero", "all negative"],
    )
    @pytest.mark.parametrize("informed", [True, False], ids=["prior", "no prior"])
    def test_a_scan_without_points_is_refused_with_its_reason(self, ranges, method, informed):
        ranges = np.asarray(ranges, dtype=np.float32)
        poor = prepare(LaserScan(0, -1.5, 3.0 / 180, ranges, 0.02, 30.0), CENTRED, SCAN)
        guess, good = Pose2(0.1, 0.0, 0.1), see(START)
        prior = prior_at(guess) if informed else None
        for target, source in ((poor, good), (good, poor), (poor, poor)):
            result = match_one(target, source, guess, prior, method=method)
            assert not result.converged
            assert result.reason
            assert result.target_T_source.equals(guess, 1e-12)
            expected = np.eye(3) if prior is None else prior.covariance
            np.testing.assert_array_equal(result.covariance, expected)

    def test_nothing_to_match_against_is_refused(self):
        assert "reference" in match([], see(START), Pose2(), MatchConfig()).reason

    def test_a_guess_that_is_no_pose_is_refused(self):
        assert "guess" in match_one(see(START), see(START), Pose2(np.nan, 0.0, 0.0)).reason

    @pytest.mark.parametrize("method", ["point_to_line", "point_to_point", "ndt", "psm"])
    def test_all_points_at_one_place_are_no_line(self, method):
        scan = LaserScan(0, 0.0, 1e-9, np.full(181, 2.0, dtype=np.float32), 0.02, 30.0)
        same = prepare(scan, CENTRED, SCAN)
        result = match_one(same, same, Pose2(0.1, 0.0, 0.0), method=method)
        assert not result.converged
        assert result.reason

    @pytest.mark.parametrize("method", ["point_to_line", "point_to_point", "ndt", "psm"])
    def test_lost_beams_in_a_good_scan_do_no_harm(self, method):
        motion = Pose2(0.1, 0.0, 0.05)
        scans = []
        for seed, pose in ((1, START), (2, START * motion)):
            ranges = np.array(see(pose, seed=seed).ranges, dtype=np.float32)
            ranges[seed::7], ranges[seed::11] = np.nan, np.inf
            scan = LaserScan(0, HOKUYO.angle_min, HOKUYO.angle_step, ranges, 0.02, 30.0)
            scans.append(prepare(scan, CENTRED, SCAN))
        result = match_one(*scans, motion, method=method)
        assert result.converged
        assert np.abs(error_of(result, motion)).max() < 0.05

    def test_places_that_have_nothing_in_common_are_refused_or_do_not_fit(self):
        elsewhere = see(Pose2(40.0, 0.0, 0.0), seed=3)  # outside all walls
        assert not match_one(see(START), elsewhere, Pose2()).converged


class TestDegeneracy:
    heading = 0.2
    laser = HOKUYO

    def corridor_match(self, seed=1, prior_error=(0.04, 0.0, 0.0)):
        pose, motion = Pose2(0.0, 0.1, self.heading), Pose2(0.3, 0.0, 0.05)
        target = see(pose, seed=seed, world=ENDLESS)
        source = see(pose * motion, seed=seed + 1, world=ENDLESS)
        axis = self.heading + motion.theta()  # of the corridor, clockwise from the source's x
        along = Pose2(np.cos(axis) * prior_error[0], -np.sin(axis) * prior_error[0], 0.0)
        prior = prior_at(motion * along)
        return match_one(target, source, prior.target_T_source, prior), motion, axis, prior

    def test_the_weak_axis_lies_along_a_plain_corridor(self):
        result, _, axis, _ = self.corridor_match()
        assert result.converged
        assert result.degenerate_direction is not None
        assert result.condition_ratio > 5
        apart = (result.degenerate_direction + axis + np.pi / 2) % np.pi - np.pi / 2
        assert abs(apart) < np.radians(3)

    def test_along_the_corridor_the_prior_is_kept_with_its_error_and_its_sigma(self):
        for seed in range(1, 40, 2):
            result, motion, axis, _ = self.corridor_match(seed)
            along = np.array([np.cos(axis), -np.sin(axis)])
            across = np.array([np.sin(axis), np.cos(axis)])
            error = error_of(result, motion)
            assert abs(error[:2] @ along - 0.04) < 0.01
            assert abs(error[:2] @ across) < 0.01
            own = result.covariance[:2, :2]
            assert np.sqrt(along @ own @ along) == pytest.approx(0.05, rel=0.05)
            assert np.sqrt(along @ own @ along) > 20 * np.sqrt(across @ own @ across)

    def test_a_room_has_no_weak_axis(self):
        motion = Pose2(0.3, 0.0, 0.05)
        result = match_one(
            see(START, seed=1), see(START * motion, seed=2), motion, prior_at(motion)
        )
        assert result.degenerate_direction is None
        assert result.condition_ratio < 0.2


class TestAgainstOdometry:
    def test_honest_odometry_is_called_a_liar_as_often_as_stated(self):
        rng, distances = np.random.default_rng(11), []
        poses = [Pose2(0.0, 0.0, t) for t in (0.3, 1.5, -2.0)] + [Pose2(3.5, -0.5, 0.8)]
        for k in range(1200):
            motion = Pose2(rng.uniform(0.1, 0.4), 0.0, rng.uniform(-0.2, 0.2))
            pose = poses[k % len(poses)]
            prior = prior_at(motion * Pose2.Expmap(rng.normal(size=3) * [0.05, 0.05, 0.03]))
            target, source = see(pose, seed=2 * k), see(pose * motion, seed=2 * k + 1)
            result = match_one(target, source, prior.target_T_source, prior)
            if result.converged:
                distances.append(disagreement(result, prior))
        assert len(distances) > 1150
        for rate in (0.5, 0.1, 0.01):
            expected = rate * len(distances)
            alarms = np.sum(np.array(distances) > chi2.isf(rate, 3))
            # Counts scatter like Poisson's.
            assert abs(alarms - expected) < 3.5 * np.sqrt(expected)

    def test_the_zero_motion_trap_is_seen(self):
        """Scans that agree best at rest, while the wheels truly moved."""
        scan_a, scan_b = see(START, seed=1), see(START, seed=2)
        moved = prior_at(Pose2(0.4, 0.0, 0.0), [0.02, 0.02, 0.01])
        result = match_one(scan_a, scan_b, Pose2(), None)
        assert result.converged
        assert disagreement(result, moved) > chi2.isf(1e-4, 3)

    def test_in_a_plain_corridor_odometry_cannot_be_contradicted_along_it(self):
        case = TestDegeneracy()
        result, _, _, prior = case.corridor_match()
        assert disagreement(result, prior) < chi2.isf(0.01, 3)


def test_equal_inputs_give_equal_bits():
    motion = Pose2(0.3, 0.05, 0.1)
    results = [
        match_one(see(START, seed=1), see(START * motion, seed=2), motion, prior_at(motion))
        for _ in range(2)
    ]
    assert fingerprint(results[0]) == fingerprint(results[1])


def test_two_processes_give_equal_bits():
    program = (
        "import sys; sys.path[:0] = sys.argv[1:]\n"
        "from tests.frontend.test_matching import *\n"
        "motion = Pose2(0.3, 0.05, 0.1)\n"
        "scans = see(START, seed=1), see(START * motion, seed=2)\n"
        "print(fingerprint(match_one(*scans, motion, prior_at(motion))))"
    )
    folder = __file__.rpartition("/")[0]
    command = [sys.executable, "-c", program, f"{folder}/../.."]
    runs = [subprocess.run(command, capture_output=True, text=True, check=True) for _ in range(2)]
    assert runs[0].stdout == runs[1].stdout
    assert len(runs[0].stdout) > 100


def fingerprint(result):
    pose = result.target_T_source
    numbers = [pose.x(), pose.y(), pose.theta(), *result.covariance.ravel(), result.inlier_fraction]
    return " ".join(float(number).hex() for number in numbers)


def test_the_building_has_walls_all_round():
    assert np.isfinite(see(START, ALL_ROUND).ranges).all()
    assert BUILDING.clearance(np.array([[0.0, 0.0]]))[0] > 1.0
