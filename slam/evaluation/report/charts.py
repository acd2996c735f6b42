"""The charts of a report: which curves belong together, and what they are called."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from slam.evaluation.report.evaluate import RunReport
from slam.evaluation.report.page_data import Values, column, shown_rows

_BINS = 40  # of a histogram
_DIGITS = 4  # decimals of what is drawn: a tenth of a millimetre


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """One line of a chart; `style` names a colour of the style sheet."""

    name: str
    style: str  # "a", "b", "c"
    y: Values | str  # or the name of a column of the path


@dataclass(frozen=True, eq=False, slots=True)
class Chart:
    """Curves over common values of x; the page's script draws it."""

    title: str
    x_label: str
    y_label: str
    x: Values | str
    curves: Sequence[Curve]
    kind: Literal["line", "bars", "events"] = "line"

    def for_page(self) -> dict[str, Any]:
        """Return it as JSON; events have a row for each curve."""
        n = 0 if isinstance(self.x, str) else len(self.x)
        own = [c.y for c in self.curves if not isinstance(c.y, str) and np.isfinite(c.y).any()]
        rows = shown_rows(n, np.array([np.nanargmax(y) for y in own], dtype=np.intp))
        return {
            "title": self.title,
            "kind": self.kind,
            "x_label": self.x_label,
            "y_label": self.y_label,
            "x": _values(self.x, rows),
            "curves": [
                {"name": c.name, "style": c.style, "y": _values(c.y, rows)} for c in self.curves
            ],
        }


def charts(report: RunReport, path: Mapping[str, Any]) -> list[tuple[str, list[Chart]]]:
    """Return the charts of one run, whose `path` has these columns, under their headings."""
    groups = [
        ("Pose over time", _pose_charts(path)),
        ("Accuracy", _relation_charts(report) + _error_charts(report)),
        ("Covariances", _sigma_charts(report)),
        ("Keyframes", _keyframe_charts(report)),
    ]
    return [(heading, made) for heading, made in groups if made]


def _values(values: Values | str, rows: NDArray[np.intp]) -> Any:
    return values if isinstance(values, str) else column(values[rows], _DIGITS)


def _pose_charts(path: Mapping[str, Any]) -> list[Chart]:
    """x, y and heading beside odometry and truth, as far as they are known."""
    sources = (("SLAM", "a", ""), ("odometry", "b", "odometry_"), ("truth", "c", "truth_"))
    return [
        Chart(
            f"{title} over time",
            "time [s]",
            label,
            "t",
            [Curve(n, style, before + key) for n, style, before in sources if before + key in path],
        )
        for title, label, key in (
            ("x", "x [m]", "x"), ("y", "y [m]", "y"), ("Heading", "heading [°]", "heading"),
        )
    ]  # fmt: skip


def _relation_charts(report: RunReport) -> list[Chart]:
    found = report.relations
    if found is None or not len(found.trans_m):
        return []
    at_s = (found.at_ns - report.run.trajectory.stamps_ns[0]) / 1e9
    order = np.argsort(at_s, kind="stable")
    curve = Curve("error", "a", found.trans_m[order])
    label = "error of a relation"
    return [
        _histogram("Relations: translational error", f"{label} [m]", found.trans_m),
        _histogram("Relations: rotational error", f"{label} [°]", found.rot_deg),
        Chart("Relations over time", "time [s]", f"{label} [m]", at_s[order], [curve]),
    ]


def _histogram(title: str, label: str, values: Values) -> Chart:
    """Counts up to the 99th percentile; what lies beyond is counted in the label."""
    end = float(np.percentile(values, 99.0)) or 1e-9
    counts, edges = np.histogram(values, bins=_BINS, range=(0.0, end))
    beyond = int(np.count_nonzero(values > end))
    label = f"{label}   ({beyond} beyond, up to {values.max():.3g})" if beyond else label
    middles = (edges[:-1] + edges[1:]) / 2.0
    curve = Curve("count", "b", counts.astype(np.float64))
    return Chart(title, label, "count", middles, [curve], "bars")


def _error_charts(report: RunReport) -> list[Chart]:
    errors = report.errors
    if errors is None or len(errors.trans_m) < 2:
        return []
    position = [Curve("position", "a", errors.trans_m)]
    heading = [Curve("heading", "b", errors.rot_deg)]
    at_m, label = errors.at_m, "travelled [m]"
    return [
        Chart("Position error over time", "time [s]", "error [m]", errors.at_s, position),
        Chart("Position error over distance", label, "error [m]", at_m, position),
        Chart("Heading error over distance", label, "error [°]", at_m, heading),
    ]


def _sigma_charts(report: RunReport) -> list[Chart]:
    if report.sigmas is None:
        return []
    at, label, made = report.sigmas.at_m, "travelled [m]", []
    for k, (axis, unit, scale) in enumerate(
        (("x", "m", 1.0), ("y", "m", 1.0), ("θ", "°", 180 / math.pi))
    ):
        error = Curve("error", "a", np.abs(report.sigmas.errors[:, k]) * scale)
        sigma = Curve("2 sigma claimed", "b", 2.0 * report.sigmas.sigmas[:, k] * scale)
        title = f"Error and claimed sigma, {axis} of the base"
        made.append(Chart(title, label, f"|error in {axis}| [{unit}]", at, [error, sigma]))
    band = [
        Curve(f"{share:.1%} of honest ones", "c", np.full(len(at), chi2.ppf(share, 3)))
        for share in (0.025, 0.975)
    ]
    nees = Curve("NEES", "a", report.sigmas.nees)
    made.append(Chart("NEES with chi-square band", label, "NEES", at, [nees, *band]))
    return made


def _keyframe_charts(report: RunReport) -> list[Chart]:
    decisions = report.run.records.decisions
    if len(decisions) < 2:
        return []
    travelled = np.cumsum([d.travelled_m for d in decisions])
    columns = np.array([(d.travelled_m, d.interval_m, d.t_pe) for d in decisions])
    columns[0, :2] = math.nan  # before the first there is no interval
    unit = report.run.records.config.get("keyframes", {}).get("unit", "metres")
    if unit == "scans":
        columns[1:, 0] = np.diff([d.scan_index for d in decisions])
    taken = Curve("taken" if unit == "scans" else "travelled", "a", columns[:, 0])
    chosen = Curve("chosen", "b", columns[:, 1])
    label = "interval [m]" if unit == "metres" else f"interval [{unit}]"
    x_label = "travelled [m]"
    made = [Chart("Keyframe interval along the path", x_label, label, travelled, [taken, chosen])]
    if np.isfinite(columns[:, 2]).any():
        complexity = [Curve("T_PE", "c", columns[:, 2])]
        made.append(Chart("T_PE along the path", x_label, "T_PE", travelled, complexity))
    causes = np.array([d.reason + (f", {d.axis}" if d.axis else "") for d in decisions])
    rows = [
        Curve(cause, "b", np.where(causes == cause, float(k), math.nan))
        for k, cause in enumerate(sorted(set(causes[1:].tolist())))
    ]
    title = "Why keyframes were taken, and the deciding axis"
    return [*made, Chart(title, x_label, "", travelled, rows, "events")]
