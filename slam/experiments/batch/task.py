"""What a worker of a batch does: one log under one configuration, replayed and judged."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import get_worker

from slam.backend.edges import GraphError
from slam.evaluation.report.evaluate import evaluate
from slam.experiments.batch.engine import BatchError
from slam.experiments.batch.sources import local_copy
from slam.logs.atomic_write import atomic_write
from slam.logs.errors import LogError
from slam.mapping.config import SlamConfig
from slam.runs.errors import ReportError, SlamError
from slam.runs.kernel_warmup.warmup import warm_up
from slam.runs.replay import file_sha256, replay
from slam.runs.run_directory import version

_LASTING = (LogError, SlamError, ReportError, GraphError)
"""Errors that the same log and configuration would give again, if it was not the disk's fault."""

LOG = "{log}"
"""Stands in a kept reason for the log's address: the same log may lie elsewhere next time."""

_ONE_AT_A_TIME = threading.Lock()
"""A worker with several threads still replays one log at a time: drawing a map wants it so."""


@dataclass(frozen=True, slots=True)
class Task:
    """All that a worker is told; addresses must mean the same to it as to whoever asks."""

    log: str  # address
    log_sha256: str
    config: str  # JSON of the effective configuration
    config_sha256: str
    truth: str  # path; empty for the log's own
    truth_sha256: str
    results: str  # folder that all share
    version: str

    @property
    def key(self) -> str:
        """Name of the result: equal for equal contents, wherever they lie."""
        parts = (self.log_sha256, self.config_sha256, self.truth_sha256, self.version)
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    @property
    def result(self) -> Path:
        """File of the result."""
        return Path(self.results) / f"{self.key}.json"


def log_hash(address: str) -> str:
    """SHA-256 of a log, in the worker, which is nearer to it.

    Raises:
        OSError: the log is not there or cannot be read.
    """
    with local_copy(address, _scratch()) as path:
        with path.open("rb"):  # says why, where the hash would only be empty
            pass
        return file_sha256(path)


def run_task(task: Task) -> None:
    """Replay and judge, and leave the result in the folder that all share.

    What is wrong with the log or its truth is a result too; any other error is raised, and may
    be gone the next time.

    Raises:
        BatchError: the worker has another version, or the log has changed.
        RunError: the result cannot be written.
        OSError: the log cannot be fetched.
    """
    if version() != task.version:
        raise BatchError(f"a worker has version {version()}, not {task.version}")
    with _ONE_AT_A_TIME:
        warm()
        with local_copy(task.log, _scratch()) as log:
            try:
                begin = time.perf_counter()
                record = {"status": "ok", "reason": "", **_judge(task, log)}
                record["seconds"] = round(time.perf_counter() - begin, 4)
            except _LASTING as error:
                reason = str(error).replace(str(log), LOG)
                if isinstance(error.__cause__, OSError):
                    raise BatchError(str(error)) from error
                record = {"status": "failed", "reason": reason}
    atomic_write(task.result, json.dumps(record, indent=1, allow_nan=False) + "\n")


def read_result(task: Task) -> dict[str, Any] | None:
    """The record of a finished task; None if there is none, or it is not whole."""
    with suppress(OSError, ValueError):
        record = json.loads(task.result.read_text(encoding="utf-8"))
        return record if isinstance(record, dict) else None
    return None


def _judge(task: Task, log: Path) -> dict[str, Any]:
    config = SlamConfig.model_validate_json(task.config)
    with TemporaryDirectory(dir=_scratch()) as folder:
        run = Path(folder) / log.stem
        summary = replay(log, run, config)
        if summary["log_sha256"] != task.log_sha256:
            raise BatchError(f"{task.log}: the log has changed since the batch began")
        figures = evaluate(run, Path(task.truth) if task.truth else None).figures
    return {"summary": summary, "figures": figures}


@cache
def warm() -> None:
    """Compile the kernels before the first replay of a process is timed."""
    warm_up(SlamConfig())


def _scratch() -> Path | None:
    """Folder of the worker, which Dask cleans up after workers that were killed."""
    with suppress(ValueError):  # no worker: somebody calls the function itself
        return Path(get_worker().local_directory)
    return None
