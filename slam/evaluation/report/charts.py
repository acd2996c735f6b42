"""The charts of a report: which curves belong together, and what they are called."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from scipy.stats import chi2

from slam.evaluation.report.compare import Group
from slam.evaluation.report.evaluate import RunReport
from slam.evaluation.report.rows import bar_chart, strip_chart
from slam.evaluation.report.svg import Curve, histogram, line_chart

Chart = tuple[str, Markup]  # title and drawing; an empty drawing is left out

# What the bars of a comparison show, of the first kind that is known: title, path, unit.
_ERRORS = (
    ("Final pose error", "final_pose_error_m", "m"),
    ("Mean error of relations", "relations.trans_mean_m", "m"),
    ("ATE", "ate_rmse_m", "m"),
)
_COSTS = (
    ("Time spent on matching", "timing.stages_s.matching", "s"),
    ("Matches", "matches", ""),
)


def charts(report: RunReport) -> list[Chart]:
    """Return the charts of one run."""
    return [
        *_relation_charts(report),
        *_error_charts(report),
        *_sigma_charts(report),
        *_keyframe_charts(report),
    ]


def comparison_charts(groups: Sequence[Group]) -> list[Chart]:
    """Return bars of error and cost, as in the paper's Figure 7, with 95 % intervals."""
    known = [e for e in _ERRORS if any(e[1] in g.values for g in groups)][:1]
    made = []
    for title, key, unit in (*known, *_COSTS):
        intervals = [g.values.get(key) for g in groups]
        values = np.array([i.mean if i else math.nan for i in intervals])
        halves = np.array([i.half if i else math.nan for i in intervals])
        label = f"{title.lower()} [{unit}]" if unit else title.lower()
        made.append((title, bar_chart([g.label for g in groups], values, halves, label)))
    return made


def _relation_charts(report: RunReport) -> list[Chart]:
    if report.relations is None:
        return []
    start = report.run.trajectory.stamps_ns[0]
    at_s = (report.relations.at_ns - start) / 1e9
    order = np.argsort(at_s, kind="stable")
    curve = Curve("error", "a", at_s[order], report.relations.trans_m[order])
    trans, rot = report.relations.trans_m, report.relations.rot_deg
    return [
        ("Relations: translational error", histogram(trans, "error of a relation [m]")),
        ("Relations: rotational error", histogram(rot, "error of a relation [°]")),
        ("Relations over time", line_chart([curve], "time [s]", "error of a relation [m]")),
    ]


def _error_charts(report: RunReport) -> list[Chart]:
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


def _sigma_charts(report: RunReport) -> list[Chart]:
    if report.sigmas is None:
        return []
    at, made = report.sigmas.at_m, []
    for k, (axis, unit, scale) in enumerate(
        (("x", "m", 1.0), ("y", "m", 1.0), ("θ", "°", 180 / math.pi))
    ):
        error = Curve("error", "a", at, np.abs(report.sigmas.errors[:, k]) * scale)
        sigma = Curve("2 sigma claimed", "b", at, 2.0 * report.sigmas.sigmas[:, k] * scale)
        chart = line_chart([error, sigma], "travelled [m]", f"|error in {axis}| [{unit}]")
        made.append((f"Error and claimed sigma, {axis} of the base", chart))
    ends = np.array([at.min(), at.max()])
    band = [
        Curve(f"{share:.1%} of honest ones", "c", ends, np.full(2, chi2.ppf(share, 3)))
        for share in (0.025, 0.975)
    ]
    nees = Curve("NEES", "a", at, report.sigmas.nees)
    made.append(("NEES with chi-square band", line_chart([nees, *band], "travelled [m]", "NEES")))
    return made


def _keyframe_charts(report: RunReport) -> list[Chart]:
    decisions = report.run.records.decisions
    if len(decisions) < 2:
        return []
    travelled = np.cumsum([d.travelled_m for d in decisions])
    columns = np.array([(d.travelled_m, d.interval_m, d.t_pe) for d in decisions])
    between = Curve("travelled", "a", travelled[1:], columns[1:, 0])
    chosen = Curve("chosen", "b", travelled[1:], columns[1:, 1])
    complexity = Curve("T_PE", "c", travelled, columns[:, 2])
    causes = [d.reason + (f", {d.axis}" if d.axis else "") for d in decisions]
    rows = [(cause, travelled[[c == cause for c in causes]]) for cause in sorted(set(causes[1:]))]
    unit = report.run.records.config.get("keyframes", {}).get("unit", "metres")
    if unit == "scans":
        between = Curve("taken", "a", travelled[1:], np.diff([d.scan_index for d in decisions]))
    label = "interval [m]" if unit == "metres" else f"interval [{unit}]"
    return [
        ("Keyframe interval along the path", line_chart([between, chosen], "travelled [m]", label)),
        ("T_PE along the path", line_chart([complexity], "travelled [m]", "T_PE")),
        (
            "Why keyframes were taken, and the deciding axis",
            strip_chart(rows, float(travelled[-1]), "travelled [m]"),
        ),
    ]
