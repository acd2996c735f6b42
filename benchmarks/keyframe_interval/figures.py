"""The figure of the interval benchmark: error against matches, and against processor time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

Rows = Sequence[Mapping[str, Any]]

STYLES = {  # method: colour, marker
    "constant": ("0.45", "o"),
    "gate": ("tab:olive", "v"),
    "overlap": ("tab:green", "^"),
    "sdp-pe": ("tab:blue", "s"),
    "information": ("tab:red", "D"),
    "information-permuted": ("tab:pink", "X"),
}
SCALES = (("matches_median", "matches"), ("cpu_ms_median", "processor time [ms]"))


def draw_pareto(rows: Rows, path: Path) -> None:
    """A column for each world; medians over the seeds with their 95 % intervals."""
    worlds = list(dict.fromkeys(row["world"] for row in rows))
    figure = Figure(figsize=(4.2 * len(worlds), 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(SCALES), len(worlds), squeeze=False)
    for across, world in enumerate(worlds):
        chosen = [row for row in rows if row["world"] == world]
        for down, (key, label) in enumerate(SCALES):
            axes = grid[down][across]
            _draw(axes, chosen, key)
            axes.set(xscale="log", yscale="log", xlabel=label, title="" if down else world)
            _tick(axes)
        grid[0][across].sharey(grid[1][across])
    for down in range(len(SCALES)):
        grid[down][0].set_ylabel("ATE [cm]")
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    figure.savefig(path, dpi=80)


def _draw(axes: Axes, rows: Rows, key: str) -> None:
    for method, (colour, marker) in STYLES.items():
        chosen = [row for row in rows if row["method"] == method]
        x = [row[key] for row in chosen]
        y = [100.0 * row["ate_m_median"] for row in chosen]
        below = [100.0 * (row["ate_m_median"] - row["ate_m_ci95"][0]) for row in chosen]
        above = [100.0 * (row["ate_m_ci95"][1] - row["ate_m_median"]) for row in chosen]
        axes.errorbar(
            x, y, yerr=[below, above], color=colour, marker=marker, markersize=6, capsize=2,
            linewidth=0.8, linestyle="-" if method == "constant" else "", label=method,
        )  # fmt: skip
    axes.grid(True, which="both", alpha=0.25)


def _tick(axes: Axes) -> None:
    """Plain numbers at 1, 2 and 5: most panels span less than a decade."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
