"""Limits of the chi-square test, without the second that importing `scipy.stats` takes."""

from __future__ import annotations

from scipy.special import chdtri


def chi_square_limit(probability: float, freedom: int) -> float:
    """What a chi-square variable of `freedom` degrees exceeds with this probability."""
    return float(chdtri(freedom, probability))
