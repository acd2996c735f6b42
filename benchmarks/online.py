"""How late poses are and what is lost at 40 scans of 1081 beams a second, with loops to close.

Robot and laser are simulated in this process and read by `slam online` in another, so that
its figures hold its own work alone, although both share the machine's cores.
"""

from __future__ import annotations

import json
import os
import platform
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from slam.runs.config_file import load_config
from slam.tools.demo.drive import Plan, drive_online

OFFICE = Plan(world="office", most_s=1200.0)
_PASSES = 6  # of 107 s each: over ten minutes


def bench_online(quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Drive in real time, for ten minutes or (`quick`) two, and return the figures.

    `latency_ms` is from a scan's last byte until the pipeline is done with it and has a pose
    from the odometry so far, `searching_ms` likewise of the scans that came while a loop search
    ran; `delay_ms` until the scan itself is placed, for which the next report of the wheels
    must have come.
    """
    plan = OFFICE if quick else replace(OFFICE, passes=_PASSES)
    with tempfile.TemporaryDirectory(prefix="slam-bench-") as folder:
        drive_online(Path(folder), load_config(None), echo, plan)
        summary = json.loads((Path(folder) / "online" / "summary.json").read_text("utf-8"))
        log_mb = (Path(folder) / "online" / "run.mcap").stat().st_size / 1e6
    return {"meta": _meta(), "rows": [_row(summary, plan) | {"log_mb": round(log_mb, 1)}]}


def _row(summary: dict[str, Any], plan: Plan) -> dict[str, Any]:
    timing, laser = summary["timing"], summary["devices"]["laser"]
    spreads = [
        f"{what}_ms_{rank}" for what in ("latency", "searching", "delay", "step")
        for rank in ("p50", "p99", "max")
    ]  # fmt: skip
    names = [*spreads, "searching_scans", "cpu_share", "stages_s"]
    return {
        "world": plan.world,
        "duration_s": summary["duration_s"],
        "scans": laser["scans"],
        "lost": summary["lost"],
        "keyframes": summary["keyframes"],
        "loops": summary["loops"],
        **{name: timing.get(name) for name in names},
        "peak_rss_mb": summary["peak_rss_mb"],
        "queued_most": summary["recording"]["queued_most"],
    }


def _meta() -> dict[str, Any]:
    return {
        "machine": platform.machine(), "cores": os.cpu_count(),
        "load": [round(load, 2) for load in os.getloadavg()],  # other programs count too
    }  # fmt: skip
