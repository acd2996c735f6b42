"""The back end once more over foreign graphs."""

import numpy as np
from slam.backend.g2o import read_g2o
from slam.logs.trajectory import read_tum

from slam.runs.reoptimise import reoptimise


def test_a_graph_with_ids_of_symbols_is_solved(tmp_path):
    """GTSAM names its poses x0, x1, ... and writes them as numbers beyond any count of seconds."""
    x0 = ord("x") << 56
    lines = [f"VERTEX_SE2 {x0 + k} {k + 0.1} 0 0" for k in range(3)]
    lines += [f"EDGE_SE2 {x0 + k} {x0 + k + 1} 1 0 0 100 0 0 100 0 100" for k in range(2)]
    source, out = tmp_path / "graph.g2o", tmp_path / "run"
    source.write_text("\n".join(lines) + "\n")
    assert reoptimise(source, out, None, [])["keyframes"] == 3
    keyframes = read_tum(out / "keyframes.tum")
    assert keyframes.stamps_ns.tolist() == [0, 10**9, 2 * 10**9]
    np.testing.assert_allclose(np.diff(keyframes.poses[:, 0]), 1.0, atol=1e-6)
    np.testing.assert_array_equal(read_g2o(out / "graph.g2o").poses, keyframes.poses)
