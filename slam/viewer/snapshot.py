"""What a viewer shows, copied from the pipeline at one moment; nothing in it changes afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from slam.logs.messages import (
    KeyframeDecision,
    LaserExtrinsics,
    LaserScan,
    LoopResult,
    OccupancyMap,
)
from slam.logs.trajectory import Poses
from slam.mapping.keyframe import Keyframe
from slam.mapping.slam import Slam
from slam.maps.occupancy import MapConfig
from slam.runs.offline import Result
from slam.runs.status import Status


@dataclass(frozen=True, eq=False, slots=True)
class Snapshot:
    """The state of a run; poses are map_T_base."""

    extrinsics: LaserExtrinsics
    keyframes: tuple[Keyframe, ...]
    pruned_counts: int  # keyframes that there were besides; as it grows, the others' indices change
    poses: Poses  # (n, 3) of the keyframes
    decisions: tuple[KeyframeDecision, ...]
    closure_results: tuple[LoopResult, ...]
    scan: LaserScan | None  # the newest one that is placed
    pose: tuple[float, float, float]  # at that scan
    covariance: tuple[float, ...]  # of the last keyframe's pose, in its frame; empty if unknown
    lost: bool  # whether the last keyframe could be tied to nothing trustworthy
    scans: int
    matches: int
    map_config: MapConfig
    interval_unit: str
    losses: Mapping[str, int] = field(default_factory=dict)


def take(slam: Slam) -> Snapshot | None:
    """Copy the state of a pipeline; None before its first keyframe."""
    if slam.graph is None:
        return None
    last = slam.keyframes[-1]
    pose = slam.graph.pose(last.index) * last.odom_T_base.between(slam.scans.last_odometry)
    estimate = slam.records.estimates[-1] if slam.records.estimates else None
    return Snapshot(
        extrinsics=slam.extrinsics,
        keyframes=tuple(slam.keyframes),
        pruned_counts=slam.records.pruned_counts["keyframes"],
        poses=slam.graph.poses.copy(),
        decisions=tuple(slam.records.decisions),
        closure_results=tuple(slam.loops.closure_results),
        scan=None if slam.not_relocalised else slam.latest_scan,
        pose=(pose.x(), pose.y(), pose.theta()),
        covariance=estimate.covariance if estimate else (),
        lost=estimate.lost if estimate else False,
        scans=len(slam.scans),
        matches=slam.matches,
        map_config=slam.config.map,
        interval_unit=slam.config.keyframes.unit,
        losses=dict(slam.lost),
    )


def take_result(result: Result) -> Snapshot:
    """Copy what a finished run knows."""
    slam, estimate = result.slam, result.estimates[-1]
    x, y, theta = (float(v) for v in result.trajectory.poses[-1])
    return Snapshot(
        extrinsics=slam.extrinsics,
        keyframes=tuple(slam.keyframes),
        pruned_counts=slam.records.pruned_counts["keyframes"],
        poses=result.keyframes.poses.copy(),
        decisions=tuple(slam.records.decisions),
        closure_results=tuple(slam.loops.closure_results),
        scan=slam.latest_scan,
        pose=(x, y, theta),
        covariance=estimate.covariance,
        lost=estimate.lost,
        scans=len(slam.scans),
        matches=result.matches,
        map_config=slam.config.map,
        interval_unit=slam.config.keyframes.unit,
        losses=dict(result.lost),
    )


# Stages of a run in which devices are expected to send.
DRIVING = ("starting", "waiting for data", "tracking")


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """All that a page may ask for at one moment."""

    stage: str  # what the run is doing, in words
    snapshot: Snapshot | None = None
    status: Status | None = None  # of devices, on a robot
    grid: OccupancyMap | None = None  # at the end
