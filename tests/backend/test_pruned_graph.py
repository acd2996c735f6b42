"""Poses that leave a graph: what is known of the others stays, and is not claimed better."""

import gtsam
import numpy as np
import pytest
from gtsam import Pose2
from gtsam.symbol_shorthand import X
from slam.backend.batch_optimisation import FactorMaker, values_of
from slam.backend.edges import Edge, relative_covariance
from slam.backend.pose_graph import GraphConfig, PoseGraph
from slam.backend.pruned_graph import prune

CONFIG = GraphConfig(match_sigma_trans=0.0, match_sigma_rot=0.0, robust=False)
MATCH = np.diag([1e4, 2e4, 1e5])
WHEELS = np.array([[900.0, 30.0, 20.0], [30.0, 500.0, -40.0], [20.0, -40.0, 2500.0]])
POSES = [Pose2(0, 0, 0.1), Pose2(0.5, 0.1, 0.4), Pose2(0.9, 0.4, 0.9), Pose2(1.1, 0.9, 1.3)]


def told(kind, i, j, poses=POSES, information=MATCH, error=(0.0, 0.0, 0.0)):
    i_T_j = poses[i].between(poses[j]) * Pose2.Expmap(np.array(error))
    return Edge(kind, i, j, i_T_j, information)


def rows(poses):
    return np.array([[p.x(), p.y(), p.theta()] for p in poses])


def covariance_between(edges, poses, i, j):
    """(3, 3) of i_T_j by GTSAM's own marginals of the whole graph."""
    maker = FactorMaker(CONFIG)
    graph, values = maker.graph(poses[0], edges, robust=False), values_of(rows(poses))
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(gtsam.KeyVector([X(i), X(j)]))
    blocks = np.block([[joint.at(X(a), X(b)) for b in (i, j)] for a in (i, j)])
    return relative_covariance(blocks, poses[i].between(poses[j]))


def chain():
    return [
        Edge(*edge) for k in range(3) for edge in (
            ("odometry", k, k + 1, POSES[k].between(POSES[k + 1]), WHEELS),
            ("icp", k, k + 1, POSES[k].between(POSES[k + 1]), MATCH),
        )
    ]  # fmt: skip


def test_a_chain_without_its_middle_says_what_the_whole_chain_said():
    left = prune(chain(), rows(POSES), [1, 2], FactorMaker(CONFIG).information)
    assert left.untouched == []
    (edge,) = left.edges
    assert (edge.kind, edge.i, edge.j) == ("icp", 0, 1)  # under the new indices
    assert left.anchors == {1: 0, 2: 0}
    assert edge.i_T_j.equals(POSES[0].between(POSES[3]), 1e-9)
    exact = covariance_between(chain(), POSES, 0, 3)
    np.testing.assert_allclose(np.linalg.inv(edge.information), exact, rtol=1e-4, atol=1e-9)


def test_disagreeing_edges_are_weighed_by_what_they_know():
    a = told("odometry", 0, 1, information=WHEELS, error=(0.02, 0.0, 0.0))
    b = told("icp", 0, 1, error=(-0.001, 0.0, 0.0))
    left = prune([a, b, told("icp", 1, 2)], rows(POSES), [1], FactorMaker(CONFIG).information)
    found = POSES[0].between(POSES[2]).between(left.edges[0].i_T_j)
    maker = FactorMaker(CONFIG)
    graph, values = gtsam.NonlinearFactorGraph(), values_of(rows(POSES[:3]))
    graph.add(maker.anchor(POSES[0]))
    for edge in (a, b, told("icp", 1, 2)):
        graph.add(maker.between(edge, robust=False))
    best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atPose2(X(2))
    whole = POSES[2].between(best)
    np.testing.assert_allclose(Pose2.Logmap(found), Pose2.Logmap(whole), atol=1e-6)


def test_the_neighbour_that_knows_best_hands_on_and_the_nearest_keeps_the_place():
    vague = told("icp", 1, 2, information=np.diag([50.0, 50.0, 500.0]))
    edges = [told("icp", 0, 1), vague, told("loop", 0, 2), told("icp", 2, 3)]
    left = prune(edges, rows(POSES), [2], FactorMaker(CONFIG).information)
    assert left.untouched == edges[:1]
    (made,) = left.made
    assert (made.i, made.j, made.kind) == (0, 2, "icp")
    assert left.anchors == {2: 1}
    exact = covariance_between([edges[2], edges[3], told("icp", 0, 1)], POSES, 0, 3)
    np.testing.assert_allclose(np.linalg.inv(made.information), exact, rtol=1e-4, atol=1e-9)


