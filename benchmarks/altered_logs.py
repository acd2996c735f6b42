"""`slam bench altered-logs`: public logs made worse, against themselves and raw odometry."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from slam.logs.importers.detect import read_any
from slam.logs.messages import Message
from slam.logs.trajectory import Trajectory, read_tum

from benchmarks.alterations import ALTERATIONS, mirrored_back
from benchmarks.kept_runs import KeptRuns
from benchmarks.situations import refused
from slam.evaluation.metrics import absolute_errors, align, associate
from slam.evaluation.relations import Relations, read_relations, relation_errors
from slam.mapping.config import SlamConfig
from slam.runs.errors import RunError, SlamError
from slam.runs.offline import run_offline

SEED = 1
STAMP_GAP_S = 0.02  # between a pose and its scan; keyframe logs round theirs
QUICK = ("freiburg-101",)


@dataclass(frozen=True, eq=False, slots=True)
class _KnownLog:
    """A log's messages and what is known of its trajectory."""

    messages: list[Message]
    truth: Relations | Trajectory


def bench_altered_logs(
    out: Path, data: Path, quick: bool, echo: Callable[[str], None]
) -> dict[str, Any]:
    """Every log of `data` with each alteration; one short log with `quick`.

    Raises:
        RunError: no log is there.
    """
    names = QUICK if quick else known_logs(data)
    return compare_alterations(out, data, names, echo, SlamConfig())


def compare_alterations(
    out: Path, data: Path, names: Sequence[str], echo: Callable[[str], None], config: SlamConfig
) -> dict[str, Any]:
    """Some logs under one configuration.

    Results are kept in `out`/altered-logs.jsonl: the same command goes on where it was stopped.

    Raises:
        RunError: no log is there.
    """
    if not names:
        raise RunError(f"{data}: no benchmark/NAME.relations and no keyframes/NAME.ref.tum")
    kept = KeptRuns(out / "altered-logs.jsonl", config)
    for name in names:
        rest = [kind for kind in ALTERATIONS if f"{name} {kind}" not in kept]
        log = _read(data, name) if rest else None
        for kind in rest:
            assert log is not None
            result = replay(name, log, kind, config)
            echo(" ".join(f"{key}={value}" for key, value in result.items()))
            kept.add(f"{name} {kind}", result)
    rows = [_row(name, kind, kept) for name in names for kind in ALTERATIONS]
    return {"meta": {"seed": SEED}, "rows": rows}


def known_logs(data: Path) -> list[str]:
    """Names of all logs whose trajectory is known, the short ones first."""
    paths = [*data.glob("keyframes/*.ref.tum"), *data.glob("benchmark/*.relations")]
    names = {p.name.removesuffix(".ref.tum").removesuffix(".relations"): p for p in paths}
    return sorted(names, key=lambda name: (_log_path(data, name).stat().st_size, name))


def _log_path(data: Path, name: str) -> Path:
    keyframes = data / "keyframes" / f"{name}.keyframes.clf.gz"
    return keyframes if keyframes.exists() else data / "benchmark" / f"{name}.clf.gz"


def _read(data: Path, name: str) -> _KnownLog:
    messages: list[Message] = [message for message, _ in read_any(_log_path(data, name)).received()]
    reference = data / "keyframes" / f"{name}.ref.tum"
    if reference.exists():
        return _KnownLog(messages, read_tum(reference))
    return _KnownLog(messages, read_relations(data / "benchmark" / f"{name}.relations"))


def replay(name: str, log: _KnownLog, kind: str, config: SlamConfig) -> dict[str, Any]:
    """One run: its error and raw odometry's, in m (mean of relations, or ATE)."""
    begun = time.perf_counter()
    altered = ALTERATIONS[kind](log.messages, SEED)
    case = {"log": name, "alteration": kind}
    try:
        result = run_offline(lambda: altered, config)
    except SlamError as error:
        return {**case, "failed": str(error)}
    mirror = kind == "mirrored"
    return {
        **case,
        "failed": "",
        "error_m": error_m(result.trajectory, log.truth, mirror),
        "raw_m": error_m(result.odometry, log.truth, mirror),
        "odometry_refused": refused(result),
        "wall_s": round(time.perf_counter() - begun, 1),
    }


def error_m(trajectory: Trajectory, truth: Relations | Trajectory, mirror: bool) -> float:
    """Mean error of relations, or absolute trajectory error after alignment, m."""
    if mirror:
        trajectory = Trajectory(trajectory.stamps_ns.copy(), mirrored_back(trajectory.poses))
    if isinstance(truth, Relations):
        return round(float(np.mean(relation_errors(trajectory, truth).trans_m)), 5)
    pairs = associate(trajectory, truth, STAMP_GAP_S)
    errors = absolute_errors(pairs, align(pairs.estimate.poses, pairs.truth.poses))
    return round(float(np.sqrt(np.mean(errors.trans_m**2))), 5)


def _row(name: str, kind: str, kept: KeptRuns) -> dict[str, Any]:
    result, plain = kept[f"{name} {kind}"], kept[f"{name} none"]
    ours, without = result.get("error_m"), plain.get("error_m")
    return {
        "log": name,
        "alteration": kind,
        "error_m": ours,
        "unaltered_m": without,
        "ratio": ours / without if ours is not None and without else None,
        "raw_m": result.get("raw_m"),
        "odometry_refused": result.get("odometry_refused"),
        "failed": result["failed"],
    }
