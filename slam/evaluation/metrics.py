"""Errors of a trajectory against a true one: ATE, RPE, final pose, and credibility (NEES).

Absolute and relative trajectory error follow Sturm et al. 2012 ("A Benchmark for the
Evaluation of RGB-D SLAM Systems"), pairs by path length follow KITTI's idea as evo defines
it, and the functions agree with evo to rounding.  Everything is planar.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from slam.backend.se2 import between, compose, wrap
from slam.evaluation.relations import nearest_rows
from slam.logs.trajectory import Poses, Trajectory, path_length

ASSOCIATION_GAP_S = 0.01
"""Farthest apart two poses may be in time and still be compared; evo's default."""

RPE_TOLERANCE = 0.1
"""A pair counts for a path length if its own differs by no more than this share (evo's default)."""


@dataclass(frozen=True, eq=False, slots=True)
class Association:
    """The poses of two trajectories that belong to the same instants, row by row."""

    estimate: Trajectory
    truth: Trajectory

    def __len__(self) -> int:
        return len(self.estimate)


@dataclass(frozen=True, slots=True)
class ErrorSummary:
    """How a set of errors is distributed; nan where the set is empty."""

    n: int
    rmse: float
    mean: float
    median: float
    std: float
    max: float


@dataclass(frozen=True, eq=False, slots=True)
class AbsoluteErrors:
    """Pose errors after a rigid motion of the estimate, one for each associated pose."""

    truth_T_map: Poses
    trans_m: NDArray[np.float64]  # (n,)
    rot_deg: NDArray[np.float64]  # (n,) absolute


@dataclass(frozen=True, eq=False, slots=True)
class RelativeErrors:
    """Errors of relative motion over pairs of poses."""

    pairs: NDArray[np.intp]  # (m, 2) rows of the association
    trans_m: NDArray[np.float64]  # (m,)
    rot_deg: NDArray[np.float64]  # (m,) absolute


@dataclass(frozen=True, slots=True)
class Credibility:
    """Whether errors are as large as their covariances say (Li et al. 2001, ANEES)."""

    n: int
    anees: float  # mean NEES / 3: 1 is honest, above is over-confident
    low: float  # band that holds 95 % of credible filters, if the errors were independent
    high: float


def summarise(errors: NDArray[np.float64]) -> ErrorSummary:
    """Return the usual statistics; `std` is the population's."""
    if len(errors) == 0:
        return ErrorSummary(0, math.nan, math.nan, math.nan, math.nan, math.nan)
    return ErrorSummary(
        n=len(errors),
        rmse=float(np.sqrt(np.mean(errors**2))),
        mean=float(np.mean(errors)),
        median=float(np.median(errors)),
        std=float(np.std(errors)),
        max=float(np.max(errors)),
    )


def associate(
    estimate: Trajectory, truth: Trajectory, max_gap_s: float = ASSOCIATION_GAP_S
) -> Association:
    """Pair the poses by time: each of the shorter trajectory with the nearest of the other."""
    if len(estimate) <= len(truth):
        rows, near = nearest_rows(truth.stamps_ns, estimate.stamps_ns, max_gap_s)
        return Association(estimate.select(near), truth.select(rows[near]))
    rows, near = nearest_rows(estimate.stamps_ns, truth.stamps_ns, max_gap_s)
    return Association(estimate.select(rows[near]), truth.select(near))


def align(estimate: Poses, truth: Poses) -> Poses:
    """Return `truth_T_map` (3,), the least-squares fit of the positions (Umeyama 1991, no scale).

    Both are (n, 3).  One pose, or poses all in one place, leave the heading open; then the
    first pair of poses is made equal instead.
    """
    centred, target = (p[:, :2] - p[:, :2].mean(axis=0) for p in (estimate, truth))
    dot = float(np.sum(centred * target))
    cross = float(np.sum(centred[:, 0] * target[:, 1] - centred[:, 1] * target[:, 0]))
    if math.hypot(dot, cross) < 1e-12:
        return anchor(estimate, truth)
    theta = math.atan2(cross, dot)
    rotation = np.array([0.0, 0.0, theta])
    moved = compose(rotation, np.append(estimate[:, :2].mean(axis=0), 0.0))
    x, y = truth[:, :2].mean(axis=0) - moved[:2]
    return np.array([x, y, theta])


