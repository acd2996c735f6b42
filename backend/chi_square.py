"""The chi-square test: its limits, without importing `scipy`, and what it is applied to."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

SUSPICIOUS = 16.27
"""Chi-square of 3 degrees of freedom that one true loop in 1000 exceeds.

The exact limit is 16.2662.  The rounded one stays: it is part of the cost by which optima are
compared, and the optimum that is chosen must stay the same to the bit.  It is not `loops.gate`,
which judges a closure before it enters the graph; this one judges edges of the graph.
"""


@lru_cache(maxsize=256)
def chi_square_limit(probability: float, freedom: int) -> float:
    """What a chi-square variable of `freedom` degrees exceeds with this probability (above 0).

    A hundred steps of bisection, of which few are ever different: a run asks for the same limits
    at every loop closure.
    """
    low, high = 0.0, 1.0
    while _share_beyond(high, freedom) > probability:
        low, high = high, 2.0 * high
    while low < (middle := 0.5 * (low + high)) < high:
        if _share_beyond(middle, freedom) > probability:
            low = middle
        else:
            high = middle
    return high


def _share_beyond(limit: float, freedom: int) -> float:
    """How likely a chi-square variable exceeds `limit` (Abramowitz and Stegun 26.4.4, 26.4.5)."""
    half = 0.5 * limit
    if freedom % 2:
        share, term, order = math.erfc(math.sqrt(half)), 2.0 * math.sqrt(half / math.pi), 1.5
    else:
        share, term, order = 0.0, 1.0, 1.0
    term *= math.exp(-half)
    while order <= 0.5 * freedom:
        share += term
        term *= half / order
        order += 1.0
    return share


def mahalanobis(error: Matrix, covariance: Matrix, information: Matrix) -> float:
    """Squared Mahalanobis distance of two estimates of one pose, chi-square of 3 if both hold.

    (P^-1 + I^-1)^-1 = P - P (P + I)^-1 P with P the inverse of the first estimate's covariance:
    it needs no inverse of I, so an axis that the second estimate cannot see cannot disagree.

    Args:
        error: (3,) tangent vector from one to the other.
        covariance: (3, 3) of the first, positive definite.
        information: (3, 3) of the second, semi-definite.
    """
    known = np.linalg.inv(covariance)
    weight = known - known @ np.linalg.solve(known + information, known)
    return float(error @ weight @ error)
