"""Leave poses out of a graph: their constraints are handed on to those that stay.

The exact way would connect all neighbours of a pose that goes to one another, and the graph would
fill up.  Each pose gives one edge to every later neighbour instead, as a graph for which old
places suffice needs no more (cf. Kretzschmar and Stachniss 2012, "Information-theoretic
compression of pose graphs for laser-based SLAM").
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.backend.chi_square import SUSPICIOUS
from slam.backend.edges import Edge, Kind, Matrix

InformationOf = Callable[[Edge], Matrix]  # (3, 3) information with which an edge is optimised

_RIDGE = 1e-6  # 1 / m^2 or 1 / rad^2: a kilometre, where no edge sees an axis


class Renumbered:
    """The indices of poses that stay, once some are gone."""

    def __init__(self, count: int, gone: Sequence[int]) -> None:
        self.stays = np.ones(count, dtype=bool)
        self.stays[list(gone)] = False
        self._index = np.cumsum(self.stays) - 1

    def __call__(self, k: int) -> int:
        """The new index of one that stays; of one that is gone, that of the last before it."""
        return int(self._index[k])

    def keeps(self, i: int, j: int) -> bool:
        """Whether both stay."""
        return bool(self.stays[i] and self.stays[j])

    def renamed(self, edge: Edge) -> Edge:
        """An edge between two that stay, under their new indices."""
        return edge.renamed(self(edge.i), self(edge.j))

    def all(self, indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """The same for several."""
        renumbered: NDArray[np.int64] = self._index[indices]
        return renumbered


@dataclass(frozen=True, eq=False, slots=True)
class Pruned:
    """What a graph is without some of its poses."""

    untouched: list[Edge]  # those that did not touch them
    edges: list[Edge]  # the same under new indices, and new ones behind
    anchors: dict[int, int]  # pose that went -> one before it that stays, under the old indices
    index: Renumbered

    @property
    def made(self) -> list[Edge]:
        """The new edges alone."""
        return self.edges[len(self.untouched) :]


@dataclass(frozen=True, eq=False, slots=True)
class _Constraint:
    """What several edges know together of one relative pose."""

    i_T_j: Pose2
    information: Matrix  # (3, 3), in frame j
    agrees: bool  # with where the graph has both
    well_constrained: bool  # without the odometry, which may be wrong, it is not much weaker

    @property
    def log_det(self) -> float:
        """Logarithm of the information's determinant."""
        return float(np.linalg.slogdet(self.information)[1])

    def edge(self, kind: Kind, i: int, j: int) -> Edge:
        """As one measurement."""
        return Edge(kind, i, j, self.i_T_j, 0.5 * (self.information + self.information.T))


def prune(
    edges: Sequence[Edge], poses: Matrix, gone: Sequence[int], information_of: InformationOf
) -> Pruned:
    """The graph without the poses `gone`.

    New edges lead from the earlier neighbour that constrains such a pose best to its later ones;
    what the other earlier neighbours know of it is given up.  With one later neighbour the
    rest of the graph is never better known than before; several share what the first one knows.

    Args:
        edges: each from an earlier pose to a later one (i < j).
        poses: (n, 3) map_T_k [x, y, theta], where the graph has them.
        gone: indices; each has an edge to an earlier pose, which 0 cannot have.
        information_of: (3, 3) with which an edge is optimised.
    """
    leaving, anchors, made = set(gone), {}, []
    touching: dict[int, list[Edge]] = {v: [] for v in sorted(leaving)}
    for edge in edges:
        for end in leaving.intersection((edge.i, edge.j)):
            touching[end].append(edge)
    for v, touched in touching.items():
        before = _by_end([edge for edge in touched if edge.i != v and edge.i not in leaving], "i")
        after = _by_end([edge for edge in touched if edge.i == v], "j")
        anchors[v] = min(before, key=lambda i: (float(np.hypot(*(poses[i] - poses[v])[:2])), i))
        first, nearest = _best(
            {i: _combined(group, poses, information_of) for i, group in before.items()}
        )
        for j, group in after.items():
            through = _joined(nearest, _combined(group, poses, information_of))
            kind: Kind = "icp" if through.well_constrained else "odometry"
            if all(edge.kind == "loop" for edge in group):
                kind = "loop"
            new = through.edge(kind, first, j)
            if j in leaving:
                touching[j].append(new)
            else:
                made.append(new)
    index = Renumbered(len(poses), gone)
    untouched = [edge for edge in edges if index.keeps(edge.i, edge.j)]
    left = [index.renamed(edge) for edge in (*untouched, *made)]
    return Pruned(untouched, left, anchors, index)


def _by_end(edges: Sequence[Edge], end: str) -> dict[int, list[Edge]]:
    groups: dict[int, list[Edge]] = defaultdict(list)
    for edge in edges:
        groups[getattr(edge, end)].append(edge)
    return groups


def _best(constraints: dict[int, _Constraint]) -> tuple[int, _Constraint]:
    """The most informative one, of those that the graph does not contradict if there are any."""
    return max(constraints.items(), key=lambda item: (item[1].agrees, item[1].log_det))


def _combined(edges: Sequence[Edge], poses: Matrix, information_of: InformationOf) -> _Constraint:
    """Edges between the same two poses as one constraint."""
    known = Pose2(*poses[edges[0].i]).between(Pose2(*poses[edges[0].j]))
    total, pull, matched = _RIDGE * np.eye(3), np.zeros(3), np.zeros((3, 3))
    for edge in edges:
        information = information_of(edge)
        total = total + information
        if edge.kind != "odometry":
            matched = matched + information
        pull = pull + information @ Pose2.Logmap(known.between(edge.i_T_j))
    error = np.linalg.solve(total, pull)
    well_constrained = np.linalg.eigvalsh(matched)[0] > 0.5 * np.linalg.eigvalsh(total)[0]
    agrees = float(error @ total @ error) <= SUSPICIOUS
    return _Constraint(known * Pose2.Expmap(error), total, agrees, bool(well_constrained))


def _joined(a: _Constraint, b: _Constraint) -> _Constraint:
    """One constraint behind the other."""
    back = b.i_T_j.inverse().AdjointMap()
    covariance = back @ np.linalg.inv(a.information) @ back.T + np.linalg.inv(b.information)
    return _Constraint(
        a.i_T_j * b.i_T_j,
        np.linalg.inv(covariance),
        a.agrees and b.agrees,
        a.well_constrained and b.well_constrained,
    )
