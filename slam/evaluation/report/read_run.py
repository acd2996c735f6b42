"""Reads a RUN directory into memory for the report."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from slam.logs.errors import LogError
from slam.logs.messages import (
    FactorRecord,
    KeyframeDecision,
    LaserExtrinsics,
    LaserScan,
    LoopResult,
    Message,
    OccupancyMap,
    PoseEstimate,
    TruePose,
)
from slam.logs.trajectory import Trajectory, read_tum, sorted_trajectory
from slam.mapping.calibration import mount_in_force
from slam.maps.nav2_map import read_nav2_map
from slam.runs.errors import ReportError

TOPICS = ("/truth", "/keyframe", "/loop", "/factor", "/pose", "/tf")
CONFIG = "config.json"  # the attachment with the effective settings


@dataclass(frozen=True, eq=False)
class RunRecords:
    """What the run's log says beyond the trajectories."""

    truth: Trajectory | None = None
    decisions: tuple[KeyframeDecision, ...] = ()
    closure_results: tuple[LoopResult, ...] = ()
    factors: tuple[FactorRecord, ...] = ()
    estimates: tuple[PoseEstimate, ...] = ()
    scans: tuple[LaserScan, ...] = ()  # of keyframes
    extrinsics: LaserExtrinsics | None = None
    config: Mapping[str, Any] = field(default_factory=dict)  # the run's effective settings


@dataclass(frozen=True, eq=False)
class Run:
    """One RUN directory; parts that were missing are None and named in the warnings."""

    name: str
    trajectory: Trajectory  # map_T_base at every scan, at least one finite pose
    keyframes: Trajectory | None
    odometry: Trajectory | None
    grid: OccupancyMap | None
    summary: dict[str, Any]
    records: RunRecords
    warnings: tuple[str, ...] = field(default=())


def read_run(directory: Path) -> Run:
    """Read a RUN directory.

    Raises:
        ReportError: if the directory or its trajectory is missing, damaged or empty.
    """
    if not directory.is_dir():
        raise ReportError(f"{directory}: no such run directory")
    if not (directory / "trajectory.tum").is_file():
        raise ReportError(f"{directory}: holds no trajectory.tum: not a directory of `slam replay`")
    warnings: list[str] = []
    trajectory = _finite(read_tum(directory / "trajectory.tum"), "trajectory.tum", warnings)
    if len(trajectory) == 0:
        raise ReportError(f"{directory / 'trajectory.tum'}: holds no pose to report on")
    return Run(
        name=directory.resolve().name,
        trajectory=trajectory,
        keyframes=_optional_tum(directory / "keyframes.tum", warnings),
        odometry=_optional_tum(directory / "odometry.tum", warnings),
        grid=_optional_map(directory, warnings),
        summary=_read_summary(directory / "summary.json", warnings),
        records=_read_records(directory / "run.mcap", warnings),
        warnings=tuple(warnings),
    )


def _finite(trajectory: Trajectory, name: str, warnings: list[str]) -> Trajectory:
    finite = np.all(np.isfinite(trajectory.poses), axis=1)
    if not finite.all():
        count = np.count_nonzero(~finite)
        warnings.append(f"{name}: {count} of {len(finite)} poses are not finite and are left out")
    return trajectory.select(finite)


def _optional_tum(path: Path, warnings: list[str]) -> Trajectory | None:
    if not path.is_file():
        warnings.append(f"{path.name} is missing")
        return None
    return _finite(read_tum(path), path.name, warnings)


def _optional_map(directory: Path, warnings: list[str]) -> OccupancyMap | None:
    try:
        return read_nav2_map(directory)
    except LogError as error:
        warnings.append(f"no map: {error}")
        return None


def _read_summary(path: Path, warnings: list[str]) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError:
        warnings.append("summary.json is missing: counts and timing are unknown")
        return {}
    except ValueError as error:
        warnings.append(f"summary.json is not JSON ({error}): counts and timing are unknown")
        return {}
    if not isinstance(summary, dict):
        warnings.append("summary.json is not an object: counts and timing are unknown")
        return {}
    return summary


def _read_records(path: Path, warnings: list[str]) -> RunRecords:
    from slam.logs.mcap_log import open_log

    if not path.is_file():
        warnings.append("run.mcap is missing: decisions, closures and covariances are unknown")
        return RunRecords()
    messages: list[Message] = []
    config: Mapping[str, Any] = {}
    try:
        with open_log(path) as log:
            messages.extend(log.messages(TOPICS))
            kept = {m.stamp_ns for m in messages if isinstance(m, KeyframeDecision)}
            messages.extend(m for m in log.messages(("/scan",)) if m.stamp_ns in kept)
            for attachment in log.attachments():
                if attachment.name == CONFIG:
                    config = _read_config(attachment.data, warnings)
            warnings += [f"run.mcap: {n} skipped, {cause}" for cause, n in log.skipped.items()]
    except LogError as error:
        warnings.append(f"run.mcap is damaged, read {len(messages)} messages of it: {error}")
    records = collect_records(messages)
    if records.extrinsics is not None:
        records = replace(records, extrinsics=mount_in_force(records.extrinsics, config))
    return replace(records, config=config)


def _read_config(data: bytes, warnings: list[str]) -> Mapping[str, Any]:
    try:
        config = json.loads(data)
    except ValueError:
        config = None
    if not isinstance(config, dict):
        warnings.append(f"run.mcap: {CONFIG} cannot be read: the settings are unknown")
        return {}
    return config


def collect_records(messages: Iterable[Message]) -> RunRecords:
    """Sort messages by kind; others are ignored."""
    kinds = (
        TruePose, KeyframeDecision, LoopResult, FactorRecord, PoseEstimate, LaserScan,
        LaserExtrinsics,
    )  # fmt: skip
    kept: dict[type, list[Any]] = {kind: [] for kind in kinds}
    for message in messages:
        kept.get(type(message), []).append(message)
    truth = kept[TruePose]
    return RunRecords(
        truth=sorted_trajectory([t.stamp_ns for t in truth], [(t.x, t.y, t.theta) for t in truth])
        if truth
        else None,
        decisions=tuple(kept[KeyframeDecision]),
        closure_results=tuple(kept[LoopResult]),
        factors=tuple(kept[FactorRecord]),
        estimates=tuple(kept[PoseEstimate]),
        scans=tuple(kept[LaserScan]),
        extrinsics=kept[LaserExtrinsics][-1] if kept[LaserExtrinsics] else None,
    )
