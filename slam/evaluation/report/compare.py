"""Several runs side by side: each, and the mean of those that differ by their log alone."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from slam.evaluation.report.read_run import Run

# Columns of the comparison: heading, path into the figures, decimals
COLUMNS: tuple[tuple[str, str, int], ...] = (
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
    ("wall thickness [m]", "consistency.wall_thickness_median_m", 4),
    ("matching [s]", "timing.stages_s.matching", 2),
    ("wall clock [s]", "timing.wall_s", 2),
    ("\N{MULTIPLICATION SIGN} real time", "timing.realtime_factor", 1),
)

# What the bars of a comparison show, of the first kind of error that is known: title, path, unit.
_ERRORS = (
    ("Final pose error", "final_pose_error_m", "m"),
    ("Mean error of relations", "relations.trans_mean_m", "m"),
    ("ATE", "ate_rmse_m", "m"),
)
_COSTS = (
    ("Time spent on matching", "timing.stages_s.matching", "s"),
    ("Matches", "matches", ""),
)


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean and half the width of Student's 95 % interval; nan of one value."""

    n: int
    mean: float
    half: float


@dataclass(frozen=True, eq=False)
class Group:
    """Runs of equal settings: seeds, or logs, of one method."""

    label: str
    members: tuple[int, ...]  # which of the runs
    values: Mapping[str, Interval]  # by path into the figures, where known


def group_runs(runs: Sequence[Run], figures: Sequence[Mapping[str, Any]]) -> tuple[Group, ...]:
    """Put runs of equal settings together, in the order of their first.

    Runs whose settings are unknown stay alone.  A group of several is named after the settings
    that tell it from the others, one run after itself.
    """
    members: dict[str, list[int]] = {}
    for k, run in enumerate(runs):
        known = json.dumps(run.records.config, sort_keys=True) if run.records.config else f"run {k}"
        members.setdefault(known, []).append(k)
    settings = [_flat(runs[rows[0]].records.config) for rows in members.values()]
    return tuple(
        Group(
            _label(own, settings) if len(rows) > 1 else runs[rows[0]].name,
            tuple(rows),
            {
                key: mean_interval(values)
                for _, key, _ in COLUMNS
                if (values := [v for k in rows if (v := lookup(figures[k], key)) is not None])
            },
        )
        for rows, own in zip(members.values(), settings, strict=True)
    )


def lookup(figures: Mapping[str, Any], key: str) -> float | None:
    """Return a figure by its path, None where there is no number."""
    value: Any = figures
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    known = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if known and math.isfinite(value) else None


def mean_interval(values: Sequence[float]) -> Interval:
    """Return the mean of at least one value, with its 95 % interval."""
    known = np.asarray(values, dtype=np.float64)
    n = len(known)
    if n < 2:
        return Interval(n, float(known[0]), math.nan)
    half = student_t.ppf(0.975, n - 1) * known.std(ddof=1) / math.sqrt(n)
    return Interval(n, float(known.mean()), float(half))


def bars(groups: Sequence[Group]) -> list[dict[str, Any]]:
    """Return bars of error and cost, as in the paper's Figure 7, with 95 % intervals.

    Lengths are in percent of the longest; `low` and `high` are None where no interval is known.
    """
    known = [e for e in _ERRORS if any(e[1] in g.values for g in groups)][:1]
    made = []
    for title, key, unit in (*known, *_COSTS):
        rows = [(g.label, g.values[key]) for g in groups if key in g.values]
        reach = [i.mean + (i.half if i.n > 1 else 0.0) for _, i in rows]
        if not rows or max(reach) <= 0.0:
            continue
        scale = 100.0 / max(reach)
        drawn = [
            {
                "label": label,
                "interval": i,
                "width": i.mean * scale,
                "low": max(i.mean - i.half, 0.0) * scale if i.n > 1 else None,
                "high": (i.mean + i.half) * scale if i.n > 1 else None,
            }
            for label, i in rows
        ]
        made.append({"title": title, "unit": unit, "rows": drawn})
    return made


def groups_json(groups: Sequence[Group], runs: Sequence[Run]) -> list[dict[str, Any]]:
    """The groups as `report.json` has them."""
    return [
        {
            "label": group.label,
            "runs": [runs[k].name for k in group.members],
            "means": {
                key: {"n": i.n, "mean": i.mean, "half95": i.half if i.n > 1 else None}
                for key, i in group.values.items()
            },
        }
        for group in groups
    ]


def _flat(config: Mapping[str, Any], prefix: str = "") -> dict[str, str]:
    found: dict[str, str] = {}
    for name, value in config.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{name}.")
        else:
            found[prefix + name] = str(value)
    return found


def _label(own: Mapping[str, str], all_settings: Sequence[Mapping[str, str]]) -> str:
    known = [settings for settings in all_settings if settings]
    differing = [name for name in own if len({s.get(name) for s in known}) > 1]
    if not differing:
        return "all runs"
    return ", ".join(f"{name.rpartition('.')[2]} {own[name]}" for name in differing)