def anchor(estimate: Poses, truth: Poses) -> Poses:
    """Return `truth_T_map` (3,) that makes the first poses equal."""
    return compose(truth[0], between(estimate[0], np.zeros(3)))


def absolute_errors(pairs: Association, truth_T_map: Poses) -> AbsoluteErrors:
    """Compare positions and headings after moving the estimate into the frame of the truth."""
    moved = compose(truth_T_map, pairs.estimate.poses)
    difference = moved - pairs.truth.poses
    return AbsoluteErrors(
        truth_T_map=truth_T_map,
        trans_m=np.hypot(difference[:, 0], difference[:, 1]),
        rot_deg=np.degrees(np.abs(wrap(difference[:, 2]))),
    )


def pairs_by_path(poses: Poses, length_m: float) -> NDArray[np.intp]:
    """Return (m, 2) rows i < j whose path is nearest to `length_m`, within `RPE_TOLERANCE`.

    Every i gets at most one j: evo's `all_pairs` of a path length.
    """
    travelled = path_length(poses)
    if len(travelled) < 2:
        return np.zeros((0, 2), dtype=np.intp)
    start = np.arange(len(travelled) - 1)
    end = _nearest_later(travelled, start, travelled[:-1] + length_m)
    good = np.abs(travelled[end] - travelled[start] - length_m) <= length_m * RPE_TOLERANCE
    return np.stack([start[good], end[good]], axis=1)


def _nearest_later(
    travelled: NDArray[np.float64], start: NDArray[np.intp], goal: NDArray[np.float64]
) -> NDArray[np.intp]:
    """Return the row after `start` with the path nearest to `goal`, the first of equals."""
    above = np.maximum(np.searchsorted(travelled, goal), start + 1).clip(max=len(travelled) - 1)
    below = np.maximum(above - 1, start + 1)
    take_below = goal - travelled[below] <= travelled[above] - goal
    chosen = np.where(take_below, below, above)
    first_of_equals = np.searchsorted(travelled, travelled[chosen])
    return np.maximum(first_of_equals, start + 1)


def relative_errors(pairs: Association, rows: NDArray[np.intp]) -> RelativeErrors:
    """Compare relative motions over rows (m, 2): error = inverse(true motion) estimated motion."""
    true = between(pairs.truth.poses[rows[:, 0]], pairs.truth.poses[rows[:, 1]])
    found = between(pairs.estimate.poses[rows[:, 0]], pairs.estimate.poses[rows[:, 1]])
    error = between(true, found)
    return RelativeErrors(rows, np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(error[:, 2])))


def nees(errors: Poses, covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return error' covariance^-1 error for each row: (n, 3) and (n, 3, 3) give (n,).

    Error and covariance must be in the same (base) frame.  Rows whose covariance is not
    positive definite give nan: they claim certainty that no error can be weighed against.
    """
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", covariances), 0.0))
    usable = np.all(np.isfinite(covariances), axis=(1, 2)) & np.all(scale > 0.0, axis=1)
    unit = np.where(usable[:, None], scale, 1.0)
    # Metres and radians differ by orders of magnitude, so judge definiteness on correlations.
    correlations = covariances / (unit[:, :, None] * unit[:, None, :])
    correlations[~usable] = np.eye(3)
    usable &= np.linalg.eigvalsh(correlations)[:, 0] > 1e-12
    correlations[~usable] = np.eye(3)
    whitened = errors / unit
    solved = np.linalg.solve(correlations, whitened[:, :, None])[:, :, 0]
    return np.where(usable, np.einsum("ni,ni->n", whitened, solved), math.nan)


def credibility(nees_values: NDArray[np.float64], confidence: float = 0.95) -> Credibility:
    """Return the average NEES by degree of freedom and its chi-square band.

    Poses of one run share their errors, so a run outside the band is not proof by itself.
    """
    values = nees_values[np.isfinite(nees_values)]
    n = len(values)
    if n == 0:
        return Credibility(0, math.nan, math.nan, math.nan)
    tail = (1.0 - confidence) / 2.0
    low, high = (float(chi2.ppf(p, 3 * n)) / (3 * n) for p in (tail, 1.0 - tail))
    return Credibility(n, float(np.mean(values)) / 3.0, low, high)
