"""The comparison report of a batch: settings against each other, then every row.

It holds no times, so that it is the same for any number of workers; the table has them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.stats import t as student_t

from slam.evaluation.report.page import format_number, page_template
from slam.experiments.batch.grid import Grid
from slam.experiments.batch.table import Row, is_time
from slam.runs.run_directory import version

ERRORS = ("relations_trans_mean_m", "ate_rmse_m")
"""What settings are compared by: of each log the first that its truth gives."""

_SHOWN: tuple[tuple[str, str, int], ...] = (  # heading, column, decimals
    ("matches", "matches", 0),
    ("keyframes", "keyframes", 0),
    ("loops", "loops_accepted", 0),
    ("relations mean [m]", "relations_trans_mean_m", 4),
    ("ATE rmse [m]", "ate_rmse_m", 4),
    ("final pose [m]", "final_pose_error_m", 4),
    ("lost messages", "lost", 0),
)


def compare(rows: Sequence[Row], grid: Grid) -> list[dict[str, Any]]:
    """Figures of each combination over all logs, and its errors relative to the first's."""
    groups = [_of_point(rows, grid, k) for k in range(len(grid.points))]
    found = []
    for point, group in zip(grid.points, groups, strict=True):
        done = [row for row in group if row["status"] == "ok"]
        errors = [e for row in done if (e := error_of(row)) is not None]
        matches = [row["matches"] for row in done]
        found.append(
            {
                "setting": grid.label(point),
                "logs": len(group),
                "failed": len(group) - len(done),
                "error_median_m": float(np.median(errors)) if errors else None,
                "error_max_m": max(errors, default=None),
                "matches_median": float(np.median(matches)) if matches else None,
                **_relative(group, groups[0]),
            }
        )
    return found


def error_of(row: Row) -> float | None:
    """The error that a row is compared by, in m; None if it failed or has no truth."""
    return next((row[name] for name in ERRORS if row[name] is not None), None)


def comparison_json(rows: Sequence[Row], grid: Grid) -> str:
    """`report.json`."""
    document = {
        "version": version(),
        "settings": compare(rows, grid),
        "rows": [{k: v for k, v in row.items() if not is_time(k)} for row in rows],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def comparison_html(rows: Sequence[Row], grid: Grid) -> str:
    """`report.html`: one page that needs nothing else."""
    labels = [grid.label(point) for point in grid.points]
    labelled = [(labels[k % len(labels)], row) for k, row in enumerate(rows)]
    shown = [column for column in _SHOWN if any(row[column[1]] for row in rows)]
    return page_template("batch.html.j2").render(
        scripts=(),
        styles=("page.css",),
        version=version(),
        logs=len(rows) // len(labels),
        settings=compare(rows, grid),
        failures=[(label, row) for label, row in labelled if row["status"] != "ok"],
        columns=shown,
        rows=[(label, row) for label, row in labelled if row["status"] == "ok"],
    )


def lines(rows: Sequence[Row], grid: Grid) -> Iterator[str]:
    """The comparison for a terminal."""
    for entry in compare(rows, grid):
        error = entry["error_median_m"]
        yield (
            f"{entry['setting']}: {entry['logs'] - entry['failed']} of {entry['logs']} logs, "
            f"median error {format_number(error, 4)} m, "
            f"median matches {format_number(entry['matches_median'], 0)}"
        )


def _of_point(rows: Sequence[Row], grid: Grid, k: int) -> list[Row]:
    """Rows of the kth combination; they come log by log."""
    return list(rows[k :: len(grid.points)])


def _relative(group: Sequence[Row], first: Sequence[Row]) -> dict[str, Any]:
    """Geometric mean of the errors' ratios to the first combination's, log by log.

    With it the 95 % interval of Student's t on the logarithms, and the logs it is smaller on.
    """
    pairs = [(error_of(a), error_of(b)) for a, b in zip(group, first, strict=True)]
    ratios = np.log([a / b for a, b in pairs if a and b])
    names = ("error_ratio", "error_ratio_low", "error_ratio_high")
    n = len(ratios)
    if n == 0:
        return dict.fromkeys(names) | {"compared": 0, "better": 0}
    mean = float(ratios.mean())
    spread = float(ratios.std(ddof=1)) / math.sqrt(n) if n > 1 else math.nan
    half = float(student_t.ppf(0.975, n - 1)) * spread if n > 1 else None
    band = (None, None) if half is None else (math.exp(mean - half), math.exp(mean + half))
    return {
        **dict(zip(names, (math.exp(mean), *band), strict=True)),
        "compared": n,
        "better": int(np.count_nonzero(ratios < 0)),
    }
