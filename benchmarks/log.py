"""How fast a robot's log is written and read, how large it gets, and what a sync costs."""

from __future__ import annotations

import os
import platform
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.log_speed import HOUR_S, log_rows

QUICK_S = 60.0


def bench_log(quick: bool, out: Path | None = None) -> dict[str, Any]:
    """Write and read one log for each set of sensors: an hour, or a minute if `quick`.

    Args:
        quick: for a first look.
        out: on the disk to be measured, made if it is missing; the working directory's
            if not said, because a system's folder for temporary files may be in memory.

    Returns:
        `rows`, one a set of sensors, with the columns that `log_speed.measure_logs` describes, and
        what bringing a chunk to the disk costs (ms, for all alike); `meta` with the machine.

    Raises:
        LogError: the folder cannot be written.
        OSError: the folder cannot be made.
    """
    seconds = QUICK_S if quick else HOUR_S
    where = out or Path.cwd()
    where.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="slam-bench-", dir=where) as work:
        *rows, fsync = log_rows(work, seconds)
    del fsync["case"]
    rows = [row | fsync for row in rows]
    meta = {
        "machine": platform.machine(), "cores": os.cpu_count(), "log_s": seconds,
    }  # fmt: skip
    return {"meta": meta, "rows": rows}
