"""`slam bench batch`: how batches scale with workers, and what a task costs beyond its replay."""

from __future__ import annotations

import io
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from distributed import Client

from slam.experiments.batch.batch import Batch, run_batch
from slam.experiments.batch.engine import engine, run_tasks
from slam.experiments.batch.grid import Grid, make_grid
from slam.experiments.batch.run_batch import make_task
from slam.experiments.batch.table import Row, is_time
from slam.experiments.batch.task import Task, warm
from slam.mapping.config import SlamConfig
from slam.tools.simulate import simulate_log

_WORLD, _LOGS, _SLICE = "testbed-180cm", 40, 8
_SETTINGS = ("keyframes.method=constant", "keyframes.interval=0.1,0.2,0.3,0.4")
_WORKERS = (1, 2)
_TINY = 1000


@dataclass(frozen=True, slots=True)
class _Side:
    """One number of workers."""

    workers: int
    client: Client
    out: Path


def bench_batch(quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """The same batch with one worker and with two, then many tasks that do nothing."""
    grid = make_grid(None, _SETTINGS)
    with tempfile.TemporaryDirectory() as scratch, ExitStack() as stack:
        logs = _simulate(Path(scratch), _SLICE if quick else _LOGS)
        sides = []
        for workers in _WORKERS:
            client = stack.enter_context(engine(workers))
            client.wait_for_workers(workers)
            client.run(warm)
            sides.append(_Side(workers, client, Path(scratch) / f"out-{workers}"))
        walls = [0.0 for _ in sides]
        # In turns, so that both see the same of whatever else the machine has to do.
        for begin in range(0, len(logs), _SLICE):
            for k, side in enumerate(sides):
                walls[k] += _timed(logs[begin : begin + _SLICE], grid, side)
        tables = [run_batch(Batch(logs, grid, side.out), side.client, echo) for side in sides]
        rows = [
            _row(side, table, wall, walls[0]) | {"identical": _same(sides[0].out, side.out)}
            for side, table, wall in zip(sides, tables, walls, strict=True)
        ]
        tiny = _tiny(sides[-1].client)
    return {"meta": {"world": _WORLD, "settings": list(_SETTINGS), **tiny}, "rows": rows}


def _simulate(folder: Path, count: int) -> list[str]:
    logs = [folder / f"{_WORLD}-{seed:02}.mcap" for seed in range(count)]
    for seed, log in enumerate(logs):
        simulate_log(_WORLD, log, seed, "hokuyo-181", "typical")
    return [str(log) for log in logs]


def _timed(logs: Sequence[str], grid: Grid, side: _Side) -> float:
    begin = time.perf_counter()
    run_batch(Batch(logs, grid, side.out), side.client, lambda _: None)
    return time.perf_counter() - begin


def _row(side: _Side, rows: Sequence[Row], wall: float, wall_of_one: float) -> dict[str, Any]:
    inside = sum(row["timing_task_s"] for row in rows)
    return {
        "workers": side.workers,
        "tasks": len(rows),
        "wall_s": wall,
        "speedup": wall_of_one / wall,
        "replays_s": inside,
        "busy_share": inside / (wall * side.workers),
        "overhead_s_per_task": (wall * side.workers - inside) / len(rows),
    }


def _same(one: Path, other: Path) -> bool:
    """Whether two batches left the same, byte for byte, but for the times."""
    reports = [(one / name, other / name) for name in ("report.html", "report.json")]
    pages = all(a.read_bytes() == b.read_bytes() for a, b in reports)
    return pages and _without_times(one) == _without_times(other)


def _without_times(out: Path) -> bytes:
    table = pq.read_table(out / "table.parquet")
    stream = io.BytesIO()
    pq.write_table(table.drop_columns([n for n in table.column_names if is_time(n)]), stream)
    return stream.getvalue()


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
