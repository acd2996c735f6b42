"""`slam bench places`: how often place recognition names the right place, log by log.

Poses are those of a finished run or of a reference trajectory; the descriptors themselves see
nothing of where a place is.  A revisit is a place with an older one within NEAR; it counts as
recognised at rank k if one of the first k answers is within NEAR with the heading right.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.frontend.place_descriptor import PlaceConfig, PlaceIndex, Spectrum, describe, thinned
from slam.frontend.scan import PreparedScan, ScanConfig, prepare
from slam.logs.mcap_log import open_log
from slam.logs.messages import LaserExtrinsics, LaserScan
from slam.logs.trajectory import read_tum

from benchmarks.benchmark import logs_in
from slam.evaluation.relations import nearest_rows
from slam.evaluation.report.read_run import read_run
from slam.runs.errors import RunError
from slam.tools.imports import import_log

NEAR = 2.0  # m: what a small search about the answer still covers
HEADING = np.radians(15.0)  # the same of the heading
RANKS = (1, 10, 50)
STAMP_GAP_S = 0.02  # between a pose and its scan; keyframe logs round theirs
CENTRED = LaserExtrinsics(0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """Keyframes whose poses are known, in the order of the drive."""

    name: str
    poses: NDArray[np.float64]  # (n, 3) map_T_base
    scans: list[PreparedScan]


def bench_places(data: Path, quick: bool, echo: Callable[[str], None]) -> dict[str, Any]:
    """Recall of place recognition on every log with known poses.

    With `quick`, only logs that bring a reference trajectory, which need no replay.

    Raises:
        RunError: no log is there, or a replay fails.
    """
    config, rows = PlaceConfig(), []
    references = sorted((data / "keyframes").glob("*.ref.tum"))
    replayed = [] if quick else logs_in(data / "benchmark")
    if not references and not replayed:
        raise RunError(f"{data}: no keyframes/NAME.ref.tum and no benchmark/NAME.clf.gz")
    with tempfile.TemporaryDirectory() as scratch:
        for path in references:
            echo(f"reading {path.name}")
            rows.append(recall(referenced(path, Path(scratch)), config))
        for name in replayed:
            echo(f"replaying {name}")
            rows.append(recall(replayed_log(data / "benchmark" / name, Path(scratch)), config))
    meta = {"near_m": NEAR, "heading_deg": np.degrees(HEADING), "config": config._asdict()}
    return {"meta": meta, "rows": rows}


def referenced(reference: Path, scratch: Path) -> Drive:
    """A log of keyframes beside its reference trajectory NAME.ref.tum."""
    name = reference.name.removesuffix(".ref.tum")
    log = scratch / f"{name}.mcap"
    import_log(reference.with_name(f"{name}.keyframes.clf.gz"), log)
    with open_log(log) as opened:
        messages = list(opened.messages(("/scan", "/tf")))
    scans = [m for m in messages if isinstance(m, LaserScan)]
    extrinsics = next((m for m in messages if isinstance(m, LaserExtrinsics)), CENTRED)
    truth = read_tum(reference)
    stamps = np.array([s.stamp_ns for s in scans], dtype=np.int64)
    rows, near = nearest_rows(stamps, truth.stamps_ns, STAMP_GAP_S)
    kept = [prepare(scans[k], extrinsics, ScanConfig()) for k in rows[near]]
    return Drive(name, truth.poses[near], kept)


def replayed_log(stem: Path, scratch: Path) -> Drive:
    """A log NAME.clf.gz and the trajectory that the shipped configuration makes of it."""
    log, run = scratch / f"{stem.name}.mcap", scratch / stem.name
    import_log(stem.with_name(f"{stem.name}.clf.gz"), log)
    command = [sys.executable, "-m", "slam", "replay", str(log), "--out", str(run)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        raise RunError(f"{stem.name}: replay failed: {done.stderr.strip().splitlines()[-1]}")
    return finished(run, stem.name)


def finished(directory: Path, name: str) -> Drive:
    """The keyframes of a finished run."""
    run = read_run(directory)
    extrinsics = run.records.extrinsics or CENTRED
    scans = {scan.stamp_ns: scan for scan in run.records.scans}
    keyframes = run.keyframes
    if keyframes is None:
        raise RunError(f"{directory}: holds no keyframes.tum")
    kept = [k for k, stamp in enumerate(keyframes.stamps_ns.tolist()) if stamp in scans]
    stamps = keyframes.stamps_ns[kept].tolist()
    prepared = [prepare(scans[stamp], extrinsics, ScanConfig()) for stamp in stamps]
    return Drive(name, keyframes.poses[kept], prepared)


def recall(drive: Drive, config: PlaceConfig) -> dict[str, Any]:
    """One row: shares of revisits recognised, same way and reverse, and what it costs."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(drive.poses[:, :2], axis=0).T))])
    anchors = _anchors(way, config.every_m)
    begun = time.perf_counter()
    descriptors = [describe(_submap(drive, way, anchor, config), config) for anchor in anchors]
    described = time.perf_counter()
    index = PlaceIndex(config)
    for descriptor in descriptors:
        index.add(descriptor)
    ranks, queried = _ranks(drive.poses[anchors], way[anchors], descriptors, index)
    row: dict[str, Any] = {"log": drive.name, "places": len(anchors)}
    for kind, found in ranks.items():
        row[f"{kind}_revisits"] = len(found)
        for rank in RANKS:
            share = float(np.mean(np.array(found) < rank)) if found else None
            row[f"{kind}_among_{rank}"] = share
    row["describe_us"] = 1e6 * (described - begun) / len(anchors)
    row["query_us"] = queried
    return row


