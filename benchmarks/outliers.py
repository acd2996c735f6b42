"""`slam bench outliers`: public pose graphs with false loops mixed in."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gtsam import Pose2
from slam.backend.batch_optimisation import OUTLIER, FactorMaker, GraphConfig, optimise
from slam.backend.edges import Edge
from slam.backend.g2o import G2oGraph, read_g2o
from slam.backend.se2 import compose

from slam.evaluation.metrics import align
from slam.runs.errors import RunError

GRAPHS = {
    "M3500": "nano-pgo-input_M3500_g2o",
    "intel": "vertigo-intel",
    "ring": "vertigo-ring",
}
SHARES = (0.1, 0.2, 0.5)  # false loops for every true one
PLAIN = {"match_sigma_trans": 0.0, "match_sigma_rot": 0.0}


def bench_outliers(data: Path, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Add random false loops, optimise, and compare with the optimum of the clean graph.

    Raises:
        RunError: the graphs are not there.
    """
    rows = []
    for name, file in GRAPHS.items():
        path = data / "graphs" / f"{file}.g2o.gz"
        if not path.is_file():
            raise RunError(f"{path}: no such graph; say where they are with --data")
        graph = read_g2o(path)
        config = GraphConfig(**PLAIN)
        clean = optimise(
            graph.poses,
            graph.edges,
            FactorMaker(GraphConfig(**PLAIN, robust=False, reject_loops=False)),
        ).poses
        for share in SHARES[:2] if quick else SHARES:
            echo(f"{name}: {share:.0%} false loops")
            rows.append({"graph": name, **_mixed(graph, clean, share, config)})
    return {"meta": {"seed": 1, "unit": "m"}, "rows": rows}


def _mixed(
    graph: G2oGraph, clean: np.ndarray[Any, Any], share: float, config: GraphConfig
) -> dict[str, Any]:
    false = false_loops(graph, share, np.random.default_rng(1))
    begin = time.perf_counter()
    result = optimise(graph.poses, [*graph.edges, *false], FactorMaker(config))
    wall = time.perf_counter() - begin
    refused = {k for k, weight in result.loop_weights.items() if weight < OUTLIER}
    hits = sum(k >= len(graph.edges) for k in refused)
    aligned = align(result.poses, clean)
    offsets = np.hypot(*(compose(aligned, result.poses) - clean)[:, :2].T)
    return {
        "share": share,
        "false_loops": len(false),
        "ate_to_clean_m": float(np.sqrt(np.mean(offsets**2))),
        "extent_m": float(np.ptp(clean[:, :2], axis=0).max()),
        "precision": hits / max(len(refused), 1),
        "recall": hits / max(len(false), 1),
        "wall_s": wall,
    }


def false_loops(graph: G2oGraph, share: float, rng: np.random.Generator) -> list[Edge]:
    """Loops between random poses with random transforms, as confident as the graph's own."""
    true = [edge for edge in graph.edges if edge.kind == "loop"]
    spread = 0.03 * float(np.ptp(graph.poses[:, :2], axis=0).max())
    false: list[Edge] = []
    while len(false) < share * len(true):
        i, j = sorted(int(k) for k in rng.integers(0, len(graph.poses), 2))
        if j - i < 2:
            continue
        shift = rng.normal(0.0, spread, 2)
        transform = Pose2(shift[0], shift[1], rng.uniform(-np.pi, np.pi))
        false.append(Edge("loop", i, j, transform, true[0].information))
    return false
