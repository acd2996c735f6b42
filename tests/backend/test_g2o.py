"""Graphs as text: every digit there and back, every damage named with its line."""

import gzip

import gtsam
import numpy as np
import pytest
from gtsam import Pose2
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from slam.backend.edges import Edge, GraphError
from slam.backend.g2o import read_g2o, write_g2o

numbers = st.floats(-1e6, 1e6)


def information(root):
    return root @ root.T


roots = npst.arrays(np.float64, (3, 3), elements=st.floats(-100, 100))


@st.composite
def graphs(draw):
    poses = draw(
        npst.arrays(np.float64, st.tuples(st.integers(2, 6), st.just(3)), elements=numbers)
    )
    pairs = st.tuples(*[st.integers(0, len(poses) - 1)] * 2).filter(lambda p: p[0] != p[1])
    edges = [
        Edge(
            "odometry" if j - i == 1 else "loop", i, j,
            Pose2(draw(numbers), draw(numbers), draw(st.floats(-3.14, 3.14))),
            information(draw(roots)),
        )
        for i, j in draw(st.lists(pairs, max_size=5))
    ]  # fmt: skip
    return poses, edges


@given(graphs())
def test_round_trip_keeps_every_digit(tmp_path_factory, graph):
    poses, edges = graph
    path = tmp_path_factory.mktemp("g2o") / "graph.g2o"
    write_g2o(path, poses, edges, [edge.information for edge in edges])
    back = read_g2o(path)
    np.testing.assert_array_equal(back.poses, poses)
    assert [(e.i, e.j, e.kind) for e in back.edges] == [(e.i, e.j, e.kind) for e in edges]
    for found, edge in zip(back.edges, edges, strict=True):
        assert (found.i_T_j.x(), found.i_T_j.y()) == (edge.i_T_j.x(), edge.i_T_j.y())
        # A Pose2 keeps cosine and sine, so that the angle itself may move by its last bit.
        assert abs(found.i_T_j.theta() - edge.i_T_j.theta()) < 1e-15
        upper = np.triu_indices(3)
        np.testing.assert_array_equal(found.information[upper], edge.information[upper])
        np.testing.assert_array_equal(found.information, found.information.T)
    assert back.skipped == 0


def test_gzipped_files_and_foreign_ids_are_read(tmp_path):
    text = (
        "# a comment\nVERTEX_SE2 30 1 2 0.5\nVERTEX_SE2 10 0 0 0\nFIX 10\nVERTEX_XY 7 1 1\n"
        "EDGE_SE2 10 30 1 2 0.5 1 0 0 2 0 3\n"
    )
    path = tmp_path / "graph.g2o.gz"
    path.write_bytes(gzip.compress(text.encode()))
    graph = read_g2o(path)
    assert graph.ids.tolist() == [10, 30]
    assert graph.skipped == 1
    (edge,) = graph.edges
    assert (edge.i, edge.j, edge.kind) == (0, 1, "odometry")
    np.testing.assert_array_equal(edge.information, np.diag([1.0, 2.0, 3.0]))


def test_neighbouring_ids_of_symbols_stay_apart(tmp_path):
    """GTSAM's x0 and x1 differ only beyond the digits of a float."""
    x0 = ord("x") << 56
    path = tmp_path / "graph.g2o"
    path.write_text(
        f"VERTEX_SE2 {x0} 0 0 0\nVERTEX_SE2 {x0 + 1} 1 0 0\n"
        f"EDGE_SE2 {x0} {x0 + 1} 1 0 0 1 0 0 1 0 1\n"
    )
    graph = read_g2o(path)
    assert graph.ids.tolist() == [x0, x0 + 1]
    assert [(e.i, e.j) for e in graph.edges] == [(0, 1)]


TWO = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no VERTEX_SE2"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "holds no VERTEX_SE2"),
        ("VERTEX_SE2 0 0 0\n", ":1: VERTEX_SE2 with 3 numbers"),
        ("VERTEX_SE2 0 0 zero 0\n", ":1: not a number"),
        (TWO + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0\n", ":3: EDGE_SE2 with 10 numbers"),
        (TWO + "EDGE_SE2 0 5 1 0 0 1 0 0 1 0 1\n", ":3: edge to unknown vertex 5"),
        (TWO + "EDGE_SE2 1 1 1 0 0 1 0 0 1 0 1\n", ":3: edge from vertex 1 to itself"),
        (TWO + "EDGE_SE2 0 1 nan 0 0 1 0 0 1 0 1\n", ":3: odometry edge 0-1: .* not finite"),
        (f"VERTEX_SE2 {2**63} 0 0 0\n", ":1: vertex id 9223372036854775808 does not fit"),
        ("VERTEX_SE2 nan 0 0 0\n", ":1: not a number"),
        ("VERTEX_SE2 0 0 nan 0\n", ":1: vertex pose is not finite"),
        ("VERTEX_SE2 0 0 0 inf\n", ":1: vertex pose is not finite"),
        (TWO + "EDGE_SE2 nan 1 1 0 0 1 0 0 1 0 1\n", ":3: not a number"),
        (TWO + "EDGE_SE2 0.5 1 1 0 0 1 0 0 1 0 1\n", ":3: not a number"),
        (TWO + f"EDGE_SE2 0 {10**30} 1 0 0 1 0 0 1 0 1\n", ":3: vertex id 1000000"),
        (TWO + "EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1\n", ":3: odometry edge 0-1: .* negative"),
    ],
)
def test_damage_is_named_with_its_line(tmp_path, text, message):
    path = tmp_path / "graph.g2o"
    path.write_text(text)
    with pytest.raises(GraphError, match=message) as caught:
        read_g2o(path)
    assert str(path) in str(caught.value)


