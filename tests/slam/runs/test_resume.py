"""A map goes on where it ended: one drive cut in two gives as good a map as in one go."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.pose_graph import GraphConfig, PoseGraph
from slam.backend.se2 import compose
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import LogWriter
from slam.logs.messages import LaserExtrinsics, WheelOdometry
from slam.logs.trajectory import read_tum

from slam.evaluation.metrics import align
from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError, SlamError
from slam.runs.offline import run_offline
from slam.runs.replay import replay
from slam.runs.resume import read_prior_map

CONFIG = SlamConfig()


@pytest.fixture(scope="module")
def halves():
    """The messages of a drive before and after its middle; the second has a new odom frame."""
    messages = list(simulate(scenario("office", 3), seed=3))
    middle = (messages[0].stamp_ns + messages[-1].stamp_ns) // 2
    first = [m for m in messages if m.stamp_ns <= middle]
    second = [m for m in messages if m.stamp_ns > middle]
    start = next(m for m in second if isinstance(m, WheelOdometry))
    odom_T_start = Pose2(start.x, start.y, start.theta)

    def anew(m):
        if not isinstance(m, WheelOdometry):
            return m
        pose = odom_T_start.between(Pose2(m.x, m.y, m.theta))
        return replace(m, x=pose.x(), y=pose.y(), theta=pose.theta())

    extrinsics = replace(messages[0], stamp_ns=second[0].stamp_ns)
    assert isinstance(extrinsics, LaserExtrinsics)
    return first, [extrinsics, *(anew(m) for m in second)]


@pytest.fixture(scope="module")
def first_run(halves, tmp_path_factory):
    """RUN of the first half."""
    folder = tmp_path_factory.mktemp("resume")
    with LogWriter(folder / "first.mcap", {}) as log:
        for message in halves[0]:
            log.write(message)
    replay(folder / "first.mcap", folder / "first", CONFIG)
    return folder / "first"


def ate(result):
    truth = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    true = np.array([truth[int(stamp)] for stamp in result.trajectory.stamps_ns])
    found = compose(align(result.trajectory.poses, true), result.trajectory.poses)
    return float(np.sqrt(np.mean(np.sum((found - true)[:, :2] ** 2, axis=1))))


@pytest.mark.parametrize("start", ["", "end"])
def test_a_drive_cut_in_two_gives_one_good_map(halves, first_run, start):
    prior_map = read_prior_map(first_run, CONFIG, start)
    result = run_offline(lambda: halves[1], CONFIG, prior_map=prior_map)
    old = len(prior_map.keyframes)
    assert len(result.keyframes) > old + 50
    np.testing.assert_array_equal(
        result.keyframes.stamps_ns[:old], read_tum(first_run / "keyframes.tum").stamps_ns
    )
    assert any(e.i < old <= e.j for e in result.edges if e.kind == "loop")
    assert result.slam.records.decisions[old].reason == "resumed"
    assert sum(result.lost.values()) < 0.05 * len(result.trajectory)
    assert ate(result) < 0.02  # in one go: below 1 cm
    stamps = result.trajectory.stamps_ns
    assert all(a < b for a, b in pairwise(stamps.tolist()))


def test_another_building_is_not_taken_for_the_map(first_run):
    elsewhere = list(simulate(scenario("clutter", 1), seed=1))[:240]
    late = 10**12
    moved = [replace(m, stamp_ns=m.stamp_ns + late) for m in elsewhere]
    with pytest.raises(SlamError, match=r"not found in the map.* --start"):
        run_offline(lambda: moved, CONFIG, prior_map=read_prior_map(first_run, CONFIG))


def test_a_log_that_is_older_than_the_map_is_refused(halves, first_run):
    with pytest.raises(SlamError, match="older than the run"):
        run_offline(lambda: halves[0], CONFIG, prior_map=read_prior_map(first_run, CONFIG))


@pytest.mark.parametrize("start", ["here", "1,2", "nan,0,0"])
def test_a_start_that_is_no_pose_is_refused(first_run, start):
    with pytest.raises(RunError, match=f"start '{start}'"):
        read_prior_map(first_run, CONFIG, start)


def test_a_restored_graph_is_the_graph(first_run):
    prior_map = read_prior_map(first_run, CONFIG)
    graph = PoseGraph.restored(prior_map.poses, prior_map.edges, GraphConfig())
    assert len(graph) == len(prior_map.keyframes)
    np.testing.assert_allclose(graph.poses, prior_map.poses, atol=0.01)
