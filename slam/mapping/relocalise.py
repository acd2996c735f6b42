"""A map made before, to be continued, and where in it the robot starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

from slam.backend.pose_graph import Edge, PoseGraph
from slam.frontend.degeneracy import well_constrained
from slam.frontend.loop_search import Closure, close_loop, target_field
from slam.frontend.match_types import Reference
from slam.frontend.scan import PreparedScan
from slam.logs.messages import FactorRecord, KeyframeDecision, LaserExtrinsics, TruePose
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe

Matrix = NDArray[np.float64]

APART_M = 3.0  # m between the places of the old map that are tried
ELSEWHERE_M, ELSEWHERE_RAD = 1.0, 0.3  # two results farther apart are different ones
ANY_HEADING = np.diag([1.0, 1.0, 4.0]) ** 2  # m, m, rad about a place: any heading
NEAR_START = np.diag([0.5, 0.5, 0.2]) ** 2  # m, m, rad: how far off a given start may be


@dataclass(frozen=True, eq=False, slots=True)
class PriorMap:
    """What a finished run hands over to the next."""

    keyframes: list[Keyframe]
    poses: Matrix  # (n, 3) map_T_base of the keyframes
    edges: list[Edge]  # of the graph as it ended
    factors: list[FactorRecord]
    decisions: list[KeyframeDecision]
    extrinsics: LaserExtrinsics
    truth: list[TruePose]
    start: Pose2 | None  # map_T_base where the robot goes on; None if it is to be found


def relocalise(
    scan: PreparedScan, keyframes: Sequence[Keyframe], graph: PoseGraph, start: Pose2 | None,
    config: SlamConfig,
) -> Edge | None:  # fmt: skip
    """The edge from an old keyframe to a new one with `scan`; None where no place stands out.

    Old places all over the map, or those about `start`, are searched as loop closures are; the
    best answer must be sound and no other place may explain the scan about as well.
    """
    found: list[tuple[int, Closure]] = []
    for anchor in _places(graph.poses, start):
        if start is None:
            predicted, covariance = Pose2(), ANY_HEADING
        else:
            predicted, covariance = graph.pose(anchor).between(start), NEAR_START
        half = config.loops.target_half
        members = range(max(0, anchor - half), min(len(graph), anchor + half + 1))
        base = graph.pose(anchor)
        old = [(base.between(graph.pose(k)), keyframes[k].prepared) for k in members]
        closure = close_loop(
            target_field(old, config.loops.search.correlative),
            [Reference(pose, member) for pose, member in old],
            [(Pose2(), scan)], predicted, covariance, config.loops.search, config.matcher,
        )  # fmt: skip
        if closure.result is not None:
            found.append((anchor, closure))
    sound = [pair for pair in found if not pair[1].reason]
    if not sound:
        return None
    anchor, best = max(sound, key=lambda pair: pair[1].score)
    here = _placed(graph, anchor, best)
    for place, other in found:
        error = here.between(_placed(graph, place, other))
        elsewhere = np.hypot(error.x(), error.y()) > ELSEWHERE_M
        if elsewhere or abs(error.theta()) > ELSEWHERE_RAD:
            if other.score > config.loops.search.ambiguity_ratio * best.score:
                return None
    assert best.result is not None
    edge = Edge("icp", anchor, len(graph), best.result.target_T_source, best.result.information)
    # In a corridor the position along it would stay open.
    return edge if well_constrained(graph.information(edge), ELSEWHERE_M) else None


def _places(poses: Matrix, start: Pose2 | None) -> list[int]:
    """Keyframes (n, 3) so far apart that every place is near one of them."""
    chosen: list[int] = []
    for k in range(len(poses)):
        if start is not None and np.hypot(*(poses[k, :2] - (start.x(), start.y()))) > APART_M:
            continue
        if all(_differ(poses[k], poses[other]) for other in chosen):
            chosen.append(k)
    return chosen


def _differ(a: Matrix, b: Matrix) -> bool:
    """Whether two keyframes stand or look elsewhere: the same spot has a view either way."""
    turn = abs(float(np.angle(np.exp(1j * (a[2] - b[2])))))
    return bool(np.hypot(*(a[:2] - b[:2])) > APART_M or turn > 0.25 * np.pi)


def _placed(graph: PoseGraph, anchor: int, closure: Closure) -> Pose2:
    assert closure.result is not None
    return graph.pose(anchor) * closure.result.target_T_source
