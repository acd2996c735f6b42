"""`slam online`: drivers, log and pipeline on the robot; ends with a complete RUN."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from slam.drivers.connection import steady_utc
from slam.drivers.ports import Port, open_port
from slam.logs.messages import Message
from slam.logs.parts import Recording
from slam.logs.recorder import Recorder
from slam.logs.recording import RecordingStatus
from slam.mapping.slam import Slam
from slam.online.main_loop import LiveRun
from slam.online.priority import lower_priority, prioritised
from slam.online.robot_config import RobotConfig
from slam.online.run_folder import RECORDING, add_results, log_name, online_run
from slam.runs.errors import RunError, SlamError
from slam.runs.kernel_warmup.warmup import warm_up
from slam.runs.machine import peak_memory_mb
from slam.runs.observer import NullObserver, Observer
from slam.runs.offline import Result, finish
from slam.runs.replay import SLAM_TOPICS, time_matches
from slam.runs.run_directory import version, write_summary
from slam.runs.status import Status
from slam.runs.stopwatch import Stopwatch
from slam.runs.summary import summarise

_RANKS = ("p50", "p99", "max")


def run_online(
    config: RobotConfig,
    out: Path,
    *,
    stop: Callable[[], bool],
    record_only: bool = False,
    on_status: Callable[[Status], None] = lambda status: None,
    report: Callable[[str], None] = lambda text: None,
    period_s: float = 1.0,
    opener: Callable[[str, int], Port] = open_port,
    observer: Observer | None = None,
) -> dict[str, Any]:
    """Record and map until `stop` says so, write the RUN, and return its summary.

    Args:
        config: of robot, laser, recording and pipeline.
        out: the RUN to make.
        stop: asked several times a second.
        record_only: leave the pipeline out.
        on_status: given a status every `period_s` seconds.
        report: given what happens, in words.
        period_s: between two statuses.
        opener: opens ports; replaced in tests.
        observer: shown the run as it goes.

    Raises:
        RunError: `out` cannot be written, or nothing was there to map; what was recorded is
            in `out` all the same.
        LogError: the disk failed.
    """
    watch, observer = Stopwatch(), observer or NullObserver()
    loops = ThreadPoolExecutor(1, thread_name_prefix="loops", initializer=lower_priority)
    slam = None if record_only else Slam(config.slam, watch, loops.submit)
    identity = {
        "source": "online", "version": version(), "config_sha256": config.slam.sha256(),
        "host": platform.node(),
    }  # fmt: skip
    began = time.perf_counter(), time.process_time()
    with online_run(out, config.slam) as folder, loops:
        if slam is not None:
            report("getting ready (kernels compile the first time)")
            warm_up(config.slam)
        clock = steady_utc()
        kept = record_only or config.recording.rotates
        how = config.recording.recorder(recompress=kept)
        with Recorder(folder / RECORDING, identity, how) as recorder:
            recorder.add_attachment(
                "config.json", config.slam.model_dump_json(indent=2).encode(), "application/json"
            )
            recorder.add_attachment(
                "robot.json", config.model_dump_json(indent=2, exclude={"slam"}).encode(),
                "application/json",
            )  # fmt: skip
            live = LiveRun(config, recorder, clock, slam, opener, observer)
            report("recording; stop with Ctrl-C")
            with prioritised():
                live.run(stop, on_status, period_s)
        status = recorder.status()
        summary = _account(live, status, identity)
        report(f"recorded {status.written} messages")
        if not status.files:
            raise RunError(status.stopped)
        try:
            if slam is not None:
                report("finishing the map")
                observer.stage("finishing the map")
                recording = Recording(status.files[0])
                summary = _map(recording, live, slam, watch, identity, summary, began, observer)
        finally:
            write_summary(folder, summary)
    if status.stopped and slam is None:
        raise RunError(status.stopped)
    if len(live.never_connected) == len(live.readers):
        raise RunError(f"no device was ever connected{_absent(live)}")
    return summary


def _map(
    recording: Recording, live: LiveRun, slam: Slam, watch: Stopwatch, identity: Mapping[str, str],
    account: dict[str, Any], began: tuple[float, float], observer: Observer,
) -> dict[str, Any]:  # fmt: skip
    """Finish the graph, write all results, and return the summary."""
    if not live.sequencer.scans:
        raise SlamError(
            f"no scan came in: the recording is kept, the map is not made{_absent(live)}"
        )

    def source() -> Iterator[Message]:
        return recording.messages(SLAM_TOPICS)

    result = finish(slam, source, timer=watch)
    observer.finish(result)
    add_results(recording, result, identity, slam.config)
    timing = _timing(live, result, watch, began)
    summary = summarise(result, account["log"], timing, slam.config)
    lost = {**account["lost"], **summary["lost"]}
    account = account | {"scans": summary["scans"]}
    return summary | account | {"lost": dict(sorted(lost.items()))}


def _absent(live: LiveRun) -> str:
    """Which devices have never been there, and why, to be put behind a sentence."""
    return "".join(f"; {device}: {why}" for device, why in sorted(live.never_connected.items()))


def _timing(
    live: LiveRun, result: Result, watch: Stopwatch, began: tuple[float, float]
) -> dict[str, Any]:
    stamps = result.trajectory.stamps_ns
    wall = time.perf_counter() - began[0]
    return {
        "wall_s": round(wall, 3),
        "cpu_s": round(time.process_time() - began[1], 3),
        "realtime_factor": round(float(stamps[-1] - stamps[0]) * 1e-9 / wall, 2),
        "match_us_median": round(time_matches(result), 1),
        "cpu_share": round(live.cpu_share, 3),
        **_spread("step_ms", live.timed.milliseconds),
        **_spread("latency_ms", live.latencies_ms),
        **_spread("searching_ms", live.searching_ms),
        "searching_scans": len(live.searching_ms),
        **_spread("delay_ms", live.delays_ms),
        "stages_s": {name: round(s, 3) for name, s in sorted(watch.seconds.items())},
    }


def _spread(name: str, values: Sequence[float]) -> dict[str, float]:
    """Median, 99th percentile and maximum; nothing of nothing."""
    if not len(values):
        return {}
    found = np.percentile(np.asarray(values), [50, 99, 100])
    return {f"{name}_{k}": round(float(v), 4) for k, v in zip(_RANKS, found, strict=True)}


def _account(live: LiveRun, status: RecordingStatus, identity: Mapping[str, str]) -> dict[str, Any]:
    """What the summary says of devices and recording."""
    return {
        "log": log_name(status.files),
        "scans": live.sequencer.scans,
        "lost": live.losses(),
        "devices": live.devices(),
        "recording": {
            "messages": status.written, "queued_most": status.queued_most,
            "slowest_sync_s": round(status.slowest_sync_s, 3), "stopped": status.stopped,
        },
        "peak_rss_mb": peak_memory_mb(),
        "version": identity["version"],
        "config_sha256": identity["config_sha256"],
        "host": identity["host"],
    }  # fmt: skip
