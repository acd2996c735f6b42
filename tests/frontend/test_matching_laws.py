"""Laws that hold for every match, whatever the scans: inverse, rotation, mirror, derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.frontend import icp_kernels
from slam.frontend.compiled import kernel
from slam.frontend.degeneracy import STRONGEST_PAIRS
from slam.frontend.match_arrays import COST, PAIRS, SYSTEM, Pass, Source, Workspace
from slam.frontend.match_types import MatchConfig, Reference
from slam.frontend.matching import match
from slam.frontend.scan import prepare
from slam.logs.messages import LaserExtrinsics, LaserScan

from tests.frontend.scans import (
    ALL_ROUND,
    CENTRED,
    FINE,
    HOKUYO,
    SCAN,
    error_of,
    match_one,
    prior_at,
    see,
    stacked,
)

START = Pose2(0.0, 0.0, 0.3)
accumulate = kernel(icp_kernels.accumulate.py_func)
motions = st.builds(Pose2, st.floats(-0.4, 0.4), st.floats(-0.15, 0.15), st.floats(-0.26, 0.26))
seeds = st.integers(0, 10_000)


@settings(deadline=None, max_examples=40)
@given(motions, seeds)
def test_there_and_back_is_nowhere(motion, seed):
    a, b = see(START, seed=seed), see(START * motion, seed=seed + 1)
    there, back = match_one(a, b, motion), match_one(b, a, motion.inverse())
    assert there.converged
    assert back.converged
    rest = np.asarray(Pose2.Logmap(there.target_T_source * back.target_T_source))
    # Both see the same noise, so the rest is smaller than either's sigma would let it be.
    assert (np.abs(rest) < 4 * np.array(there.sigmas) + 1e-3).all()


@settings(deadline=None, max_examples=30)
@given(motions, st.floats(-np.pi, np.pi), seeds)
def test_a_common_rotation_of_both_scans_turns_the_result(motion, turn, seed):
    """A laser mounted at an angle: the same beams in a turned base frame."""
    a, b = see(START, seed=seed), see(START * motion, seed=seed + 1)
    turned = LaserExtrinsics(0, 0.0, 0.0, turn)
    straight = match_one(a, b, motion)
    frame = Pose2(0.0, 0.0, turn)
    scans = [_remounted(scan, turned) for scan in (a, b)]
    other = match_one(*scans, frame * motion * frame.inverse())
    expected = frame * straight.target_T_source * frame.inverse()
    # The iteration ends within its tolerance of 0.2 mm, from another side.
    assert other.target_T_source.equals(expected, 2e-4)
    R = np.eye(3)
    R[:2, :2] = frame.rotation().matrix()
    np.testing.assert_allclose(
        other.covariance, R @ straight.covariance @ R.T, rtol=0.02, atol=2e-9
    )


@settings(deadline=None, max_examples=30)
@given(motions, seeds)
def test_a_mirrored_world_gives_the_mirrored_motion(motion, seed):
    a, b = see(START, seed=seed), see(START * motion, seed=seed + 1)
    plain = match_one(a, b, motion)
    image = match_one(_mirrored(a), _mirrored(b), _mirror(motion))
    assert image.converged
    # Coarse passes leave out other beams of a mirrored scan, so the iterations differ.
    tolerance = 0.5 * np.array(plain.sigmas) + 2e-4
    assert (np.abs(error_of(image, _mirror(plain.target_T_source))) < tolerance).all()


@settings(deadline=None, max_examples=30)
@given(motions, st.builds(Pose2, st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3)), seeds)
def test_the_choice_of_the_target_frame_changes_nothing(motion, frame, seed):
    a, b = see(START, seed=seed), see(START * motion, seed=seed + 1)
    plain = match_one(a, b, motion, prior_at(motion))
    prior = prior_at(frame * motion)
    moved = match([Reference(frame, a)], b, frame * motion, MatchConfig(), prior)
    assert moved.target_T_source.equals(frame * plain.target_T_source, 1e-6)
    np.testing.assert_allclose(moved.covariance, plain.covariance, rtol=1e-3, atol=1e-12)


@settings(deadline=None, max_examples=40)
@given(motions, seeds, st.floats(0.005, 0.2))
def test_covariance_and_information_are_positive(motion, seed, sigma):
    prior = prior_at(motion, [sigma, sigma, sigma])
    result = match_one(see(START, seed=seed), see(START * motion, seed=seed + 1), motion, prior)
    for matrix in (result.covariance, result.information):
        np.testing.assert_allclose(matrix, matrix.T, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(result.covariance)[0] > 0
    assert np.linalg.eigvalsh(result.information)[0] > -1e-6
    # A match never makes the prior worse.
    assert np.linalg.eigvalsh(prior.covariance - result.covariance)[0] > -1e-12


@pytest.mark.parametrize("laser", [HOKUYO, FINE, ALL_ROUND], ids=["181", "1081", "720 round"])
def test_normal_equations_agree_with_finite_differences(laser):
    """With pairs held fixed and a scale so wide that all weigh alike, g and H are exact."""
    motion = Pose2(0.3, 0.05, 0.1)
    target, source = see(START, laser, 1), see(START * motion, laser, 2)
    pose, pairs = motion * Pose2(0.02, -0.01, 0.01), _no_pairs(source)
    system = _sums(target, source, pose, pairs, search=True)
    assert system[PAIRS] > 100
    H = np.array([[system[0], system[1], system[2]], [0, system[3], system[4]], [0, 0, system[5]]])
    H = H + np.triu(H, 1).T
    step = 1e-5
    gradient, hessian = np.empty(3), np.empty((3, 3))
    for k, axis in enumerate(np.eye(3) * step):
        ahead = _sums(target, source, pose * Pose2.Expmap(axis), pairs, search=False)
        behind = _sums(target, source, pose * Pose2.Expmap(-axis), pairs, search=False)
        gradient[k] = (ahead[COST] - behind[COST]) / (2 * step) / 2
        hessian[k] = (ahead[6:9] - behind[6:9]) / (2 * step)
    np.testing.assert_allclose(system[6:9], gradient, rtol=1e-5, atol=1e-6)
    # Gauss-Newton leaves out residual times curvature, which is small at small residuals.
    np.testing.assert_allclose(H, hessian, atol=0.05 * np.abs(H).max())


def test_robust_weights_are_the_derivative_of_the_robust_cost():
    motion = Pose2(0.3, 0.05, 0.1)
    target, source = see(START, seed=1), see(START * motion, seed=2)
    pose, pairs = motion * Pose2(0.03, -0.02, 0.01), _no_pairs(source)
    system = _sums(target, source, pose, pairs, search=True, scale=0.05)
    step = 1e-6
    for k, axis in enumerate(np.eye(3) * step):
        ahead = _sums(target, source, pose * Pose2.Expmap(axis), pairs, False, 0.05)
        behind = _sums(target, source, pose * Pose2.Expmap(-axis), pairs, False, 0.05)
        slope = (ahead[COST] - behind[COST]) / (2 * step) / 2
        assert system[6 + k] == pytest.approx(slope, rel=1e-4, abs=1e-6)


def _no_pairs(source):
    return np.full((1, len(source.points)), -1, dtype=np.int32)


def _sums(target, source, pose, pairs, search, scale=1e6):
    system = np.zeros(SYSTEM)
    work = Workspace(
        pairs, system, np.empty((1, 4)), np.empty((4, 6)), np.empty(4), np.empty(STRONGEST_PAIRS)
    )
    level = Pass(gate=1.0, scale=scale, tolerance=1e-4, stride=1, noise=0.01, iterations=1)
    scan = Source(source.points, source.lines, source.flags, source.geometry)
    at = np.array([pose.x(), pose.y(), pose.theta()])
    accumulate(scan, stacked([target]), at, level, search, work)
    return system


def _raw(scan):
    angle_min, step = scan.geometry[:2]
    return LaserScan(0, angle_min, step, np.array(scan.ranges, np.float32), 0.02, 30.0)


def _remounted(scan, extrinsics):
    return prepare(_raw(scan), extrinsics, SCAN)


def _mirrored(scan):
    raw = _raw(scan)
    return prepare(
        replace(raw, angle_min=-raw.angle_min, angle_step=-raw.angle_step), CENTRED, SCAN
    )


def _mirror(pose):
    return Pose2(pose.x(), -pose.y(), -pose.theta())
