"""Runs of one log compared pair by pair: both errors at the same relation or pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.report.compare import mean_interval
from slam.evaluation.report.evaluate import RunReport
from slam.evaluation.report.page_data import Values
from slam.logs.trajectory import Stamps

_BLOCKS = 20  # in time: neighbouring errors are alike, means of blocks nearly independent
_LEAST_PER_BLOCK = 2

# What each error belongs to, its time, and the error in m
Errors = tuple[NDArray[np.intp] | Stamps, Stamps, Values]


@dataclass(frozen=True, slots=True)
class Paired:
    """The error of a run against that of another, over all that both have an error for."""

    run: str
    against: str
    n: int
    mean_m: float
    against_mean_m: float
    difference_m: float  # below 0 the run is better
    half95_m: float | None  # half the width of the 95 % interval of the difference
    smaller_share: float  # of the pairs in which the run's error is the smaller


def compare_with_first(reports: Sequence[RunReport]) -> tuple[Paired, ...]:
    """Pair each run with the first, where both are judged by the same truth."""
    pairs = ((report, reports[0]) for report in reports[1:])
    return tuple(p for pair in pairs if (p := _compare(*pair)) is not None)


def paired_json(pairs: Sequence[Paired]) -> list[dict[str, Any]]:
    """Return the comparison as `report.json` has it."""
    return [asdict(pair) for pair in pairs]


def _compare(run: RunReport, first: RunReport) -> Paired | None:
    own, other = _errors(run), _errors(first)
    if own is None or other is None or not _same_truth(run, first):
        return None
    common, a, b = np.intersect1d(own[0], other[0], return_indices=True)
    if len(common) == 0:
        return None
    in_time = np.argsort(own[1][a], kind="stable")
    errors, against = own[2][a][in_time], other[2][b][in_time]
    difference = errors - against
    blocks = min(_BLOCKS, len(common) // _LEAST_PER_BLOCK)
    half = math.nan
    if blocks > 1:
        half = mean_interval([float(m.mean()) for m in np.array_split(difference, blocks)]).half
    return Paired(
        run=run.run.name,
        against=first.run.name,
        n=len(common),
        mean_m=float(errors.mean()),
        against_mean_m=float(against.mean()),
        difference_m=float(difference.mean()),
        half95_m=half if math.isfinite(half) else None,
        smaller_share=float(np.mean(errors < against)),
    )


def _errors(report: RunReport) -> Errors | None:
    """Errors by relation or by stamp of the pose."""
    if report.relations is not None:
        return report.relations.rows, report.relations.at_ns, report.relations.trans_m
    if report.errors is not None and len(report.errors.trans_m) > 1:
        stamps, first = np.unique(report.errors.stamps_ns, return_index=True)
        return stamps, stamps, report.errors.trans_m[first]
    return None


def _same_truth(a: RunReport, b: RunReport) -> bool:
    """Whether one file judges both, or both come from one log that has its truth in it."""
    logs = {a.figures["log_sha256"], b.figures["log_sha256"]}
    return a.truth is b.truth or (len(logs) == 1 and None not in logs)
