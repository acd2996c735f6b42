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
from pathlib import Path
from typing import Any

from slam.config import load_config
from slam.demo_drive import Plan, drive_online
from slam.run_directory import version

OFFICE = Plan(world="office", most_s=900.0)  # two minutes


def bench_online(out: Path, say: Callable[[str], None], plan: Plan = OFFICE) -> dict[str, Any]:
    """Drive once, in real time, and write `online.json`; returns what it holds.

    `latency_ms` is from a scan's last byte until the pipeline is done with it and has a pose
    from the odometry so far; `delay_ms` until the scan itself is placed, for which the next
    report of the wheels must have come.
    """
    with tempfile.TemporaryDirectory(prefix="slam-bench-") as folder:
        drive_online(Path(folder), load_config(None), say, plan)
        summary = json.loads((Path(folder) / "online" / "summary.json").read_text("utf-8"))
        log_mb = (Path(folder) / "online" / "run.mcap").stat().st_size / 1e6
    found = {"meta": _meta(), "rows": [_row(summary, plan) | {"log_mb": round(log_mb, 1)}]}
    out.mkdir(parents=True, exist_ok=True)
    (out / "online.json").write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    return found


def _row(summary: dict[str, Any], plan: Plan) -> dict[str, Any]:
    timing, laser = summary["timing"], summary["devices"]["laser"]
    names = ("latency_ms_p50", "latency_ms_p99", "latency_ms_max", "delay_ms_p50", "delay_ms_p99",
             "step_ms_p50", "step_ms_p99", "cpu_share")  # fmt: skip
    return {
        "world": plan.world,
        "duration_s": summary["duration_s"],
        "scans": laser["scans"],
        "scans_lost": summary["lost"],
        "keyframes": summary["keyframes"],
        "loops": summary["loops"],
        **{name: timing.get(name) for name in names},
        "peak_rss_mb": summary["peak_rss_mb"],
        "queued_most": summary["recording"]["queued_most"],
    }


def _meta() -> dict[str, Any]:
    return {
        "version": version(), "machine": platform.machine(), "cores": os.cpu_count(),
        "python": platform.python_version(),
    }  # fmt: skip
