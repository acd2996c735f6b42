"""Robust least squares of all unknowns at once, with sigmas that hold on real drives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.backend.se2 import between
from slam.evaluation.calibration.closed_form import fit_motion
from slam.evaluation.calibration.model import (
    OFFSET,
    ROTATION,
    TRANSLATION,
    YAW,
    Model,
    X,
    Y,
)
from slam.evaluation.calibration.noise import (
    FIRST,
    FREEDOM,
    OdometryNoise,
    fit_noise,
    weights_of,
)

Array = NDArray[np.float64]

# What is known before: so weak that a drive which shows a thing overrules it.
PRIOR_SIGMAS = np.array([0.5, 0.5, 1.0, 0.3, 0.3, 0.1, 0.5])  # m, m, rad, 1, 1, rad/m, s
OFFSETS_S = np.linspace(-1.0, 1.0, 21)  # tried at first: later steps find the next best only
_HELD_S = 1e-6  # the prior that holds the offset
_ROUNDS = 6  # noise from residuals, and residuals by noise
_STEPS = 5  # of Gauss-Newton in each
_BLOCKS = (30, 10, 5)  # into which a drive is cut: errors within one may have one cause
_LEAST_IN_BLOCK = 4


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """The unknowns of `model.NAMES`."""

    values: Array  # (7,)
    covariance: Array  # (7, 7)
    noise: OdometryNoise
    residuals: Array  # (n, 3) in units of the odometry
    weights: Array  # (n, 3) 4/3 where a residual is small, towards 0 where it is not noise
    cost: float  # less the logarithm of the likelihood
    offset_held: bool = False  # the stamps as they are explain more than any offset

    @property
    def sigmas(self) -> Array:
        """(7,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False, slots=True)
class _Linear:
    """The whitened problem at one point: weights (n, 3), rows (n, 3, 7), errors (n, 3)."""

    weights: Array
    rows: Array
    errors: Array

    @property
    def normal(self) -> Array:
        found: Array = np.einsum("nik,ni,nil->kl", self.rows, self.weights, self.rows)
        return found

    @property
    def gradients(self) -> Array:
        """(n, 7) of the single intervals."""
        found: Array = np.einsum("nik,ni->nk", self.rows, self.weights * self.errors)
        return found


def fit_calibration(model: Model, stated: Array) -> Fit:
    """Find what explains all intervals best.

    Where odometry is logged with each scan and stamps jitter, odometry read a little earlier or
    later is that of another moment than it says.  The offset is believed only where it explains
    more than none; then the cost has no cusp there that steps by derivatives cannot see.

    Args:
        model: of at least a dozen intervals.
        stated: (7,) what the log says, towards which the weak prior draws.
    """
    free = _fit(model, stated, _first_guess(model, stated, OFFSETS_S), PRIOR_SIGMAS)
    held_sigmas = PRIOR_SIGMAS.copy()
    held_sigmas[OFFSET] = _HELD_S
    held = _fit(model, stated, _first_guess(model, stated, stated[[OFFSET]]), held_sigmas)
    return free if free.cost <= held.cost else replace(held, offset_held=True)


def _fit(model: Model, stated: Array, values: Array, prior_sigmas: Array) -> Fit:
    prior, noise = np.diag(prior_sigmas**-2), FIRST
    metres, radians = model.paths()
    for _ in range(_ROUNDS):
        matches = model.match_covariances(values)
        covariances = matches + _diagonals(noise.variances(metres, radians))
        whiteners = np.linalg.inv(np.linalg.cholesky(covariances))
        for _ in range(_STEPS):
            linear = _linearised(model, values, whiteners)
            values = _step(linear, values, stated, prior)
        residuals = model.residuals(values)
        noise = fit_noise(residuals, np.einsum("nkk->nk", matches), metres, radians)
    size = float(np.sum(np.log(np.einsum("nkk->nk", whiteners))))
    tails = np.log1p(linear.errors**2 / FREEDOM)
    cost = 0.5 * (FREEDOM + 1.0) * float(np.sum(tails)) - size
    return Fit(values, _covariance(linear, prior), noise, residuals, linear.weights, cost)


