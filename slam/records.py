"""What a run keeps on record of its decisions, factors and poses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

import numpy as np
from gtsam import Pose2

from backend.pose_graph import Edge, PoseGraph
from backend.thinning import Renumbered
from frontend.keyframes import Interval
from logs.messages import FactorRecord, KeyframeDecision, LaserScan, LoopVerdict, PoseEstimate
from slam.tracking import Tracked

Pair = TypeVar("Pair", FactorRecord, LoopVerdict)


def decision_record(
    scan: LaserScan, number: int, index: int, reason: str, moved: Pose2, interval: Interval,
    tracked: Tracked | None,
) -> KeyframeDecision:  # fmt: skip
    """Why a scan became a keyframe.

    Args:
        scan: of the keyframe.
        number: of the keyframe.
        index: of the scan in the log.
        reason: as `reason_to_keep` gives it.
        moved: last-keyframe_T_this by odometry.
        interval: that was chosen at the last keyframe.
        tracked: what came of the match; None where there was none.
    """
    complexity, foresight = interval.complexity, interval.foresight
    sums: tuple[float, ...] = complexity.sums if complexity else ()
    sigmas: tuple[float, ...] = ()
    if tracked is not None and tracked.match_trusted:
        sigmas = tracked.result.sigmas
    return KeyframeDecision(
        scan.stamp_ns, number, index, reason, foresight.axis if foresight else "",
        float(np.hypot(moved.x(), moved.y())), abs(moved.theta()), float(interval.length),
        complexity.t_pe if complexity else float("nan"),
        foresight.sigmas if foresight else sums, sigmas,
    )  # fmt: skip


def factor_record(stamp_ns: int, edge: Edge, used: bool, note: str) -> FactorRecord:
    """A factor and what became of it; `note` says why it was refused, or what was odd."""
    floor = 1e-9 * np.eye(3)  # a blind axis has no covariance to write down
    covariance = np.linalg.inv(edge.information + floor)
    return FactorRecord(
        stamp_ns, edge.kind, edge.i, edge.j, edge.i_T_j.x(), edge.i_T_j.y(), edge.i_T_j.theta(),
        tuple(covariance.ravel().tolist()), used, note,
    )  # fmt: skip


def estimate_record(stamp_ns: int, graph: PoseGraph, k: int, lost: bool) -> PoseEstimate:
    """Where the graph has keyframe `k` just now, and how well it knows."""
    x, y, theta = (float(v) for v in graph.poses[k])
    covariance = tuple(graph.marginal(k).ravel().tolist())
    return PoseEstimate(stamp_ns, x, y, theta, covariance, lost)


def decisions_left(
    decisions: Iterable[KeyframeDecision], index: Renumbered
) -> list[KeyframeDecision]:
    """Those for keyframes that stay, under their new indices."""
    return [replace(d, index=index(d.index)) for d in decisions if index.stays[d.index]]


def pairs_left(pairs: Iterable[Pair], index: Renumbered) -> tuple[list[Pair], list[Pair]]:
    """Records between keyframes that stay, under their new indices; and the others."""
    left, gone = [], []
    for pair in pairs:
        if index.stays[pair.i] and index.stays[pair.j]:
            left.append(replace(pair, i=index(pair.i), j=index(pair.j)))
        else:
            gone.append(pair)
    return left, gone
