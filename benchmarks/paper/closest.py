"""The paper's Figure 7 at the reading that comes closest, and what changes when it is left.

The paper measures neither its test bed nor its rule of pairing.  Of all that `study` tries, its
figures come out best in a bed that is closed two metres past the end point, with narrow and deep
boards, and with pairs that are one to one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from slam.drivers.simulators.paper_bed import BedConfig
from slam.frontend.match_types import MatchConfig

from benchmarks.paper.drives import (
    CONSTANT,
    PAPER_ERRORS_CM,
    Drive,
    Reading,
    Step,
    chosen,
    evenly,
    every,
    follow,
    matched,
    paper_bed_drive,
    sdp_pe,
)
from benchmarks.paper.spread import median_ci95
from benchmarks.paper.study import RULES, by_rules

Array = NDArray[np.float64]
Rows = Sequence[Mapping[str, Any]]

READING: Reading = "180cm"
INTERVALS = (*map(str, CONSTANT), "sdp-pe", "even")
NARROW_DEEP = BedConfig(board_min=0.1, board_max=0.3, depth_max=0.5)
CLOSED, OPEN, LONG = "closed 2.1 m past the end", "left open there", "25 m of plain wall ahead"
BEDS: Mapping[str, BedConfig] = MappingProxyType(
    {
        CLOSED: replace(NARROW_DEEP, ahead=3.95),
        OPEN: replace(NARROW_DEEP, ahead=3.95, end_wall=False),
        LONG: NARROW_DEEP,
    }
)
MATCHERS: Mapping[str, Callable[[Drive], Step]] = MappingProxyType(
    {
        "point-to-point, one to one": lambda drive: by_rules(drive, RULES["one to one"]),
        "point-to-line": lambda drive: matched(drive, MatchConfig(), False),
    }
)
COLOURS = {CLOSED: "tab:blue", OPEN: "tab:orange", LONG: "tab:red"}


def closest(seeds: int, stretch_for: Callable[[Reading, BedConfig], float]) -> list[dict[str, Any]]:
    """A row for each bed and matcher, the reading closest to the paper first."""
    console = Console(stderr=True)
    errors: dict[tuple[str, str], list[list[float]]] = {
        (bed, matcher): [] for bed in BEDS for matcher in MATCHERS
    }
    counts: dict[str, list[int]] = {bed: [] for bed in BEDS}
    stretches = {bed: stretch_for(READING, config) for bed, config in BEDS.items()}
    for seed in track(
        range(seeds), "closest", console=console, transient=True, disable=not console.is_terminal
    ):
        for bed, config in BEDS.items():
            drive = paper_bed_drive(READING, seed, config)
            own = chosen(drive, sdp_pe(stretches[bed]))
            ways = [*(every(k) for k in CONSTANT), own, evenly(len(own))]
            counts[bed].append(len(own))
            for name, matcher in MATCHERS.items():
                step = matcher(drive)
                errors[bed, name].append([follow(drive, used, step).error_m for used in ways])
    return [
        _row(bed, matcher, 100.0 * np.array(table), float(np.median(counts[bed])))
        for (bed, matcher), table in errors.items()
    ]


def _row(bed: str, matcher: str, errors_cm: Array, scans: float) -> dict[str, Any]:
    """Medians of (seeds, intervals) errors with their bootstrapped 95 % intervals, in cm."""
    return {
        "bed": bed,
        "matcher": matcher,
        "seeds": len(errors_cm),
        "sdp_pe_scans": scans,
        "errors_cm": np.median(errors_cm, axis=0).tolist(),
        "errors_cm_ci95": [median_ci95(column) for column in errors_cm.T],
        "sdp_pe_minus_even_cm_ci95": median_ci95(errors_cm[:, -2] - errors_cm[:, -1]),
        "sdp_pe_minus_20_cm_ci95": median_ci95(errors_cm[:, -2] - errors_cm[:, -3]),
    }


def closest_lines(rows: Rows) -> list[str]:
    """The rows as a table in Markdown."""
    head = ["bed", "matcher", *INTERVALS, "sdp-pe minus even", "sdp-pe minus 20"]
    paper = [f"{error}" for error in PAPER_ERRORS_CM]
    lines = [
        "Median final error in cm and its 95 % interval, without odometry, over "
        f"{rows[0]['seeds']} beds:",
        "",
        "| " + " | ".join(head) + " |",
        "|---" * len(head) + "|",
        "| the paper | | " + " | ".join(paper) + " | | | |",
    ]
    for row in rows:
        cells = [
            f"{middle:.1f} ({low:.1f} to {high:.1f})"
            for middle, (low, high) in zip(row["errors_cm"], row["errors_cm_ci95"], strict=True)
        ]
        cells += [
            "{:+.1f} to {:+.1f}".format(*row[key])
            for key in ("sdp_pe_minus_even_cm_ci95", "sdp_pe_minus_20_cm_ci95")
        ]
        lines.append(f"| {row['bed']} | {row['matcher']} | " + " | ".join(cells) + " |")
    return lines


def draw_closest(rows: Rows, path: Path) -> None:
    """Figure 7 (a) redrawn: final error over the interval, a colour a bed, a mark a matcher."""
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    axes = figure.add_subplot()
    at = np.arange(len(INTERVALS))
    marks = dict(zip(MATCHERS, "os", strict=True))
    for k, row in enumerate(rows):
        middle = np.array(row["errors_cm"])
        low, high = np.array(row["errors_cm_ci95"]).T
        axes.errorbar(
            at + 0.08 * (k - 0.5 * (len(rows) - 1)), middle, [middle - low, high - middle],
            fmt=marks[row["matcher"]], ms=4, lw=1, capsize=2, color=COLOURS[row["bed"]],
            mfc=COLOURS[row["bed"]] if row["matcher"] == next(iter(MATCHERS)) else "white",
            label=f"{row['bed']}; {row['matcher']}",
        )  # fmt: skip
    axes.plot(at[: len(PAPER_ERRORS_CM)], PAPER_ERRORS_CM, "kD", ms=6, label="the paper")
    axes.set_yscale("log")
    axes.set_xticks(at, ["1", "5", "10", "15", "20", "SDP-PE", "even"])
    axes.set_xlabel("matched scans: every n-th, or chosen")
    axes.set_ylabel("final position error [cm]")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    axes.set_title(f"Figure 7 redone: median and 95 % interval over {rows[0]['seeds']} beds")
    figure.savefig(path, dpi=120)
