"""The last word on a graph: one robust batch optimisation that judges every loop closure anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slam.backend.batch_optimisation import OUTLIER, FactorMaker, optimise
from slam.backend.edges import Edge, Matrix


@dataclass(frozen=True, eq=False, slots=True)
class FinalGraph:
    """Poses, and the edges that agree with them."""

    poses: Matrix  # (n, 3) [x, y, theta] of map_T_k
    edges: list[Edge]  # those that are used, in their order
    informations: list[Matrix]  # (3, 3) of each as optimised
    loops: int  # loop closures among the edges that were given
    removed: dict[int, str]  # index among the edges that were given -> why it is not used
    error_before: float  # half the weighted squared error of the used edges, robust
    error_after: float


def finalise(poses: Matrix, edges: Sequence[Edge], maker: FactorMaker) -> FinalGraph:
    """Optimise from `poses` (n, 3); loops that the whole graph contradicts are left out.

    Raises:
        GraphError: the optimiser gave up.
    """
    result = optimise(poses, edges, maker)
    removed = {
        k: f"removed: chi-square {edges[k].chi_square(result.poses):.0f} against the whole graph"
        for k, weight in result.loop_weights.items()
        if weight < OUTLIER
    }
    kept = [edge for k, edge in enumerate(edges) if k not in removed]
    return FinalGraph(
        result.poses, kept, [maker.information(edge) for edge in kept], len(result.loop_weights),
        removed, result.error_before, result.error_after,
    )  # fmt: skip
