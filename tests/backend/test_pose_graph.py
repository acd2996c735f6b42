"""The graph on small cases whose answer is known."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.batch_optimisation import ANCHOR_SIGMA
from slam.backend.edges import Edge, GraphError
from slam.backend.pose_graph import GraphConfig, PoseGraph

SHARP = np.diag([1e4, 1e4, 1e5])  # sigmas of 1 cm and 0.18 deg
LOOSE = np.diag([400.0, 400.0, 2500.0])  # sigmas of 5 cm and 1.1 deg
PLAIN = GraphConfig(match_sigma_trans=0.0, match_sigma_rot=0.0)  # weights are the edges' own


def ring(n=24, radius=5.0):
    """True poses on a circle, driven anticlockwise."""
    angles = 2 * np.pi * np.arange(n) / n
    return [Pose2(radius * np.sin(a), radius * (1 - np.cos(a)), a) for a in angles]


def edge(kind, i, j, truth, noise=(0.0, 0.0, 0.0), information=SHARP):
    return Edge(kind, i, j, truth[i].between(truth[j]) * Pose2.Expmap(np.array(noise)), information)


def drifting_ring(truth, seed=0, config=PLAIN):
    """A graph of noisy odometry alone, whose last pose is far from where it should be."""
    rng = np.random.default_rng(seed)
    graph = PoseGraph(truth[0], config)
    for k in range(1, len(truth)):
        noise = rng.normal(0, [0.05, 0.05, 0.02])
        step = edge("odometry", k - 1, k, truth, noise, LOOSE)
        graph.add_keyframe(graph.pose(k - 1) * step.i_T_j, [step])
    return graph


def worst(graph, truth):
    return max(
        np.hypot(*(np.array([p.x(), p.y()]) - graph.poses[k, :2])) for k, p in enumerate(truth)
    )


def test_exact_measurements_lead_to_the_truth_from_a_wrong_start():
    truth = ring()
    graph = PoseGraph(truth[0], PLAIN)
    for k in range(1, len(truth)):
        wrong = truth[k] * Pose2(0.3, -0.2, 0.2)
        graph.add_keyframe(wrong, [edge("icp", k - 1, k, truth)])
    graph.add_edges([edge("loop", 0, len(truth) - 1, truth)])
    assert worst(graph, truth) < 1e-3  # ISAM2 stops short of the last digits
    graph.finalise()
    assert worst(graph, truth) < 1e-6
    assert len(graph) == len(truth)


def test_two_measurements_meet_at_their_weighted_mean():
    graph = PoseGraph(Pose2(), PLAIN)
    one = Edge("icp", 0, 1, Pose2(1.0, 0.0, 0.0), np.diag([100.0, 100.0, 100.0]))
    three = Edge("icp", 0, 1, Pose2(1.2, 0.0, 0.0), np.diag([300.0, 300.0, 300.0]))
    graph.add_keyframe(Pose2(1.0, 0.0, 0.0), [one, three])
    graph.finalise()
    np.testing.assert_allclose(graph.poses[1], [1.15, 0.0, 0.0], atol=1e-6)


def test_a_loop_brings_a_drifting_ring_home():
    truth = ring()
    graph = drifting_ring(truth)
    before = worst(graph, truth)
    graph.add_edges([edge("loop", 0, len(truth) - 1, truth)])
    graph.finalise()
    assert before > 0.5
    assert worst(graph, truth) < 0.5 * before
    last = graph.pose(0).between(graph.pose(len(truth) - 1))
    assert last.equals(truth[0].between(truth[-1]), 0.02)


def dense_joint(graph, edges, i, j):
    """Joint covariance of poses i and j by inverting the whole information matrix.

    At poses that satisfy every edge; Jacobians by finite differences.
    """
    n, h = len(graph), 1e-6
    poses = [graph.pose(k) for k in range(n)]
    total = np.zeros((3 * n, 3 * n))
    anchor = [ANCHOR_SIGMA] * 3
    total[:3, :3] = np.diag(1.0 / np.square(anchor))
    for e in edges:
        jacobian = np.zeros((3, 3 * n))
        for end in (e.i, e.j):
            for axis in range(3):
                shift = h * np.eye(3)[axis]
                ends = []
                for sign in (1, -1):
                    moved = list(poses)
                    moved[end] = poses[end] * Pose2.Expmap(sign * shift)
                    ends.append(Pose2.Logmap(e.i_T_j.between(moved[e.i].between(moved[e.j]))))
                jacobian[:, 3 * end + axis] = (ends[0] - ends[1]) / (2 * h)
        total += jacobian.T @ e.information @ jacobian
    rows = np.r_[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
    return np.linalg.inv(total)[np.ix_(rows, rows)]


@pytest.mark.parametrize(("i", "j"), [(0, 11), (3, 4), (9, 2), (5, 11)])
def test_covariances_are_those_of_the_dense_system(i, j):
    truth = ring(12)
    correlated = np.array([[900.0, 300.0, 50.0], [300.0, 500.0, -80.0], [50.0, -80.0, 3000.0]])
    edges = [edge("odometry", k - 1, k, truth, information=correlated) for k in range(1, 12)]
    loop = edge("loop", 2, 10, truth, information=LOOSE)
    graph = PoseGraph(truth[0], PLAIN)
    for k, step in enumerate(edges, start=1):
        graph.add_keyframe(truth[k], [step])
    graph.add_edges([loop])
    joint = dense_joint(graph, [*edges, loop], i, j)
    tolerance = 1e-6 * np.abs(joint).max()
    np.testing.assert_allclose(graph.marginal(i), joint[:3, :3], atol=tolerance)
    np.testing.assert_allclose(graph.marginals()[j], joint[3:, 3:], atol=tolerance)
    i_T_j, covariance = graph.relative(i, j)
    jacobian = np.hstack([-i_T_j.inverse().AdjointMap(), np.eye(3)])
    np.testing.assert_allclose(covariance, jacobian @ joint @ jacobian.T, atol=2 * tolerance)
    assert i_T_j.equals(truth[i].between(truth[j]), 1e-6)


def test_neighbours_are_known_better_than_their_places():
    truth = ring(12)
    graph = PoseGraph(truth[0], PLAIN)
    for k in range(1, 12):
        graph.add_keyframe(truth[k], [edge("odometry", k - 1, k, truth, information=LOOSE)])
    _, step = graph.relative(10, 11)
    np.testing.assert_allclose(step, np.linalg.inv(LOOSE), atol=1e-9)
    assert np.trace(graph.marginal(11)) > 5 * np.trace(step)


@pytest.mark.parametrize("wrong", [(3.0, 1.0, 0.5), (0.0, 4.0, 0.0), (1.0, 0.0, 2.0)])
def test_the_batch_leaves_out_a_false_loop_and_keeps_the_true_ones(wrong):
    truth = ring()
    n = len(truth)
    true_loops = [edge("loop", 0, n - 1, truth), edge("loop", 1, n - 2, truth)]
    false_loop = edge("loop", 4, n // 2, truth, wrong)
    clean = drifting_ring(truth)
    clean.add_edges(true_loops)
    clean.finalise()
    graph = drifting_ring(truth)
    graph.add_edges([*true_loops, false_loop])
    index = graph.edges.index(false_loop)
    final = graph.finalise()
    assert list(final.removed) == [index]
    assert final.removed[index].startswith("removed: chi-square")
    assert final.loops == 3
    assert graph.edges == final.edges
    assert [e in graph.edges for e in (*true_loops, false_loop)] == [True, True, False]
    np.testing.assert_allclose(graph.poses, clean.poses, atol=1e-3)


def test_a_removed_loop_has_no_more_influence_and_a_refused_one_gets_another_chance():
    truth = ring()
    graph, clean = drifting_ring(truth), drifting_ring(truth)
    true_loop = edge("loop", 0, len(truth) - 1, truth)
    false_loop = edge("loop", 0, len(truth) // 2, truth, (2.0, 1.0, 0.3))
    graph.add_edges([false_loop])
    final = graph.finalise([true_loop])
    assert false_loop not in final.edges
    assert true_loop in final.edges
    clean.finalise([true_loop])
    graph.finalise()
    clean.finalise()
    np.testing.assert_allclose(graph.poses, clean.poses, atol=1e-4)


def test_equal_graphs_have_equal_bits():
    def bits():
        truth = ring()
        graph = drifting_ring(truth, config=GraphConfig())
        graph.add_edges([edge("loop", 0, 23, truth), edge("loop", 3, 20, truth, (1.0, 0.0, 0.4))])
        return graph.finalise().poses.tobytes(), graph.marginals().tobytes()

    assert bits() == bits()


def test_the_models_error_widens_a_match_but_not_the_odometry():
    graph = PoseGraph(Pose2(), GraphConfig(match_sigma_trans=0.02, match_sigma_rot=0.01))
    information = np.array([[900.0, 300.0, 50.0], [300.0, 500.0, -80.0], [50.0, -80.0, 3000.0]])
    widened = np.linalg.inv(np.linalg.inv(information) + np.diag([4e-4, 4e-4, 1e-4]))
    found = graph.information(Edge("icp", 0, 1, Pose2(), information))
    np.testing.assert_allclose(found, widened, rtol=1e-9)
    kept = graph.information(Edge("odometry", 0, 1, Pose2(), information))
    np.testing.assert_array_equal(kept, information)


def test_a_blind_axis_stays_blind_when_widened():
    graph = PoseGraph(Pose2(), GraphConfig())
    weight = graph.information(Edge("icp", 0, 1, Pose2(), np.diag([0.0, 1e4, 1e5])))
    assert abs(weight[0]).max() < 1e-9
    assert np.linalg.eigvalsh(weight)[0] >= -1e-9


def test_a_keyframe_must_be_tied_to_an_earlier_one():
    graph = PoseGraph(Pose2(), PLAIN)
    step = Edge("odometry", 0, 1, Pose2(1, 0, 0), SHARP)
    with pytest.raises(GraphError, match="keyframe 1 has no edge"):
        graph.add_keyframe(Pose2(), [])
    for i, j in ((0, 2), (1, 1), (1, 0), (-1, 1)):
        with pytest.raises(GraphError, match="does not tie keyframe 1"):
            graph.add_keyframe(Pose2(), [Edge("odometry", i, j, Pose2(), SHARP)])
    assert graph.add_keyframe(Pose2(1, 0, 0), [step]) == 1  # a refusal leaves the graph usable
    for i, j in ((0, 2), (1, 1), (-1, 0)):
        with pytest.raises(GraphError, match="no such pair"):
            graph.add_edges([Edge("loop", i, j, Pose2(), SHARP)])
    assert len(graph) == 2
    assert len(graph.edges) == 1


def test_a_heading_that_is_hardly_known_beside_a_well_known_place_breaks_nothing():
    """Cholesky refuses the step from millimetres to radians; QR does not."""
    step, sigmas = Pose2(0.5, 0.0, 0.1), np.array([1e-3, 1e-3, 3.0])
    graph = PoseGraph(Pose2(), GraphConfig())
    for k in range(20):
        edge = Edge("odometry", k, k + 1, step, np.diag(1.0 / sigmas**2))
        graph.add_keyframe(graph.pose(k) * step, [edge])
    # A factor's ridge, 1e-9 of the best-known axis, is 1 % of what is known of the heading here.
    assert graph.marginal(20)[2, 2] == pytest.approx(20 * sigmas[2] ** 2, rel=0.02)
    assert np.allclose(graph.marginals()[20], graph.marginal(20), rtol=1e-6)
    graph.add_edges([Edge("loop", 0, 20, graph.pose(20), np.eye(3) * 1e4)])
    assert graph.marginal(20)[2, 2] < 0.1
    assert np.isfinite(graph.finalise().poses).all()
