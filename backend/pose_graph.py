"""The pose graph: ISAM2 while the robot drives, robust batch optimisation at the end."""

from __future__ import annotations

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam import Pose2
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from backend.edges import Edge, GraphError, Matrix, relative_covariance

__all__ = ["Edge", "GraphConfig", "GraphError", "PoseGraph"]


class GraphConfig(BaseModel):
    """The back end."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    anchor_sigma_trans: float = Field(1e-3, gt=0, description="m, prior on the first pose")
    anchor_sigma_rot: float = Field(1e-3, gt=0, description="rad, prior on the first pose")
    odometry_kernel: float = Field(
        1.0, gt=0, description="sigmas at which an odometry factor starts to weigh less (Cauchy)"
    )
    loop_kernel: float = Field(
        1.0, gt=0, description="sigmas at which a loop factor starts to weigh less (Cauchy)"
    )
    icp_kernel: float = Field(3.0, gt=0, description="the same for matches of neighbours (Huber)")
    match_sigma_trans: float = Field(
        0.008, ge=0, description="m, added to every match: what real places do to its model"
    )
    match_sigma_rot: float = Field(0.004, ge=0, description="rad, the same for the heading")
    relinearise_threshold: float = Field(0.05, gt=0, description="m or rad, ISAM2")
    relinearise_skip: int = Field(1, ge=1, description="updates between relinearisations, ISAM2")
    gnc: bool = Field(True, description="graduated non-convexity over the loops in the batch")


class PoseGraph:
    """Keyframe poses `map_T_k` and the measurements between them; keyframe 0 is held."""

    def __init__(self, map_T_first: Pose2, config: GraphConfig) -> None:
        self.config = config
        self.edges: list[Edge] = []
        self.loop_weights: dict[int, float] = {}  # of the last GNC run: index into edges
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(config.relinearise_threshold)
        parameters.relinearizeSkip = config.relinearise_skip
        self._isam = gtsam.ISAM2(parameters)
        self._first = map_T_first
        sigmas = [config.anchor_sigma_trans, config.anchor_sigma_trans, config.anchor_sigma_rot]
        self._anchor = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(gtsam.PriorFactorPose2(X(0), map_T_first, self._anchor))
        values.insert(X(0), map_T_first)
        self._isam.update(graph, values)
        self._poses = np.array([[map_T_first.x(), map_T_first.y(), map_T_first.theta()]])
        self._count = 1

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
            edges: at least one, each ending (j) at the new keyframe.

        Raises:
            GraphError: an edge is missing or points elsewhere.
        """
        new = self._count
        if not edges:
            raise GraphError(f"keyframe {new} has no edge: nothing would hold it")
        for edge in edges:
            if edge.j != new or not 0 <= edge.i < new:
                raise GraphError(f"edge {edge.i}-{edge.j} does not tie keyframe {new}")
        values = gtsam.Values()
        values.insert(X(new), guess)
        self._grow()
        self._count = new + 1
        self._update(edges, values)
        pose = self._isam.calculateEstimatePose2(X(new))
        self._poses[new] = pose.x(), pose.y(), pose.theta()
        return new

    def add_edges(self, edges: Sequence[Edge]) -> None:
        """Add edges between existing keyframes and update every pose."""
        for edge in edges:
            if not (0 <= edge.i < self._count and 0 <= edge.j < self._count and edge.i != edge.j):
                raise GraphError(f"edge {edge.i}-{edge.j}: no such pair of keyframes")
        self._update(edges, gtsam.Values())
        for _ in range(3):  # a loop moves much at once: let ISAM2 settle
            self._isam.update()
        self._refresh(self._isam.calculateEstimate())

    def add_edges_batch(self, edges: Sequence[Edge]) -> None:
        """Add edges that only the next batch optimisation shall see; ISAM2 stays as it is."""
        self.edges += edges

    def drop(self, edge: Edge) -> None:
        """Leave an edge out of all further batch optimisation.

        Raises:
            GraphError: it is not in the graph.
        """
        index = next((k for k, known in enumerate(self.edges) if known is edge), None)
        if index is None:
            raise GraphError(f"{edge.kind} edge {edge.i}-{edge.j} is not in the graph")
        del self.edges[index]

    def marginal(self, k: int) -> Matrix:
        """(3, 3) covariance of map_T_k in its own frame."""
        covariance: Matrix = self._isam.marginalCovariance(X(k))
        return covariance

    def marginals(self) -> Matrix:
        """(n, 3, 3) covariance of every map_T_k in its own frame, from the batch graph."""
        marginals = gtsam.Marginals(self._graph(self.edges, robust=True), self._values())
        return np.array([marginals.marginalCovariance(X(k)) for k in range(self._count)])

    def relative(self, i: int, j: int) -> tuple[Pose2, Matrix]:
        """Estimate of i_T_j and its (3, 3) covariance in frame j, from the joint marginal."""
        i_T_j = self.pose(i).between(self.pose(j))
        joint = self._isam.jointMarginalCovariance(gtsam.KeyVector([X(i), X(j)]))
        blocks = [[joint.at(X(a), X(b)) for b in (i, j)] for a in (i, j)]
        return i_T_j, relative_covariance(np.block(blocks), i_T_j)

    def optimise(self) -> Matrix:
        """Optimise everything in one batch from the current estimates; (n, 3) poses.

        Loops are weighed by graduated non-convexity (Yang et al. 2020) where configured: it
        recovers from false loops that a robust kernel started at the wrong place does not.
        Loops that end with less than half their weight are left out of the last step.
        """
        values = self._values()
        loops = [k for k, edge in enumerate(self.edges) if edge.kind == "loop"]
        self.loop_weights = dict.fromkeys(loops, 1.0)
        if self.config.gnc and loops:
            values, weights = self._optimise_gnc(values, loops)
            self.loop_weights = {loop: float(weights[loop + 1]) for loop in loops}
        believed = [e for k, e in enumerate(self.edges) if self.loop_weights.get(k, 1.0) >= 0.5]
        graph = self._graph(believed, robust=True)
        values = gtsam.LevenbergMarquardtOptimizer(graph, values, self._lm()).optimize()
        self._refresh(values)
        return self.poses.copy()

    def _optimise_gnc(
        self, values: gtsam.Values, loops: list[int]
    ) -> tuple[gtsam.Values, NDArray[np.float64]]:
        parameters = gtsam.GncLMParams(self._lm())
        parameters.setLossType(gtsam.GncLossType.TLS)
        suspects = set(loops)
        # Factor 0 is the prior; factor k + 1 is edge k.
        inliers = [0] + [k + 1 for k in range(len(self.edges)) if k not in suspects]
        parameters.setKnownInliers(inliers)
        optimiser = gtsam.GncLMOptimizer(self._graph(self.edges, robust=False), values, parameters)
        return optimiser.optimize(), optimiser.getWeights()

    @staticmethod
    def _lm() -> gtsam.LevenbergMarquardtParams:
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(50)
        parameters.setRelativeErrorTol(1e-6)
        return parameters

    def _noise(self, edge: Edge, robust: bool) -> gtsam.noiseModel.Base:
        gaussian = gtsam.noiseModel.Gaussian.Information(self.weight(edge))
        if not robust:
            return gaussian
        kernel: gtsam.noiseModel.mEstimator.Base
        estimators = gtsam.noiseModel.mEstimator
        if edge.kind == "icp":
            kernel = estimators.Huber.Create(self.config.icp_kernel)
        elif edge.kind == "odometry":
            kernel = estimators.Cauchy.Create(self.config.odometry_kernel)
        else:
            kernel = estimators.Cauchy.Create(self.config.loop_kernel)
        return gtsam.noiseModel.Robust.Create(kernel, gaussian)

    def weight(self, edge: Edge) -> Matrix:
        """(3, 3) information that an edge gets: a match's own, widened by the model's error."""
        if edge.kind == "odometry":
            return edge.information
        sigma = np.array([self.config.match_sigma_trans] * 2 + [self.config.match_sigma_rot])
        # (C + S^2)^-1 = (I + H S^2)^-1 H, written symmetrically; H may be blind on an axis.
        scaled = edge.information * np.outer(sigma, sigma)
        values, vectors = np.linalg.eigh(scaled)
        shrunk = (vectors * (values / (1.0 + values))) @ vectors.T
        if not (sigma > 0).all():
            return edge.information
        weight: Matrix = shrunk / np.outer(sigma, sigma)
        return 0.5 * (weight + weight.T)

    def _factor(self, edge: Edge, robust: bool) -> gtsam.BetweenFactorPose2:
        noise = self._noise(edge, robust)
        return gtsam.BetweenFactorPose2(X(edge.i), X(edge.j), edge.i_T_j, noise)

    def _graph(self, edges: Sequence[Edge], robust: bool) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        graph.add(gtsam.PriorFactorPose2(X(0), self._first, self._anchor))
        for edge in edges:
            graph.add(self._factor(edge, robust))
        return graph

    def _update(self, edges: Sequence[Edge], values: gtsam.Values) -> None:
        graph = gtsam.NonlinearFactorGraph()
        for edge in edges:
            graph.add(self._factor(edge, robust=True))
        self._isam.update(graph, values)
        self.edges += edges

    def _values(self) -> gtsam.Values:
        values = gtsam.Values()
        for k in range(self._count):
            values.insert(X(k), Pose2(*self._poses[k]))
        return values

    def _refresh(self, values: gtsam.Values) -> None:
        self._poses[: self._count] = gtsam.utilities.extractPose2(values)

    def _grow(self) -> None:
        if self._count == len(self._poses):
            self._poses = np.vstack([self._poses, np.zeros_like(self._poses)])
