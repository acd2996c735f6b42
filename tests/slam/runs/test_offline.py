"""A whole run: every scan's pose, the map, and what must be refused."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.se2 import between
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.messages import LaserExtrinsics, LaserScan, TruePose, WheelOdometry

from slam.mapping.scan_priors import drift_corrected
from slam.runs.config_file import load_config
from slam.runs.errors import SlamError
from slam.runs.offline import run_offline

CONFIG = load_config(None)


def ate_m(result):
    """Distances (m) of all scans from the truth, both seen from the first scan."""
    truth = np.array([[t.x, t.y, t.theta] for t in result.truth])
    poses = result.trajectory.poses
    return np.hypot(*(between(truth[0], truth) - between(poses[0], poses))[:, :2].T)


@pytest.fixture(scope="module")
def office():
    messages = list(simulate(scenario("office", 1), seed=1))
    return messages, run_offline(lambda: messages, CONFIG)


def test_an_office_is_mapped_to_centimetres(office):
    _, result = office
    distances = ate_m(result)
    assert np.sqrt(np.mean(distances**2)) < 0.05
    assert distances.max() < 0.15
    start, end = result.odometry.poses[0], result.odometry.poses[-1]
    truth = between(*np.array([[t.x, t.y, t.theta] for t in (result.truth[0], result.truth[-1])]))
    drift = np.hypot(*(between(start, end) - truth)[:2])
    assert drift > 3 * distances[-1]  # the wheels alone would have been far off


def test_every_scan_has_a_pose_an_odometry_and_a_covariance(office):
    messages, result = office
    stamps = [m.stamp_ns for m in messages if isinstance(m, LaserScan)]
    assert result.trajectory.stamps_ns.tolist() == stamps
    assert result.odometry.stamps_ns.tolist() == stamps
    assert [e.stamp_ns for e in result.estimates] == stamps
    covariances = np.array([e.covariance for e in result.estimates]).reshape(-1, 3, 3)
    assert np.linalg.eigvalsh(covariances).min() > 0
    assert result.lost == {}


def test_two_threads_find_the_scans_where_one_does(office):
    messages, alone = office
    together = run_offline(lambda: messages, CONFIG, threads=2)
    assert together.trajectory.poses.tobytes() == alone.trajectory.poses.tobytes()
    assert together.matches == alone.matches


def test_keyframes_are_scans_of_the_trajectory(office):
    _, result = office
    assert set(result.keyframes.stamps_ns) <= set(result.trajectory.stamps_ns)
    assert len(result.keyframes) == len(result.slam.keyframes) < 0.5 * len(result.trajectory)
    assert len(result.edges) == len(result.weights)


def test_the_map_holds_the_walls_and_the_way(office):
    _, result = office
    grid = result.grid
    occupied = np.argwhere(grid.cells > 65)
    assert len(occupied) > 500
    here = result.trajectory.poses[::20, :2]
    columns = ((here[:, 0] - grid.origin_x) / grid.resolution).astype(int)
    rows = ((here[:, 1] - grid.origin_y) / grid.resolution).astype(int)
    on_the_way = grid.cells[rows, columns]
    assert (on_the_way >= 0).all()
    assert (on_the_way < 20).mean() > 0.99


def test_progress_is_told_and_the_source_read_twice(office):
    messages, _ = office
    told, opened = [], []

    def source():
        opened.append(True)
        return iter(messages[:200])

    run_offline(source, CONFIG, progress=lambda stage, done: told.append((stage, done)))
    assert len(opened) == 2
    assert [stage for stage, _ in told] == sorted((stage for stage, _ in told), reverse=True)
    assert {stage for stage, _ in told} == {"tracking", "localising"}


def only(messages, *kinds):
    return [m for m in messages if isinstance(m, kinds)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda ms: [], "no usable scan among 0"),
        (lambda ms: only(ms, LaserExtrinsics, WheelOdometry, TruePose), "no usable scan among 0"),
        (
            lambda ms: [
                replace(m, ranges=np.full(181, np.inf, dtype=np.float32))
                if isinstance(m, LaserScan) else m
                for m in ms
            ],
            "no usable scan among .* at least 15 returns",
        ),
        (
            lambda ms: [
                replace(m, angle_step=np.nan) if isinstance(m, LaserScan) else m for m in ms
            ],
            r"no usable scan among 0: .* left out: \d+ scan whose beams",
        ),
    ],
)  # fmt: skip
def test_a_log_that_cannot_give_a_map_is_refused(office, change, message):
    messages = change(office[0][:60])
    with pytest.raises(SlamError, match=message):
        run_offline(lambda: messages, CONFIG)


@pytest.mark.parametrize(
    ("kind", "change", "cause"),
    [
        (WheelOdometry, {"x": np.nan}, "odometry that is not finite"),
        (WheelOdometry, {"theta": np.inf}, "odometry that is not finite"),
        (LaserExtrinsics, {"y": np.nan}, "laser mount that is not finite"),
        (LaserScan, {"angle_step": 0.0}, "scan whose beams have no possible direction"),
        (LaserScan, {"angle_step": 1.0}, "scan whose beams have no possible direction"),
        (LaserScan, {"angle_min": np.nan}, "scan whose beams have no possible direction"),
        (LaserScan, {"range_max": np.nan}, "scan whose beams have no possible direction"),
    ],
)
def test_a_message_that_cannot_be_is_counted_and_the_run_goes_on(office, kind, change, cause):
    messages = list(office[0])
    del messages[[isinstance(m, LaserScan) for m in messages].index(True, 300) + 1 :]
    like_it = [k for k, m in enumerate(messages) if isinstance(m, kind)]
    at = like_it[len(like_it) // 2]
    messages.insert(at, replace(messages[at], **change))
    result = run_offline(lambda: messages, CONFIG)
    assert result.lost == {cause: 1}
    assert ate_m(result).max() < 0.1


def test_one_scan_is_a_run():
    messages = list(simulate(scenario("testbed-180cm")))[:4]
    result = run_offline(lambda: messages, CONFIG)
    assert len(result.trajectory) == len(result.keyframes) == 1
    np.testing.assert_array_equal(result.keyframes.poses, 0.0)
    np.testing.assert_allclose(result.trajectory.poses, 0.0, atol=0.005)


def test_odometry_is_bent_onto_the_keyframes():
    """The wheels say 1 m a scan; the graph says that the second keyframe is at 2.4 m, not 2."""
    odometry = np.array([[float(k), 0.0, 0.0] for k in range(4)])
    keyframes = np.array([[0.0, 0.0, 0.0], [2.4, 0.0, 0.0]])
    poses = drift_corrected(odometry, np.array([0, 0, 1, 1]), np.array([0, 2]), keyframes)
    np.testing.assert_allclose(poses[:, 0], [0.0, 1.2, 2.4, 3.4], atol=1e-9)
    turned = np.array([[0.0, 0.0, 0.0], *[[p.x(), p.y(), p.theta()] for p in [Pose2(2, 0, 0.2)]]])
    bent = drift_corrected(odometry, np.array([0, 0, 1, 1]), np.array([0, 2]), turned)
    np.testing.assert_allclose(bent[[0, 2]], turned, atol=1e-9)
    np.testing.assert_allclose(bent[1, 2], 0.1, atol=1e-9)
