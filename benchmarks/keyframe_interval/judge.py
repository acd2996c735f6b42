"""The yardstick of the interval benchmark: the best constant interval of a world, in hindsight.

Every setting drives the same seeds, so errors are compared seed by seed: the ratio of two settings
is the geometric mean of their ratios, and its interval comes from drawing seeds again.  The best of
many constants is partly lucky: it is also chosen on some seeds and held against others.  Constants
that are not known to be worse than the best are tied with it; the longest of them makes the fewest
matches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.keyframe_interval.drives import Outcome, Setting

Array = NDArray[np.float64]

RESAMPLES = 2000
JUDGED = ("information", "information-permuted", "sdp-pe")


def judged(world: str, outcomes: Mapping[Setting, Sequence[Outcome]]) -> list[dict[str, Any]]:
    """Methods against the best constant and the longest tied one; below one speaks for them."""
    logs = {s: np.log([o.ate_m for o in of]) for s, of in outcomes.items()}
    matches = {s: float(np.median([o.matches for o in of])) for s, of in outcomes.items()}
    constant = [s for s in outcomes if s.method == "constant"]
    best = min(constant, key=lambda s: float(np.mean(logs[s])))
    tied = [s for s in constant if ratio(logs[s], logs[best])[1][0] <= 1.0]
    longest = max(tied, key=lambda s: s.keyframes.interval)
    closure_results = []
    for setting in outcomes:
        if setting.method not in JUDGED:
            continue
        error, interval = ratio(logs[setting], logs[best])
        against_longest = ratio(logs[setting], logs[longest])
        closure_results.append(
            {
                "world": world,
                "method": setting.method,
                "best_constant": best.label,
                "error_ratio": error,
                "error_ratio_ci95": interval,
                "error_ratio_other_seeds": on_other_seeds(
                    logs[setting], np.array([logs[s] for s in constant])
                ),
                "matches_ratio": matches[setting] / matches[best],
                "longest_tied_constant": longest.label,
                "longest_tied_error_ratio": against_longest[0],
                "longest_tied_error_ratio_ci95": against_longest[1],
                "longest_tied_matches_ratio": matches[setting] / matches[longest],
            }
        )
    return closure_results


def ratio(own: Array, other: Array) -> tuple[float, list[float]]:
    """Geometric mean of the ratios of errors whose logarithms (n,) are given, and its interval."""
    logs = own - other
    return float(np.exp(np.mean(logs))), interval95(np.exp(np.mean(logs[draws(len(logs))], axis=1)))


def on_other_seeds(own: Array, constant: Array) -> float:
    """The ratio to the constant that is best on drawn seeds, over the seeds not drawn.

    Args:
        own: (n,) logarithms of errors.
        constant: (constants, n) likewise.
    """
    ratios = []
    for drawn in draws(len(own)):
        left = np.setdiff1d(np.arange(len(own)), drawn)
        if len(left):
            best = constant[np.argmin(np.mean(constant[:, drawn], axis=1))]
            ratios.append(np.mean(own[left] - best[left]))
    return float(np.exp(np.mean(ratios)))


def draws(count: int) -> NDArray[np.int64]:
    """(RESAMPLES, count) seeds, drawn with replacement; ever the same."""
    return np.random.default_rng(0).integers(0, count, (RESAMPLES, count))


def interval95(values: Array) -> list[float]:
    """The middle 95 % of bootstrapped values."""
    low, high = np.percentile(values, [2.5, 97.5])
    return [float(low), float(high)]
