"""`slam bench NAME`: measure, print a table, write NAME.json."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from slam.mapping.config import SlamConfig
from slam.runs.config_file import nearest
from slam.runs.errors import RunError
from slam.runs.run_directory import version

Say = Callable[[str], None]

IN_A_FILE = 160  # columns of a table that no terminal shows

SPREAD = ("benchmark", "pareto")
"""Benchmarks that can use worker processes."""

# What the table shows of each row; the file holds all.
COLUMNS: Mapping[str, Mapping[str, str]] = {
    "benchmark": {
        "log": "log", "trans_mean_m": "mean m", "trans_std_m": "+- m", "trans_max_m": "worst m",
        "rot_mean_deg": "deg",
        "published_trans_mean_m": "published m", "keyframes": "keyframes", "matches": "matches",
        "closures": "closures", "wall_s": "s", "cpu_s": "CPU s", "realtime_factor": "x real",
        "peak_rss_mb": "MB",
    },
    "buildings": {
        "building": "building", "fault": "fault", "seeds": "seeds", "ate_m_median": "ATE m",
        "ate_m_max": "worst m", "ate_ratio_median": "x without", "closures": "closures",
        "precision": "precision", "recall": "recall", "runs_named": "named",
        "other_named": "other named",
    },
    "batch": {
        "workers": "workers", "tasks": "tasks", "wall_s": "s", "speedup": "speed-up",
        "busy_share": "replaying", "overhead_s_per_task": "s a task beyond its replay",
        "identical": "identical",
    },
    "log": {
        "case": "laser", "write_per_s": "put/s", "write_x_realtime": "x real",
        "read_per_s": "read/s", "mb_per_hour": "MB/h", "mb_per_hour_closed": "closed",
        "read_rss_mb": "RSS MB", "sync_ms_median": "sync ms", "sync_ms_p99": "p99",
    },
    "growth": {
        "keyframes": "keyframes", "closures": "closures", "way_m": "way m",
        "step_ms_p50": "step ms p50", "step_ms_p99": "p99", "step_ms_max": "most",
        "optimising_ms_p99": "ISAM2 p99", "closing_ms_p99": "loops p99",
        "matching_ms_p99": "match p99", "rss_mb": "peak MB",
    },
    "pareto": {
        "world": "world", "method": "method", "setting": "setting",
        "matches_median": "matches", "ate_m_median": "ATE m",
        "cpu_ms_median": "cpu ms",
    },
    "outliers": {
        "graph": "graph", "share": "false per true loop", "false_loops": "false",
        "ate_to_clean_m": "ATE to clean m", "extent_m": "extent m", "precision": "precision",
        "recall": "recall", "wall_s": "s",
    },
    "online": {
        "duration_s": "s", "scans": "scans", "latency_ms_p50": "latency ms p50",
        "latency_ms_p99": "p99", "latency_ms_max": "max", "searching_scans": "while searching",
        "searching_ms_p99": "p99", "cpu_share": "of a core", "peak_rss_mb": "MB", "lost": "lost",
    },
    "memory": {
        "run": "run", "minutes": "minutes", "keyframes": "keyframes",
        "rss_mb_first": "MB first", "rss_mb_last": "MB last",
        "growth_mb_per_hour": "MB an hour", "pruned": "pruned",
    },
    "view": {
        "log": "log", "watched_by": "watched by", "cpu_s": "pipeline's CPU s", "wall_s": "s",
        "look_us": "us a step for it", "frames": "frames", "identical": "same run",
    },
    "online-faults": {
        "faults": "faults", "runs": "runs", "outages": "outages", "scans_lost": "scans lost",
        "worst_ratio": "worst error ratio", "worst_stamp_ms": "stamps off by ms", "wrong": "wrong",
    },
}  # fmt: skip


def run_bench(name: str, out: Path, data: Path, quick: bool, say: Say, workers: int = 0) -> None:
    """Run one benchmark by name, print it and write `out`/NAME.json.

    With workers, benchmarks that can are spread over so many processes.

    Raises:
        RunError: no such benchmark, its data is missing, or the output cannot be written.
    """
    if workers and name not in SPREAD:
        raise RunError(f"{name} is not spread over workers: leave --workers out")
    result = _measure(name, out, data, quick, say, workers)
    result["meta"] = {
        "version": version(),
        "config_sha256": SlamConfig().sha256(),
        "python": platform.python_version(),
        "quick": quick,
        **result["meta"],
    }
    if name in COLUMNS:
        console = Console()
        if not console.is_terminal:  # nothing to fit into: a file holds whole rows
            console.width = IN_A_FILE
        console.print(table(name, result["rows"]))
    target = out / f"{name}.json"
    try:
        out.mkdir(parents=True, exist_ok=True)
        target.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise RunError(f"{target}: cannot be written: {error.strerror}") from error
    say(f"figures: {target}")


def _measure(
    name: str, out: Path, data: Path, quick: bool, say: Say, workers: int
) -> dict[str, Any]:
    """Each benchmark is imported only when asked for: some need optional packages."""
    if name == "benchmark":
        from benchmarks.benchmark import bench_benchmark

        return bench_benchmark(data, quick, say, workers)
    if name == "buildings":
        from benchmarks.buildings import bench_buildings

        return bench_buildings(out, quick, say)
    if name == "growth":
        from benchmarks.growth import bench_growth

        return bench_growth(quick, say)
    if name == "matcher":
        from benchmarks.matcher.matcher import bench_matcher

        return bench_matcher(data, quick, say)
    if name == "outliers":
        from benchmarks.outliers import bench_outliers

        return bench_outliers(data, quick, say)
    if name == "online":
        from benchmarks.online import bench_online

        return bench_online(quick, say)
    if name == "memory":
        from benchmarks.memory import bench_memory

        return bench_memory(quick, say)
    if name == "view":
        from benchmarks.view import bench_view

        return bench_view(data, quick, say)
    if name == "online-faults":
        from benchmarks.faults.online_faults import bench_online_faults

        return bench_online_faults(out, quick, say)
    if name == "batch":
        from benchmarks.batch import bench_batch

        return bench_batch(quick, say)
    if name == "log":
        from benchmarks.log import bench_log

        return bench_log(quick, out)
    if name == "paper":
        from benchmarks.paper.paper import bench_paper

        return bench_paper(out, quick, say)
    if name == "weights":
        from benchmarks.paper.weights import bench_weights

        return bench_weights(quick, say)
    if name == "pareto":
        from benchmarks.keyframe_interval.pareto import bench_pareto

        return bench_pareto(out, data, quick, say, workers)
    known = (
        "benchmark", "batch", "buildings", "growth", "matcher", "memory", "outliers",
        "online", "online-faults", "log", "paper", "pareto", "view", "weights",
    )  # fmt: skip
    raise RunError(f"no benchmark is named {name!r}{nearest(name, known)}: {', '.join(known)}")


def table(name: str, rows: list[dict[str, Any]]) -> Table:
    """The chosen columns of a benchmark's rows."""
    shown = Table(title=name)
    for k, heading in enumerate(COLUMNS[name].values()):
        shown.add_column(heading, justify="right" if k else "left", overflow="fold")
    for row in rows:
        shown.add_row(*(_cell(row[column]) for column in COLUMNS[name]))
    return shown


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
