"""`slam bench memory`: an hour on the robot as fast as it goes, and what it leaves in memory.

Bytes of simulated devices go through decoders, recorder and pipeline, as on a robot but without
ports and their waiting.  The robot drives through the office, back in reverse, and so on; for
comparison it stands still as long.  Memory that grows while it stands would grow for ever.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from slam.drivers.arcos_protocol import encode_command
from slam.drivers.connection import Received
from slam.drivers.hokuyo_decoder import HokuyoDecoder
from slam.drivers.pioneer_decoder import PioneerDecoder
from slam.drivers.simulators.drive import EPOCH_NS
from slam.logs.messages import LaserExtrinsics, RawBytes
from slam.logs.recorder import Recorder
from slam.logs.recording import RecorderConfig

from benchmarks.online import OFFICE
from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.online.sequencer import MessageSequencer
from slam.runs.offline import feed
from slam.tools.demo.drive import SimulatedRobot

_PASS_S = 107.0  # of the office
_SCAN_S = 0.025
_SAMPLE_S = 60.0
_QUEUE = 4000  # messages; the disk must keep up with the accelerated time


def bench_memory(quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Drive and stand, an hour each or (`quick`) six minutes; memory at every minute."""
    seconds = 360.0 if quick else 3600.0
    rows = []
    for name, drives in (("standing", False), ("driving", True)):
        names = ("s", "rss_mb", "keyframes", "pruned")
        samples = [dict(zip(names, s, strict=True)) for s in _run(seconds, drives, echo)]
        rows.append(_row(name, samples) | {"samples": samples})
    return {"meta": {"beams": 1081, "scan_hz": 40}, "rows": rows}


def _row(name: str, samples: list[dict[str, float]]) -> dict[str, Any]:
    """Growth by least squares over all but the first tenth, when things are still being set up."""
    steady = samples[len(samples) // 10 :]
    t, rss = (np.array([s[k] for s in steady]) for k in ("s", "rss_mb"))
    growth = float(np.polyfit(t, rss, 1)[0]) * 3600.0
    return {
        "run": name, "minutes": round(samples[-1]["s"] / 60.0, 1),
        "keyframes": int(samples[-1]["keyframes"]), "pruned": int(samples[-1]["pruned"]),
        "rss_mb_first": round(float(rss[0]), 1), "rss_mb_last": round(float(rss[-1]), 1),
        "growth_mb_per_hour": round(growth, 1),
    }  # fmt: skip


def _run(
    seconds: float, drives: bool, echo: Callable[[str], None]
) -> Iterator[tuple[float, float, int, int]]:
    """Yield seconds, memory in MB, keyframes and those pruned, once in a simulated minute."""
    with tempfile.TemporaryDirectory(prefix="slam-memory-") as folder:
        plan = replace(OFFICE, passes=int(np.ceil(seconds / _PASS_S)))
        robot = SimulatedRobot(Path(folder), plan)
        for port in robot.ports:
            port.close()  # not needed here
        robot.motion.starts_s = 1.0 if drives else 1e9
        settings = RecorderConfig(recompress=False)
        recorder = Recorder(Path(folder) / "log.mcap", {}, settings)
        with recorder, ThreadPoolExecutor(1) as loops:
            slam, sequencer = Slam(SlamConfig(), submit=loops.submit), MessageSequencer(recorder)
            sequencer(Received(EPOCH_NS, LaserExtrinsics(EPOCH_NS, plan.ahead_m, 0.0, 0.0)))
            due_s = _SAMPLE_S
            for now_s, received in _wire(robot, seconds):
                while recorder.status().queued > _QUEUE:
                    time.sleep(0.001)
                sequencer(received)
                while (taken := sequencer.get(0.0)) is not None:
                    feed(slam, taken.message)
                if now_s >= due_s:
                    due_s += _SAMPLE_S
                    gone = slam.records.pruned_counts["keyframes"]
                    sample = now_s, _rss_mb(), len(slam.keyframes), gone
                    echo(f"{now_s / 60:.0f} min: {sample[1]:.0f} MB, {sample[2]} keyframes")
                    yield sample


def _wire(robot: SimulatedRobot, seconds: float) -> Iterator[tuple[float, Received]]:
    """Yield what the devices send, in raw bytes and decoded, and when."""
    base, laser = PioneerDecoder(), HokuyoDecoder()
    for number in (0, 1, 2, 1):
        robot.base.receive(encode_command(number), 0.0)
    robot.base.receive(encode_command(28, 0), 0.0)  # no sonar
    robot.laser.receive(b"PP\nMD0000108001000\n", 0.0)
    for step in range(round(seconds / _SCAN_S)):
        now_s = step * _SCAN_S
        stamp = EPOCH_NS + round(now_s * 1e9)
        for raw, decoder in (
            (RawBytes(stamp, "p3dx", "rx", robot.base.advance(now_s)), base),
            (RawBytes(stamp, "laser", "rx", robot.laser.advance(now_s)), laser),
        ):
            if raw.data:
                yield now_s, Received(stamp, raw)
                for message in decoder.decode(raw):
                    yield now_s, Received(stamp, message)


def _rss_mb() -> float:
    """Memory of this process that is in RAM, MB."""
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    return pages * 4096 / 1e6
