"""`slam replay`: a log in, a RUN out."""

from __future__ import annotations

import hashlib
import os
import platform
import time
from array import array
from collections.abc import Iterable, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np

from slam.frontend.match_types import Prior, Reference
from slam.frontend.matching import match
from slam.logs.messages import Message
from slam.logs.parts import Recording
from slam.logs.trajectory import path_length
from slam.mapping.config import SlamConfig
from slam.mapping.relocalise import PriorMap
from slam.mapping.slam import Slam
from slam.runs.compiling.second_process import compiled
from slam.runs.compiling.warmup import warm_up
from slam.runs.machine import peak_memory_mb
from slam.runs.observer import NullObserver, Observer
from slam.runs.offline import Progress, Result, run_offline
from slam.runs.pacing import paced
from slam.runs.raw_source import messages_from_raw
from slam.runs.run_directory import new_run, version, write_results, write_summary
from slam.runs.stopwatch import Stopwatch

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


def replay(
    log: Path,
    out: Path,
    config: SlamConfig,
    progress: Progress | None = None,
    from_raw: bool = False,
    rate: float = 0.0,
    observer: Observer | None = None,
    prior_map: PriorMap | None = None,
    processes: int = 1,
) -> dict[str, Any]:
    """Run SLAM over a log and write a RUN directory; returns its summary.

    Of a recording in several parts, those behind the named one are taken along.

    With `from_raw`, scans and odometry are decoded anew from the bytes of the devices.  A `rate`
    of 1 hands messages to the pipeline as slowly as they were measured, 0 as fast as it goes;
    the results are the same, and so they are with an `observer`.  With a `prior_map`, its map is
    continued and becomes part of the new run.  Several `processes` place the scans in the end,
    if this process has no other threads.

    Raises:
        LogError: the log cannot be read.
        SlamError: it holds no usable scan.
        RunError: the output cannot be written.
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
    with new_run(out) as partial:
        if not compiled():
            if progress is not None:
                progress("compiling", 0)
            warm_up(config)
        result, timing = timed_run(source, config, progress, observer, prior_map, processes)
        identity = {
            "source": log.name, "source_sha256": source_sha256, "version": version(),
            "config_sha256": config.sha256(), "host": platform.node(),
        }  # fmt: skip
        config_json = config.model_dump_json(indent=2).encode()
        begin = time.perf_counter()
        write_results(partial, result, identity, config_json)
        timing["stages_s"]["writing"] = round(time.perf_counter() - begin, 3)
        result.lost.update(skipped)
        summary = summarise(result, log.name, timing, config)
        if prior_map is not None:
            summary["resumed_keyframes"] = len(prior_map.keyframes)
        summary |= {"log_sha256": source_sha256, "host": platform.node()}
        write_summary(partial, summary)
    return summary


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
    processes: int = 1,
) -> tuple[Result, dict[str, Any]]:
    """Run offline; also the figures of `summary.json`'s `timing`."""
    watch, step, watching = Stopwatch(), TimedStep(), observer or NullObserver()

    def told(stage: str, done: float) -> None:
        watching.stage(stage)
        if progress is not None:
            progress(stage, done)

    def shown(slam: Slam, message: Message) -> None:
        step(slam, message)
        watching.show(slam, message)

    wall, cpu = time.perf_counter(), _cpu_s()
    result = run_offline(source, config, watch, told, shown, prior_map, processes)
    wall, cpu = time.perf_counter() - wall, _cpu_s() - cpu
    watching.finish(result)
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
        "stages_s": {name: round(s, 3) for name, s in sorted(watch.seconds.items())},
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


def summarise(
    result: Result, log: str, timing: dict[str, Any], config: SlamConfig
) -> dict[str, Any]:
    """The keys of `summary.json`."""
    slam, stamps = result.slam, result.trajectory.stamps_ns
    closure_results = slam.loops.closure_results
    gone = slam.records.pruned_counts
    accepted = sum(v.accepted for v in closure_results) + gone["accepted"]
    candidates = len(closure_results) + gone["accepted"] + gone["rejected"]
    return {
        "log": log,
        "scans": len(stamps),
        "keyframes": len(slam.keyframes),
        "pruned": gone["keyframes"],
        "matches": slam.matches,
        "scan_matches": result.matches - slam.matches,
        "loops": {
            "candidates": candidates,
            "accepted": accepted,
            "rejected": candidates - accepted,
        },
        "distance_m": round(float(path_length(slam.places(result.keyframes.poses)[1])[-1]), 3),
        "duration_s": round(float(stamps[-1] - stamps[0]) * 1e-9, 3),
        "timing": timing,
        "peak_rss_mb": peak_memory_mb(),
        "lost": dict(sorted(result.lost.items())),
        "noted": dict(sorted(slam.noted.items())),
        "odometry_faults": dict(sorted(slam.odometry_faults.items())),
        "odometry_refused": gone["odometry refused"]
        + sum(not f.used and f.kind == "odometry" for f in slam.records.factors),
        "lost_keyframes": sum(e.lost for e in slam.records.estimates),
        "version": version(),
        "config_sha256": config.sha256(),
    }


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
