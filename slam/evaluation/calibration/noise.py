"""How exact the odometry is, from what a calibration leaves unexplained.

Random errors add up as variances: so much per metre and per radian, and a part per interval
(rounding, stamps that jitter).  Errors of the heading, gained evenly on the way, swing the end of
a step sideways: seen from its middle, by a twelfth of length^2 times their variance.

Wheels slip and matches go wrong, so residuals count as Student's t with few degrees of freedom:
each as a Gaussian whose variance is its own (Lange, Little and Taylor, JASA 1989).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Array = NDArray[np.float64]

FREEDOM = 3.0  # of Student's t: 85 % efficient where noise is Gaussian
GAUSSIAN = 0.6297  # its scale^2 for Gaussian noise of unit variance
_FLOORS = np.array([5e-4, 5e-4, 5e-4]) ** 2  # m, m, rad: rounding of usual odometry
_ROUNDS = 10


@dataclass(frozen=True, eq=False, slots=True)
class OdometryNoise:
    """Variances (scales of t) of forward, left and turn (rows), in units of the odometry."""

    components: Array  # (3, 3): per interval, per metre, per radian (columns)
    sigmas: Array  # (3, 3) of them

    def variances(self, metres: Array, radians: Array) -> Array:
        """(n, 3) of intervals of such lengths and turns."""
        columns = _columns(metres, radians)
        found = columns @ self.components.T
        found[:, 1] += metres**2 * (columns @ self.components[2]) / 12.0
        return found


FIRST = OdometryNoise(
    np.array([[0.003, 0.02, 0.01], [0.003, 0.01, 0.01], [0.003, 0.005, 0.03]]) ** 2,
    np.zeros((3, 3)),
)
"""Before anything is known: as the odometry of usual robots."""


def weights_of(squares: Array) -> Array:
    """Weights of residuals, from their squares in units of the variance."""
    return (FREEDOM + 1.0) / (FREEDOM + squares)


def _columns(metres: Array, radians: Array) -> Array:
    return np.column_stack([np.ones_like(metres), metres, radians])


def fit_noise(
    residuals: Array, match_variances: Array, metres: Array, radians: Array
) -> OdometryNoise:
    """Variance components of n intervals.

    Args:
        residuals: (n, 3).
        match_variances: (n, 3) of them, by the matches.
        metres: (n,) of way.
        radians: (n,) turned, without sign.
    """
    columns = _columns(metres, radians)
    found, sigmas = np.zeros((3, 3)), np.zeros((3, 3))
    for axis in (2, 0, 1):  # the heading first: sideways errors follow from it
        known = match_variances[:, axis].copy()
        if axis == 1:
            known += metres**2 * (columns @ found[2]) / 12.0
        found[axis], sigmas[axis] = _axis(residuals[:, axis] ** 2, known, columns, _FLOORS[axis])
    return OdometryNoise(found, sigmas)


def _axis(squares: Array, known: Array, columns: Array, floor: float) -> tuple[Array, Array]:
    """Components (3,) and their sigmas, by expectation and maximisation."""
    variance = np.full(len(squares), float(np.median(squares)))
    found = sigmas = np.zeros(columns.shape[1])
    for _ in range(_ROUNDS):
        variance = np.maximum(variance, floor)
        wanted = weights_of(squares / variance) * squares - known
        rows = columns / variance[:, None]
        scale = np.maximum(np.linalg.norm(rows, axis=0), 1e-12)
        found = nnls(rows / scale, wanted / variance)[0] / scale
        normal = (rows / scale).T @ (rows / scale) + 1e-9 * np.eye(len(scale))
        sigmas = np.sqrt(2.0 * np.diag(np.linalg.inv(normal))) / scale
        found[0] = max(found[0], floor)
        variance = known + columns @ found
    return found, sigmas
