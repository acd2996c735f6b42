"""`slam bench localise`: localisation in maps that were made before, on logs and in simulation."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.kept_runs import KeptRuns
from benchmarks.localise.recorded import MAPPED, recorded_row
from benchmarks.localise.simulated import MOVED, simulated_row
from slam.mapping.config import SlamConfig

LOGS = ("mit-csail", "intel")
BUILDINGS = ("office", "office-ring", "mixed", "clutter", "symmetric-corridors")
STARTS, QUICK_STARTS = 20, 3  # from nothing, on each log
SIMULATED_STARTS = 10  # in each building
SEEDS = (11, 12)  # not those that the figures of `evidence` were found with


def bench_localise(
    out: Path, data: Path | None, quick: bool, echo: Callable[[str], None]
) -> dict[str, Any]:
    """Simulated buildings, and logs if their folder is given.

    Results are kept in `out`/localise.jsonl: the same command goes on where it was stopped.
    """
    config, starts = SlamConfig(), QUICK_STARTS if quick else STARTS
    kept = KeptRuns(out / "localise.jsonl", config)
    rows = []
    for name in LOGS if data is not None else ():
        assert data is not None
        path = data / "benchmark" / f"{name}.clf.gz"
        if not path.exists():
            continue
        rows.append(kept.made(f"{name} {starts}", partial(recorded_row, path, starts, config)))
        echo(" ".join(f"{key}={value}" for key, value in rows[-1].items()))
    for seed in SEEDS[: 1 if quick else None]:
        for name in BUILDINGS:
            make = partial(simulated_row, name, seed, min(starts, SIMULATED_STARTS), config)
            rows.append(kept.made(f"{name} {seed} {starts}", make))
            echo(" ".join(f"{key}={value}" for key, value in rows[-1].items()))
    return {"meta": {"mapped": MAPPED, "moved": MOVED, "starts": starts}, "rows": rows}