def _first_guess(model: Model, stated: Array, offsets_s: Array) -> Array:
    """By the closed form, which no start can lead astray, under the best of some offsets."""
    laser, track = model.motions, model.track
    best, least = stated, np.inf
    for offset in offsets_s:
        wheels = between(track.at(model.start_s - offset), track.at(model.end_s - offset))
        found = fit_motion(
            wheels[:, 0] + 1j * wheels[:, 1], wheels[:, 2], laser[:, 0] + 1j * laser[:, 1],
            laser[:, 2], complex(stated[X], stated[Y]),
        )  # fmt: skip
        values = stated.copy()
        values[[X, Y, YAW, OFFSET]] = found.place.real, found.place.imag, found.yaw, offset
        values[TRANSLATION] = np.clip(found.distance_scale, 0.2, 5.0)
        if np.isfinite(found.turn_scale) and found.turn_scale > 0.0:
            values[ROTATION] = np.clip(found.turn_scale, 0.2, 5.0)
        # In units of usual errors; the logarithm does not mind outliers.
        errors = np.abs(model.residuals(values)) / (0.01, 0.01, 0.02)
        cost = float(np.mean(np.log1p(errors**2)))
        if cost < least:
            best, least = values, cost
    return best


def _diagonals(variances: Array) -> Array:
    found = np.zeros((len(variances), 3, 3))
    found[:, [0, 1, 2], [0, 1, 2]] = variances
    return found


def _linearised(model: Model, values: Array, whiteners: Array) -> _Linear:
    errors = np.einsum("nij,nj->ni", whiteners, model.residuals(values))
    return _Linear(weights_of(errors**2), whiteners @ model.jacobian(values), errors)


def _step(linear: _Linear, values: Array, stated: Array, prior: Array) -> Array:
    """One step of Gauss-Newton."""
    off = values - stated
    off[YAW] = np.remainder(off[YAW] + np.pi, 2.0 * np.pi) - np.pi
    normal = linear.normal + prior
    right = linear.gradients.sum(axis=0) + prior @ off
    found: Array = values - np.linalg.solve(normal, right)
    return found


def _covariance(linear: _Linear, prior: Array) -> Array:
    """(7, 7) from how the intervals, and blocks of them, disagree; the larger sigma counts.

    Errors of neighbours may have one cause (a slippery floor, a wall matched to a wrong one),
    which no sum over single intervals sees: gradients are added up over blocks, short and long
    (Huber 1967; Liang and Zeger 1986).  The prior stands for one more such block.
    """
    squares = linear.errors**2
    # How the weighted error grows with the error itself: less than by the weight.
    slopes = linear.weights * (1.0 - 2.0 * squares / (FREEDOM + squares))
    bread = np.linalg.inv(linear.normal * (slopes.sum() / linear.weights.sum()) + prior)
    # An interval that decides an unknown by itself draws the fit to it: its error is larger than
    # what is left of it (the jackknife's correction, HC3 of MacKinnon and White 1985).
    pull = np.einsum("nik,kl,nil->ni", linear.rows, bread, linear.rows) * linear.weights
    free = 1.0 / (1.0 - np.clip(pull, 0.0, 0.9))
    single = _Linear(linear.weights * free, linear.rows, linear.errors).gradients
    found = [bread @ (single.T @ single + prior) @ bread]
    for count in _BLOCKS:
        blocks = np.array_split(single, max(2, min(count, len(single) // _LEAST_IN_BLOCK)))
        sums = np.array([block.sum(axis=0) for block in blocks])
        sums -= sums.mean(axis=0)
        inner = sums.T @ sums * len(sums) / (len(sums) - 1)
        found.append(bread @ (inner + prior) @ bread)
    variances = np.array([np.diag(one) for one in found])
    larger = np.sqrt(variances.max(axis=0) / variances[0])
    covariance: Array = found[0] * np.outer(larger, larger)
    return covariance
