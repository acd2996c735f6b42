"""`slam bench NAME`: measure, print a table, write NAME.json."""

from __future__ import annotations

import importlib
import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from slam.logs.atomic_write import atomic_write

from slam.mapping.config import SlamConfig
from slam.runs.config_file import nearest
from slam.runs.errors import RunError
from slam.runs.run_directory import version

Echo = Callable[[str], None]

IN_A_FILE = 160  # characters in a line of a table that no terminal shows


@dataclass(frozen=True, slots=True)
class Benchmark:
    """What one benchmark is, and what it can be told."""

    about: str
    function: str  # `module:name`; imported only when asked for: some need optional packages
    takes: str  # names of the arguments of the function, of: out, data, quick, echo, workers
    columns: Mapping[str, str] = field(default_factory=dict)  # of the table: row key -> heading
    data: str = ""  # what the folder of `--data` must hold; empty where it can do without

    @property
    def spreads(self) -> bool:
        """Whether it can use worker processes."""
        return "workers" in self.takes.split()


BENCHMARKS: Mapping[str, Benchmark] = {
    "altered-logs": Benchmark(
        "real logs, altered: stale or missing odometry, scale, cut ranges and more",
        "benchmarks.altered_logs:bench_altered_logs", "out data quick echo",
        {
            "log": "log", "alteration": "alteration", "error_m": "error m",
            "unaltered_m": "unaltered", "ratio": "ratio", "raw_m": "odometry alone",
            "odometry_refused": "odometry refused",
        },
        data="`benchmark/` with NAME.clf.gz and NAME.relations, `keyframes/` with NAME.ref.tum",
    ),
    "batch": Benchmark(
        "how batches scale with workers",
        "benchmarks.batch:bench_batch", "quick echo",
        {
            "workers": "workers", "tasks": "tasks", "wall_s": "s", "speedup": "speed-up",
            "busy_share": "replaying", "overhead_s_per_task": "s per task beyond replay",
            "identical": "identical",
        },
    ),
    "benchmark": Benchmark(
        "public logs against published errors",
        "benchmarks.benchmark:bench_benchmark", "data quick echo workers",
        {
            "log": "log", "trans_mean_m": "mean m", "trans_std_m": "+- m",
            "trans_max_m": "worst m", "rot_mean_deg": "deg",
            "published_trans_mean_m": "published m", "keyframes": "keyframes",
            "matches": "matches", "closures": "closures", "wall_s": "s", "cpu_s": "CPU s",
            "realtime_factor": "x real", "peak_rss_mb": "MB",
        },
        data="`benchmark/` with NAME.clf.gz and NAME.relations of each log",
    ),
    "buildings": Benchmark(
        "simulated buildings with loops and odometry faults",
        "benchmarks.buildings:bench_buildings", "out quick echo",
        {
            "building": "building", "fault": "fault", "seeds": "seeds", "ate_m_median": "ATE m",
            "ate_m_max": "worst m", "ate_ratio_median": "x without", "closures": "closures",
            "precision": "precision", "recall": "recall", "runs_named": "named",
            "other_named": "other named",
        },
    ),
    "calibration": Benchmark(
        "simulated robots of known sizes, calibrated from a drive of three minutes each",
        "benchmarks.calibration:bench_calibration", "quick echo workers",
        {
            "case": "case", "unknown": "unknown", "truth": "truth", "drives": "drives",
            "refused": "refused", "rms_error": "rms error", "sigma": "sigma",
            "sigma_max": "largest", "within": "within 3 sigma",
        },
    ),
    "calibration-logs": Benchmark(
        "real logs: what they say of the robot, and whether their halves agree",
        "benchmarks.calibration_logs:bench_calibration_logs", "data quick echo",
        {
            "log": "log", "unknown": "unknown", "value": "value", "sigma": "sigma",
            "apart": "halves apart, sigmas", "refused": "refused",
        },
        data="`benchmark/` with NAME.clf.gz and NAME.relations of each log",
    ),
    "evidence": Benchmark(
        "pieces of a scan that fit a map at right poses and at wrong ones, simulated",
        "benchmarks.localise.evidence:bench_evidence", "quick echo",
        {
            "building": "building", "moved": "moved", "pose": "pose", "poses": "poses",
            "fitting": "fitting", "new": "new", "contradicting": "contradicting",
            "nats_p5": "nats p5", "nats_p50": "p50", "nats_p95": "p95",
        },
    ),
    "growth": Benchmark(
        "time and memory as the graph grows",
        "benchmarks.growth:bench_growth", "quick echo",
        {
            "keyframes": "keyframes", "closures": "closures", "way_m": "path m",
            "step_ms_p50": "step ms p50", "step_ms_p99": "p99", "step_ms_max": "max",
            "optimising_ms_p99": "ISAM2 p99", "closing_ms_p99": "loops p99",
            "matching_ms_p99": "match p99", "rss_mb": "peak MB",
        },
    ),
    "localise": Benchmark(
        "poses in a finished map: tracking, starts from nothing, after a kidnapping",
        "benchmarks.localise.localise:bench_localise", "out data quick echo",
        {
            "log": "map", "scans": "scans", "inside": "inside", "lost_inside": "lost there",
            "median_cm": "median cm", "median_deg": "deg", "wrong_not_lost": "wrong, not lost",
            "starts": "starts", "starts_found": "found", "starts_wrong": "wrong",
            "start_way_m": "after m", "kidnap_noticed_s": "kidnap noticed s",
            "kidnap_found_s": "found s",
        },
    ),
    "log": Benchmark(
        "writing and reading logs",
        "benchmarks.log:bench_log", "quick out",
        {
            "case": "laser", "write_per_s": "put/s", "write_x_realtime": "x real",
            "read_per_s": "read/s", "mb_per_hour": "MB/h", "mb_per_hour_closed": "closed",
            "read_rss_mb": "RSS MB", "sync_ms_median": "sync ms", "sync_ms_p99": "p99",
        },
    ),
    "matcher": Benchmark(
        "time, accuracy, basin and consistency of single matches",
        "benchmarks.matcher.matcher:bench_matcher", "data quick echo",
        data="`benchmark/` with NAME.clf.gz and NAME.relations of intel, mit-csail, mit-killian",
    ),
    "memory": Benchmark(
        "memory over an hour, standing and driving",
        "benchmarks.memory:bench_memory", "quick echo",
        {
            "run": "run", "minutes": "minutes", "keyframes": "keyframes",
            "rss_mb_first": "MB first", "rss_mb_last": "MB last",
            "growth_mb_per_hour": "MB/h", "pruned": "pruned",
        },
    ),
    "online": Benchmark(
        "latency and losses in real time",
        "benchmarks.online:bench_online", "quick echo",
        {
            "duration_s": "s", "scans": "scans", "latency_ms_p50": "latency ms p50",
            "latency_ms_p99": "p99", "latency_ms_max": "max",
            "searching_scans": "while searching", "searching_ms_p99": "p99",
            "cpu_share": "of one core", "peak_rss_mb": "MB", "lost": "lost",
        },
    ),
    "online-faults": Benchmark(
        "faults of wires, devices and wheels",
        "benchmarks.faults.online_faults:bench_online_faults", "out quick echo",
        {
            "faults": "faults", "runs": "runs", "outages": "outages", "scans_lost": "scans lost",
            "worst_ratio": "worst error ratio", "worst_stamp_ms": "stamps off by ms",
            "wrong": "wrong",
        },
    ),
    "outliers": Benchmark(
        "public graphs with false loops mixed in",
        "benchmarks.outliers:bench_outliers", "data quick echo",
        {
            "graph": "graph", "share": "false per true loop", "false_loops": "false",
            "ate_to_clean_m": "ATE to clean m", "extent_m": "extent m", "precision": "precision",
            "recall": "recall", "wall_s": "s",
        },
        data="`graphs/` with NAME.g2o.gz of M3500, intel and ring",
    ),
    "paper": Benchmark(
        "the seed paper's experiment",
        "benchmarks.paper.paper:bench_paper", "out quick echo",
    ),
    "pareto": Benchmark(
        "error against matches for every way to choose keyframes",
        "benchmarks.keyframe_interval.pareto:bench_pareto", "out data quick echo workers",
        {
            "world": "world", "method": "method", "setting": "setting",
            "matches_median": "matches", "ate_m_median": "ATE m", "cpu_ms_median": "cpu ms",
        },
    ),
    "places": Benchmark(
        "recall of places by their shape, same way and reverse",
        "benchmarks.places:bench_places", "data quick echo",
        {
            "log": "log", "places": "places", "same_revisits": "same way",
            "same_among_1": "first", "same_among_50": "among 50",
            "reverse_revisits": "reverse", "reverse_among_1": "first",
            "reverse_among_50": "among 50", "describe_us": "us to describe",
            "query_us": "us a query",
        },
        data="`benchmark/` with NAME.clf.gz, `keyframes/` with NAME.ref.tum",
    ),
    "situations": Benchmark(
        "simulated drives that break maps, with and without their trait",
        "benchmarks.situations:bench_situations", "out quick echo",
        {
            "situation": "situation", "ate_m": "ATE m", "without_m": "without", "raw_m": "odometry",
            "closures": "closures", "false_closures": "false", "odometry_refused": "refused",
            "refused_without": "refused without",
        },
    ),
    "stages": Benchmark(
        "where the processor time of a replay goes",
        "benchmarks.stages:bench_stages", "data quick echo",
        {
            "log": "log", "start_s": "start s", "reading_s": "reading", "matching_s": "matching",
            "closing_s": "closing", "optimising_s": "optimising", "localising_s": "localising",
            "map_s": "map", "writing_s": "writing", "rest_s": "rest", "cpu_s": "CPU s",
            "us_per_scan": "us per scan", "ms_per_keyframe": "ms per keyframe", "peak_mb": "MB",
        },
        data="`benchmark/` with NAME.clf.gz and NAME.relations of each log",
    ),
    "view": Benchmark(
        "what watching a run costs",
        "benchmarks.view:bench_view", "data quick echo",
        {
            "log": "log", "watched_by": "watched by", "cpu_s": "pipeline's CPU s", "wall_s": "s",
            "look_us": "us per step", "frames": "frames", "identical": "same run",
        },
    ),
    "weights": Benchmark(
        "the weights of SDP-PE, fitted",
        "benchmarks.paper.weights:bench_weights", "quick echo",
    ),
}  # fmt: skip
"""Every benchmark by its name on the command line."""


