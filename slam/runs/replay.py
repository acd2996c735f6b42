"""`slam replay`: a log in, a RUN out."""

from __future__ import annotations

import hashlib
import os
import platform
import time
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np

from slam.frontend.match_types import Prior, Reference
from slam.frontend.matching import match
from slam.logs.check_clocks import refuse_clocks_apart
from slam.logs.messages import Message
from slam.logs.parts import Recording
from slam.mapping.config import SlamConfig
from slam.mapping.relocalise import PriorMap
from slam.mapping.slam import Slam
from slam.runs.kernel_warmup.second_process import compiled
from slam.runs.kernel_warmup.warmup import warm_up
from slam.runs.observer import NullObserver, Observer
from slam.runs.offline import Progress, Result, run_offline
from slam.runs.pacing import paced
from slam.runs.raw_source import messages_from_raw
from slam.runs.run_directory import new_run, version, write_results, write_summary
from slam.runs.stopwatch import Stopwatch
from slam.runs.summary import summarise

SLAM_TOPICS = ("/scan", "/odom", "/tf", "/truth")


class TimedStep:
    """Hands messages to the pipeline and notes how long each took."""

    def __init__(self) -> None:
        self.milliseconds = array("d")

    def __call__(self, slam: Slam, message: Message) -> None:
        """One step, timed."""
        begin = time.perf_counter()
        slam.step(message)
        self.milliseconds.append((time.perf_counter() - begin) * 1e3)


@dataclass(frozen=True, eq=False)
class FinishedRun:
    """A log that was mapped, with all that a RUN directory holds."""

    result: Result
    config: SlamConfig
    log: str  # its file name
    log_sha256: str
    timing: dict[str, Any]  # as in summary.json
    skipped: dict[str, int]  # data of the log that could not be read, per cause
    resumed_keyframes: int | None = None  # of the prior map; None if there was none

    def summary(self) -> dict[str, Any]:
        """What `summary.json` says."""
        result = self.result
        result.lost.update(self.skipped)
        summary = summarise(result, self.log, self.timing, self.config)
        if self.resumed_keyframes is not None:
            summary["resumed_keyframes"] = self.resumed_keyframes
        return summary | {"log_sha256": self.log_sha256, "host": platform.node()}

    def write(self, directory: Path) -> dict[str, Any]:
        """Write all files of a RUN into a directory that exists; returns its summary.

        Raises:
            OSError: a file cannot be written.
        """
        identity = {
            "source": self.log, "source_sha256": self.log_sha256, "version": version(),
            "config_sha256": self.config.sha256(), "host": platform.node(),
        }  # fmt: skip
        begin = time.perf_counter()
        write_results(
            directory, self.result, identity, self.config.model_dump_json(indent=2).encode()
        )
        self.timing["stages_s"]["writing"] = round(time.perf_counter() - begin, 3)
        summary = self.summary()
        write_summary(directory, summary)
        return summary


def replay(
    log: Path,
    out: Path,
    config: SlamConfig,
    progress: Progress | None = None,
    from_raw: bool = False,
    rate: float = 0.0,
    observer: Observer | None = None,
    prior_map: PriorMap | None = None,
    threads: int = 1,
) -> dict[str, Any]:
    """Run SLAM over a log as `run_log` does, and write a RUN directory; returns its summary.

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no usable scan.
        RunError: the output cannot be written.
    """
    with new_run(out) as partial:
        run = run_log(log, config, progress, from_raw, rate, observer, prior_map, threads)
        return run.write(partial)


