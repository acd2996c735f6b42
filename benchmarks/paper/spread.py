"""How far medians over test beds can be trusted."""

from __future__ import annotations

from typing import Any

import numpy as np

RESAMPLES = 2000


def median_ci95(values: np.ndarray[Any, Any]) -> list[float]:
    """Percentile bootstrap of the median, the same draws each time."""
    draws = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    low, high = np.percentile(np.median(values[draws], axis=1), [2.5, 97.5])
    return [float(low), float(high)]