def run_bench(
    name: str, out: Path, data: Path | None, quick: bool, echo: Echo, workers: int = 0
) -> None:
    """Run one benchmark by name, print it and write `out`/NAME.json.

    With workers, benchmarks that can are spread over so many processes.

    Raises:
        RunError: no such benchmark, its data is missing, or the output cannot be written.
    """
    benchmark = _chosen(name, data, workers)
    given = {"out": out, "data": data, "quick": quick, "echo": echo, "workers": workers}
    module, _, function = benchmark.function.partition(":")
    measure = getattr(importlib.import_module(module), function)
    result = measure(**{argument: given[argument] for argument in benchmark.takes.split()})
    result["meta"] = {
        "version": version(),
        "config_sha256": SlamConfig().sha256(),
        "python": platform.python_version(),
        "quick": quick,
        **result["meta"],
    }
    if benchmark.columns:
        console = Console()
        if not console.is_terminal:  # nothing to fit into: a file holds whole rows
            console.width = IN_A_FILE
        console.print(table(name, result["rows"]))
    target = out / f"{name}.json"
    try:
        out.mkdir(parents=True, exist_ok=True)
        atomic_write(target, json.dumps(result, indent=2) + "\n")
    except OSError as error:
        raise RunError(f"{target}: cannot be written: {error.strerror}") from error
    echo(f"figures: {target}")