def run_log(
    log: Path,
    config: SlamConfig,
    progress: Progress | None = None,
    from_raw: bool = False,
    rate: float = 0.0,
    observer: Observer | None = None,
    prior_map: PriorMap | None = None,
    threads: int = 1,
) -> FinishedRun:
    """Run SLAM over a log.  Of a recording in several parts, those behind the named one count too.

    Args:
        log: the recording.
        config: of the run.
        progress: called with the stage and how far it is.
        from_raw: decode scans and odometry anew from the bytes of the devices.
        rate: 1 hands messages over as slowly as they were measured, 0 as fast as it goes; the
            results are the same.
        observer: shown the run as it goes; the results are the same.
        prior_map: a map to continue, which becomes part of the new run.
        threads: to place the scans with in the end; the results are the same.

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no usable scan.
    """
    skipped: dict[str, int] = {}
    rates = chain([rate], repeat(0.0))  # what is read again, to place every scan, need not wait

    def source() -> Iterable[Message]:
        pace = next(rates)
        messages = (
            messages_from_raw(recording, skipped) if from_raw else recording.messages(SLAM_TOPICS)
        )
        yield from paced(messages, pace) if pace else messages
        skipped.update(recording.skipped)

    recording = Recording(log)
    source_sha256 = file_sha256(*recording.files)
    if not from_raw and recording.counts().get("/odom"):
        refuse_clocks_apart(log.name, recording.receipts(("/scan", "/odom")))
    if not compiled():
        if progress is not None:
            progress("compiling", 0)
        warm_up(config)
    result, timing = timed_run(source, config, progress, observer, prior_map, threads)
    resumed = len(prior_map.keyframes) if prior_map is not None else None
    return FinishedRun(result, config, log.name, source_sha256, timing, skipped, resumed)


def _cpu_s() -> float:
    """Processor time of this process and its copies that have ended."""
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def timed_run(
    source: Any,
    config: SlamConfig,
    progress: Progress | None,
    observer: Observer | None = None,
    prior_map: PriorMap | None = None,
    threads: int = 1,
) -> tuple[Result, dict[str, Any]]:
    """Run offline; also the figures of `summary.json`'s `timing`."""
    timer, step, watcher = Stopwatch(), TimedStep(), observer or NullObserver()

    def on_stage(stage: str, done: float) -> None:
        watcher.stage(stage)
        if progress is not None:
            progress(stage, done)

    def on_message(slam: Slam, message: Message) -> None:
        step(slam, message)
        watcher.show(slam, message)

    wall, cpu = time.perf_counter(), _cpu_s()
    result = run_offline(source, config, timer, on_stage, on_message, prior_map, threads)
    wall, cpu = time.perf_counter() - wall, _cpu_s() - cpu
    watcher.finish(result)
    stamps = result.trajectory.stamps_ns
    duration = float(stamps[-1] - stamps[0]) * 1e-9
    steps = np.array(step.milliseconds)
    timing = {
        "wall_s": round(wall, 3),
        "cpu_s": round(cpu, 3),
        "realtime_factor": round(duration / wall, 2),
        "match_us_median": round(time_matches(result), 1),
        "step_ms_p50": round(float(np.percentile(steps, 50)), 4),
        "step_ms_p99": round(float(np.percentile(steps, 99)), 4),
        "stages_s": {name: round(s, 3) for name, s in sorted(timer.seconds.items())},
    }
    return result, timing


def time_matches(result: Result, most: int = 100) -> float:
    """Median microseconds of a single-reference match between neighbouring keyframes, warm."""
    keyframes, poses = result.slam.keyframes, result.keyframes.poses
    matcher = result.slam.config.matcher
    times = []
    for k in _spread(len(keyframes) - 1, most):
        a, b = keyframes[k], keyframes[k + 1]
        guess = a.odom_T_base.between(b.odom_T_base)
        prior = Prior(guess, np.diag([0.05, 0.05, 0.05]) ** 2)
        references = [Reference(type(guess)(), a.prepared)]
        begin = time.perf_counter()
        match(references, b.prepared, guess, matcher, prior)
        times.append((time.perf_counter() - begin) * 1e6)
    return float(np.median(times)) if times and len(poses) else 0.0


def _spread(n: int, most: int) -> Sequence[int]:
    return range(0, n, max(1, -(-n // most)))


def file_sha256(*paths: Path) -> str:
    """SHA-256 of files one behind the other; empty if one cannot be read (opening it says why)."""
    digest = hashlib.sha256()
    try:
        for path in paths:
            with path.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
    except OSError:
        return ""
    return digest.hexdigest()
