"""`slam bench situations`: drives that break maps, each with its trait, without it, and raw."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from slam.backend.se2 import compose
from slam.drivers.simulators.situations import SITUATIONS, situation_drive
from slam.logs.trajectory import Trajectory

from benchmarks.buildings import judged_closures
from benchmarks.kept_runs import KeptRuns
from slam.evaluation.metrics import align
from slam.mapping.config import SlamConfig
from slam.runs.errors import SlamError
from slam.runs.offline import Result, run_offline

SEEDS = 3
SLOW = ("long-loop",)  # left out of the quick campaign


def bench_situations(out: Path, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Every situation with three seeds; one seed and no slow drives with `quick`."""
    names = [name for name in SITUATIONS if not (quick and name in SLOW)]
    return compare_situations(out, names, quick, echo, SlamConfig())


def compare_situations(
    out: Path, names: Sequence[str], quick: bool, echo: Callable[[str], None], config: SlamConfig
) -> dict[str, Any]:
    """Some situations under one configuration.

    Results are kept in `out`/situations.jsonl: the same command goes on where it was stopped.
    """
    kept = KeptRuns(out / "situations.jsonl", config)
    seeds = range(1, (1 if quick else SEEDS) + 1)
    for name in names:
        for seed in seeds:
            for trait in (True, False):
                if _run(name, seed, trait) not in kept:
                    result = drive(name, seed, trait, config)
                    echo(" ".join(f"{key}={value}" for key, value in result.items()))
                    kept.add(_run(name, seed, trait), result)
    return {"meta": {"seeds": len(seeds)}, "rows": [_row(name, seeds, kept) for name in names]}


def _run(name: str, seed: int, trait: bool) -> str:
    return f"{name} {seed} {'with' if trait else 'without'}"


def drive(name: str, seed: int, trait: bool, config: SlamConfig) -> dict[str, Any]:
    """One drive: errors of map and wheels (m), closures, what the wheels are blamed for."""
    begun = time.perf_counter()
    case = {"situation": name, "seed": seed, "trait": trait}
    try:
        result = run_offline(partial(situation_drive, name, seed, trait), config)
    except SlamError as error:
        return {**case, "failed": str(error)}
    truth = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    keyframes = np.array([truth[int(stamp)] for stamp in result.keyframes.stamps_ns])
    return {
        **case,
        "failed": "",
        "ate_m": round(ate(result.trajectory, truth), 4),
        "raw_ate_m": round(ate(result.odometry, truth), 4),
        "keyframes": len(keyframes),
        **judged_closures(result, keyframes),
        "odometry_refused": refused(result),
        "named": dict(sorted(result.slam.odometry_faults.items())),
        "wall_s": round(time.perf_counter() - begun, 1),
    }


def ate(trajectory: Trajectory, truth: dict[int, tuple[float, float, float]]) -> float:
    """Root mean square error of position after a rigid alignment, m."""
    true = np.array([truth[int(stamp)] for stamp in trajectory.stamps_ns])
    offsets: NDArray[np.float64] = compose(align(trajectory.poses, true), trajectory.poses) - true
    return float(np.sqrt(np.mean(np.sum(offsets[:, :2] ** 2, axis=1))))


def refused(result: Result) -> int:
    """Steps whose odometry was left out of the graph."""
    return sum(f.kind == "odometry" and not f.used for f in result.slam.records.factors)


def _row(name: str, seeds: Sequence[int], kept: KeptRuns) -> dict[str, Any]:
    odd = [kept[_run(name, seed, True)] for seed in seeds]
    plain = [kept[_run(name, seed, False)] for seed in seeds]
    return {
        "situation": name,
        "ate_m": [r.get("ate_m") for r in odd],
        "without_m": [r.get("ate_m") for r in plain],
        "raw_m": [r.get("raw_ate_m") for r in odd],
        "closures": sum(r.get("closures", 0) for r in odd),
        "false_closures": sum(r.get("false_closures", 0) for r in odd),
        "odometry_refused": sum(r.get("odometry_refused", 0) for r in odd),
        "refused_without": sum(r.get("odometry_refused", 0) for r in plain),
        "failed": "; ".join(sorted({r["failed"] for r in odd if r["failed"]})),
    }