CORRUPT = gzip.compress(TWO.encode())[:10] + b"\xff" * 20


def test_what_is_no_text_is_refused(tmp_path):
    path = tmp_path / "graph.g2o"
    for data in (b"\x89PNG\xff\xfe", gzip.compress(TWO.encode())[:-12], CORRUPT):
        path.write_bytes(data)
        with pytest.raises(GraphError, match="is not g2o text"):
            read_g2o(path)
    with pytest.raises(GraphError, match="cannot be read"):
        read_g2o(tmp_path / "missing.g2o")


TORO = "VERTEX2 0 0 0 0\nVERTEX2 1 1.2 0.1 0\nVERTEX2 2 2.1 0.2 0\nVERTEX2 3 2.7 0.3 0\n" + "".join(
    f"EDGE2 {k} {k + 1} 1 0 0 100 0 25 400 0 0\n" for k in range(3)
)


def test_toro_has_an_order_of_information_of_its_own(tmp_path):
    (tmp_path / "toro.graph").write_text(TORO)
    graph = read_g2o(tmp_path / "toro.graph")
    assert len(graph.edges) == 3
    assert graph.skipped == 0
    np.testing.assert_array_equal(graph.edges[0].information, np.diag([100.0, 25.0, 400.0]))
    (tmp_path / "full.graph").write_text(TORO + "EDGE2 0 2 2 0 0 100 1 25 400 2 3\n")
    full = read_g2o(tmp_path / "full.graph").edges[-1].information
    np.testing.assert_array_equal(full, [[100, 1, 2], [1, 25, 3], [2, 3, 400]])
    (tmp_path / "g2o.graph").write_text(TORO.replace("100 0 25 400 0 0", "100 0 0 25 0 400"))
    other = read_g2o(tmp_path / "g2o.graph")
    np.testing.assert_array_equal(other.edges[0].information, np.diag([100.0, 25.0, 400.0]))
    assert other.left_out.total() == 3


def test_what_is_not_used_is_counted_by_kind(tmp_path):
    lines = (
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY 7 1 1\nEDGE_SE2_XY 0 7 1 1 1 0 1\n"
        "EDGE_PRIOR_SE2 0 0 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nFIX 1 9\n"
    )
    (tmp_path / "a.g2o").write_text(lines)
    graph = read_g2o(tmp_path / "a.g2o")
    assert graph.left_out == {
        "VERTEX_XY lines": 1, "EDGE_SE2_XY lines": 1, "EDGE_PRIOR_SE2 lines": 1,
        "FIX of a further or unknown vertex: one is held": 1,
    }  # fmt: skip
    assert graph.fixed == 1


@given(graphs())
def test_gtsam_reads_the_same_graph_with_the_same_error(tmp_path_factory, graph):
    poses, edges = graph
    edges = [e for e in edges if abs(np.linalg.slogdet(e.information)[1]) < 40]  # gtsam inverts it
    path = tmp_path_factory.mktemp("g2o") / "graph.g2o"
    write_g2o(path, poses, edges, [edge.information for edge in edges])
    factors, values = gtsam.readG2o(str(path), False)
    assert factors.size() == len(edges)
    assert values.size() == len(poses)
    ours = gtsam.NonlinearFactorGraph()
    for e in edges:
        noise = gtsam.noiseModel.Gaussian.Information(e.information)
        ours.add(gtsam.BetweenFactorPose2(e.i, e.j, e.i_T_j, noise))
    expected = ours.error(values)
    assert factors.error(values) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_another_programs_reader_finds_every_vertex_and_edge(tmp_path):
    load = pytest.importorskip("graphslam.load", reason="graphslam is not installed").load_g2o_se2
    rng = np.random.default_rng(1)
    poses = rng.normal(size=(5, 3))
    edges = [Edge("odometry", k, k + 1, Pose2(1, 0, 0.1), np.diag([4.0, 3, 2])) for k in range(4)]
    write_g2o(tmp_path / "a.g2o", poses, edges, [e.information for e in edges])
    graph = load(str(tmp_path / "a.g2o"))
    assert (len(graph._vertices), len(graph._edges)) == (5, 4)
    np.testing.assert_allclose([v.pose.to_array() for v in graph._vertices], poses, atol=1e-12)
