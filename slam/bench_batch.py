"""`slam bench batch`: how batches scale with workers, and what a task costs beyond its replay."""

from __future__ import annotations

import io
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from distributed import Client

from slam.batch import Batch, run_batch
from slam.batch_engine import engine, run_tasks
from slam.batch_grid import Grid, make_grid
from slam.batch_run import make_task
from slam.batch_table import is_time
from slam.batch_task import Task, warm
from slam.config import SlamConfig
from slam.simulate import simulate_log

_WORLD, _LOGS = "testbed-180cm", 40
_SETTINGS = ("keyframes.method=constant", "keyframes.interval=0.1,0.2,0.3,0.4")
_WORKERS = (1, 2)
_TINY = 1000


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What a batch left behind, but for the times."""

    table: bytes
    reports: tuple[bytes, bytes]


def bench_batch(quick: bool, say: Callable[[str], None]) -> dict[str, Any]:
    """The same batch with one worker and with two, then many tasks that do nothing."""
    grid = make_grid(None, _SETTINGS)
    rows: list[dict[str, Any]] = []
    outcomes: list[_Outcome] = []
    with tempfile.TemporaryDirectory() as scratch:
        logs = Path(scratch) / "logs"
        logs.mkdir()
        for seed in range(4 if quick else _LOGS):
            name = f"{_WORLD}-{seed:02}.mcap"
            simulate_log(_WORLD, logs / name, seed, "hokuyo-181", "typical")
        for workers in _WORKERS:
            with engine(workers) as client:
                client.wait_for_workers(workers)
                client.run(warm)
                out = Path(scratch) / f"out-{workers}"
                rows.append(_timed(logs, grid, out, client, workers, say))
                outcomes.append(_outcome(out))
                tiny = _tiny(client)
    for row, outcome in zip(rows, outcomes, strict=True):
        row["speedup"] = rows[0]["wall_s"] / row["wall_s"]
        row["identical"] = outcome == outcomes[0]
    return {"meta": {"world": _WORLD, "settings": list(_SETTINGS), **tiny}, "rows": rows}


def _timed(
    logs: Path, grid: Grid, out: Path, client: Client, workers: int, say: Callable[[str], None]
) -> dict[str, Any]:
    begin = time.perf_counter()
    rows = run_batch(Batch([f"{logs}/*.mcap"], grid, out), client, say)
    wall = time.perf_counter() - begin
    inside = sum(row["timing_task_s"] for row in rows)
    return {
        "workers": workers,
        "tasks": len(rows),
        "failed": sum(row["status"] != "ok" for row in rows),
        "wall_s": wall,
        "replays_s": inside,
        "overhead_s_per_task": (wall * workers - inside) / len(rows),
    }


def _outcome(out: Path) -> _Outcome:
    table = pq.read_table(out / "table.parquet")
    stream = io.BytesIO()
    pq.write_table(table.drop_columns([n for n in table.column_names if is_time(n)]), stream)
    reports = (out / "report.html", out / "report.json")
    return _Outcome(stream.getvalue(), (reports[0].read_bytes(), reports[1].read_bytes()))


def _tiny(client: Client) -> dict[str, Any]:
    """Tasks as large as real ones, that do nothing."""
    config = SlamConfig()
    before = _peak_mb()
    tasks = [make_task(f"{k}.mcap", str(k), config, None, Path("results")) for k in range(_TINY)]
    begin = time.perf_counter()
    done = sum(1 for _ in run_tasks(client, nothing, tasks))
    seconds = time.perf_counter() - begin
    return {
        "tiny_tasks": done,
        "tiny_s_per_task": seconds / done,
        "client_peak_rss_mb": _peak_mb(),
        "client_peak_rss_before_mb": before,
    }


def _peak_mb() -> float:
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1)


def nothing(task: Task) -> None:
    """What is done to a tiny task."""
