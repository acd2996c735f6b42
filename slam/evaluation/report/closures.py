"""Loop closures for the page: their numbers, and the pairs of scans to look at."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from slam.backend.se2 import between, wrap
from slam.evaluation.report.page_data import Values, column
from slam.evaluation.report.read_run import Run
from slam.logs.messages import LaserScan, LoopResult

_MOST_ROWS = 300  # of the table
_MOST_CLOSURES = 8000  # on the map: about 40 bytes of page each
_MOST_SCANS = 2500  # embedded: about 0.5 kB of page each
_MOST_BEAMS = 181  # of an embedded scan: one a degree shows how two scans lie
_NUMBER = re.compile(r"-?\d+(\.\d+)?")


def closures_table(run: Run) -> dict[str, Any]:
    """Return counts, the reasons of refusals, and rows for the table, evenly over the run."""
    results = run.records.closure_results
    start = run.trajectory.stamps_ns[0]
    place = {k: row for row, k in enumerate(_shown(results))}
    refused = Counter(
        _NUMBER.sub("\N{HORIZONTAL ELLIPSIS}", r.reason) for r in results if not r.accepted
    )
    return {
        "n": len(results),
        "accepted": sum(r.accepted for r in results),
        "refusals": refused.most_common(),
        "rows": [
            {
                "at_s": float(results[k].stamp_ns - start) / 1e9,
                "result": results[k],
                "shown": place.get(k),
            }
            for k in range(0, len(results), max(1, math.ceil(len(results) / _MOST_ROWS)))
        ],
    }


def closure_columns(run: Run) -> dict[str, Any]:
    """Return the closures that the map shows and the scans of their keyframes.

    `old_T_new` is what the closure measured; where it has left no measurement (most rejected
    ones) it is what the finished graph has, and `measured` is 0.
    """
    keyframes, results = run.keyframes, run.records.closure_results
    shown = [results[k] for k in _shown(results)]
    if keyframes is None or len(keyframes) == 0 or not shown:
        return {}
    last = len(keyframes) - 1
    old, new = (np.array([getattr(r, end) for r in shown]) for end in ("i", "j"))
    known = (old <= last) & (new <= last) & (np.minimum(old, new) >= 0)
    in_graph = np.full((len(shown), 3), np.nan)
    in_graph[known] = between(keyframes.poses[old[known]], keyframes.poses[new[known]])
    motions = {(f.i, f.j): (f.x, f.y, f.theta) for f in run.records.factors if f.kind == "loop"}
    nothing = (math.nan, math.nan, math.nan)
    measured = np.array([motions.get((r.i, r.j), nothing) for r in shown])
    off = between(measured, in_graph)
    has = np.isfinite(measured[:, 0])
    relative = np.where(has[:, None], measured, in_graph)
    words = sorted({r.reason for r in shown})
    start = run.trajectory.stamps_ns[0]
    numbers: list[tuple[str, Any, int]] = [
        ("t", [(r.stamp_ns - start) / 1e9 for r in shown], 3),
        ("old", old, 0),
        ("new", new, 0),
        ("score", [r.score for r in shown], 3),
        ("second_score", [r.second_score for r in shown], 3),
        ("chi_square", [r.chi_square for r in shown], 2),
        ("x", relative[:, 0], 4),
        ("y", relative[:, 1], 4),
        ("heading", np.degrees(relative[:, 2]), 3),
        ("off_m", np.hypot(off[:, 0], off[:, 1]), 4),
        ("off_deg", np.degrees(np.abs(wrap(off[:, 2]))), 3),
    ]
    return {
        **{name: column(np.asarray(v, dtype=np.float64), digits) for name, v, digits in numbers},
        "accepted": [int(r.accepted) for r in shown],
        "measured": has.astype(int).tolist(),
        "reasons": words,
        "reason": [words.index(r.reason) for r in shown],
        "scans": _scans(run, shown),
        "laser": _laser(run),
    }


def _shown(results: Sequence[LoopResult]) -> list[int]:
    """Indices of the closures on the map: all, or else accepted ones first, in order of time."""
    order = sorted(range(len(results)), key=lambda k: not results[k].accepted)
    return sorted(order[:_MOST_CLOSURES])


def _laser(run: Run) -> list[float]:
    """`base_T_laser` as x (m), y (m), heading (degrees)."""
    at = run.records.extrinsics
    return [at.x, at.y, math.degrees(at.theta)] if at else [0.0, 0.0, 0.0]


def _scans(run: Run, shown: Sequence[LoopResult]) -> dict[str, Any]:
    """Scans by number of keyframe, those of accepted closures first."""
    assert run.keyframes is not None
    by_stamp = {scan.stamp_ns: scan for scan in run.records.scans}
    stamps = run.keyframes.stamps_ns.tolist()
    found: dict[str, Any] = {}
    for result in sorted(shown, key=lambda r: not r.accepted):
        for k in (result.i, result.j):
            scan = by_stamp.get(stamps[k]) if 0 <= k < len(stamps) else None
            if scan is not None and str(k) not in found and len(found) < _MOST_SCANS:
                found[str(k)] = _scan(scan)
    return found


def _scan(scan: LaserScan) -> dict[str, Any]:
    step = max(1, math.ceil(len(scan.ranges) / _MOST_BEAMS))
    ranges: Values = scan.ranges[::step].astype(np.float64)
    hit = (ranges > scan.range_min) & (ranges < scan.range_max)
    return {
        "first": round(math.degrees(scan.angle_min), 4),
        "step": round(math.degrees(scan.angle_step) * step, 6),
        "ranges": column(np.where(hit, ranges, np.nan), 2),
    }
