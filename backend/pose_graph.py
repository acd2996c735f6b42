"""The pose graph: ISAM2 while the robot drives, robust batch optimisation at the end."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam import Pose2
from gtsam.symbol_shorthand import X
from slam.backend.batch_optimisation import (
    FactorMaker,
    GraphConfig,
    chi_squares,
    values_of,
)
from slam.backend.chi_square import SUSPICIOUS
from slam.backend.edges import Edge, GraphError, Matrix, relative_covariance
from slam.backend.final_optimisation import FinalGraph, finalise
from slam.backend.pruned_graph import Pruned, prune

__all__ = ["Edge", "GraphConfig", "GraphError", "PoseGraph"]

# A pose that moves farther than this is linearised anew by ISAM2.  Between factors bend with the
# heading alone, so the limit in metres is wide.
RELINEARISE_M, RELINEARISE_RAD = 0.5, 0.02
SETTLE = 3  # further ISAM2 updates after a loop that turns poses, at most


class PoseGraph:
    """Keyframe poses `map_T_k` and the measurements between them; keyframe 0 is held."""

    def __init__(self, map_T_first: Pose2, config: GraphConfig) -> None:
        self.config = config
        self.edges: list[Edge] = []
        self._maker = FactorMaker(config)
        self._first = map_T_first
        self._isam = self._begun("CHOLESKY")
        self._poses = np.array([[map_T_first.x(), map_T_first.y(), map_T_first.theta()]])
        self._count = 1

    @classmethod
    def restored(
        cls, poses: Matrix, edges: Sequence[Edge], config: GraphConfig,
        maker: FactorMaker | None = None,
    ) -> PoseGraph:  # fmt: skip
        """The graph of a finished run, at its poses (n, 3); `maker` may know its edges already.

        Raises:
            GraphError: an edge names a keyframe that does not exist.
        """
        graph = cls(Pose2(*poses[0]), config)
        graph._maker = maker or graph._maker
        values = gtsam.Values()
        for k in range(1, len(poses)):
            values.insert(X(k), Pose2(*poses[k]))
        graph._poses, graph._count = poses.copy(), len(poses)
        graph._check(edges)
        graph._update(edges, values)
        graph._refresh(graph._isam.calculateEstimate())
        return graph

    def __len__(self) -> int:
        return self._count

    @property
    def poses(self) -> Matrix:
        """(n, 3) current estimates [x, y, theta] of map_T_k; a view, not to be written."""
        return self._poses[: self._count]

    def pose(self, k: int) -> Pose2:
        """Current estimate of map_T_k."""
        return Pose2(*self._poses[k])

    def add_keyframe(self, guess: Pose2, edges: Sequence[Edge]) -> int:
        """Append a keyframe with the edges that tie it to earlier ones; return its index.

        Args:
            guess: map_T_new, where the optimiser starts.
            edges: at least one, each ending (j) at the new keyframe; together they see all axes.

        Raises:
            GraphError: an edge is missing, points elsewhere, or an axis is tied by none.
        """
        new = self._count
        if not edges:
            raise GraphError(f"keyframe {new} has no edge: nothing would hold it")
        for edge in edges:
            if edge.j != new or not 0 <= edge.i < new:
                raise GraphError(f"edge {edge.i}-{edge.j} does not tie keyframe {new}")
        total = sum((self._maker.information(edge) for edge in edges), np.zeros((3, 3)))
        if np.linalg.eigvalsh(total)[0] < 1e-6:
            raise GraphError(f"keyframe {new} is loose: its edges leave an axis open")
        values = gtsam.Values()
        values.insert(X(new), guess)
        self._grow()
        self._count = new + 1
        self._update(edges, values)
        pose = self._isam.calculateEstimatePose2(X(new))
        self._poses[new] = pose.x(), pose.y(), pose.theta()
        return new

    def add_edges(self, edges: Sequence[Edge]) -> None:
        """Add edges between existing keyframes and update every pose.

        Raises:
            GraphError: an edge names a keyframe that does not exist.
        """
        for edge in edges:
            if not (0 <= edge.i < self._count and 0 <= edge.j < self._count and edge.i != edge.j):
                raise GraphError(f"edge {edge.i}-{edge.j}: no such pair of keyframes")
        headings = self.poses[:, 2].copy()
        self._update(edges, gtsam.Values())
        self._refresh(self._isam.calculateEstimate())
        for _ in range(SETTLE):  # what is turned much at once has to be linearised anew
            turns = np.abs(np.sin(self.poses[:, 2] - headings))
            if turns.max() < RELINEARISE_RAD:
                break
            headings = self.poses[:, 2].copy()
            self._isam.update()
            self._refresh(self._isam.calculateEstimate())

    def add_edges_batch(self, edges: Sequence[Edge]) -> None:
        """Add edges that only the next batch optimisation shall see; ISAM2 stays as it is."""
        self.edges += edges

    def without(self, gone: Sequence[int]) -> tuple[PoseGraph, Pruned]:
        """A new graph that lacks the keyframes `gone`, and what became of their edges."""
        left = prune(self.edges, self.poses, gone, self.information)
        maker = self._maker.renamed(zip(left.untouched, left.edges, strict=False))
        poses = self.poses[left.index.stays]
        return PoseGraph.restored(poses, left.edges, self.config, maker), left

    def information(self, edge: Edge) -> Matrix:
        """(3, 3) information with which an edge is optimised."""
        return self._maker.information(edge)

    def agrees(self, edge: Edge) -> bool:
        """Whether an edge, in the graph or not, fits where the poses are now."""
        return bool(chi_squares(self.poses, [edge], self._maker)[0] <= SUSPICIOUS)

    def marginal(self, k: int) -> Matrix:
        """(3, 3) covariance of map_T_k in its own frame."""
        covariance: Matrix = self._isam.marginalCovariance(X(k))
        return covariance

    def marginals(self) -> Matrix:
        """(n, 3, 3) covariance of every map_T_k in its own frame, from the batch graph."""
        graph = self._maker.graph(self._first, self.edges, robust=True)
        values, names = values_of(self.poses), [X(k) for k in range(self._count)]
        try:
            marginals = gtsam.Marginals(graph, values)
            return np.array([marginals.marginalCovariance(x) for x in names])
        except RuntimeError:  # as in _update
            isam = self._begun("QR")
            isam.update(self._factors(self.edges), _without_first(values))
            return np.array([isam.marginalCovariance(x) for x in names])

    def relative(self, i: int, j: int) -> tuple[Pose2, Matrix]:
        """Estimate of i_T_j and its (3, 3) covariance in frame j."""
        return self.relatives([i], j)[0]

    def relatives(self, anchors: Sequence[int], j: int) -> list[tuple[Pose2, Matrix]]:
        """The same for several i, from one joint marginal.

        Most of the work is to walk ISAM2's tree up from them, a way that near anchors share.
        """
        joint = self._isam.jointMarginalCovariance(gtsam.KeyVector([X(k) for k in (*anchors, j)]))
        found = []
        for i in anchors:
            i_T_j = self.pose(i).between(self.pose(j))
            blocks = [[joint.at(X(a), X(b)) for b in (i, j)] for a in (i, j)]
            found.append((i_T_j, relative_covariance(np.block(blocks), i_T_j)))
        return found

    def finalise(self, candidates: Sequence[Edge] = ()) -> FinalGraph:
        """Optimise everything in one batch, and leave out the loops that the whole contradicts.

        Args:
            candidates: loops that were refused along the way, which get another chance.  They
                count as edges behind those of the graph in `FinalGraph.removed`.

        Raises:
            GraphError: the optimiser gave up.
        """
        final = finalise(self.poses, [*self.edges, *candidates], self._maker)
        self.edges = list(final.edges)
        self._poses[: self._count] = final.poses
        return final

    def _check(self, edges: Sequence[Edge]) -> None:
        for edge in edges:
            if not (0 <= edge.i < self._count and 0 <= edge.j < self._count and edge.i != edge.j):
                raise GraphError(f"edge {edge.i}-{edge.j}: no such pair of keyframes")

    def _begun(self, factorization: str) -> gtsam.ISAM2:
        """A fresh ISAM2 that holds keyframe 0."""
        parameters = _isam_parameters()
        parameters.setFactorization(factorization)
        isam = gtsam.ISAM2(parameters)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(self._maker.anchor(self._first))
        values.insert(X(0), self._first)
        isam.update(graph, values)
        return isam

    def _update(self, edges: Sequence[Edge], values: gtsam.Values) -> None:
        """Give ISAM2 edges and new poses.

        Cholesky refuses a heading that is known thousands of times worse than a position, as
        after many keyframes in a row without a match.  QR, twice as slow, does not.
        """
        try:
            self._isam.update(self._factors(edges), values)
        except RuntimeError:
            self._start_again(edges, values)
        self.edges += edges

    def _start_again(self, edges: Sequence[Edge], values: gtsam.Values) -> None:
        """Build ISAM2 anew with QR, from all edges at the present poses, and these."""
        everything = gtsam.Values(values)
        for k in range(1, self._count):
            if not everything.exists(X(k)):
                everything.insert(X(k), self.pose(k))
        self._isam = self._begun("QR")
        try:
            self._isam.update(self._factors([*self.edges, *edges]), everything)
        except RuntimeError as error:
            raise GraphError(f"the graph cannot be solved: {_first_line(error)}") from error

    def _factors(self, edges: Sequence[Edge]) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        for edge in edges:
            graph.add(self._maker.between(edge, robust=True))
        return graph

    def _refresh(self, values: gtsam.Values) -> None:
        self._poses[: self._count] = gtsam.utilities.extractPose2(values)

    def _grow(self) -> None:
        if self._count == len(self._poses):
            self._poses = np.vstack([self._poses, np.zeros_like(self._poses)])


def _without_first(values: gtsam.Values) -> gtsam.Values:
    rest = gtsam.Values(values)
    rest.erase(X(0))
    return rest


def _first_line(error: Exception) -> str:
    return next((line for line in str(error).splitlines() if line.strip()), "no reason given")


def _isam_parameters() -> gtsam.ISAM2Params:
    """Between factors bend with the heading alone: a shifted pose needs no new linearisation.

    Which poses do is looked for from the tree's root down, as far as there are any: to go through
    all of them would make each keyframe more expensive than the last.
    """
    thresholds = gtsam.ISAM2ThresholdMap()
    limits = [RELINEARISE_M, RELINEARISE_M, RELINEARISE_RAD]
    thresholds.insert(("x", np.array(limits)))
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(thresholds)
    parameters.relinearizeSkip = 1
    parameters.enablePartialRelinearizationCheck = True
    return parameters
