"""Where the processor time of a replay goes, stage by stage.

By the clock of the processor, since wall time on a machine with other users says little; with one
thread, so that a stage's time is its own.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.benchmark import logs_in
from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError
from slam.runs.kernel_warmup.warmup import warm_up
from slam.tools.imports import import_log


def bench_stages(data: Path, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Replay each log of `data`/benchmark once, in a process of its own; the first with `quick`.

    Row keys: seconds of CPU per stage of `stage_times`, `start_s` (the interpreter, and all that is
    imported), `rest_s` (of the run, outside of every stage), `cpu_s` (all of it), `us_per_scan`
    and `ms_per_keyframe` (of `cpu_s` without `start_s`), `peak_mb`.

    Raises:
        RunError: no log is there, or a replay fails.
    """
    folder = data / "benchmark"
    names = logs_in(folder)[: 1 if quick else None]
    if not names:
        raise RunError(f"{folder}: no NAME.clf.gz with its NAME.relations; name --data")
    echo("compiling the kernels")
    warm_up(SlamConfig())
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in names:
            echo(name)
            log = Path(scratch) / f"{name}.mcap"
            import_log(folder / f"{name}.clf.gz", log)
            for _ in range(2):  # the first may compile what only placing scans needs
                row = _in_a_process_of_its_own(log, Path(scratch))
            rows.append({"log": name, **row})
    return {"meta": {"threads": 1}, "rows": rows}


def _in_a_process_of_its_own(log: Path, scratch: Path) -> dict[str, Any]:
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parents[1])!r}); "
        f"from benchmarks.stage_times import measure; measure({str(log)!r}, {str(scratch)!r})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RunError(f"{log.stem}: replay failed: {done.stderr.strip().splitlines()[-1]}")
    row: dict[str, Any] = json.loads(done.stdout)
    return row
