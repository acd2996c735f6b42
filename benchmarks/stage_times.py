"""One replay by the clock of the processor; imports nothing that a replay does not."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

from slam.logs.parts import Recording

from slam.mapping.config import SlamConfig
from slam.runs.machine import peak_memory_mb
from slam.runs.offline import run_offline
from slam.runs.replay import SLAM_TOPICS
from slam.runs.run_directory import write_results
from slam.runs.stopwatch import Stopwatch

STAGES = (
    "reading", "matching", "closing", "optimising", "pruning", "localising", "map", "writing",
)  # fmt: skip


def measure(log: str, scratch: str) -> None:
    """Map a log and write its results; print the row of it as JSON."""
    start_s = time.process_time()
    watch, config, recording = Stopwatch(time.process_time), SlamConfig(), Recording(log)
    result = run_offline(lambda: recording.messages(SLAM_TOPICS), config, watch)
    with tempfile.TemporaryDirectory(dir=scratch) as run, watch("writing"):
        write_results(Path(run), result, {}, config.model_dump_json().encode())
    cpu_s = time.process_time()
    stages = {f"{stage}_s": watch.seconds.get(stage, 0.0) for stage in STAGES}
    scans, keyframes, own_s = len(result.trajectory), len(result.keyframes), cpu_s - start_s
    row = {
        "scans": scans,
        "keyframes": keyframes,
        "start_s": start_s,
        **stages,
        "rest_s": own_s - sum(stages.values()),
        "cpu_s": cpu_s,
        "us_per_scan": 1e6 * own_s / scans,
        "ms_per_keyframe": 1e3 * own_s / keyframes,
        "peak_mb": peak_memory_mb(),
    }
    sys.stdout.write(json.dumps(row))
