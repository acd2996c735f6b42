"""`slam bench benchmark`: the public logs against the published figures."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.spread import spread
from slam.evaluation.report.evaluate import evaluate
from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError
from slam.runs.kernel_warmup.warmup import warm_up
from slam.tools.imports import import_log

# Hess et al. 2016, table of errors by relations: mean and standard deviation, m.
CARTOGRAPHER = {
    "intel": (0.0229, 0.0239),
    "mit-csail": (0.0319, 0.0363),
    "mit-killian": (0.0395, 0.0488),
}


@dataclass(frozen=True, slots=True)
class _Job:
    """One log to be imported, replayed and judged."""

    name: str
    folder: Path  # of the public logs
    scratch: Path
    threads: int  # for one replay, 0: as many as are worthwhile


def bench_benchmark(
    data: Path, quick: bool, echo: Callable[[str], None], workers: int = 0
) -> dict[str, Any]:
    """Replay every log of `data`/benchmark with the shipped configuration and judge it.

    A log is NAME.clf.gz beside NAME.relations.  Each replay is a process of its own, so that its
    peak memory is its own too; kernels are compiled before.  With `quick` only the first is run;
    with workers, several at a time.

    Raises:
        RunError: no log is there, or a replay fails.
    """
    folder = data / "benchmark"
    names = logs_in(folder)[: 1 if quick else None]
    if not names:
        raise RunError(
            f"{folder}: no NAME.clf.gz with its NAME.relations; say where they are with --data"
        )
    echo("compiling the kernels")
    warm_up(SlamConfig())
    echo(f"importing and replaying {', '.join(names)}")
    with tempfile.TemporaryDirectory() as scratch:
        several = 1 if workers else 0  # the workers keep the cores busy
        jobs = [_Job(name, folder.absolute(), Path(scratch), several) for name in names]
        rows = spread(_row, jobs, workers)
    for row in rows:
        stages = sorted(row["stages_s"].items(), key=lambda stage: -stage[1])
        echo(f"{row['log']}: " + ", ".join(f"{name} {s:.1f} s" for name, s in stages))
    meta = {"published": "Cartographer, Hess et al. 2016", "workers": workers}
    return {"meta": meta, "rows": rows}


def logs_in(folder: Path) -> list[str]:
    """Names of the logs that have relations, in alphabetical order."""
    names = sorted(path.name.removesuffix(".clf.gz") for path in folder.glob("*.clf.gz"))
    return [name for name in names if (folder / f"{name}.relations").is_file()]


def _row(job: _Job) -> dict[str, Any]:
    name, folder = job.name, job.folder
    log, run = job.scratch / f"{name}.mcap", job.scratch / name
    import_log(folder / f"{name}.clf.gz", log)
    command = [sys.executable, "-m", "slam", "replay", str(log), "--out", str(run)]
    command += ["--threads", str(job.threads)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        raise RunError(f"{name}: replay failed: {done.stderr.strip().splitlines()[-1]}")
    summary = json.loads((run / "summary.json").read_text())
    relations = evaluate(run, folder / f"{name}.relations").figures["relations"]
    mean, std = CARTOGRAPHER.get(name, (None, None))
    return {
        "log": name,
        **relations,
        "published_trans_mean_m": mean,
        "published_trans_std_m": std,
        "scans": summary["scans"],
        "keyframes": summary["keyframes"],
        "matches": summary["matches"],
        "closures": summary["loops"]["accepted"],
        "wall_s": summary["timing"]["wall_s"],
        "cpu_s": summary["timing"]["cpu_s"],
        "realtime_factor": summary["timing"]["realtime_factor"],
        "peak_rss_mb": summary["peak_rss_mb"],
        "stages_s": summary["timing"]["stages_s"],
    }
