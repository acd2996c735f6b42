"""Renders reports as one page that needs nothing else: no network, no library, no font."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from scipy.stats import t as student_t

from slam.report import RunReport
from slam.report_map import Track, map_figure
from slam.report_svg import Curve, histogram, line_chart
from slam.trajectory import path_length

_MOST_CLOSURES = 300  # rows of the closure table

# Columns of the comparison: heading, path into the figures, decimals
_COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("matches", "matches", 0),
    ("keyframes", "keyframes", 0),
    ("relations mean [m]", "relations.trans_mean_m", 4),
    ("± std [m]", "relations.trans_std_m", 4),
    ("rotation mean [°]", "relations.rot_mean_deg", 3),
    ("± std [°]", "relations.rot_std_deg", 3),
    ("ATE rmse [m]", "ate_rmse_m", 4),
    ("ATE median [m]", "ate_median_m", 4),
    ("final pose [m]", "final_pose_error_m", 4),
    ("ANEES", "anees", 2),
    ("wall [s]", "timing.wall_s", 2),
    ("\N{MULTIPLICATION SIGN} real time", "timing.realtime_factor", 1),
)


def render(reports: Sequence[RunReport]) -> str:
    """Return the page for one or more runs."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = format_number
    template = environment.get_template("report.html.j2")
    return template.render(
        title=", ".join(report.run.name for report in reports),
        comparison=_comparison(reports),
        runs=[_run(report) for report in reports],
    )


def format_number(value: Any, decimals: int = 3) -> str:
    """Return a number for people: a dash where there is none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "\N{EN DASH}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return f"{value:,.{decimals}f}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def _comparison(reports: Sequence[RunReport]) -> dict[str, Any]:
    """Return headings, a row for each run, and mean ± 95 % interval; nothing for one run."""
    values = [[_lookup(r.figures, key) for _, key, _ in _COLUMNS] for r in reports]
    used = [
        k
        for k in range(len(_COLUMNS))
        if len(reports) > 1 and any(row[k] is not None for row in values)
    ]
    rows = [
        (report.run.name, [format_number(row[k], _COLUMNS[k][2]) for k in used])
        for report, row in zip(reports, values, strict=True)
    ]
    means = [_mean_interval([row[k] for row in values], _COLUMNS[k][2]) for k in used]
    return {
        "headings": [_COLUMNS[k][0] for k in used],
        "rows": rows,
        "means": means if len(reports) > 1 else [],
    }


def _lookup(figures: dict[str, Any], key: str) -> float | None:
    value: Any = figures
    for part in key.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value if isinstance(value, int | float) else None


def _mean_interval(values: Sequence[float | None], decimals: int) -> str:
    """Return the mean with the half width of Student's 95 % interval."""
    known = np.array([value for value in values if value is not None], dtype=np.float64)
    if len(known) < 2:
        return "\N{EN DASH}"
    half = student_t.ppf(0.975, len(known) - 1) * known.std(ddof=1) / math.sqrt(len(known))
    digits = max(decimals, 1)
    return f"{format_number(float(known.mean()), digits)} ± {format_number(float(half), digits)}"


def _run(report: RunReport) -> dict[str, Any]:
    """Return what the template shows of one run."""
    return {
        "name": report.run.name,
        "figures": report.figures,
        "warnings": report.warnings,
        "map": _map(report),
        "charts": [chart for chart in _charts(report) if chart[1]],
        "keyframes": _keyframe_counts(report),
        "closures": _closures(report),
        "provenance": _provenance(report),
    }


def _map(report: RunReport) -> dict[str, Any]:
    tracks = [Track("SLAM", "a", report.run.trajectory.poses)]
    if report.errors is not None and len(report.errors.truth_in_map) > 1:
        tracks.append(Track("truth", "c", report.errors.truth_in_map))
    if report.run.odometry is not None and len(report.run.odometry):
        tracks.append(Track("odometry", "b", report.run.odometry.poses))
    return {"svg": map_figure(report.run.grid, tracks), "keys": [(t.name, t.style) for t in tracks]}


