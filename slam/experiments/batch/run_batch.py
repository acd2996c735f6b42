"""Runs tasks that are not finished yet, and gathers what all of them found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from distributed import Client

from slam.experiments.batch.engine import run_tasks
from slam.experiments.batch.progress import TaskProgress
from slam.experiments.batch.sources import absolute, find_truth
from slam.experiments.batch.task import Task, log_hash, read_result, run_task
from slam.mapping.config import SlamConfig
from slam.runs.errors import ReportError, RunError
from slam.runs.replay import file_sha256
from slam.runs.run_directory import version

Echo = Callable[[str], None]


def hash_logs(client: Client, addresses: Sequence[str]) -> dict[str, str | Exception]:
    """SHA-256 of each log, or why it cannot be read."""
    progress = TaskProgress("logs looked at", len(addresses))
    hashes: dict[str, str | Exception] = {}
    for index, found in run_tasks(client, log_hash, [absolute(a) for a in addresses]):
        hashes[addresses[index]] = found
        progress.tick(isinstance(found, Exception))
    return hashes


def make_task(
    address: str, log_sha256: str, config: SlamConfig, truth: Path | None, results: Path
) -> Task:
    """The task of one log under one configuration.

    Raises:
        ReportError: the log has several truths in the folder `truth`.
    """
    file = find_truth(truth, address)
    return Task(
        log=absolute(address),
        log_sha256=log_sha256,
        config=config.model_dump_json(),
        config_sha256=config.sha256(),
        truth=str(file or ""),
        truth_sha256=file_sha256(file) if file else "",
        results=str(results.absolute()),
        version=version(),
    )


def run_all(
    client: Client, tasks: Sequence[Task], echo: Echo, what: str = "replays"
) -> dict[str, dict[str, Any]]:
    """Records of all tasks by key; those whose results are there already are not run again.

    A task that could not be finished has a record with its reason, which is not kept.
    """
    unique = {task.key: task for task in tasks}
    records = {key: found for key, task in unique.items() if (found := read_result(task))}
    missing = [task for key, task in unique.items() if key not in records]
    if records:
        echo(f"{what}: {len(records)} of {len(unique)} are there already")
    progress = TaskProgress(what, len(missing))
    for index, error in run_tasks(client, run_task, missing):
        task = missing[index]
        record = failure(error, task.log) if error else read_result(task)
        if record is None:
            record = failure(RunError(f"{task.result}: not here: is --out on shared storage?"), "")
        records[task.key] = record
        progress.tick(record["status"] != "ok")
    return records


def failure(error: Exception, log: str) -> dict[str, Any]:
    """The record of what could not even be tried, or was cut short."""
    if isinstance(error, RunError | ReportError):
        reason = str(error)
    elif isinstance(error, FileNotFoundError):
        reason = f"{log}: no such file"
    elif isinstance(error, OSError) and error.strerror:
        reason = f"{log}: {error.strerror}"
    else:
        reason = f"{log}: {type(error).__name__}: {error}"
    return {"status": "failed", "reason": reason}


def make_folder(folder: Path) -> None:
    """Make a folder and those above it.

    Raises:
        RunError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(
            f"{folder}: cannot be made: {error.strerror}; choose another --out"
        ) from error
