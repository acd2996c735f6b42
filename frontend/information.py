"""How far may the robot go until the next match is worth most?  No wall profiles, no weights.

A match after d metres is predicted from the keyframe alone: its points give what a later scan
will still see of them, and its normals the information along each axis.  With the odometry's
prior this is the covariance P(d) of a match.  Chained over a path, the variance added per metre
depends on d; the interval is the longest whose sum is as good as the best.  Likewise for turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from slam.frontend.information_kernels import predict
from slam.frontend.scan import VALID, PreparedScan

Array = NDArray[np.float64]

AXES = ("x", "y", "theta")
PER_OCTAVE = 2  # distances at which a match is predicted; between them its variance is smooth
FINER = 4  # distances tried between two of those
MOST_BEAMS = 180  # cast into the scan
# Factor on the variance that range noise alone explains, in chains of matches: some errors stay
# while the same things are in view.
CHAIN_CORRELATION = 1.15


@dataclass(frozen=True, eq=False, slots=True)
class PredictionModel:
    """What is known, besides the scan, about the matches to come; all of it physical."""

    odometry: Callable[[float, float], Array]  # m travelled, rad turned -> (3, 3) covariance
    references: int  # keyframes that a match is made against at once
    range_noise: float  # m, one sigma
    correlation: float  # factor on the variance that range noise alone explains, at least 1
    gap_ratio: float  # of beam spacings, that parts two surfaces
    tolerance: float  # by which share of the least a predicted error may be larger


@dataclass(frozen=True, slots=True)
class Prediction:
    """The chosen distance and what is expected of the match after it."""

    distance: float  # m
    sigmas: tuple[float, float, float]  # x (m), y (m), theta (rad) of match and odometry
    axis: str  # of AXES: the one that costs most there


def informations(scan: PreparedScan, poses: Array, model: PredictionModel) -> tuple[Array, Array]:
    """What a match of a scan taken at each of `poses` against this one would know.

    Args:
        scan: the keyframe.
        poses: (k, 3) base_T_later: x, y (m), theta (rad).
        model: the noise.

    Returns:
        (k, 3, 3) information of x, y, theta in the later frame, without floor and prior, and
        (k,) the number of beams that would find a correspondence.
    """
    information, pairs = np.empty((len(poses), 3, 3)), np.empty(len(poses))
    source = scan.points, scan.lines, scan.flags, scan.geometry
    variance = model.range_noise**2 * model.correlation
    rules = model.range_noise, variance, model.gap_ratio, MOST_BEAMS
    predict(source, rules, poses, information, pairs)
    return information, pairs


def distance_of_overlap(
    scan: PreparedScan, direction: float, shortest: float, longest: float, least: float,
    model: PredictionModel,
) -> float:  # fmt: skip
    """The farthest distance (m) up to which `least` of the paired beams still find a pair."""
    distances = np.geomspace(shortest, longest, _count(shortest, longest, PER_OCTAVE))
    poses = _ahead(np.concatenate([[0.0], distances]), direction)
    pairs = informations(scan, poses, model)[1]
    enough = np.logical_and.accumulate(pairs[1:] >= least * pairs[0])
    return float(distances[enough][-1]) if enough.any() else shortest


def best_distance(
    scan: PreparedScan, direction: float, shortest: float, longest: float, model: PredictionModel
) -> Prediction:
    """The farthest distance whose matches add about the least variance per metre of path.

    With P(d) the trace of a match's covariance (the heading counts by r^2, r the median distance
    of what is seen, so that the sum is the square shift of a point): a keyframe that is matched
    against several at once hangs, on average, on one D(d) metres back, each of them weighing by
    what it knows.  Such a chain grows by P d / D^2 per metre.  Of the part of P that comes from the
    scans, S, the share that range noise does not explain comes from the shape of what is seen.  It
    is the same for as long as that is in view, about r metres, and adds `share` S r / D^2: the
    error that every match has of its own.  About the least: the sigma may
    be larger by the tolerance.

    Args:
        scan: the keyframe.
        direction: rad, in the base frame, in which the robot travels.
        shortest: m, the least distance.
        longest: m, the greatest.
        model: the rest.
    """
    reach = _reach(scan)
    steps = _steps(shortest, longest, model.references)
    odometry = np.array([model.odometry(float(d), 0.0) for d in steps])
    seen = _seen(scan, _ahead(steps, direction), model)
    chosen = _farthest(steps, seen, odometry, longest, reach, reach, model)
    nearest = int(np.argmin(np.abs(np.log(steps / chosen))))
    variances = np.diag(np.linalg.inv(seen[nearest] + np.linalg.inv(odometry[nearest])))
    sx, sy, st = np.sqrt(variances).tolist()
    return Prediction(chosen, (sx, sy, st), AXES[int(np.argmax(variances * _lever(reach)))])


def best_turn(scan: PreparedScan, narrowest: float, widest: float, model: PredictionModel) -> float:
    """The widest turn (rad), to either side, whose matches add the least variance per radian.

    As `best_distance`; what is seen is new after a turn by the field of view.

    Args:
        scan: the keyframe.
        narrowest: rad, the least turn.
        widest: rad, the greatest.
        model: the rest.
    """
    reach, field = _reach(scan), min(len(scan.points) * float(scan.geometry[1]), 2.0 * math.pi)
    steps = _steps(narrowest, widest, model.references)
    odometry = np.array([model.odometry(0.0, float(a)) for a in steps])
    chosen = []
    for side in (1.0, -1.0):
        seen = _seen(scan, side * steps[:, None] * np.array([0.0, 0.0, 1.0]), model)
        chosen.append(_farthest(steps, seen, odometry, widest, field, reach, model))
    return min(chosen)


def _farthest(
    steps: Array, seen: Array, odometry: Array, longest: float, renewed: float, reach: float,
    model: PredictionModel,
) -> float:  # fmt: skip
    """The longest step that adds about the least variance a unit of way.

    Args:
        steps: (k,) m or rad, to the farthest reference.
        seen: (k, 3, 3) information of the scans after each.
        odometry: (k, 3, 3) covariance after each.
        longest: of the steps that may be chosen.
        renewed: after how much way something else is seen, in units of the steps.
        reach: m, median distance of what is seen.
        model: the rest.
    """
    covariances = np.linalg.inv(seen + np.linalg.inv(odometry))
    variances = np.diagonal(covariances, axis1=1, axis2=2) @ _lever(reach)
    own = np.diagonal(covariances @ seen @ covariances, axis1=1, axis2=2) @ _lever(reach)
    lasting = (1.0 - 1.0 / model.correlation) * renewed
    within = np.flatnonzero(steps <= longest * (1.0 + 1e-9))
    back = _mean_reference(steps[within], steps, variances, model.references)
    grown = (variances[within] * steps[within] + lasting * own[within]) / back**2
    logs = np.log(steps[within])
    candidates = np.linspace(logs[0], logs[-1], FINER * (len(logs) - 1) + 1)
    cost = np.interp(candidates, logs, np.log(grown))
    return float(np.exp(candidates[cost <= cost.min() + 2.0 * math.log1p(model.tolerance)][-1]))


def _mean_reference(chosen: Array, steps: Array, variances: Array, references: int) -> Array:
    """(n,) how far back, on average, what holds a keyframe stands after each of `chosen` (n,)."""
    at = np.log(chosen)[:, None] + np.log(np.arange(1, references + 1))
    weights = np.exp(-np.interp(at, np.log(steps), np.log(variances)))
    mean: Array = np.sum(np.exp(at) * weights, axis=1) / np.sum(weights, axis=1)
    return mean


def _seen(scan: PreparedScan, poses: Array, model: PredictionModel) -> Array:
    """(k, 3, 3) information of matches from `poses`; rounding leaves no negative direction."""
    values, vectors = np.linalg.eigh(informations(scan, poses, model)[0])
    kept: Array = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return kept


def _reach(scan: PreparedScan) -> float:
    """Median distance of what is seen, m."""
    seen = scan.ranges[(scan.flags & VALID) > 0]
    return float(np.median(seen)) if len(seen) else 0.0


def _lever(reach: float) -> Array:
    return np.array([1.0, 1.0, reach**2])


def _steps(shortest: float, longest: float, references: int) -> Array:
    """Geometric, from the shortest to the farthest reference; one of them is the longest."""
    near = np.geomspace(shortest, longest, _count(shortest, longest, PER_OCTAVE))
    beyond = np.geomspace(1.0, references, _count(1.0, references, PER_OCTAVE))[1:]
    return np.concatenate([near, longest * beyond])


def _ahead(distances: Array, direction: float) -> Array:
    """(k, 3) poses straight on, heading kept."""
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    poses: Array = distances[:, None] * along
    return poses


def _count(low: float, high: float, per_octave: int) -> int:
    return max(2, 1 + round(per_octave * math.log2(high / low)))
