"""`slam bench pareto`: error against matches and processor time, for every way to choose keyframes.

A constant interval is good in one place and bad in the next.  The yardstick of a method that
chooses by itself is therefore the best constant interval of each world, chosen in hindsight.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from slam.bench.pareto_drives import (
    LONGEST_M,
    WORLDS,
    Outcome,
    Setting,
    outcomes_of,
    settings,
    warm_up,
)
from slam.bench.pareto_figures import draw_pareto
from slam.bench.pareto_logs import bench_logs

Say = Callable[[str], None]
Outcomes = dict[str, dict[Setting, list[Outcome]]]  # by world, in the order of the seeds

SEEDS, QUICK_SEEDS = 30, 2
FIRST_SEED = 2000  # no drive of these seeds was looked at while the methods were made
RESAMPLES = 2000
WORKERS = 2
JUDGED = ("information", "information-permuted", "sdp-pe")


def bench_pareto(out: Path, data: Path, quick: bool, say: Say) -> dict[str, Any]:
    """Run all settings in all worlds, and a few on the recorded logs found in `data`.

    Draws `pareto.png` into `out`.  `quick` leaves the logs out.
    """
    seeds = QUICK_SEEDS if quick else SEEDS
    say(f"{len(WORLDS)} worlds, {seeds} drives of up to {LONGEST_M:g} m each")
    outcomes = _drive_all(seeds)
    rows = [
        row(world, setting, found)
        for world, by_setting in outcomes.items()
        for setting, found in by_setting.items()
    ]
    verdicts = [v for world in outcomes for v in judged(world, outcomes[world])]
    out.mkdir(parents=True, exist_ok=True)
    draw_pareto(rows, out / "pareto.png")
    say(f"figure: {out / 'pareto.png'}")
    _show(verdicts)
    logs = [] if quick else bench_logs(data, say)
    meta = {
        "seeds": seeds,
        "first_seed": FIRST_SEED,
        "longest_m": LONGEST_M,
        "against_best_constant": verdicts,
    }
    return {"meta": meta, "rows": rows, "logs": logs}


def _drive_all(seeds: int) -> Outcomes:
    """All drives, on up to WORKERS processes; the result does not depend on their number."""
    compared = settings()
    done: dict[tuple[str, int], list[Outcome]] = {}
    workers = min(WORKERS, os.cpu_count() or 1)
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task("drives", total=seeds * len(WORLDS))
        with ProcessPoolExecutor(workers, get_context("spawn"), warm_up) as pool:
            waiting = {
                pool.submit(outcomes_of, world, seed, compared): (world, seed)
                for seed in range(FIRST_SEED, FIRST_SEED + seeds)
                for world in WORLDS
            }
            for future in as_completed(waiting):
                done[waiting[future]] = future.result()
                progress.advance(task)
    return {
        world: {
            setting: [done[world, FIRST_SEED + seed][k] for seed in range(seeds)]
            for k, setting in enumerate(compared)
        }
        for world in WORLDS
    }


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
        "ate_m_ci95": interval95(np.median(errors[_draws(len(errors))], axis=1)),
        "ate_m_mean": float(np.mean(errors)),
        "keyframe_ate_m_median": float(np.median([o.keyframe_ate_m for o in outcomes])),
        "cpu_ms_median": float(np.median([outcome.cpu_ms for outcome in outcomes])),
    }


def judged(world: str, outcomes: dict[Setting, list[Outcome]]) -> list[dict[str, Any]]:
    """Methods against the best constant interval of the world, chosen in hindsight.

    Ratios below one speak for the method.  The interval of the error's ratio comes from drawing
    the same seeds for both; the luck of the best of many constants is not taken out of it.
    """
    medians = {s: float(np.median([o.ate_m for o in of])) for s, of in outcomes.items()}
    best = min((s for s in outcomes if s.method == "constant"), key=medians.__getitem__)
    other = np.array([o.ate_m for o in outcomes[best]])
    draws = _draws(len(other))
    verdicts = []
    for setting in outcomes:
        if setting.method not in JUDGED:
            continue
        own = np.array([o.ate_m for o in outcomes[setting]])
        ratios = np.median(own[draws], axis=1) / np.median(other[draws], axis=1)
        matches = [float(np.median([o.matches for o in outcomes[s]])) for s in (setting, best)]
        verdicts.append(
            {
                "world": world,
                "method": setting.method,
                "best_constant": best.label,
                "error_ratio": medians[setting] / medians[best],
                "error_ratio_ci95": interval95(ratios),
                "matches_ratio": matches[0] / matches[1],
            }
        )
    return verdicts


def _draws(count: int) -> NDArray[np.int64]:
    return np.random.default_rng(0).integers(0, count, (RESAMPLES, count))


def interval95(values: NDArray[np.float64]) -> list[float]:
    """The middle 95 % of bootstrapped values."""
    low, high = np.percentile(values, [2.5, 97.5])
    return [float(low), float(high)]


def _show(verdicts: Sequence[dict[str, Any]]) -> None:
    table = Table(title="against the best constant interval of each world, chosen in hindsight")
    for heading in ("world", "method", "best constant", "error ratio", "95 %", "matches ratio"):
        table.add_column(heading)
    for v in verdicts:
        low, high = v["error_ratio_ci95"]
        table.add_row(
            v["world"], v["method"], v["best_constant"], f"{v['error_ratio']:.2f}",
            f"{low:.2f} to {high:.2f}", f"{v['matches_ratio']:.2f}",
        )  # fmt: skip
    Console().print(table)
