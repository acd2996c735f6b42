"""`slam bench buildings`: simulated buildings with loops, with and without odometry faults."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.backend.se2 import compose
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.faults import FaultKind, OdometryFault
from slam.drivers.simulators.worlds import scenario

from benchmarks.kept_runs import KeptRuns
from slam.evaluation.metrics import align
from slam.mapping.config import SlamConfig
from slam.runs.offline import Result, run_offline

BUILDINGS = ("office-ring", "symmetric-corridors", "clutter")
FAULTS: tuple[FaultKind, ...] = ("sign-flip", "stall", "jump", "slip", "scan-gap")
SEEDS = 20

FALSE_M, FALSE_RAD = 0.3, 0.15  # a closure that errs by more joins what does not belong together
# A keyframe revisits where an older one, this much path ago, stood so near and looked alike.
AGO_M, NEAR_M, ALIKE_RAD = 8.0, 1.0, np.radians(45.0)
CLOSED_M = 2.0  # m of path from a revisit to the closure that uses it

Case = tuple[str, int, FaultKind | None]  # building, seed, fault
Matrix = NDArray[np.float64]


def bench_buildings(out: Path, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Drive every building with the shipped configuration and judge maps and closures by truth.

    Twenty seeds, without a fault and with each; with `quick` one.  Each drive is written down in
    `out` as it ends: after an interruption the same command does only the rest.
    """
    seeds = range(1, (1 if quick else SEEDS) + 1)
    cases: list[Case] = [(building, seed, None) for seed in seeds for building in BUILDINGS]
    cases += [
        (building, seed, fault)
        for seed in seeds for building in BUILDINGS for fault in FAULTS
    ]  # fmt: skip
    kept = KeptRuns(out / "buildings.jsonl")
    rest = [case for case in cases if _name(case) not in kept]
    workers = min(len(os.sched_getaffinity(0)), len(rest))
    if rest:
        with multiprocessing.get_context("spawn").Pool(workers) as pool:
            for case, run in zip(rest, pool.imap(drive, rest), strict=True):
                echo(" ".join(f"{key}={_short(value)}" for key, value in run.items()))
                kept.add(_name(case), run)
    runs = [kept[_name(case)] for case in cases]
    meta = {
        "closure_false_beyond": [FALSE_M, FALSE_RAD],
        "revisit_within": [NEAR_M, float(ALIKE_RAD)],
        "runs": runs,
    }
    return {"meta": meta, "rows": summary_rows(runs)}


def _name(case: Case) -> str:
    building, seed, fault = case
    return f"{building}, seed {seed}, {fault or 'no fault'}"


def drive(case: Case) -> dict[str, Any]:
    """One drive: its error, its closures judged by truth, and the faults that were named."""
    building, seed, fault = case
    begin = 0.0 if fault == "sign-flip" else 29.0 + 3.0 * seed  # driving in all of them
    faults = [] if fault is None else [OdometryFault(fault, at_s=begin)]
    source = partial(simulate, scenario(building, seed), seed=seed, faults=faults)
    result = run_offline(source, SlamConfig())
    truth = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    true = np.array([truth[int(stamp)] for stamp in result.trajectory.stamps_ns])
    offsets = compose(align(result.trajectory.poses, true), result.trajectory.poses) - true
    keyframes = np.array([truth[int(stamp)] for stamp in result.keyframes.stamps_ns])
    return {
        "building": building,
        "seed": seed,
        "fault": fault or "none",
        "ate_m": float(np.sqrt(np.mean(np.sum(offsets[:, :2] ** 2, axis=1)))),
        "keyframes": len(keyframes),
        **judged_closures(result, keyframes),
        "named": dict(sorted(result.slam.odometry_faults.items())),
        "odometry_refused": sum(
            f.kind == "odometry" and not f.used for f in result.slam.records.factors
        ),
        "lost_keyframes": sum(e.lost for e in result.slam.records.estimates),
    }


def judged_closures(result: Result, true: Matrix) -> dict[str, int]:
    """Closures of the final graph and those removed, judged; revisits and those closed.

    `true` (n, 3) are the keyframes' true poses.
    """
    accepted = [
        f for f in result.slam.records.factors
        if f.kind == "loop" and (f.used or f.note.startswith("removed"))
    ]  # fmt: skip
    final = [f for f in accepted if f.used]
    wrong = [
        f for f in final
        if _is_false(Pose2(f.x, f.y, f.theta), Pose2(*true[f.i]).between(Pose2(*true[f.j])))
    ]  # fmt: skip
    path = np.array([k.travelled_m for k in result.slam.keyframes])
    revisiting = revisits(true, path)
    closed_at = path[sorted({f.j for f in final})]
    closed = [
        k for k in revisiting if len(closed_at) and np.abs(closed_at - path[k]).min() <= CLOSED_M
    ]
    return {
        "closures": len(final),
        "false_closures": len(wrong),
        "withdrawn": len(accepted) - len(final),
        "revisits": len(revisiting),
        "revisits_closed": len(closed),
    }


def _is_false(measured: Pose2, true: Pose2) -> bool:
    error = measured.between(true)
    return bool(np.hypot(error.x(), error.y()) > FALSE_M or abs(error.theta()) > FALSE_RAD)


def revisits(true: Matrix, path: Matrix) -> list[int]:
    """Keyframes, of poses (n, 3) and path lengths (n,), that stand where an older one stood."""
    found = []
    for k in range(len(true)):
        old = true[: np.searchsorted(path, path[k] - AGO_M)]
        near = np.hypot(*(old[:, :2] - true[k, :2]).T) < NEAR_M
        turn = np.abs(np.angle(np.exp(1j * (old[:, 2] - true[k, 2]))))
        if (near & (turn < ALIKE_RAD)).any():
            found.append(k)
    return found


def summary_rows(runs: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each building and fault, over all seeds."""
    clean = {(r["building"], r["seed"]): r["ate_m"] for r in runs if r["fault"] == "none"}
    rows = []
    for building in BUILDINGS:
        for fault in ("none", *FAULTS):
            group = [r for r in runs if (r["building"], r["fault"]) == (building, fault)]
            if group:
                rows.append(_row(building, fault, group, clean))
    return rows


def _row(
    building: str, fault: str, group: Sequence[dict[str, Any]], clean: dict[Any, float]
) -> dict[str, Any]:
    errors = [r["ate_m"] for r in group]
    closures, wrong = (sum(r[key] for r in group) for key in ("closures", "false_closures"))
    seen, closed = (sum(r[key] for r in group) for key in ("revisits", "revisits_closed"))
    named = [r["named"].get(fault, 0) > 0 for r in group]
    other = sum(n for r in group for kind, n in r["named"].items() if kind != fault)
    return {
        "building": building,
        "fault": fault,
        "seeds": len(group),
        "ate_m_median": float(np.median(errors)),
        "ate_m_max": max(errors),
        "ate_ratio_median": float(
            np.median([r["ate_m"] / clean[building, r["seed"]] for r in group])
        ),
        "closures": closures,
        "precision": 1.0 - wrong / closures if closures else 1.0,
        "recall": closed / seen if seen else 1.0,
        "runs_named": "" if fault == "none" else f"{sum(named)}/{len(named)}",
        "other_named": other,  # faults that were not there
        "keyframes": sum(r["keyframes"] for r in group),
    }


def _short(value: Any) -> str:
    return f"{value:.4f}" if isinstance(value, float) else str(value).replace(" ", "")
