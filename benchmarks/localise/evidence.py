"""`slam bench evidence`: what scans show at right poses of a finished map, and at wrong ones.

From these rows come the figures of `slam.mapping.localisation.evidence`.  A wrong pose is one that
a search of the whole map brings up and a match makes the best of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from gtsam import Pose2
from slam.frontend.agreement import Agreement
from slam.frontend.match_types import Prior
from slam.frontend.matching import match
from slam.frontend.scan import PreparedScan
from slam.logs.messages import LaserScan

from benchmarks.localise.judge import is_wrong
from benchmarks.localise.simulated import MOVED, Building, build
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import preparer
from slam.mapping.localisation.evidence import scan_evidence
from slam.mapping.localisation.fixed_map import FixedMap
from slam.mapping.localisation.global_search import SEED, GlobalSearch

BUILDINGS = ("office", "office-ring", "clutter", "mixed", "symmetric-corridors")
SEEDS = (1, 2)
EVERY, SEARCH_EVERY = 15, 60  # scans


def bench_evidence(quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Every building as it was mapped, and with a share of its things moved."""
    rows = []
    for name in BUILDINGS[: 1 if quick else None]:
        for moved in (0.0, MOVED):
            right: list[Agreement] = []
            wrong: list[Agreement] = []
            for seed in SEEDS[: 1 if quick else None]:
                _collect(build(name, seed, moved, SlamConfig()), right, wrong)
            rows += [_row(name, moved, "right", right), _row(name, moved, "wrong", wrong)]
            echo(f"{name}, {moved:.0%} moved: {len(right)} right poses, {len(wrong)} wrong ones")
    return {"meta": {"seeds": list(SEEDS)}, "rows": rows}


def _collect(building: Building, right: list[Agreement], wrong: list[Agreement]) -> None:
    config = SlamConfig()
    prepare = preparer(config.scan)
    fixed_map = FixedMap(building.prior.keyframes, building.prior.poses)
    search = GlobalSearch(fixed_map, config.localise.neighbours, config.matcher)
    scans = [m for m in building.messages if isinstance(m, LaserScan)]
    for k, scan in enumerate(scans[::EVERY]):
        prepared, true = prepare(scan, building.prior.extrinsics), building.truth[scan.stamp_ns]
        at = _matched(prepared, true, fixed_map, config)
        if at is not None and not _is_wrong(true, at):
            right.append(fixed_map.seen(prepared, at, config.matcher))
        if k % (SEARCH_EVERY // EVERY) == 0:
            found = [h.pose for h in search(prepared) if _is_wrong(true, h.pose)]
            wrong += [fixed_map.seen(prepared, pose, config.matcher) for pose in found]


def _matched(
    scan: PreparedScan, pose: Pose2, fixed_map: FixedMap, config: SlamConfig
) -> Pose2 | None:
    base, references = fixed_map.near(scan, pose, config.localise.neighbours)
    prior = Prior(base.between(pose), SEED)
    result = match(references, scan, prior.target_T_source, config.matcher, prior)
    return base * result.target_T_source if result.converged else None


def _is_wrong(true: Pose2, pose: Pose2) -> bool:
    error = true.between(pose)
    off = np.array([[np.hypot(error.x(), error.y()), abs(error.theta())]])
    return bool(is_wrong(off)[0])


def _row(name: str, moved: float, pose: str, seen: Sequence[Agreement]) -> dict[str, Any]:
    counts = np.array(seen).reshape(-1, 3)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1e-9)
    nats = [scan_evidence(one) for one in seen]
    p5, p50, p95 = np.percentile(nats, [5, 50, 95]) if nats else [np.nan] * 3
    fitting, new, contradicting = shares.mean(axis=0) if len(seen) else [np.nan] * 3
    return {
        "building": name, "moved": moved, "pose": pose, "poses": len(seen),
        "fitting": float(fitting), "new": float(new), "contradicting": float(contradicting),
        "nats_p5": float(p5), "nats_p50": float(p50), "nats_p95": float(p95),
    }  # fmt: skip
