"""Drives that once broke maps: people beside the robot, no odometry, a robot carried away."""

from itertools import pairwise

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.situations import situation_drive
from slam.drivers.simulators.worlds import scenario
from slam.logs.messages import LaserScan, WheelOdometry

from benchmarks.alterations import kidnapped
from benchmarks.situations import ate, refused
from slam.mapping.config import SlamConfig
from slam.runs.config_file import load_config
from slam.runs.offline import run_offline


def run(messages, config=None):
    result = run_offline(lambda: messages, config or SlamConfig())
    truth = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    return result, ate(result.trajectory, truth), ate(result.odometry, truth)


@pytest.fixture(scope="module")
def office():
    return list(simulate(scenario("office", 4), seed=4))


@pytest.mark.parametrize("name", ["person-behind", "nothing-code", "posts-0.36"])
def test_honest_odometry_is_not_overruled(name):
    result, error, _ = run(list(situation_drive(name, 3)))
    assert error < 0.3
    assert refused(result) == 0
    assert not any(closure.accepted for closure in result.slam.loops.closure_results)


def test_without_odometry_the_laser_maps_alone(office):
    result, error, raw = run([m for m in office if not isinstance(m, WheelOdometry)])
    assert result.slam.laser_only
    assert error < 0.05
    assert raw < 0.5


def test_the_setting_leaves_odometry_out(office):
    alone = load_config(None, ["odometry.use=false"])
    result, error, _ = run(office, alone)
    assert result.slam.laser_only
    assert result.slam.noted["odometry that is not used: the map is made by the laser alone"] > 100
    assert error < 0.05


def test_a_robot_that_was_carried_breaks_the_track(office):
    """It does not come by a known place again: the piece stays where it is, and joins nothing."""
    result, _, raw = run(kidnapped(office, 1, metres=6.0))
    assert result.slam.noted["break in the track, which only closures can join"] == 1
    assert raw > 1.0
    [broken] = [f.j for f in result.slam.records.factors if f.note.endswith("carried") and f.used]
    across = [c for c in result.slam.loops.closure_results if c.accepted and c.i < broken <= c.j]
    assert not across


def test_a_turn_on_the_spot_without_odometry_is_followed(office):
    """Constant velocity expects none of it."""
    scans = [m for m in office if isinstance(m, LaserScan)]
    result, _, _ = run([m for m in office if not isinstance(m, WheelOdometry)])
    steps = result.odometry.poses
    turns = [Pose2(*a).between(Pose2(*b)).theta() for a, b in pairwise(steps)]
    assert len(steps) == len(scans)
    assert max(map(abs, turns)) < 0.5
    assert np.abs(turns).sum() > 3.0