def _chosen(name: str, data: Path | None, workers: int) -> Benchmark:
    """Return the benchmark of this name if it can be run with these options."""
    if name not in BENCHMARKS:
        known = ", ".join(BENCHMARKS)
        raise RunError(f"no benchmark is named {name!r}{nearest(name, list(BENCHMARKS))}: {known}")
    benchmark = BENCHMARKS[name]
    if workers and not benchmark.spreads:
        able = ", ".join(key for key, one in BENCHMARKS.items() if one.spreads)
        raise RunError(f"{name} cannot use workers, only {able}: leave --workers out")
    if benchmark.data and data is None:
        raise RunError(f"{name} needs recorded data: --data DIR, where DIR holds {benchmark.data}")
    if data is not None and not data.is_dir():
        raise RunError(f"{data}: no such folder: --data must name one")
    return benchmark


def described() -> list[str]:
    """A line for each benchmark."""
    width = max(map(len, BENCHMARKS))
    return [f"{name:{width}}  {benchmark.about}" for name, benchmark in BENCHMARKS.items()]


def table(name: str, rows: list[dict[str, Any]]) -> Table:
    """The chosen columns of a benchmark's rows."""
    shown = Table(title=name)
    columns = BENCHMARKS[name].columns
    for k, heading in enumerate(columns.values()):
        shown.add_column(heading, justify="right" if k else "left", overflow="fold")
    for row in rows:
        shown.add_row(*(_cell(row.get(column)) for column in columns))
    return shown


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
