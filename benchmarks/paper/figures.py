"""Figures 6 and 7 of the paper, redrawn from the repeated experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import NDArray
from slam.frontend.match_types import MatchConfig
from slam.frontend.scan import VALID

from benchmarks.paper.drives import (
    CONSTANT,
    INTERVALS,
    PAPER_COUNTS,
    PAPER_ERRORS_CM,
    PAPER_SECONDS,
    READINGS,
    Drive,
    Outcome,
    chosen,
    every,
    follow,
    matched,
    paper_bed_drive,
    sdp_pe,
)
from benchmarks.paper.study import BEDS, RULES, by_rules

Rows = Sequence[Mapping[str, Any]]

COLOURS = {
    "point_to_point": "tab:red",
    "point_to_line": "tab:blue",
    "ndt": "tab:green",
    "psm": "tab:purple",
}


def draw_figures(rows: Rows, studied: Rows, stretch: float, out: Path) -> None:
    """Write paper-fig6.png and a paper-fig7-READING.png for each reading."""
    draw_maps(studied[0], stretch, out / "paper-fig6.png")
    for reading in READINGS:
        draw_comparison(
            [row for row in rows if row["reading"] == reading],
            reading,
            out / f"paper-fig7-{reading}.png",
        )


def draw_comparison(rows: Rows, reading: str, path: Path) -> None:
    """Final error, time and number of scans of each method, beside the paper's."""
    figure = Figure(figsize=(13, 9), layout="constrained")
    errors, counts, times = figure.subplot_mosaic(
        [["errors", "errors"], ["counts", "times"]], height_ratios=[1.4, 1.0]
    ).values()  # fmt: skip
    at = {name: k for k, name in enumerate(INTERVALS)}
    lines = list(COLOURS)
    for row in rows:
        shift = 0.09 * (lines.index(row["matcher"]) - 1.5) + 0.045 * row["odometry"]
        place, colour = at[row["interval"]] + shift, COLOURS[row["matcher"]]
        _bar(errors, place, row, colour)
        filled = colour if row["odometry"] else "white"
        times.plot(place, row["match_ms_median"], "o", color=colour, mfc=filled, ms=4)
    for name in INTERVALS:
        count = next(row["scans_used_median"] for row in rows if row["interval"] == name)
        counts.bar(at[name], count, color="0.7")
    paper = [*range(len(CONSTANT)), at["sdp-pe"]]
    for axes, values in (
        (errors, PAPER_ERRORS_CM), (counts, PAPER_COUNTS), (times, 1e3 * np.array(PAPER_SECONDS)),
    ):  # fmt: skip
        axes.plot(paper, values, "kD", ms=6, label="the paper")
        axes.set_yscale("log")
        axes.set_xticks(
            range(len(INTERVALS)),
            [
                name.replace("-shipped", "\nshipped").replace("information", "infor-\nmation")
                for name in INTERVALS
            ],
        )
        axes.tick_params(axis="x", labelsize=9 if axes is errors else 7)
        axes.grid(axis="y", alpha=0.3)
    for name, colour in COLOURS.items():
        for filled, word in (("white", ""), (colour, ", odometry")):
            errors.plot([], [], "o", color=colour, mfc=filled, label=name.replace("_", "-") + word)
    errors.legend(ncols=3, fontsize=8)
    errors.set_ylabel("final position error [cm]")
    counts.set_ylabel("scans used")
    times.set_ylabel("matching, whole drive [ms]")
    seeds = rows[0]["seeds"]
    figure.suptitle(f"Figure 7, reading {reading}: median and 95 % interval over {seeds} beds")
    figure.savefig(path, dpi=110)


def _bar(axes: Axes, place: float, row: Mapping[str, Any], colour: str) -> None:
    middle = row["final_error_cm_median"]
    low, high = row["final_error_cm_ci95"]
    axes.errorbar(
        place, middle, [[middle - low], [high - middle]], fmt="o", ms=4, color=colour,
        mfc=colour if row["odometry"] else "white", lw=1, capsize=2,
    )  # fmt: skip


def draw_maps(nearest: Mapping[str, Any], stretch: float, path: Path) -> None:
    """Maps and poses of one bed; `nearest` is the row of the study most like the paper.

    `stretch` is that of SDP-PE's intervals on the usual bed.
    """
    usual, other = paper_bed_drive("180cm", 0), paper_bed_drive("180cm", 0, BEDS[nearest["bed"]])
    plain, ours = MatchConfig(method="point_to_point"), MatchConfig()
    bed = next(iter(BEDS))
    rules = by_rules(other, RULES[nearest["rules"]])
    cases = [
        (f"point-to-point: {bed}", usual, matched(usual, plain, False), stretch),
        (f"point-to-point: {nearest['bed']}; {nearest['rules']}", other, rules, nearest["stretch"]),
        (f"point-to-line: {bed}", usual, matched(usual, ours, False), stretch),
    ]
    figure = Figure(
        figsize=(14, 12), layout=ConstrainedLayoutEngine(hspace=0.09, rect=(0, 0, 1, 0.965))
    )
    for line, (title, drive, step, factor) in enumerate(cases):
        ways = {f"interval {k}": every(k) for k in CONSTANT}
        ways["SDP-PE"] = chosen(drive, sdp_pe(factor))
        for column, (name, used) in enumerate(ways.items()):
            axes = figure.add_subplot(len(cases), len(ways), line * len(ways) + column + 1)
            _map(axes, drive, follow(drive, used, step))
            axes.set_title(f"{name}: {len(used)} scans", fontsize=9, loc="left")
            if column == 0:
                heading = axes.text(0.0, 1.11, title, transform=axes.transAxes, fontsize=10)
                heading.set_in_layout(False)
    figure.savefig(path, dpi=100)


def _map(axes: Axes, drive: Drive, outcome: Outcome) -> None:
    """As the paper draws it: the way up, the map green, the poses red."""
    for pose, k in zip(outcome.poses, outcome.used, strict=True):
        points = _placed(drive, k, pose)
        axes.plot(-100 * points[:, 1], 100 * points[:, 0], ",", color="tab:green")
    axes.plot(-100 * outcome.poses[:, 1], 100 * outcome.poses[:, 0], "r.", ms=3)
    end = drive.truth[outcome.used[-1]]
    axes.plot(-100 * end.y(), 100 * end.x(), "k+", ms=10)
    axes.set_xlabel(f"error {100 * outcome.error_m:.1f} cm", fontsize=9)
    axes.set_aspect("equal")
    axes.set_xlim(-150, 150)
    axes.set_ylim(-50, 450)
    axes.tick_params(labelsize=7)


def _placed(drive: Drive, k: int, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    scan = drive.scans[k]
    points = scan.points[(scan.flags & VALID) > 0]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    placed: NDArray[np.float64] = points @ np.array([[c, s], [-s, c]]) + pose[:2]
    return placed
