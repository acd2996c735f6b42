"""A robot that turns while its laser sweeps: with and without taking that motion out."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.laser import LaserConfig, take_moving_scan
from slam.drivers.simulators.world import World
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

from slam.runs.config_file import load_config
from slam.runs.offline import run_offline

ROOM = World.from_polygon([(-4, -3), (5, -3), (5, 2), (2, 2), (2, 4), (-4, 4)])
BEAM_S = 0.025 / 1440
LASER = LaserConfig(beams=1081, angle_min=-np.radians(135.0), angle_step=np.radians(0.25),
                    rate_hz=40.0, beam_period_s=BEAM_S)  # fmt: skip
START_NS = 1_700_000_000_000_000_000


def heading(t):
    """To and fro, at up to 1.9 rad/s."""
    return 1.2 * np.sin(1.6 * t)


@pytest.fixture(scope="module")
def drive():
    rng, messages = np.random.default_rng(0), [LaserExtrinsics(START_NS, 0.16, 0.0, 0.0)]
    for k in range(200):
        t = k * 0.025
        stamp = START_NS + round(t * 1e9)
        messages.append(WheelOdometry(stamp, 0.0, 0.0, heading(t)))
        theta = heading(t + BEAM_S * np.arange(1081))
        lasers = np.column_stack([0.16 * np.cos(theta), 0.16 * np.sin(theta), theta])
        messages.append(take_moving_scan(ROOM, lasers, LASER, rng, stamp))
    return messages


def errors_deg(drive, deskew):
    config = load_config(None, [f"scan.deskew={deskew}", "loops.enabled=false"])
    found = run_offline(lambda: drive, config).trajectory
    t = (found.stamps_ns - START_NS) * 1e-9
    wrong = [Pose2(0, 0, heading(at)).between(Pose2(0, 0, p[2])).theta()
             for at, p in zip(t, found.poses, strict=True)]  # fmt: skip
    return np.degrees(np.std(wrong)), len(found.poses)


def test_headings_are_those_of_the_first_beam_where_motion_is_taken_out(drive):
    bent, _ = errors_deg(drive, "false")
    straight, scans = errors_deg(drive, "true")
    assert straight < 0.06
    assert bent > 4.0 * straight
    assert scans >= sum(isinstance(m, LaserScan) for m in drive) - 1  # it waits for odometry
