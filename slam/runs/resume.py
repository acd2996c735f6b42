"""Read a RUN to go on with its map."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from gtsam import Pose2

from slam.logs.messages import KeyframeDecision, LaserExtrinsics, LaserScan, TruePose
from slam.logs.trajectory import path_length
from slam.mapping.calibration import mount_in_force
from slam.mapping.config import SlamConfig
from slam.mapping.keyframe import Keyframe, preparer
from slam.mapping.relocalise import Matrix, PriorMap
from slam.runs.errors import RunError
from slam.runs.reoptimise import read_stored


def read_prior_map(directory: Path, config: SlamConfig, start: str = "") -> PriorMap:
    """Read a RUN to go on with; `start` is empty, `end`, or `x,y,theta` in its map (m, m, rad).

    Raises:
        RunError: it is no finished run, lacks its keyframes' scans, or `start` is no pose.
        LogError: its log cannot be read.
    """
    stored = read_stored(directory)
    stamps = stored.keyframes.stamps_ns
    scans = {m.stamp_ns: m for m in stored.messages if isinstance(m, LaserScan)}
    if not len(stamps) or any(int(stamp) not in scans for stamp in stamps):
        raise RunError(f"{directory}: holds no scans of its keyframes: it cannot be resumed")
    all_extrinsics = [m for m in stored.messages if isinstance(m, LaserExtrinsics)]
    stated = all_extrinsics[-1] if all_extrinsics else LaserExtrinsics(0, 0.0, 0.0, 0.0)
    extrinsics = mount_in_force(stated, json.loads(stored.config_json))
    odometry = dict(zip(stored.odometry.stamps_ns.tolist(), stored.odometry.poses, strict=True))
    travelled = path_length(stored.keyframes.poses)
    prepare = preparer(config.scan)
    keyframes = [
        Keyframe(
            k, k, scans[stamp], extrinsics, prepare, prepare(scans[stamp], extrinsics).centre,
            Pose2(*odometry[stamp]), float(travelled[k]), k,
        )
        for k, stamp in enumerate(stamps.tolist())
    ]  # fmt: skip
    used = [r.used for r in stored.records]
    return PriorMap(
        keyframes,
        stored.keyframes.poses,
        [edge for edge, kept in zip(stored.edges, used, strict=True) if kept],
        [record for record, kept in zip(stored.records, used, strict=True) if kept],
        [m for m in stored.messages if isinstance(m, KeyframeDecision)],
        extrinsics,
        [m for m in stored.messages if isinstance(m, TruePose)],
        _start(start, stored.keyframes.poses[-1]),
    )


def _start(text: str, end: Matrix) -> Pose2 | None:
    if not text:
        return None
    if text == "end":
        return Pose2(*end)
    try:
        x, y, theta = (float(part) for part in text.split(","))
    except ValueError as error:
        raise RunError(f"start {text!r}: say `end` or x,y,theta in m and rad") from error
    if not np.isfinite((x, y, theta)).all():
        raise RunError(f"start {text!r}: is not finite")
    return Pose2(x, y, theta)
