"""What viewers need beside a run's results: a tree of frames at every scan, and maps along the way.

With map -> odom -> base at each scan and the mount at the start, Foxglove's 3D panel puts
scans, map and poses into one picture without being told anything.  Readers of ours pass
over these transforms.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slam.backend.se2 import between, compose
from slam.logs.messages import FrameTransform, OccupancyMap
from slam.logs.trajectory import Poses
from slam.maps.occupancy import build_map
from slam.runs.offline import Result

MAP_UPDATES = 4
"""Maps in a run's log, the final one included: enough to see it grow, each costs its size."""


def transforms(result: Result) -> Iterator[FrameTransform]:
    """Yield map -> world, if the truth is known, then map -> odom -> base at every scan."""
    yield from _world(result)
    trajectory, odometry = result.trajectory, result.odometry
    origin: Poses = np.zeros((1, 3))
    map_T_odom = compose(trajectory.poses, between(odometry.poses, origin))
    for stamp, correction, pose in zip(
        trajectory.stamps_ns.tolist(), map_T_odom.tolist(), odometry.poses.tolist(), strict=True
    ):
        yield FrameTransform(stamp, "map", "odom", *correction)
        yield FrameTransform(stamp, "odom", "base", *pose)


def _world(result: Result) -> Iterator[FrameTransform]:
    """Lay the truth on the run's first pose: the frame of a survey is seldom the map's."""
    trajectory = result.trajectory
    if not result.truth or not len(trajectory):
        return
    first = trajectory.stamps_ns[0]
    truth = min(result.truth, key=lambda pose: abs(pose.stamp_ns - first))
    world_T_base = np.array([[truth.x, truth.y, truth.theta]])
    row = int(np.abs(trajectory.stamps_ns - truth.stamp_ns).argmin())
    map_T_base = trajectory.poses[row : row + 1]
    pose = compose(map_T_base, between(world_T_base, np.zeros((1, 3))))[0]
    if np.isfinite(pose).all():
        yield FrameTransform(int(first), "map", "world", *pose.tolist())


def maps_along_the_way(result: Result) -> Iterator[OccupancyMap]:
    """Yield the map as it was after each part of the keyframes, at their final poses."""
    keyframes, slam = result.slam.keyframes, result.slam
    mount = np.array([slam.extrinsics.x, slam.extrinsics.y, slam.extrinsics.theta])
    places = compose(result.keyframes.poses, mount)
    for part in range(1, MAP_UPDATES):
        count = len(keyframes) * part // MAP_UPDATES
        if count:
            scans = [keyframe.scan for keyframe in keyframes[:count]]
            yield build_map(scans, places[:count], slam.config.map)
    yield result.grid
