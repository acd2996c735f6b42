"""How far may the robot go until the next match is worth most?  No walls, no weights.

A match after d metres is foreseen from the keyframe alone: its own points say what a later scan
will still see of them, and its normals what that tells about each axis.  With the odometry's
prior this is the covariance P(d) of a match.  Chained over a path, the variance that a metre
adds depends on d; the interval is the longest whose sum is as good as the best.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.information_kernels import foresee
from frontend.scan import VALID, PreparedScan

Array = NDArray[np.float64]

AXES = ("x", "y", "theta")
PER_OCTAVE = 2  # distances at which a match is foreseen; between them its variance is smooth
FINER = 4  # distances tried between two of those
MOST_BEAMS = 180  # cast into the scan
# What is foreseen is not right to more than a twentieth (tests hold it against real matches):
# nearer than that, two variances are equal, and the longer interval saves matches.
AS_GOOD = 1.05


@dataclass(frozen=True, eq=False, slots=True)
class Outlook:
    """What is known, besides the scan, about the matches to come; all of it physical."""

    odometry: Callable[[float], Array]  # metres travelled -> (3, 3) covariance of the step
    references: int  # keyframes that a match is made against at once
    range_noise: float  # m, one sigma
    correlation: float  # factor on the variance that range noise alone explains, at least 1
    gap_ratio: float  # of beam spacings, that parts two surfaces


@dataclass(frozen=True, slots=True)
class Foresight:
    """The chosen distance and what is expected of the match after it."""

    distance: float  # m
    sigmas: tuple[float, float, float]  # x (m), y (m), theta (rad) of match and odometry
    axis: str  # of AXES: the one that costs most there


def informations(scan: PreparedScan, poses: Array, outlook: Outlook) -> tuple[Array, Array]:
    """What a match of a scan taken at each of `poses` against this one would know.

    Args:
        scan: the keyframe.
        poses: (k, 3) base_T_later: x, y (m), theta (rad).
        outlook: the noise.

    Returns:
        (k, 3, 3) information of x, y, theta in the later frame, without floor and prior, and
        (k,) the number of beams that would find a partner.
    """
    information, pairs = np.empty((len(poses), 3, 3)), np.empty(len(poses))
    foresee(
        scan.points, scan.lines, scan.flags, scan.geometry, outlook.range_noise,
        outlook.gap_ratio, MOST_BEAMS, poses, outlook.range_noise**2 * outlook.correlation,
        information, pairs,
    )  # fmt: skip
    return information, pairs


def distance_of_overlap(
    scan: PreparedScan, direction: float, shortest: float, longest: float, least: float,
    outlook: Outlook,
) -> float:  # fmt: skip
    """The farthest distance (m) up to which `least` of the paired beams still find a partner."""
    distances = np.geomspace(shortest, longest, _count(shortest, longest, PER_OCTAVE))
    poses = _ahead(np.concatenate([[0.0], distances]), direction)
    pairs = informations(scan, poses, outlook)[1]
    enough = np.logical_and.accumulate(pairs[1:] >= least * pairs[0])
    return float(distances[enough][-1]) if enough.any() else shortest


def best_distance(
    scan: PreparedScan, direction: float, shortest: float, longest: float, outlook: Outlook
) -> Foresight:
    """The farthest distance whose matches add the least variance per metre of path.

    With P(d) the trace of a match's covariance (the heading counts by r^2, r the median distance
    of what is seen, so that the sum is the square shift of a point): a keyframe that is matched
    against several at once hangs, on average, on one D(d) metres back, each of them weighing by
    what it knows.  Such a chain grows by P d / D^2 a metre.  Of the part of P that comes from the
    scans, S, the share that range noise does not explain comes from the shape of what is seen.  It
    is the same for as long as that is in view, about r metres, and adds `share` S r / D^2: the
    error that every match has of its own.

    Args:
        scan: the keyframe.
        direction: rad, in the base frame, in which the robot travels.
        shortest: m, the least distance.
        longest: m, the greatest.
        outlook: the rest.
    """
    distances, covariances, own = _covariances(scan, direction, shortest, longest, outlook)
    seen = scan.ranges[(scan.flags & VALID) > 0]
    reach = float(np.median(seen)) if len(seen) else 0.0
    lever = np.array([1.0, 1.0, reach**2])
    shares = np.diagonal(covariances, axis1=1, axis2=2) * lever
    lasting = (1.0 - 1.0 / outlook.correlation) * reach
    fixed = lasting * (np.diagonal(own, axis1=1, axis2=2) @ lever)
    candidates = np.geomspace(shortest, longest, _count(shortest, longest, FINER * PER_OCTAVE))
    cost = _per_metre(candidates, distances, shares.sum(axis=1), fixed, outlook.references)
    chosen = float(candidates[np.flatnonzero(cost <= AS_GOOD * cost.min())[-1]])
    nearest = int(np.argmin(np.abs(np.log(distances / chosen))))
    sx, sy, st = np.sqrt(np.diag(covariances[nearest])).tolist()
    return Foresight(chosen, (sx, sy, st), AXES[int(np.argmax(shares[nearest]))])


def _covariances(
    scan: PreparedScan, direction: float, shortest: float, longest: float, outlook: Outlook
) -> tuple[Array, Array, Array]:
    """Distances (k,) to the farthest reference, and what matches after them know.

    The (k, 3, 3) covariances, and the part of each that comes from the scans, not the odometry.
    """
    farthest = outlook.references * longest
    distances = np.geomspace(shortest, farthest, _count(shortest, farthest, PER_OCTAVE))
    known, _ = informations(scan, _ahead(distances, direction), outlook)
    odometry = np.linalg.inv(np.array([outlook.odometry(float(d)) for d in distances]))
    covariances = np.asarray(np.linalg.inv(known + odometry), np.float64)
    return distances, covariances, covariances @ known @ covariances


def _ahead(distances: Array, direction: float) -> Array:
    """(k, 3) poses straight on, heading kept."""
    along = np.array([np.cos(direction), np.sin(direction), 0.0])
    poses: Array = distances[:, None] * along
    return poses


def _count(low: float, high: float, per_octave: int) -> int:
    return max(2, 1 + round(per_octave * math.log2(high / low)))


def _per_metre(
    candidates: Array, distances: Array, variances: Array, fixed: Array, references: int
) -> Array:
    """Variance (m^2 a metre) that chained matches add at each candidate distance."""
    at = np.log(candidates)[:, None] + np.log(np.arange(1, references + 1))
    variance = np.exp(np.interp(at, np.log(distances), np.log(variances)))  # (candidates, refs)
    back = np.sum(np.exp(at) / variance, axis=1) / np.sum(1.0 / variance, axis=1)
    every = np.interp(np.log(candidates), np.log(distances), fixed)
    grown: Array = (variance[:, 0] * candidates + every) / back**2
    return grown
