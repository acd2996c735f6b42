"""Odometry that lies: the fault is found, named, and costs next to nothing."""

from functools import cache

import numpy as np
import pytest
from gtsam import Pose2
from slam.backend.se2 import compose
from slam.drivers.simulators.drive import simulate
from slam.drivers.simulators.faults import OdometryFault
from slam.drivers.simulators.worlds import scenario

from slam.evaluation.metrics import align
from slam.mapping.config import SlamConfig
from slam.runs.offline import run_offline


@cache
def run(world, seed, *faults, passes=1):
    """ATE (m) of a simulated drive, and what its run says."""
    drive = simulate(scenario(world, seed), seed=seed, faults=faults, passes=passes)
    messages = list(drive)
    result = run_offline(lambda: messages, SlamConfig())
    truth = {m.stamp_ns: (m.x, m.y, m.theta) for m in result.truth}
    true = np.array([truth[int(stamp)] for stamp in result.trajectory.stamps_ns])
    found = compose(align(result.trajectory.poses, true), result.trajectory.poses)
    return float(np.sqrt(np.mean(np.sum((found - true)[:, :2] ** 2, axis=1)))), result


@pytest.mark.parametrize("kind", ["sign-flip", "stall", "jump", "slip", "scan-gap"])
def test_a_lie_in_a_furnished_building_costs_next_to_nothing(kind):
    error, _ = run("office", 1, OdometryFault(kind, at_s=30.0))
    assert error < 0.05


@pytest.mark.parametrize("kind", ["sign-flip", "stall", "jump", "slip", "scan-gap"])
def test_a_lie_is_named(kind):
    _, result = run("office", 1, OdometryFault(kind, at_s=30.0))
    assert result.slam.odometry_faults == {kind: 1}


@pytest.mark.parametrize("kind", ["stall", "jump"])
def test_a_refused_odometry_is_on_record(kind):
    _, result = run("office", 1, OdometryFault(kind, at_s=30.0))
    refused = [f for f in result.slam.records.factors if f.kind == "odometry" and not f.used]
    assert refused
    assert all("odometry refused" in f.note for f in refused)


def test_honest_odometry_is_not_called_a_liar():
    error, result = run("office", 1)
    refused = [f for f in result.slam.records.factors if f.kind == "odometry" and not f.used]
    assert error < 0.05
    assert len(refused) <= 0.01 * len(result.slam.keyframes)
    assert not result.slam.odometry_faults


def test_backing_out_of_a_bare_corridor_is_no_lie():
    """Walls come into view that were behind the robot: no motion would explain more beams."""
    error, result = run("plain-corridor", 1, passes=2)
    assert not result.slam.odometry_faults
    truth = {m.stamp_ns: Pose2(m.x, m.y, m.theta) for m in result.truth}
    first, last = (truth[int(result.keyframes.stamps_ns[k])] for k in (0, -1))
    way = Pose2(*result.keyframes.poses[0]).between(Pose2(*result.keyframes.poses[-1]))
    off = first.between(last).between(way)
    assert np.hypot(off.x(), off.y()) < 0.6  # of 94 m, along which only the wheels can tell
    assert error < 0.4


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sign-flip", "stall", "jump", "slip", "scan-gap"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_lie_in_a_ring_corridor_costs_next_to_nothing(kind, seed):
    error, result = run("office-ring", seed, OdometryFault(kind, at_s=60.0))
    assert error < 0.05
    assert kind in result.slam.odometry_faults