def test_a_closure_that_the_graph_contradicts_hands_nothing_on():
    false = told("loop", 0, 2, information=10.0 * MATCH, error=(1.5, 0.0, 0.0))
    edges = [told("icp", 0, 1), told("icp", 1, 2), false, told("icp", 2, 3)]
    left = prune(edges, rows(POSES), [2], FactorMaker(CONFIG).information)
    assert left.made[0].i == 1
    assert left.made[0].i_T_j.equals(POSES[1].between(POSES[3]), 1e-6)


def test_a_closure_to_a_pose_that_goes_ends_at_its_anchor_and_stays_a_closure():
    edges = [told("icp", 0, 1), told("icp", 1, 2), told("icp", 2, 3), told("loop", 1, 3)]
    left = prune(edges, rows(POSES), [1], FactorMaker(CONFIG).information)
    assert [(e.kind, e.i, e.j) for e in left.edges] == [
        ("icp", 1, 2),
        ("icp", 0, 1),
        ("loop", 0, 2),
    ]
    assert left.made == left.edges[1:]


def test_where_the_wheels_alone_tell_the_new_edge_is_as_open_to_doubt_as_their_word():
    blind = told("icp", 1, 2, information=np.diag([0.0, 1e4, 1e5]))
    edges = [told("icp", 0, 1), blind, told("odometry", 1, 2, information=WHEELS)]
    assert (
        prune(edges, rows(POSES), [1], FactorMaker(CONFIG).information).made[0].kind == "odometry"
    )
    sure = [told("icp", 0, 1), told("icp", 1, 2), told("odometry", 1, 2, information=WHEELS)]
    assert prune(sure, rows(POSES), [1], FactorMaker(CONFIG).information).made[0].kind == "icp"


def test_an_edge_that_is_blind_on_an_axis_hands_on_what_it_sees():
    edges = [told("icp", 0, 1, information=np.diag([0.0, 1e4, 1e5])), told("icp", 1, 2)]
    (edge,) = prune(edges, rows(POSES), [1], FactorMaker(CONFIG).information).made
    assert np.linalg.eigvalsh(edge.information)[0] < 1.0
    assert np.linalg.eigvalsh(edge.information)[-1] > 1e3


@pytest.fixture
def laps():
    """Four laps on a noisy circle, each later pose tied to one of the first."""
    rng, lap = np.random.default_rng(5), 16
    angles = 2 * np.pi * np.arange(4 * lap) / lap
    truth = [Pose2(2 * np.sin(a), 2 * (1 - np.cos(a)), a) for a in angles]
    graph = PoseGraph(truth[0], CONFIG)
    for k in range(1, len(truth)):
        step = told("icp", k - 1, k, truth, error=rng.normal(0, [0.01, 0.007, 0.003]))
        graph.add_keyframe(graph.pose(k - 1) * step.i_T_j, [step])
        if k >= lap:
            graph.add_edges([told("loop", k % lap, k, truth, error=rng.normal(0, 0.003, 3))])
    return graph, truth, lap


def test_the_rest_stays_where_it_was_and_claims_no_more(laps):
    graph, truth, lap = laps
    before, marginals = graph.poses.copy(), graph.marginals()
    gone = list(range(lap + 3, 3 * lap, 2))
    smaller, left = graph.without(gone)
    stays = left.index.stays
    assert len(smaller) == len(graph) - len(gone) == stays.sum()
    for pose, was, covariance in zip(smaller.poses, before[stays], marginals[stays], strict=True):
        moved = Pose2.Logmap(Pose2(*was).between(Pose2(*pose)))
        assert (np.abs(moved) <= 2.0 * np.sqrt(np.diag(covariance))).all()
    sigmas = np.linalg.det(smaller.marginals()[1:]) ** (1 / 6)
    were = np.linalg.det(marginals[stays][1:]) ** (1 / 6)
    assert (sigmas > 0.999 * were).all()
    assert (sigmas < 1.3 * were).all()
    smaller.finalise()
    kept = [truth[k] for k in np.flatnonzero(stays)]
    away = [Pose2(*pose).between(true) for pose, true in zip(smaller.poses, kept, strict=True)]
    assert max(np.hypot(p.x(), p.y()) for p in away) < 0.03


def test_the_smaller_graph_goes_on(laps):
    graph, truth, lap = laps
    smaller, _ = graph.without(list(range(lap, 3 * lap)))
    last = len(smaller) - 1
    step = Edge("icp", last, last + 1, truth[0].between(truth[1]), MATCH)
    assert smaller.add_keyframe(smaller.pose(last) * step.i_T_j, [step]) == last + 1
    assert np.isfinite(smaller.marginal(last + 1)).all()
    assert len(graph) == 4 * lap  # the old one is as it was
