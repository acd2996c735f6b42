"""Batch optimisation of a whole graph, robust against false loops."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam import Pose2
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from slam.backend.chi_square import SUSPICIOUS
from slam.backend.edges import Edge, GraphError, Matrix, residuals

ANCHOR_SIGMA = 1e-3  # m and rad: the first pose defines the map frame, so it is held
OUTLIER = 0.5  # a loop of less weight is left out
COARSE, FINE = 1e-4, 1e-6  # relative change of the error that ends an alternative, and the last run
NARROWING = ((30.0, 8), (10.0, 8), (3.0, 50))  # kernel in sigmas, iterations

_ESTIMATORS = gtsam.noiseModel.mEstimator


class GraphConfig(BaseModel):
    """The back end."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    odometry_kernel: float = Field(
        1.0, gt=0, description="sigmas at which an odometry factor starts to weigh less (Cauchy)"
    )
    loop_kernel: float = Field(
        1.0, gt=0, description="sigmas at which a loop factor starts to weigh less (Cauchy)"
    )
    icp_kernel: float = Field(
        3.0, gt=0, description="sigmas at which a match of neighbours starts to weigh less (Huber)"
    )
    match_sigma_trans: float = Field(
        0.008, ge=0, description="m, added to every match: what real places do to its model"
    )
    match_sigma_rot: float = Field(0.004, ge=0, description="rad, sigma added to the heading")
    reject_loops: bool = Field(
        True, description="let the batch leave out loops that the whole graph contradicts"
    )
    robust: bool = Field(True, description="robust kernels; without them plain least squares")


@dataclass(frozen=True, eq=False, slots=True)
class BatchResult:
    """Optimised poses, and what became of the loops."""

    poses: Matrix  # (n, 3) [x, y, theta] of map_T_k
    loop_weights: dict[int, float]  # index into the edges -> weight, 0 to 1
    error_before: float  # half the weighted squared error of the accepted edges, robust
    error_after: float


