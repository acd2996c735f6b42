"""The counter-test of `information`: what its drives gain, and whether normals bring it.

What permuting the normals has to destroy is what `information` gains over a choice that looks at
nothing: constant intervals with as many matches.  In a world by itself that is little, where one
constant suits the whole of it; over all worlds together it is held against one constant for all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.keyframe_interval.drives import Outcome, Setting
from benchmarks.keyframe_interval.judge import ratio

Array = NDArray[np.float64]
World = Mapping[Setting, Sequence[Outcome]]

ALL = "all together"


def counter_test(outcomes: Mapping[str, World]) -> list[dict[str, Any]]:
    """A row for each world, and one for all together; every world has the same seeds."""
    rows = [_row(name, [world]) for name, world in outcomes.items()]
    return [*rows, _row(ALL, list(outcomes.values()))]


def _row(name: str, worlds: Sequence[World]) -> dict[str, Any]:
    settings = list(worlds[0])
    constant = [s for s in settings if s.method == "constant"]
    own, permuted = (
        next(s for s in settings if s.method == method)
        for method in ("information", "information-permuted")
    )
    logs = {s: np.mean([np.log([o.ate_m for o in w[s]]) for w in worlds], axis=0) for s in settings}
    matches = {s: float(np.mean([o.matches for w in worlds for o in w[s]])) for s in settings}
    counts = np.array([matches[s] for s in constant])
    errors = np.array([logs[s] for s in constant])
    found: dict[str, Any] = {"world": name}
    for label, one, other in (
        ("blind_to_information", as_many(matches[own], counts, errors), logs[own]),
        ("blind_to_permuted", as_many(matches[permuted], counts, errors), logs[permuted]),
        ("permuted_to_information", logs[permuted], logs[own]),
    ):
        found[label], found[f"{label}_ci95"] = ratio(one, other)
    found["permuted_matches_ratio"] = matches[permuted] / matches[own]
    return found


def as_many(wanted: float, counts: Array, errors: Array) -> Array:
    """Logarithms (n,) of the errors of a blind choice with `wanted` matches on the average.

    It takes now the one, now the other of the two constants that make more and fewer.

    Args:
        wanted: matches.
        counts: (constants,) matches of each.
        errors: (constants, n) logarithms of the errors of each drive.
    """
    order = np.argsort(counts)
    at = np.interp(np.log(wanted), np.log(counts[order]), np.arange(len(order)))
    below = int(at)
    above = min(below + 1, len(order) - 1)
    share = at - below
    mixed: Array = (1.0 - share) * errors[order[below]] + share * errors[order[above]]
    return mixed
