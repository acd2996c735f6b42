"""Renders reports as one page that needs nothing else: no network, no library, no font."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.evaluation.report.charts import charts, comparison_charts
from slam.evaluation.report.compare import COLUMNS, Interval, group_runs, lookup
from slam.evaluation.report.credibility import explanation
from slam.evaluation.report.evaluate import RunReport
from slam.evaluation.report.map import Track, map_figure
from slam.evaluation.report.page import format_number, page_template
from slam.evaluation.report.read_run import Run
from slam.logs.messages import LoopResult
from slam.logs.trajectory import path_length

_MOST_CLOSURES = 300  # rows of the closure table

# The rows of the table of consistency: what it is, where it is, decimals, unit
_CONSISTENCY = (
    ("closures against the finished graph, median", "closure_residual_median_m", 4, " m"),
    ("the same, largest", "closure_residual_max_m", 4, " m"),
    ("the same in heading, median", "closure_residual_median_deg", 3, "°"),
    ("odometry against ICP, a keyframe's step, median", "odometry_against_icp_median_m", 4, " m"),
    ("the same, 95 % below", "odometry_against_icp_p95_m", 4, " m"),
    ("the same in heading, median", "odometry_against_icp_median_deg", 3, "°"),
    ("share of steps whose odometry was refused", "odometry_refused_share", 4, ""),
    ("odometry against trajectory, after each metre", "odometry_disagreement_per_m", 4, " m"),
    ("map sharpness: thickness of walls, median RMS", "wall_thickness_median_m", 4, " m"),
    ("the same, 90 % below", "wall_thickness_p90_m", 4, " m"),
    ("places that this was measured at", "wall_cells", 0, ""),
)
_NUMBER = re.compile(r"-?\d+(\.\d+)?")


def render(reports: Sequence[RunReport]) -> str:
    """Return the page for one or more runs."""
    return page_template("report.html.j2").render(
        title=", ".join(report.run.name for report in reports),
        comparison=_comparison(reports),
        runs=[_run(report) for report in reports],
    )


def _comparison(reports: Sequence[RunReport]) -> dict[str, Any]:
    """Return headings, a row for each run and group, and charts; nothing for one run."""
    figures = [report.figures for report in reports]
    used = [c for c in COLUMNS if any(lookup(f, c[1]) is not None for f in figures)]
    if len(reports) < 2:
        return {"headings": [], "rows": [], "groups": [], "charts": []}
    groups = group_runs([report.run for report in reports], figures)
    return {
        "headings": [heading for heading, _, _ in used],
        "rows": [
            (f["name"], [format_number(lookup(f, key), decimals) for _, key, decimals in used])
            for f in figures
        ],
        "groups": [
            (
                g.label,
                len(g.members),
                [_format_interval(g.values.get(key), d) for _, key, d in used],
            )
            for g in groups
            if len(g.members) > 1
        ],
        "charts": comparison_charts(groups),
    }


def _format_interval(interval: Interval | None, decimals: int) -> str:
    if interval is None or interval.n < 2:
        return "\N{EN DASH}"
    digits = max(decimals, 1)
    return f"{format_number(interval.mean, digits)} ± {format_number(interval.half, digits)}"


def _run(report: RunReport) -> dict[str, Any]:
    """Return what the template shows of one run."""
    return {
        "name": report.run.name,
        "figures": report.figures,
        "warnings": report.warnings,
        "map": _map(report),
        "charts": [chart for chart in charts(report) if chart[1]],
        "credibility": explanation(report.sigmas.credibility, report.run.records.config)
        if report.sigmas
        else "",
        "consistency": [
            (label, report.figures["consistency"][key], decimals, unit)
            for label, key, decimals, unit in _CONSISTENCY
            if key in report.figures["consistency"]
        ],
        "timing": _timing(report.figures),
        "config": json.dumps(report.run.records.config, indent=2)
        if report.run.records.config
        else "",
        "keyframes": _keyframe_counts(report),
        "closures": _closures(report),
        "provenance": _provenance(report),
    }


def _map(report: RunReport) -> dict[str, Any]:
    run = report.run
    tracks = [Track("SLAM", "a", run.trajectory.poses)]
    if report.errors is not None and len(report.errors.truth_in_map) > 1:
        tracks.append(Track("truth", "c", report.errors.truth_in_map))
    if run.odometry is not None and len(run.odometry):
        tracks.append(Track("odometry", "b", run.odometry.poses))
    keys = [(track.name, track.style) for track in tracks]
    links = _closure_links(run)
    if len(links):
        keys.append(("closures", "d"))
    return {"svg": map_figure(run.grid, tracks, links), "keys": keys}


def _closure_links(run: Run) -> NDArray[np.float64]:
    """(n, 4) where the accepted closures begin and end."""
    used = [f for f in run.records.factors if f.kind == "loop" and f.used]
    keyframes = run.keyframes
    known = [f for f in used if keyframes is not None and max(f.i, f.j) < len(keyframes)]
    if keyframes is None or not known:
        return np.zeros((0, 4))
    ends = [keyframes.poses[[getattr(f, end) for f in known], :2] for end in ("i", "j")]
    return np.concatenate(ends, axis=1)


def _keyframe_counts(report: RunReport) -> dict[str, Any] | None:
    decisions = report.run.records.decisions
    if not decisions:
        return None
    intervals = np.array([d.travelled_m for d in decisions[1:]] or [math.nan])
    return {
        "n": len(decisions),
        "reasons": Counter(d.reason for d in decisions).most_common(),
        "axes": Counter(d.axis for d in decisions if d.axis).most_common(),
        "median_m": float(np.median(intervals)),
        "min_m": float(np.min(intervals)),
        "max_m": float(np.max(intervals)),
    }


def _timing(figures: dict[str, Any]) -> list[tuple[str, Any]]:
    timing = figures["timing"] or {}
    rows = [(key, value) for key, value in timing.items() if not isinstance(value, dict)]
    return rows + [
        (f"of it {name}, s" if key == "stages_s" else f"{key}: {name}", value)
        for key, values in timing.items()
        if isinstance(values, dict)
        for name, value in values.items()
    ]


def _closures(report: RunReport) -> dict[str, Any]:
    closure_results = report.run.records.closure_results
    start = report.run.trajectory.stamps_ns[0]
    rows = [
        {
            "at_s": float(v.stamp_ns - start) / 1e9,
            "i": v.i,
            "j": v.j,
            "accepted": v.accepted,
            "reason": v.reason,
            "score": v.score,
            "second_score": v.second_score,
            "chi_square": v.chi_square,
        }
        for v in _spread(closure_results)
    ]
    return {
        "n": len(closure_results),
        "accepted": sum(v.accepted for v in closure_results),
        "refusals": Counter(
            _NUMBER.sub("\N{HORIZONTAL ELLIPSIS}", v.reason)
            for v in closure_results
            if not v.accepted
        ).most_common(),
        "rows": rows,
    }


def _spread(closure_results: Sequence[LoopResult]) -> list[LoopResult]:
    """As many as the table takes, evenly over the run."""
    step = max(1, math.ceil(len(closure_results) / _MOST_CLOSURES))
    return list(closure_results[::step])


def _provenance(report: RunReport) -> list[tuple[str, Any]]:
    summary = report.run.summary
    keys = ("log", "log_sha256", "version", "config_sha256", "host", "peak_rss_mb", "scans")
    known = [(key.replace("_", " "), summary[key]) for key in keys if key in summary]
    odometry = report.run.odometry
    if odometry is not None and len(odometry):
        length = f"{path_length(odometry.poses)[-1]:.1f} m"
        known.append(("path by odometry", length))
    return known
