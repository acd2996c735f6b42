"""Recorded logs in the interval benchmark: with surveyed relations, and without any truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.frontend.keyframes import KeyframeConfig
from slam.frontend.match_types import Reference
from slam.frontend.matching import match
from slam.frontend.scan import VALID, prepare
from slam.logs.importers.breezyslam import read_breezyslam
from slam.logs.importers.carmen import read_carmen
from slam.logs.messages import LaserScan, Message

from benchmarks.kept_runs import KeptRuns
from benchmarks.keyframe_interval.drives import trajectory_of
from slam.evaluation.relations import read_relations, relation_errors
from slam.mapping.config import SlamConfig
from slam.mapping.slam import Slam
from slam.runs.offline import run_offline

Echo = Callable[[str], None]

SURVEYED = ("intel", "mit-csail", "mit-killian")
UNSURVEYED = ("exp1", "exp2")
COMPARED: dict[str, dict[str, Any]] = {
    "constant 0.3 m": {"method": "constant", "interval": 0.3},
    "sdp-pe": {"method": "sdp-pe"},
    "information": {"method": "information"},
}
MORE: dict[str, dict[str, Any]] = {
    "constant 0.1 m": {"method": "constant", "interval": 0.1},
    "constant 0.6 m": {"method": "constant", "interval": 0.6},
    "constant 1 m": {"method": "constant", "interval": 1.0},
    "overlap 0.7": {"method": "overlap"},
}
CELL_M = 0.05
REVISIT_M = 1.5  # keyframes as near as this, by the estimate, may look at one place
APART_M = 6.0  # of path between two visits of a place


def bench_logs(data: Path, kept: KeptRuns, echo: Echo) -> list[dict[str, Any]]:
    """Rows of the logs that are there; those with relations run with loop closure.

    Runs that are `kept` from an earlier, interrupted campaign are not made again.
    """
    rows = []
    for name in SURVEYED:
        path = data / "benchmark" / f"{name}.clf.gz"
        if not path.is_file():
            echo(f"{path}: not there, left out")
            continue
        for label, choice in COMPARED.items():
            echo(f"{name}: {label}")
            found = kept.made(f"{name}: {label}", partial(surveyed, choice, path))
            rows.append({"log": name, "setting": label, **found})
    for name in UNSURVEYED:
        path = data / "hokuyo" / f"{name}.dat.gz"
        if not path.is_file():
            echo(f"{path}: not there, left out")
            continue
        for label, choice in (COMPARED | MORE).items():
            found = kept.made(f"{name}: {label}", partial(unsurveyed, choice, path))
            rows.append({"log": name, "setting": label, **found})
    return rows


def _config(choice: dict[str, Any], loops: bool) -> SlamConfig:
    shipped = SlamConfig()
    closing = shipped.loops.model_copy(update={"enabled": loops})
    keyframes = KeyframeConfig.model_validate({**shipped.keyframes.model_dump(), **choice})
    return shipped.model_copy(update={"loops": closing, "keyframes": keyframes})


def surveyed(choice: dict[str, Any], path: Path) -> dict[str, Any]:
    """A whole run with loop closure, against the relations beside the log."""
    messages = read_carmen(path).messages
    begin = time.process_time()
    result = run_offline(lambda: messages, _config(choice, loops=True))
    cpu_s = time.process_time() - begin
    relations = read_relations(path.with_name(path.name.replace(".clf.gz", ".relations")))
    errors = relation_errors(result.trajectory, relations)
    return {
        "keyframes": len(result.slam.keyframes),
        "matches": result.slam.matches,
        "closures": sum(closure.accepted for closure in result.slam.loops.closure_results),
        "trans_mean_m": float(errors.trans_m.mean()),
        "trans_std_m": float(errors.trans_m.std()),
        "rot_mean_deg": float(errors.rot_deg.mean()),
        "rot_std_deg": float(errors.rot_deg.std()),
        "cpu_s": cpu_s,
    }


def unsurveyed(choice: dict[str, Any], path: Path) -> dict[str, Any]:
    """An open chain, judged by itself: what is left at a revisit, and how sharp the map is."""
    messages = read_breezyslam(path).messages
    slam = Slam(_config(choice, loops=False))
    begin = time.process_time()
    for message in messages:
        slam.step(message)
    slam.finish_input()
    cpu_s = time.process_time() - begin
    rows, poses = trajectory_of(slam, [m for m in messages if isinstance(m, LaserScan)], 1)
    residual_m, residual_deg, revisits = loop_residual(slam)
    return {
        "keyframes": len(slam.keyframes),
        "matches": slam.matches,
        "revisits": revisits,
        "loop_residual_m": residual_m,
        "loop_residual_deg": residual_deg,
        "map_cells": map_cells(slam, messages, rows, poses),
        "cpu_s": cpu_s,
    }


def loop_residual(slam: Slam) -> tuple[float | None, float | None, int]:
    """By how much the chain is off where a drive comes back to a place.

    Each keyframe is matched against the nearest of those that lie APART_M of path or more back.

    Returns:
        The median distance (m) and turn (deg) between the chain and these matches, None if no
        place is seen again, and the number of matches.
    """
    assert slam.graph is not None
    poses = slam.graph.poses
    travelled = np.array([k.travelled_m for k in slam.keyframes])
    rests = []
    for new in range(len(poses)):
        old = np.flatnonzero(travelled <= travelled[new] - APART_M)
        distances = np.hypot(*(poses[old, :2] - poses[new, :2]).T)
        if len(old) == 0 or distances.min() > REVISIT_M:
            continue
        nearest = int(old[distances.argmin()])
        guess = slam.graph.pose(nearest).between(slam.graph.pose(new))
        reference = Reference(Pose2(), slam.keyframes[nearest].prepared)
        found = match([reference], slam.keyframes[new].prepared, guess, slam.config.matcher)
        if found.converged and found.inlier_fraction >= slam.config.matcher.good_inlier_fraction:
            rest = guess.between(found.target_T_source)
            rests.append((float(np.hypot(rest.x(), rest.y())), abs(np.degrees(rest.theta()))))
    if not rests:
        return None, None, 0
    trans, rot = np.median(rests, axis=0).tolist()
    return trans, rot, len(rests)


def map_cells(
    slam: Slam, messages: Sequence[Message], rows: NDArray[np.int64], poses: NDArray[np.float64]
) -> int:
    """Cells of CELL_M that hold a point of any scan: the same scans fill fewer in a sharper map."""
    scans = {m.stamp_ns: m for m in messages if isinstance(m, LaserScan)}
    stamps = slam.scans.stamps_ns
    cells: set[tuple[int, int]] = set()
    for row, pose in zip(rows.tolist(), poses, strict=True):
        scan = prepare(scans[int(stamps[row])], slam.extrinsics, slam.config.scan)
        points = scan.points[(scan.flags & VALID) > 0]
        placed = Pose2(*pose).transformFrom(np.asfortranarray(points.T))
        cells.update(map(tuple, np.floor(placed / CELL_M).astype(np.int64).T.tolist()))
    return len(cells)