class FactorMaker:
    """Makes GTSAM factors of edges, the only place that knows noise models and kernels."""

    def __init__(self, config: GraphConfig) -> None:
        self.config = config
        self._anchor = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, ANCHOR_SIGMA))
        # A batch asks for each many times.
        self._informations: dict[Edge, Matrix] = {}
        self._gaussians: dict[Edge, gtsam.noiseModel.Gaussian] = {}
        self._factors: dict[tuple[Edge, bool], gtsam.BetweenFactorPose2] = {}

    def renamed(self, edges: Iterable[tuple[Edge, Edge]]) -> FactorMaker:
        """A maker that knows edges under new names, the second of each pair, as this one does."""
        other = FactorMaker(self.config)
        for old, new in edges:
            if old in self._informations:
                other._informations[new] = self._informations[old]
            if old in self._gaussians:
                other._gaussians[new] = self._gaussians[old]
        return other

    def anchor(self, map_T_first: Pose2) -> gtsam.PriorFactorPose2:
        """The prior that holds keyframe 0."""
        return gtsam.PriorFactorPose2(X(0), map_T_first, self._anchor)

    def between(
        self,
        edge: Edge,
        robust: bool,
        kernel: gtsam.noiseModel.mEstimator.Base | None = None,
    ) -> gtsam.BetweenFactorPose2:
        """The factor of an edge, under `kernel` or, if robust, the one of its kind."""
        if kernel is not None:
            robustly = gtsam.noiseModel.Robust.Create(kernel, self._gaussian(edge))
            return gtsam.BetweenFactorPose2(X(edge.i), X(edge.j), edge.i_T_j, robustly)
        robust = robust and self.config.robust
        known = self._factors.get((edge, robust))
        if known is None:
            noise = self._noise(edge, robust)
            known = gtsam.BetweenFactorPose2(X(edge.i), X(edge.j), edge.i_T_j, noise)
            self._factors[edge, robust] = known
        return known

    def information(self, edge: Edge) -> Matrix:
        """(3, 3) information that an edge gets: a match's own, widened by the model's error."""
        known = self._informations.get(edge)
        if known is None:
            known = self._informations[edge] = self._widened(edge)
        return known

    def _widened(self, edge: Edge) -> Matrix:
        sigma = np.array([self.config.match_sigma_trans] * 2 + [self.config.match_sigma_rot])
        if edge.kind == "odometry" or not (sigma > 0).all():
            return edge.information
        # (C + S^2)^-1 = (1 + H S^2)^-1 H, in the units of S; H may be degenerate.
        values, vectors = np.linalg.eigh(edge.information * np.outer(sigma, sigma))
        values = np.maximum(values, 0.0)
        shrunk = (vectors * (values / (1.0 + values))) @ vectors.T
        weight: Matrix = shrunk / np.outer(sigma, sigma)
        return 0.5 * (weight + weight.T)

    def _gaussian(self, edge: Edge) -> gtsam.noiseModel.Gaussian:
        known = self._gaussians.get(edge)
        if known is None:
            known = self._gaussians[edge] = self._model(edge)
        return known

    def _model(self, edge: Edge) -> gtsam.noiseModel.Gaussian:
        information = self.information(edge)
        # GTSAM takes the square root by Cholesky, which an axis without information would break:
        # it gets a sigma of 30,000 times the best-known one.
        ridge = 1e-9 * float(np.abs(np.diag(information)).max())
        return gtsam.noiseModel.Gaussian.Information(information + ridge * np.eye(3))

    def _noise(self, edge: Edge, robust: bool) -> gtsam.noiseModel.Base:
        gaussian = self._gaussian(edge)
        if not robust:
            return gaussian
        kernel: gtsam.noiseModel.mEstimator.Base
        if edge.kind == "icp":
            kernel = _ESTIMATORS.Huber.Create(self.config.icp_kernel)
        elif edge.kind == "odometry":
            kernel = _ESTIMATORS.Cauchy.Create(self.config.odometry_kernel)
        else:
            kernel = _ESTIMATORS.Cauchy.Create(self.config.loop_kernel)
        return gtsam.noiseModel.Robust.Create(kernel, gaussian)

    def graph(
        self, map_T_first: Pose2, edges: Sequence[Edge], robust: bool
    ) -> gtsam.NonlinearFactorGraph:
        """Prior and all edges."""
        graph = gtsam.NonlinearFactorGraph()
        graph.add(self.anchor(map_T_first))
        for edge in edges:
            graph.add(self.between(edge, robust))
        return graph


def values_of(poses: Matrix) -> gtsam.Values:
    """GTSAM values of poses (n, 3)."""
    values = gtsam.Values()
    for k, pose in enumerate(poses):
        values.insert(X(k), Pose2(*pose))
    return values


def optimise(poses: Matrix, edges: Sequence[Edge], maker: FactorMaker) -> BatchResult:
    """Optimise everything from `poses` (n, 3); keyframe 0 is held where it is.

    Where the graph with all loops disagrees with some, plain least squares and two
    optimisations that can let go of loops are tried as well (dynamic covariance scaling, Agarwal
    et al. 2013; Geman-McClure with a kernel that narrows step by step, after Yang et al. 2020);
    none is always best, so the one with the smallest truncated cost is taken.  Loops that
    contradict it are left out, and the rest is optimised once more.

    Raises:
        GraphError: the optimiser gave up, which a graph with near-singular edges can cause.
    """
    config = maker.config
    loops = [k for k, edge in enumerate(edges) if edge.kind == "loop"]
    try:
        optimised = _descend(poses, edges, maker, None)
        weights = dict.fromkeys(loops, 1.0)
        if config.reject_loops and (chi_squares(optimised, edges, maker)[loops] > SUSPICIOUS).any():
            # Plain least squares takes part: from a bad start only it pulls hard enough.
            alternatives = [
                optimised,
                _descend(poses, edges, maker, None, iterations=10, robust=False),
            ]
            alternatives += [_descend(poses, edges, maker, _ESTIMATORS.DCS.Create(1.0))]
            alternatives += [_narrowing(poses, edges, maker)]
            optimised = min(alternatives, key=lambda found: truncated_cost(found, edges, maker))
            optimised = _descend(optimised, _consistent(optimised, edges, maker), maker, None)
            chi = chi_squares(optimised, edges, maker)
            weights = {k: float(chi[k] <= SUSPICIOUS) for k in loops}
        accepted_edges = [e for k, e in enumerate(edges) if weights.get(k, 1.0) >= OUTLIER]
        graph = maker.graph(Pose2(*poses[0]), accepted_edges, robust=True)
        before = float(graph.error(values_of(poses)))
        values = gtsam.LevenbergMarquardtOptimizer(
            graph, values_of(optimised), _lm(50, FINE)
        ).optimize()
        after = float(graph.error(values))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else "no reason given"
        raise GraphError(f"the graph cannot be optimised: {reason}") from error
    result = gtsam.utilities.extractPose2(values)
    if not np.isfinite(result).all():
        raise GraphError("the graph cannot be optimised: poses became infinite")
    return BatchResult(result, weights, before, after)


