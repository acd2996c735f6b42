"""`slam batch`: every log under every combination of settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import Client

from slam.experiments.batch.grid import Grid
from slam.experiments.batch.report import comparison_html, comparison_json
from slam.experiments.batch.run_batch import (
    Echo,
    failure,
    hash_logs,
    make_folder,
    make_task,
    run_all,
)
from slam.experiments.batch.sources import expand
from slam.experiments.batch.table import Row, make_row, parquet
from slam.experiments.batch.task import Task
from slam.logs.atomic_write import atomic_write
from slam.logs.errors import LogError
from slam.runs.errors import ReportError, RunError


@dataclass(frozen=True, slots=True)
class Batch:
    """What is asked of `slam batch`."""

    logs: Sequence[str]  # addresses and patterns
    grid: Grid
    out: Path  # on storage that all workers share
    truth: Path | None = None  # folder, shared likewise


def run_batch(batch: Batch, client: Client, echo: Echo) -> list[Row]:
    """Run what is not finished yet; write `table.parquet`, `report.html` and `report.json`.

    Returns the rows of the table, by log and then by combination, however the tasks were run.

    Raises:
        RunError: there is no log, or the output cannot be written.
        BatchError: the scheduler was lost.
    """
    make_folder(batch.out / "results")
    logs = expand(batch.logs)
    if not logs:
        raise RunError("no log was given")
    planned = _plan(batch, logs, client)
    records = run_all(client, [t for row in planned for t in row if isinstance(t, Task)], echo)
    rows = []
    for log, tasks in zip(logs, planned, strict=True):
        for point, task in zip(batch.grid.points, tasks, strict=True):
            record = records[task.key] if isinstance(task, Task) else task
            rows.append(make_row(log, batch.grid, point, _identity(task), record))
    atomic_write(batch.out / "table.parquet", parquet(rows, batch.grid))
    atomic_write(batch.out / "report.json", comparison_json(rows, batch.grid))
    atomic_write(batch.out / "report.html", comparison_html(rows, batch.grid))
    return rows


def _plan(batch: Batch, logs: Sequence[str], client: Client) -> list[list[Task | dict[str, Any]]]:
    """For each log and combination its task, or the record of why there is none."""
    hashes = hash_logs(client, logs)
    planned = []
    for log in logs:
        row: list[Task | dict[str, Any]] = []
        for point in batch.grid.points:
            known = hashes[log]
            if isinstance(known, Exception):
                row.append(failure(known, log))
            elif point.config is None:
                row.append({"status": "failed", "reason": point.reason})
            else:
                try:
                    folder = batch.out / "results"
                    row.append(make_task(log, known, point.config, batch.truth, folder))
                except (LogError, ReportError) as error:
                    row.append(failure(error, log))
        planned.append(row)
    return planned


def _identity(task: Task | dict[str, Any]) -> dict[str, str]:
    if not isinstance(task, Task):
        return {}
    names = ("log_sha256", "config_sha256", "truth_sha256", "version")
    return {name: getattr(task, name) for name in names}
