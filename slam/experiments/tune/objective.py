"""What `slam tune` makes small, and how it judges logs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from slam.runs.errors import ConfigError

_LEAST_ERROR_M = 1e-6  # an error of 0 has no logarithm
_REFUSED = 1000.0  # above any share of matches: more error than the reference is never better


class Objective(StrEnum):
    """Names of the objectives."""

    relations = "relations"
    ate = "ate"
    matches = "matches"


def parse_objective(name: str) -> Objective:
    """The objective of that name.

    Raises:
        ConfigError: there is none.
    """
    try:
        return Objective(name)
    except ValueError as error:
        raise ConfigError(f"--objective {name!r}: known are {', '.join(Objective)}") from error


@dataclass(frozen=True, slots=True)
class Score:
    """How one log, or several together, came out."""

    error_m: float  # inf where the log failed or lacks the truth
    matches: float


def score(record: Mapping[str, Any], objective: Objective) -> Score:
    """Judge a record of a task.

    `relations` takes the mean translational error of the relations, `ate` the aligned rmse;
    `matches` whichever of the two the truth gives.
    """
    if record["status"] != "ok":
        return Score(math.inf, math.inf)
    figures = record["figures"]
    relations = (figures["relations"] or {}).get("trans_mean_m")
    known = {Objective.relations: (relations,), Objective.ate: (figures["ate_rmse_m"],)}
    errors = known.get(objective, (relations, figures["ate_rmse_m"]))
    error = next((e for e in errors if e is not None), math.inf)
    return Score(error, float(record["summary"]["matches"]))


def together(scores: Sequence[Score]) -> Score:
    """Geometric means: half the error counts the same on an easy log as on a hard one."""
    return Score(
        _geometric_mean([max(s.error_m, _LEAST_ERROR_M) for s in scores]),
        _geometric_mean([max(s.matches, 1.0) for s in scores]),
    )


def value(objective: Objective, scores: Sequence[Score], reference: Sequence[Score]) -> float:
    """What the search makes small: metres of error, or the share of the reference's matches.

    Fewer matches count only at no more error than the reference has; with more error, less of
    it is better, and anything without is better still.
    """
    ours = together(scores)
    if objective is not Objective.matches:
        return ours.error_m
    theirs = together(reference)
    worse = ours.error_m / theirs.error_m
    return ours.matches / theirs.matches if worse <= 1.0 else _REFUSED + worse


def _geometric_mean(values: Sequence[float]) -> float:
    return math.exp(math.fsum(map(math.log, values)) / len(values))
