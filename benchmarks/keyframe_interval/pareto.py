"""`slam bench pareto`: error against matches and processor time, for every way to choose keyframes.

A constant interval is good in one place and bad in the next.  The yardstick of a method that
chooses by itself is therefore the best constant interval of each world, chosen in hindsight.
Drives that are done are kept in the output folder, so that a campaign can be gone on with.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from slam.logs.atomic_write import atomic_write

from benchmarks.kept_runs import KeptRuns
from benchmarks.keyframe_interval.counter import counter_test
from benchmarks.keyframe_interval.drives import (
    LONGEST_M,
    WORLDS,
    Outcome,
    Setting,
    outcomes_of,
    settings,
    warm_up,
)
from benchmarks.keyframe_interval.figures import draw_pareto
from benchmarks.keyframe_interval.judge import draws, interval95, judged
from benchmarks.keyframe_interval.logs import bench_logs
from benchmarks.spread import spread
from slam.mapping.config import SlamConfig

Echo = Callable[[str], None]
Outcomes = dict[str, dict[Setting, list[Outcome]]]  # by world, in the order of the seeds

SEEDS, QUICK_SEEDS = 30, 2
FIRST_SEED = 2000  # no drive of these seeds was looked at while the methods were made
KEPT = "pareto-drives"  # folder of the drives that are done
KEPT_LOGS = "pareto-logs.jsonl"


@dataclass(frozen=True, slots=True)
class Job:
    """One drive under every setting, and where its outcomes are kept."""

    world: str
    seed: int
    kept: Path


def bench_pareto(
    out: Path, data: Path | None, quick: bool, echo: Echo, workers: int = 0
) -> dict[str, Any]:
    """Run all settings in all worlds, and a few on the recorded logs found in `data`.

    Draws `pareto.png` into `out`.  `data` holds `benchmark/` and `hokuyo/` with the logs; `quick`
    leaves them out.
    """
    if data is None and not quick:
        echo("without --data the recorded logs are left out")
    seeds = QUICK_SEEDS if quick else SEEDS
    echo(f"{len(WORLDS)} worlds, {seeds} drives of up to {LONGEST_M:g} m each")
    outcomes = _drive_all(out, seeds, echo, workers)
    rows = [
        row(world, setting, found)
        for world, by_setting in outcomes.items()
        for setting, found in by_setting.items()
    ]
    closure_results = [v for world in outcomes for v in judged(world, outcomes[world])]
    draw_pareto(rows, out / "pareto.png")
    echo(f"figure: {out / 'pareto.png'}")
    _show(closure_results)
    counter = counter_test(outcomes)
    _show_counter(counter)
    logs = [] if quick or data is None else bench_logs(data, KeptRuns(out / KEPT_LOGS), echo)
    meta = {
        "seeds": seeds,
        "first_seed": FIRST_SEED,
        "longest_m": LONGEST_M,
        "against_best_constant": closure_results,
        "counter_test": counter,
    }
    return {"meta": meta, "rows": rows, "logs": logs}


def _drive_all(out: Path, seeds: int, echo: Echo, workers: int) -> Outcomes:
    """All drives; the result does not depend on the number of workers."""
    kept = out / KEPT
    kept.mkdir(parents=True, exist_ok=True)
    numbers = range(FIRST_SEED, FIRST_SEED + seeds)
    jobs = [Job(world, seed, kept) for seed in numbers for world in WORLDS]
    echo(f"drives that are done are kept in {kept}")
    done = dict(zip(((j.world, j.seed) for j in jobs), spread(drive, jobs, workers), strict=True))
    return {
        world: {
            setting: [done[world, seed][k] for seed in numbers]
            for k, setting in enumerate(settings())
        }
        for world in WORLDS
    }


def drive(job: Job) -> list[Outcome]:
    """The outcomes of one drive, made now unless they are kept from the same configuration."""
    compared = settings()
    path = job.kept / f"{job.world}-{job.seed}.json"
    made_with = {"config": SlamConfig().sha256(), "settings": [repr(s) for s in compared]}
    if path.is_file():
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["made_with"] == made_with:
            return [Outcome(**outcome) for outcome in found["outcomes"]]
    _warm()
    outcomes = outcomes_of(job.world, job.seed, compared)
    text = json.dumps({"made_with": made_with, "outcomes": [asdict(o) for o in outcomes]})
    atomic_write(path, text + "\n")
    return outcomes


@cache
def _warm() -> None:
    warm_up()


def row(world: str, setting: Setting, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Medians over the seeds; 95 % intervals are bootstrapped."""
    errors = np.array([outcome.ate_m for outcome in outcomes])
    return {
        "world": world,
        "method": setting.method,
        "setting": setting.label,
        "seeds": len(outcomes),
        "matches_median": float(np.median([outcome.matches for outcome in outcomes])),
        "keyframes_median": float(np.median([outcome.keyframes for outcome in outcomes])),
        "ate_m_median": float(np.median(errors)),
        "ate_m_ci95": interval95(np.median(errors[draws(len(errors))], axis=1)),
        "ate_m_mean": float(np.mean(errors)),
        "ate_m_geometric_mean": float(np.exp(np.mean(np.log(errors)))),
        "keyframe_ate_m_median": float(np.median([o.keyframe_ate_m for o in outcomes])),
        "cpu_ms_median": float(np.median([outcome.cpu_ms for outcome in outcomes])),
    }


def _with_interval(value: float, interval: Sequence[float]) -> str:
    low, high = interval
    return f"{value:.2f} ({low:.2f} to {high:.2f})"


def _show_counter(rows: Sequence[dict[str, Any]]) -> None:
    table = Table(title="counter-test: error of a blind choice with as many matches, and permuted")
    pairs = ("blind_to_information", "blind_to_permuted", "permuted_to_information")
    for heading in ("world", *(label.replace("_to_", " / ") for label in pairs)):
        table.add_column(heading)
    for found in rows:
        cells = (_with_interval(found[p], found[f"{p}_ci95"]) for p in pairs)
        table.add_row(found["world"], *cells)
    Console().print(table)


def _show(closure_results: Sequence[dict[str, Any]]) -> None:
    table = Table(title="against constant intervals chosen in hindsight: error, matches")
    for heading in ("world", "method", "best", "error", "95 %", "other seeds", "matches",
                    "longest tied", "error", "matches"):  # fmt: skip
        table.add_column(heading)
    for v in closure_results:
        low, high = v["error_ratio_ci95"]
        table.add_row(
            v["world"], v["method"], v["best_constant"], f"{v['error_ratio']:.2f}",
            f"{low:.2f} to {high:.2f}", f"{v['error_ratio_other_seeds']:.2f}",
            f"{v['matches_ratio']:.2f}", v["longest_tied_constant"],
            f"{v['longest_tied_error_ratio']:.2f}", f"{v['longest_tied_matches_ratio']:.2f}",
        )  # fmt: skip
    Console().print(table)
