"""The end of a run: the whole graph judges every closure, those refused along the way too."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.pose_graph import Edge, PoseGraph
from slam.frontend.loop_search import Closure
from slam.logs.messages import LoopResult

from slam.mapping.loop_closing import LoopCandidate
from slam.mapping.slam import READMITTED, Slam
from slam.runs.config_file import load_config

SIGMA = np.array([0.01, 0.01, 0.003])
SURE = np.diag(SIGMA**-2)
OUT = 20  # steps of half a metre down a corridor, and as many back beside the same walls


def truth(k):
    return Pose2(0.5 * (k if k <= OUT else 2 * OUT - k), 0.0 if k <= OUT else 0.4, 0.0)


def measured(i, j, slip=0.0):
    return truth(i).between(truth(j)) * Pose2(slip, 0.0, 0.0)


def candidate(slam, i, j, pose, reason):
    """A closure with its verdict, as the loop closer leaves it behind."""
    slam.loops.closure_results.append(
        LoopResult(j, i, j, reason == "accepted", reason, 0.7, 0.0, 40.0)
    )
    edge = Edge("loop", i, j, pose, SURE)
    return LoopCandidate(edge, Closure(None, 0.7, 0.0, ""), j, 0.5 * j, 40.0, 5.0)


@pytest.fixture
def bent():
    """A run in which one match slid by 0.3 m and a false closure came in before the true ones."""
    slam = Slam(load_config(None))
    slam.graph = PoseGraph(Pose2(), slam.config.graph)
    for k in range(1, 2 * OUT + 1):
        slip = 0.3 if k == OUT + 8 else 0.0
        edge = Edge("icp", k - 1, k, measured(k - 1, k, slip), SURE)
        slam.graph.add_keyframe(slam.graph.pose(k - 1) * edge.i_T_j, [edge])
    last = 2 * OUT
    first = candidate(slam, 0, last, measured(0, last, 0.3), "accepted")
    slam.graph.add_edges([first.edge])
    slam.records.add_edge(last, first.edge, True, "")
    for k in range(1, 10):
        true = candidate(slam, k, last - k, measured(k, last - k), "chi-square 40.0 against ...")
        slam.loops.rejected.append(true)
    false = candidate(slam, 3, 30, measured(3, 30, 2.0), "chi-square 40.0 against ...")
    slam.loops.rejected.append(false)
    slam.finalise()
    return slam


def test_closures_that_the_rest_sides_with_are_admitted_in_the_end(bent):
    tied = [*range(10), *range(2 * OUT - 9, 2 * OUT + 1)]
    away = [bent.graph.pose(k).between(truth(k)) for k in tied]
    assert max(np.hypot(p.x(), p.y()) for p in away) < 0.05
    back = {(f.i, f.j) for f in bent.records.factors if f.kind == "loop" and f.used}
    assert back == {(k, 2 * OUT - k) for k in range(1, 10)}
    assert all(v.reason == READMITTED for v in bent.loops.closure_results if v.accepted)


def test_what_nothing_sides_with_stays_refused_and_says_why(bent):
    refused = {(v.i, v.j): v.reason for v in bent.loops.closure_results if not v.accepted}
    assert set(refused) == {(0, 2 * OUT), (3, 30)}
    assert refused[0, 2 * OUT].startswith("removed: chi-square")
    assert refused[3, 30].startswith("chi-square 40.0 against the graph")
    kept = {(e.i, e.j) for e in bent.graph.edges if e.kind == "loop"}
    assert kept.isdisjoint(refused)
