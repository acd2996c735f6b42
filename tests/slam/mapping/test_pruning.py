"""A robot that comes by again and again: the graph stops growing, and the map stays as good."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.edges import Edge
from slam.backend.pruned_graph import Renumbered
from slam.backend.se2 import compose
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.worlds import scenario
from slam.logs.mcap_log import open_log
from slam.logs.messages import FactorRecord, KeyframeDecision, LaserScan, LoopResult

from slam.evaluation.metrics import align
from slam.mapping.loop_worker import run_inline
from slam.mapping.pruning import FormerPlaces, Pruner, PruningConfig
from slam.mapping.slam import BYPASS, Slam
from slam.runs.config_file import load_config
from slam.runs.offline import run_offline
from slam.runs.resume import read_prior_map
from slam.runs.run_directory import write_results
from slam.runs.summary import summarise
from slam.viewer.event_cursor import EventCursor
from slam.viewer.frames import Feed
from slam.viewer.snapshot import View, take

# So that a short drive shows what an hour does.
SOON = ("pruning.min_redundancy=2", "pruning.within_m=0.8")
THIN, WHOLE = load_config(None, SOON), load_config(None, ["pruning.min_redundancy=0"])


@pytest.fixture(scope="module", autouse=True)
def _few_are_enough():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("slam.mapping.pruning.PRUNED_AT_ONCE", 12)
        patch.setattr("slam.mapping.pruning.PRUNED_SHARE", 0.0)
        yield


@pytest.fixture(scope="module")
def messages():
    return list(simulate(scenario("mixed", 2), seed=2, passes=4))


@pytest.fixture(scope="module")
def thin(messages):
    return run_offline(lambda: iter(messages), THIN)


@pytest.fixture(scope="module")
def whole(messages):
    return run_offline(lambda: iter(messages), WHOLE)


def ate(result):
    truth = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    true = np.array([truth[int(stamp)] for stamp in result.trajectory.stamps_ns])
    off = compose(align(result.trajectory.poses, true), result.trajectory.poses) - true
    return float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))))


def test_the_graph_stops_growing_and_the_map_is_as_good(thin, whole):
    gone = thin.slam.records.pruned_counts["keyframes"]
    assert gone > 0.25 * len(whole.slam.keyframes)
    assert len(thin.slam.keyframes) + gone == pytest.approx(len(whole.slam.keyframes), rel=0.05)
    assert not whole.slam.records.pruned_counts
    assert ate(whole) < 0.03
    assert ate(thin) < 1.5 * ate(whole) + 0.005


def test_every_scan_keeps_its_pose(thin, whole):
    np.testing.assert_array_equal(thin.trajectory.stamps_ns, whole.trajectory.stamps_ns)
    away = compose(align(thin.trajectory.poses, whole.trajectory.poses), thin.trajectory.poses)
    assert np.abs(away[:, :2] - whole.trajectory.poses[:, :2]).max() < 0.1


def test_records_name_the_keyframes_that_are_left(thin):
    slam = thin.slam
    count = len(slam.keyframes)
    assert [k.index for k in slam.keyframes] == list(range(count))
    assert [d.index for d in slam.records.decisions] == list(range(count))
    assert [d.stamp_ns for d in slam.records.decisions] == [k.scan.stamp_ns for k in slam.keyframes]
    for pair in (*slam.records.factors, *slam.loops.closure_results, *slam.graph.edges):
        assert 0 <= pair.i < pair.j < count
    used = {(f.kind, f.i, f.j) for f in slam.records.factors if f.used}
    assert {(e.kind, e.i, e.j) for e in slam.graph.edges} == used
    assert any(f.note == BYPASS for f in slam.records.factors)
    numbers = [k.number for k in slam.keyframes]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] > count


def test_summary_counts_those_that_are_gone(thin, whole):
    timing = {"wall_s": 1.0}
    said = summarise(thin, "log", timing, THIN)
    assert said["keyframes"] == len(thin.slam.keyframes)
    assert said["pruned"] == thin.slam.records.pruned_counts["keyframes"]
    loops = said["loops"]
    assert loops["candidates"] == loops["accepted"] + loops["rejected"]
    assert loops["candidates"] > len(thin.slam.loops.closure_results)
    assert said["distance_m"] == pytest.approx(
        summarise(whole, "log", timing, WHOLE)["distance_m"], rel=0.02
    )


def test_it_does_not_matter_whether_loops_are_searched_beside(messages, thin):
    with ThreadPoolExecutor(1) as pool:
        slam = Slam(THIN, submit=pool.submit)
        for message in messages:
            slam.step(message)
        slam.finish_input()
    assert slam.records.pruned_counts == thin.slam.records.pruned_counts
    assert repr(slam.records.decisions) == repr(thin.slam.records.decisions)  # nan is not nan
    assert slam.records.estimates == thin.slam.records.estimates


def test_a_run_that_was_thinned_can_be_written_and_resumed(thin, tmp_path):
    write_results(tmp_path, thin, {}, b"{}")
    times = (tmp_path / "graph.times.csv").read_text().splitlines()
    assert len(times) == len(thin.slam.keyframes) + 1
    prior_map = read_prior_map(tmp_path, THIN)
    assert len(prior_map.keyframes) == len(prior_map.poses) == len(thin.slam.keyframes)
    slam = Slam(THIN)
    slam.resume(prior_map)
    np.testing.assert_allclose(slam.graph.poses, thin.keyframes.poses, atol=0.02)
    with open_log(tmp_path / "run.mcap") as log:
        assert any(m.note == BYPASS for m in log.messages(["/factor"]))


def test_news_of_the_run_come_once(messages):
    slam, event_cursor, told = Slam(THIN), EventCursor(), []
    for message in messages:
        slam.step(message)
        told += event_cursor.take(slam)
        if slam.records.pruned_counts["keyframes"] > 30:
            break
    decided = [m.stamp_ns for m in told if isinstance(m, KeyframeDecision)]
    assert decided == sorted(set(decided))
    assert len(decided) == len(slam.keyframes) + slam.records.pruned_counts["keyframes"]
    tied = [(m.kind, m.stamp_ns) for m in told if isinstance(m, FactorRecord) and m.kind == "icp"]
    assert len(tied) == len(set(tied)) == len(decided) - 1


def test_the_live_page_is_told_anew_when_indices_change(messages):
    slam, feed, greetings, thinnings = Slam(THIN), Feed(), 0, 0
    for message in messages:
        before = slam.records.pruned_counts["keyframes"]
        slam.step(message)
        thinnings += slam.records.pruned_counts["keyframes"] != before
        if slam.graph is not None and isinstance(message, LaserScan):
            frames = [json.loads(frame) for frame in feed.frames(View("live", take(slam)))]
            greetings += frames[0]["type"] == "hello"
            told = [f for f in frames if f["type"] == "keyframes"]
        if thinnings == 2:
            break
    assert greetings == 1 + thinnings
    assert told[0]["first"] == 0
    assert sum(len(f["items"]) for f in told) == len(slam.keyframes)


def places(*numbers):
    former = FormerPlaces()
    for scan, anchor in numbers:
        former.add(scan, anchor, Pose2(0.5, 0.0, 0.0))
    return former


class Kept:
    def __init__(self, scan_index):
        self.scan_index = scan_index


def test_former_places_follow_their_anchors():
    former = places((7, 0), (9, 3))
    former.renumber(Renumbered(5, [1, 2]))
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, np.pi / 2], [5.0, 5.0, 0.0]])
    scans, where, owners = former.joined([Kept(0), Kept(8), Kept(20)], poses)
    assert scans.tolist() == [0, 7, 8, 9, 20]
    assert owners.tolist() == [0, 0, 1, 1, 2]
    np.testing.assert_allclose(where[1], [0.5, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(where[3, :2], [1.0, 1.5], atol=1e-12)


def test_without_former_places_the_keyframes_are_all_there_is():
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.5]])
    scans, where, owners = FormerPlaces().joined([Kept(0), Kept(8)], poses)
    assert (scans.tolist(), owners.tolist()) == ([0, 8], [0, 1])
    np.testing.assert_array_equal(where, poses)


def redundant(slam, odometry_faulty=(), closures=None):
    """Whether the pruner finds enough redundant keyframes in a graph that has all."""
    pruner = Pruner(PruningConfig(min_redundancy=2, within_m=0.8), 8.0, run_inline)
    loops = [edge for edge in slam.graph.edges if edge.kind == "loop"]
    pruner.add_closures(loops if closures is None else closures(loops))
    return pruner.due(slam.keyframes, slam.graph, set(odometry_faulty))


def test_a_keyframe_to_which_the_odometry_did_not_lead_is_kept(whole):
    assert redundant(whole.slam)
    assert not redundant(whole.slam, [k.scan_index for k in whole.slam.keyframes])


def test_where_no_closure_has_shown_that_all_is_well_everything_is_kept(whole):
    assert not redundant(whole.slam, closures=lambda loops: [])


def test_where_the_graph_contradicts_a_closure_everything_is_kept(whole):
    """A match that slid, or wheels that lied: it may still be found out."""

    def contradicted(loops):
        off = Pose2(0.3, 0.0, 0.0)
        return [Edge("loop", e.i, e.j, e.i_T_j * off, e.information) for e in loops]

    assert not redundant(whole.slam, closures=contradicted)


def test_a_single_pass_loses_nothing():
    drive = list(simulate(scenario("office", 1), seed=1))
    slam = Slam(load_config(None))
    for message in drive:
        slam.step(message)
    slam.finish_input()
    assert not slam.records.pruned_counts


def test_verdicts_that_are_gone_are_counted():
    slam = Slam(THIN)
    slam.loops.closure_results = [
        LoopResult(1, 0, 2, True, "accepted", 0.8, 0.1, 1.0),
        LoopResult(2, 0, 3, False, "score", 0.2, 0.1, 1.0),
        LoopResult(3, 0, 4, True, "accepted", 0.8, 0.1, 1.0),
    ]
    assert slam.loops.renumber(Renumbered(5, [2, 3])) == {"accepted": 1, "rejected": 1}
    assert [(v.i, v.j) for v in slam.loops.closure_results] == [(0, 2)]
