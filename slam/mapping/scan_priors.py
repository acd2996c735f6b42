"""Where scans are expected, and how far off they can be, before they are matched themselves."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from gtsam import Pose2
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class PredictedPoses:
    """Of each of n scans, from the keyframes before and after it, and the odometry between."""

    poses: Matrix  # (n, 3) map_T_base
    reach_m: Matrix  # (n,) m, to the farther of the two
    odometry_faulty: NDArray[np.bool_]  # (n,) whether the odometry that leads there was refused
    before: NDArray[np.intp]  # (n,) which keyframe is the one before, 0 where there is none


def predict_poses(
    odom_poses: Matrix, keyframe_scans: NDArray[np.int64], keyframe_poses: Matrix,
    faulty_scans: Collection[int],
) -> PredictedPoses:  # fmt: skip
    """What is known of all scans once the keyframes have their poses.

    Args:
        odom_poses: (n, 3) odom_T_base of all scans.
        keyframe_scans: (m,) which of them are keyframes.
        keyframe_poses: (m, 3) map_T_base of those.
        faulty_scans: keyframes to which the odometry did not lead, as scans.
    """
    rows = np.arange(len(odom_poses))
    before = np.searchsorted(keyframe_scans, rows, side="right") - 1
    poses = drift_corrected(odom_poses, before, keyframe_scans, keyframe_poses)
    before = np.maximum(before, 0)
    after = np.searchsorted(keyframe_scans, rows)  # of a keyframe itself, that one
    ends = np.stack([before, np.minimum(after, len(keyframe_scans) - 1)])
    ways = keyframe_poses[ends, :2] - poses[:, :2]
    odometry_faulty = np.isin(np.append(keyframe_scans, -1), sorted(faulty_scans))[after]
    return PredictedPoses(
        poses, np.hypot(ways[..., 0], ways[..., 1]).max(axis=0), odometry_faulty, before
    )


def drift_corrected(
    odom_poses: Matrix,
    scan_keyframes: NDArray[np.int64],
    keyframe_scans: NDArray[np.int64],
    keyframe_poses: Matrix,
) -> Matrix:
    """Poses of all scans from odometry bent onto the keyframes, (n, 3).

    Between two keyframes the odometry's step is followed, and the difference to where the
    graph puts the second one is spread evenly over the scans in between.
    """
    out = np.empty_like(odom_poses)
    segment = -1  # of the scan before: what holds for all of its scans is composed once
    for s, (x, y, theta) in enumerate(odom_poses.tolist()):
        k = max(int(scan_keyframes[s]), 0)
        if k != segment:
            segment, is_last = k, k + 1 >= len(keyframe_scans)
            a = int(keyframe_scans[k])
            odom_T_a, map_T_a = Pose2(*odom_poses[a]), Pose2(*keyframe_poses[k])
            if not is_last:
                b = int(keyframe_scans[k + 1])
                end = map_T_a * odom_T_a.between(Pose2(*odom_poses[b]))
                correction = Pose2.Logmap(end.between(Pose2(*keyframe_poses[k + 1])))
        pose = map_T_a * odom_T_a.between(Pose2(x, y, theta))
        if not is_last and s > a:
            pose = pose * Pose2.Expmap(correction * ((s - a) / (b - a)))
        out[s] = pose.x(), pose.y(), pose.theta()
    return out
