"""ATE, RPE and association against evo; alignment and credibility against their laws."""

import math

import numpy as np
import pytest
from slam.backend.se2 import between, compose
from slam.logs.trajectory import NS, Trajectory

from slam.evaluation.metrics import (
    Association,
    absolute_errors,
    align,
    anchor,
    associate,
    credibility,
    nees,
    pairs_by_path,
    relative_errors,
    summarise,
)

TICK = NS // 1024  # not whole nanoseconds in binary seconds, but far above a double's rounding


def drive(seed: int, n: int = 400) -> tuple[Trajectory, Trajectory]:
    """Return a noisy estimate in its own frame and the truth, at overlapping times."""
    rng = np.random.default_rng(seed)
    poses = np.zeros((n, 3))
    for k in range(1, n):
        step = np.array([abs(rng.normal(0.1, 0.05)), 0.0, rng.normal(0, 0.1)])
        poses[k] = compose(poses[k - 1], step)
    truth_ns = 1_600_000_000 * NS + np.arange(n) * 100 * TICK
    kept = np.flatnonzero(rng.random(n) < 0.8)
    noise = rng.normal(0, [0.05, 0.05, 0.02], (len(kept), 3))
    estimate = compose(np.array([3.0, -2.0, 2.5]), compose(poses[kept], noise))
    estimate_ns = truth_ns[kept] + rng.integers(-20, 21, len(kept)) * TICK
    return Trajectory(estimate_ns, estimate), Trajectory(truth_ns, poses)


def to_evo(trajectory: Trajectory):
    trajectories = pytest.importorskip("evo.core.trajectory")
    half = trajectory.poses[:, 2] / 2
    zero = np.zeros(len(trajectory))
    return trajectories.PoseTrajectory3D(
        positions_xyz=np.column_stack([trajectory.poses[:, :2], zero]),
        orientations_quat_wxyz=np.column_stack([np.cos(half), zero, zero, np.sin(half)]),
        timestamps=trajectory.stamps_ns / NS,
    )


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("swap", [False, True])
def test_association_agrees_with_evo(seed, swap):
    sync = pytest.importorskip("evo.core.sync")
    a, b = drive(seed)[:: -1 if swap else 1]
    ours = associate(a, b)
    evo_a, evo_b = sync.associate_trajectories(to_evo(a), to_evo(b), max_diff=0.01)
    assert len(ours) == evo_a.num_poses < len(a)
    assert np.array_equal(ours.estimate.poses[:, :2], evo_a.positions_xyz[:, :2])
    assert np.array_equal(ours.truth.poses[:, :2], evo_b.positions_xyz[:, :2])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("aligned", [False, True])
def test_absolute_errors_agree_with_evo(seed, aligned):
    metrics = pytest.importorskip("evo.core.metrics")
    pairs = associate(*drive(seed))
    estimate, truth = to_evo(pairs.estimate), to_evo(pairs.truth)
    truth_T_map = np.zeros(3)
    if aligned:
        estimate.align(truth)
        truth_T_map = align(pairs.estimate.poses, pairs.truth.poses)
    ours = absolute_errors(pairs, truth_T_map)
    relations = metrics.PoseRelation
    for errors, relation in (
        (ours.trans_m, relations.translation_part),
        (ours.rot_deg, relations.rotation_angle_deg),
    ):
        ape = metrics.APE(relation)
        ape.process_data((truth, estimate))
        assert np.allclose(errors, ape.error, atol=1e-9)
        theirs, summary = ape.get_all_statistics(), summarise(errors)
        for name in ("rmse", "mean", "median", "std", "max"):
            assert getattr(summary, name) == pytest.approx(theirs[name], abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("length_m", [1.0, 5.0, 10.0])
def test_relative_errors_agree_with_evo(seed, length_m):
    metrics = pytest.importorskip("evo.core.metrics")
    pairs = associate(*drive(seed))
    rows = pairs_by_path(pairs.truth.poses, length_m)
    ours = relative_errors(pairs, rows)
    for errors, relation in (
        (ours.trans_m, metrics.PoseRelation.translation_part),
        (ours.rot_deg, metrics.PoseRelation.rotation_angle_deg),
    ):
        rpe = metrics.RPE(
            relation, length_m, metrics.Unit.meters, all_pairs=True, pairs_from_reference=True
        )
        rpe.process_data((to_evo(pairs.truth), to_evo(pairs.estimate)))
        assert rpe.delta_ids == rows[:, 1].tolist()
        assert np.allclose(errors, rpe.error, atol=1e-9)


def test_pairs_by_path_when_the_robot_stands_still():
    poses = np.zeros((30, 3))
    poses[10:20, 0], poses[20:, 0] = 1.0, 2.0
    pairs = pairs_by_path(poses, 1.0)
    assert pairs[:20].tolist() == [[i, 10 if i < 10 else 20] for i in range(20)]
    assert len(pairs) == 20
    assert len(pairs_by_path(poses[:1], 1.0)) == len(pairs_by_path(poses, 50.0)) == 0


def test_alignment_recovers_a_rigid_motion_exactly():
    _, truth = drive(1)
    truth_T_map = np.array([4.0, -7.0, -3.0])
    estimate = between(truth_T_map, truth.poses)
    assert np.allclose(align(estimate, truth.poses), truth_T_map, atol=1e-9)
    assert np.allclose(anchor(estimate, truth.poses), truth_T_map, atol=1e-9)


def test_one_pose_is_aligned_by_itself():
    estimate, truth = np.array([[1.0, 2.0, 0.5]]), np.array([[-1.0, 0.0, 2.0]])
    truth_T_map = align(estimate, truth)
    assert np.allclose(compose(truth_T_map, estimate[0]), truth[0], atol=1e-12)


def test_trajectories_that_never_meet_give_empty_pairs():
    estimate, truth = drive(2)
    late = Trajectory(truth.stamps_ns + 10**13, truth.poses)
    assert len(associate(estimate, late)) == 0
    assert len(associate(estimate, truth.select(np.arange(0)))) == 0
    assert math.isnan(summarise(np.zeros(0)).rmse)


def test_honest_covariances_fall_into_the_band_and_boastful_ones_do_not():
    rng = np.random.default_rng(7)
    root = rng.normal(size=(2000, 3, 3)) * np.array([0.1, 0.05, 0.001])[:, None]
    covariances = root @ root.transpose(0, 2, 1) + np.diag([1e-4, 1e-4, 1e-8])
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=(2000, 3)))
    values = nees(errors, covariances)
    direct = [e @ np.linalg.inv(c) @ e for e, c in zip(errors, covariances, strict=True)]
    assert np.allclose(values, direct, rtol=1e-6)
    honest = credibility(values)
    assert honest.low < honest.anees < honest.high
    assert honest.low < 1 < honest.high
    assert credibility(nees(errors, covariances / 4)).anees > 3


def test_certainty_without_variance_is_not_weighed():
    covariances = np.stack(
        [np.eye(3), np.zeros((3, 3)), np.diag([1, 1, -1.0]), np.full((3, 3), np.nan)]
    )
    values = nees(np.ones((4, 3)), covariances)
    assert values[0] == pytest.approx(3.0)
    assert np.all(np.isnan(values[1:]))
    assert credibility(values).n == 1
    assert credibility(values[1:]).n == 0


def test_pairs_can_be_made_by_hand():
    trajectory = Trajectory(np.array([1, 2]), np.zeros((2, 3)))
    errors = absolute_errors(Association(trajectory, trajectory), np.zeros(3))
    assert errors.trans_m.tolist() == [0.0, 0.0]
