"""Limits of the chi-square test, without the time that importing `scipy` takes."""

from __future__ import annotations

import math


def chi_square_limit(probability: float, freedom: int) -> float:
    """What a chi-square variable of `freedom` degrees exceeds with this probability (above 0)."""
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
