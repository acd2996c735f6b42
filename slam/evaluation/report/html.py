"""Renders reports as one page that needs nothing else: no network, no file, no font."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from slam.evaluation.report.charts import charts
from slam.evaluation.report.closures import closure_columns, closures_table
from slam.evaluation.report.compare import COLUMNS, Group, Interval, bars, lookup
from slam.evaluation.report.credibility import explanation
from slam.evaluation.report.evaluate import RunReport
from slam.evaluation.report.map_image import map_image
from slam.evaluation.report.page import format_number, page_template
from slam.evaluation.report.page_data import pack
from slam.evaluation.report.paired import Paired
from slam.evaluation.report.path_columns import keyframe_columns, path_columns
from slam.evaluation.report.words import CONSISTENCY, PROVENANCE, STAGES, TIMING, words
from slam.logs.trajectory import path_length

SCRIPTS = (
    "vendor/leaflet.js", "vendor/uplot.js", "tables.js", "data.js", "map.js", "closures.js",
    "run_map.js", "charts.js", "report.js",
)  # fmt: skip


def render(
    reports: Sequence[RunReport], groups: Sequence[Group], pairs: Sequence[Paired] = ()
) -> str:
    """Return the page for one or more runs, with their groups and pairs where there are several."""
    made = [_run(report) for report in reports]
    return page_template("report.html.j2").render(
        title=", ".join(report.run.name for report in reports),
        scripts=SCRIPTS,
        styles=("vendor/leaflet.css", "vendor/uplot.css", "page.css", "figures.css"),
        comparison=_comparison(reports, groups) if len(reports) > 1 else None,
        pairs=pairs,
        runs=[shown for shown, _ in made],
        data=pack({"runs": [drawn for _, drawn in made]}),
    )


def _comparison(reports: Sequence[RunReport], groups: Sequence[Group]) -> dict[str, Any]:
    """Return headings, a row for each run and group, and bars."""
    figures = [report.figures for report in reports]
    used = [c for c in COLUMNS if any(lookup(f, c[1]) is not None for f in figures)]
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
        "bars": bars(groups),
    }


def _format_interval(interval: Interval | None, decimals: int) -> str:
    if interval is None or interval.n < 2:
        return "\N{EN DASH}"
    digits = max(decimals, 1)
    return f"{format_number(interval.mean, digits)} ± {format_number(interval.half, digits)}"


def _run(report: RunReport) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what the template shows of one run, and what its scripts draw."""
    run = report.run
    path = path_columns(report)
    groups = charts(report, path)
    drawn = {
        "name": run.name,
        "error_of": "error" if report.errors is not None else "error of relations",
        "map": map_image(run.grid) if run.grid is not None else None,
        "path": path,
        "keyframes": keyframe_columns(report),
        "closures": closure_columns(run),
        "charts": [chart.for_page() for _, made in groups for chart in made],
    }
    shown = {
        "name": run.name,
        "figures": report.figures,
        "warnings": report.warnings,
        "charts": [(heading, [chart.title for chart in made]) for heading, made in groups],
        "credibility": explanation(report.sigmas.credibility, run.records.config)
        if report.sigmas
        else "",
        "consistency": [
            (label, report.figures["consistency"][key], decimals, unit)
            for label, key, decimals, unit in CONSISTENCY
            if key in report.figures["consistency"]
        ],
        "timing": _timing(report.figures),
        "config": json.dumps(run.records.config, indent=2) if run.records.config else "",
        "keyframes": _keyframe_counts(report),
        "closures": closures_table(run),
        "provenance": _provenance(report),
    }
    return shown, drawn


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
    rows = [(words(TIMING, k), v) for k, v in timing.items() if not isinstance(v, dict)]
    return rows + [
        (f"of it {words(STAGES, name)}" if key == "stages_s" else f"{words({}, key)}: {name}", v)
        for key, values in timing.items()
        if isinstance(values, dict)
        for name, v in values.items()
    ]


def _provenance(report: RunReport) -> list[tuple[str, Any]]:
    summary = report.run.summary
    known = [(label, summary[key]) for key, label in PROVENANCE.items() if key in summary]
    odometry = report.run.odometry
    if odometry is not None and len(odometry):
        length = f"{path_length(odometry.poses)[-1]:.1f} m"
        known.append(("path by odometry", length))
    return known