def chi_squares(poses: Matrix, edges: Sequence[Edge], maker: FactorMaker) -> NDArray[np.float64]:
    """Squared Mahalanobis norm of every edge's residual at poses (n, 3), (edges,)."""
    informations = np.array([maker.information(edge) for edge in edges]).reshape(-1, 3, 3)
    errors = residuals(poses, edges)
    squares: NDArray[np.float64] = np.einsum("ki,kij,kj->k", errors, informations, errors)
    return squares


def truncated_cost(poses: Matrix, edges: Sequence[Edge], maker: FactorMaker) -> float:
    """Sum of the squared residuals, a loop counting no more than a false one may.

    Beyond the Huber kernel the other edges count linearly: some matches slid, but a chain that
    breaks is never cheap, as it would be under the Cauchy kernel of the odometry.
    """
    squares = chi_squares(poses, edges, maker)
    is_loop = np.array([edge.kind == "loop" for edge in edges])
    k = maker.config.icp_kernel
    chain = np.where(squares <= k * k, squares, 2.0 * k * np.sqrt(squares) - k * k)
    return float(np.where(is_loop, np.minimum(squares, SUSPICIOUS), chain).sum())


def _narrowing(poses: Matrix, edges: Sequence[Edge], maker: FactorMaker) -> Matrix:
    """Loops under a kernel first so wide that all of them pull, then ever narrower."""
    for sigmas, iterations in NARROWING:
        kernel = _ESTIMATORS.GemanMcClure.Create(sigmas)
        poses = _descend(poses, edges, maker, kernel, iterations)
    return poses


def _consistent(poses: Matrix, edges: Sequence[Edge], maker: FactorMaker) -> list[Edge]:
    chi = chi_squares(poses, edges, maker)
    return [e for e, c in zip(edges, chi, strict=True) if e.kind != "loop" or c <= SUSPICIOUS]


def _descend(
    poses: Matrix,
    edges: Sequence[Edge],
    maker: FactorMaker,
    loop_kernel: gtsam.noiseModel.mEstimator.Base | None,
    iterations: int = 50,
    robust: bool = True,
) -> Matrix:
    """Levenberg-Marquardt, coarse, from `poses`; loops under `loop_kernel` or the configured one.

    Robust kernels make it creep: the last per mille takes most of its time.
    """
    graph = gtsam.NonlinearFactorGraph()
    graph.add(maker.anchor(Pose2(*poses[0])))
    for edge in edges:
        graph.add(maker.between(edge, robust, loop_kernel if edge.kind == "loop" else None))
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values_of(poses), _lm(iterations, COARSE))
    found: Matrix = gtsam.utilities.extractPose2(optimiser.optimize())
    return found


def _lm(iterations: int, tolerance: float) -> gtsam.LevenbergMarquardtParams:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(tolerance)
    return parameters
