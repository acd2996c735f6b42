"""What a run records of its decisions, factors and poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from gtsam import Pose2

from slam.backend.pose_graph import Edge, PoseGraph
from slam.backend.pruned_graph import Renumbered
from slam.frontend.keyframes import Interval
from slam.logs.messages import FactorRecord, KeyframeDecision, LaserScan, LoopResult, PoseEstimate
from slam.mapping.keyframe import Keyframe
from slam.mapping.registration import Registration

Pair = TypeVar("Pair", FactorRecord, LoopResult)


def decision_record(
    scan: LaserScan, number: int, index: int, reason: str, moved: Pose2, interval: Interval,
    registration: Registration | None,
) -> KeyframeDecision:  # fmt: skip
    """Why a scan became a keyframe.

    Args:
        scan: of the keyframe.
        number: of the keyframe.
        index: of the scan in the log.
        reason: as `reason_to_keep` gives it.
        moved: last-keyframe_T_this by odometry.
        interval: that was chosen at the last keyframe.
        registration: the outcome of the match; None where there was none.
    """
    complexity, prediction = interval.complexity, interval.prediction
    sigmas: tuple[float, ...] = ()
    if registration is not None and registration.match_trusted:
        sigmas = registration.result.sigmas
    return KeyframeDecision(
        scan.stamp_ns, number, index, reason, prediction.axis if prediction else "",
        float(np.hypot(moved.x(), moved.y())), abs(moved.theta()), float(interval.length),
        complexity.t_pe if complexity else float("nan"),
        complexity.sums if complexity else (), sigmas, prediction.sigmas if prediction else (),
    )  # fmt: skip


def factor_record(stamp_ns: int, edge: Edge, used: bool, note: str) -> FactorRecord:
    """A factor and what became of it; `note` says why it was refused, or what was odd."""
    floor = 1e-9 * np.eye(3)  # a direction without information has no covariance to write down
    covariance = np.linalg.inv(edge.information + floor)
    return FactorRecord(
        stamp_ns, edge.kind, edge.i, edge.j, edge.i_T_j.x(), edge.i_T_j.y(), edge.i_T_j.theta(),
        tuple(covariance.ravel().tolist()), used, note,
    )  # fmt: skip


def estimate_record(stamp_ns: int, graph: PoseGraph, k: int, lost: bool) -> PoseEstimate:
    """Where the graph has keyframe `k` now, and its covariance."""
    x, y, theta = (float(v) for v in graph.poses[k])
    covariance = tuple(graph.marginal(k).ravel().tolist())
    return PoseEstimate(stamp_ns, x, y, theta, covariance, lost)


class Records:
    """Decisions, factors and estimates so far."""

    def __init__(self) -> None:
        self.decisions: list[KeyframeDecision] = []
        self.factors: list[FactorRecord] = []
        self.estimates: list[PoseEstimate] = []
        self.pruned_counts: Counter[str] = Counter()  # keyframes, and what was known of them

    def add_edge(self, stamp_ns: int, edge: Edge, used: bool, note: str) -> None:
        """Record a factor and whether it is used."""
        self.factors.append(factor_record(stamp_ns, edge, used, note))

    def judge_loops(self, judged: Mapping[tuple[int, int], tuple[bool, str]]) -> None:
        """Mark loop factors by the final optimisation: (used, why), by keyframes i and j."""
        self.factors = [
            replace(f, used=judged[f.i, f.j][0], note=judged[f.i, f.j][1])
            if f.kind == "loop" and (f.i, f.j) in judged else f
            for f in self.factors
        ]  # fmt: skip

    def forget(self, keyframes: Sequence[Keyframe], index: Renumbered) -> None:
        """Only counts are left of pruned keyframes; the others get new indices."""
        gone = {k.scan.stamp_ns for k in keyframes if not index.stays[k.index]}
        self.decisions = [
            replace(d, index=index(d.index)) for d in self.decisions if index.stays[d.index]
        ]
        self.factors, factors = pairs_left(self.factors, index)
        self.estimates = [e for e in self.estimates if e.lost or e.stamp_ns not in gone]
        refused = sum(f.kind == "odometry" and not f.used for f in factors)
        self.pruned_counts += Counter({"keyframes": len(gone), "odometry refused": refused})


def pairs_left(pairs: Iterable[Pair], index: Renumbered) -> tuple[list[Pair], list[Pair]]:
    """Records between keyframes that stay, under their new indices; and the others."""
    left, gone = [], []
    for pair in pairs:
        if index.keeps(pair.i, pair.j):
            left.append(replace(pair, i=index(pair.i), j=index(pair.j)))
        else:
            gone.append(pair)
    return left, gone