def _anchors(way: NDArray[np.float64], every: float) -> list[int]:
    anchors, last = [], -np.inf
    for k, metres in enumerate(way.tolist()):
        if metres - last >= every:
            anchors.append(k)
            last = metres
    return anchors


def _submap(
    drive: Drive, way: NDArray[np.float64], anchor: int, config: PlaceConfig
) -> list[tuple[Pose2, PreparedScan]]:
    first = int(np.searchsorted(way, way[anchor] - config.behind))
    last = int(np.searchsorted(way, way[anchor] + config.ahead, side="right"))
    poses = [Pose2(*drive.poses[k]) for k in range(first, last)]
    kept = thinned(poses, config)
    base = Pose2(*drive.poses[anchor])
    return [(base.between(poses[k]), drive.scans[first + k]) for k in kept]


def _ranks(
    poses: NDArray[np.float64], way: NDArray[np.float64], descriptors: Sequence[Spectrum],
    index: PlaceIndex,
) -> tuple[dict[str, list[int]], float]:  # fmt: skip
    """Rank of the right place of every revisit, and microseconds for 2000 places."""
    config = index.config
    found: dict[str, list[int]] = {"same": [], "reverse": [], "across": []}
    compared, spent = 0, 0.0
    for k, (pose, metres) in enumerate(zip(poses, way, strict=True)):
        # Submaps that share keyframes are no revisit.
        old = int(np.searchsorted(way, metres - config.behind - config.ahead))
        near = np.hypot(*(poses[:old, :2] - pose[:2]).T) < NEAR
        if not near.any():
            continue
        turn = _wrapped(pose[2] - poses[:old, 2])
        begun = time.perf_counter()
        answers = index.recognise(descriptors[k], old, RANKS[-1], 0)
        spent, compared = spent + time.perf_counter() - begun, compared + old
        right = [
            bool(near[a.place] and abs(_wrapped(a.turn - turn[a.place])) < HEADING) for a in answers
        ]
        found[_kind(np.abs(turn[near]))].append(right.index(True) if any(right) else RANKS[-1])
    return found, 2000 * 1e6 * spent / max(compared, 1)


def _kind(turns: NDArray[np.float64]) -> str:
    if (turns < np.pi / 4).any():
        return "same"
    return "reverse" if (turns > 3 * np.pi / 4).any() else "across"


def _wrapped(angle: Any) -> Any:
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi
