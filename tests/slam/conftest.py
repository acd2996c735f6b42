"""Drives for the pipeline, as short as the question allows."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.laser import LASERS, take_scan
from slam.logs.messages import LaserExtrinsics, TruePose, WheelOdometry

PERIOD_NS = 100_000_000  # 10 scans a second
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="session")
def sense():
    """Messages of a robot with perfect wheels at given poses, ten scans a second.

    `world` is a World, or a function from the number of the scan to one.
    """

    def messages(world, poses, laser="hokuyo-181", seed=0):
        rng = np.random.default_rng(seed)
        at = world if callable(world) else lambda index: world
        start = poses[0]
        made = [LaserExtrinsics(START_NS, 0.0, 0.0, 0.0)]
        for index, pose in enumerate(poses):
            stamp = START_NS + index * PERIOD_NS
            odom = start.between(pose)
            made.append(WheelOdometry(stamp, odom.x(), odom.y(), odom.theta()))
            made.append(TruePose(stamp, pose.x(), pose.y(), pose.theta()))
            made.append(take_scan(at(index), pose, LASERS[laser], rng, stamp))
        return made

    return messages


@pytest.fixture(scope="session")
def straight():
    """Poses along x at 0.5 m/s."""

    def poses(length, start=0.0):
        return [Pose2(x, 0.0, 0.0) for x in np.arange(start, start + length, 0.05)]

    return poses