def _charts(report: RunReport) -> list[tuple[str, Markup]]:
    charts: list[tuple[str, Markup]] = []
    if report.relations is not None:
        charts.append(
            (
                "Relations: translational error",
                histogram(report.relations.trans_m, "error of a relation [m]"),
            )
        )
        charts.append(
            (
                "Relations: rotational error",
                histogram(report.relations.rot_deg, "error of a relation [°]"),
            )
        )
        start = report.run.trajectory.stamps_ns[0]
        at_s = (report.relations.at_ns - start) / 1e9
        order = np.argsort(at_s, kind="stable")
        curve = Curve("error", "a", at_s[order], report.relations.trans_m[order])
        charts.append(
            ("Relations over time", line_chart([curve], "time [s]", "error of a relation [m]"))
        )
    return charts + _error_charts(report) + _sigma_charts(report) + _keyframe_charts(report)


def _error_charts(report: RunReport) -> list[tuple[str, Markup]]:
    errors = report.errors
    if errors is None or len(errors.trans_m) < 2:
        return []
    by_time = Curve("position", "a", errors.at_s, errors.trans_m)
    by_path = Curve("position", "a", errors.at_m, errors.trans_m)
    heading = Curve("heading", "b", errors.at_m, errors.rot_deg)
    return [
        ("Position error over time", line_chart([by_time], "time [s]", "error [m]")),
        ("Position error over distance", line_chart([by_path], "travelled [m]", "error [m]")),
        ("Heading error over distance", line_chart([heading], "travelled [m]", "error [°]")),
    ]


def _sigma_charts(report: RunReport) -> list[tuple[str, Markup]]:
    if report.sigmas is None:
        return []
    at, charts = report.sigmas.at_m, []
    for k, (axis, unit, scale) in enumerate(
        (("x", "m", 1.0), ("y", "m", 1.0), ("θ", "°", 180 / math.pi))
    ):
        error = Curve("error", "a", at, np.abs(report.sigmas.errors[:, k]) * scale)
        sigma = Curve("2 sigma claimed", "b", at, 2.0 * report.sigmas.sigmas[:, k] * scale)
        chart = line_chart([error, sigma], "travelled [m]", f"|error in {axis}| [{unit}]")
        charts.append((f"Error and claimed sigma, {axis} of the base", chart))
    return charts


def _keyframe_charts(report: RunReport) -> list[tuple[str, Markup]]:
    decisions = report.run.records.decisions
    if len(decisions) < 2:
        return []
    travelled = np.cumsum([d.travelled_m for d in decisions])
    columns = np.array([(d.travelled_m, d.interval_m, d.t_pe) for d in decisions])
    between = Curve("travelled", "a", travelled[1:], columns[1:, 0])
    chosen = Curve("chosen", "b", travelled[1:], columns[1:, 1])
    complexity = Curve("T_PE", "c", travelled, columns[:, 2])
    return [
        (
            "Keyframe interval along the path",
            line_chart([between, chosen], "travelled [m]", "interval [m]"),
        ),
        ("T_PE along the path", line_chart([complexity], "travelled [m]", "T_PE")),
    ]


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


def _closures(report: RunReport) -> dict[str, Any]:
    verdicts = report.run.records.verdicts
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
        for v in sorted(verdicts, key=lambda v: not v.accepted)[:_MOST_CLOSURES]
    ]
    return {
        "n": len(verdicts),
        "accepted": sum(v.accepted for v in verdicts),
        "refusals": Counter(v.reason for v in verdicts if not v.accepted).most_common(),
        "rows": rows,
    }


def _provenance(report: RunReport) -> list[tuple[str, Any]]:
    summary = report.run.summary
    keys = ("log", "log_sha256", "version", "config_sha256", "host", "peak_rss_mb", "scans")
    known = [(key.replace("_", " "), summary[key]) for key in keys if key in summary]
    odometry = report.run.odometry
    if odometry is not None and len(odometry):
        length = f"{path_length(odometry.poses)[-1]:.1f} m"
        known.append(("path by odometry", length))
    return known
