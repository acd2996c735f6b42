"""A recorded log: mapped in its first part, localised in the rest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray
from slam.backend.se2 import between, compose
from slam.logs.importers.detect import read_any
from slam.logs.messages import LaserExtrinsics, Message

from benchmarks.localise.judge import (
    START_M,
    is_inside,
    located,
    scan_stamps,
    start_from,
    starts_row,
    track_row,
)
from slam.mapping.config import SlamConfig
from slam.mapping.relocalise import PriorMap
from slam.runs.offline import run_offline

Matrix = NDArray[np.float64]

MAPPED = 0.6  # of the scans make the map
TURN_M = 1.0  # m a radian: a keyframe that looks elsewhere is as far as that
INSIDE_SHARE = 0.8  # of the way after a start that must lie inside the map


@dataclass(frozen=True, eq=False, slots=True)
class Halves:
    """A map of the first part, the messages of the rest, and where full SLAM has its scans."""

    prior: PriorMap
    messages: list[Message]
    truth: dict[int, Pose2]  # by stamp, in the frame of the map


def halves(path: Path, config: SlamConfig) -> Halves:
    """Split a log and map both its first part and the whole of it."""
    messages: list[Message] = [message for message, _ in read_any(path).received()]
    stamps = scan_stamps(messages)
    cut = stamps[int(MAPPED * len(stamps))]
    first = [m for m in messages if m.stamp_ns <= cut]
    rest = [m for m in messages if m.stamp_ns > cut or isinstance(m, LaserExtrinsics)]
    part, whole = run_offline(lambda: first, config), run_offline(lambda: messages, config)
    rows = np.searchsorted(whole.trajectory.stamps_ns, part.keyframes.stamps_ns)
    truth = {
        stamp: Pose2(*pose)
        for stamp, pose in zip(
            whole.trajectory.stamps_ns.tolist(),
            in_frame_of(part.keyframes.poses, whole.trajectory.poses[rows], whole.trajectory.poses),
            strict=True,
        )
    }
    known = truth.keys()
    rest = [m for m in rest if m.stamp_ns in known or not hasattr(m, "ranges")]
    prior = PriorMap(
        part.slam.keyframes, part.keyframes.poses, [], [], [], part.slam.extrinsics, [], None
    )
    return Halves(prior, rest, truth)


def in_frame_of(keyframes: Matrix, again: Matrix, poses: Matrix) -> Matrix:
    """Poses (n, 3) of one map in another, by the keyframes (m, 3) that are in both.

    The second map is bent a little differently, by what was seen later: each pose keeps its place
    with respect to the keyframe that is the nearest one, and that looks the same way.
    """
    moved = np.empty_like(poses)
    for row, pose in enumerate(poses):
        away = np.hypot(*(again[:, :2] - pose[:2]).T)
        turn = np.abs(np.angle(np.exp(1j * (again[:, 2] - pose[2]))))
        k = int(np.argmin(away + TURN_M * turn))
        moved[row] = compose(keyframes[k], between(again[k], pose))
    return moved


def recorded_row(path: Path, starts: int, config: SlamConfig) -> dict[str, Any]:
    """Figures of one log: the rest of it in one go, and starts from nothing inside the map."""
    log = halves(path, config)
    found = located(log.messages, config, log.prior)
    row = {"log": path.name.partition(".")[0], **track_row(found, log.truth, log.prior.poses)}
    able = places_to_start(log)
    count = min(starts, len(able))
    chosen = np.random.default_rng(41).choice(able, count, replace=False)
    tried = [start_from(log.messages, int(s), log.truth, config, log.prior) for s in chosen]
    return row | starts_row(tried)


def places_to_start(log: Halves) -> list[int]:
    """Stamps from where the next START_M metres lie inside the map, mostly."""
    stamps = scan_stamps(log.messages)
    poses = np.array([[p.x(), p.y(), p.theta()] for p in (log.truth[s] for s in stamps)])
    within = np.array([is_inside(pose, log.prior.poses) for pose in poses])
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    able = []
    for k, stamp in enumerate(stamps):
        end = int(np.searchsorted(way, way[k] + START_M))
        if within[k] and end < len(way) and within[k : end + 1].mean() >= INSIDE_SHARE:
            able.append(stamp)
    return able
