"""Scans taken on the move, against what a laser at rest would have seen."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.laser import LaserConfig, take_moving_scan, take_scan
from slam.drivers.simulators.world import World
from slam.frontend.deskew import deskew, sweep_ns
from slam.logs.messages import LaserExtrinsics

ROOM = World.from_polygon([(-3, -2), (6, -2), (6, 2), (2, 2), (2, 3), (-3, 3)])
MOUNT = LaserExtrinsics(0, 0.16, 0.05, 0.1)
STEP_S = 0.025 / 1440


def laser(step=0.25, sigma=0.0):
    return LaserConfig(beams=1081, angle_min=-np.radians(540 * step), angle_step=np.radians(step),
                       rate_hz=40.0, sigma=sigma, quantum=0.0, beam_period_s=STEP_S)  # fmt: skip


def both(twist, step=0.25, sigma=0.0):
    """A scan on the move, the one at rest, and how far the base moved."""
    config, rng = laser(step, sigma), np.random.default_rng(0)
    times = STEP_S * np.arange(1081)
    base_T_laser = Pose2(MOUNT.x, MOUNT.y, MOUNT.theta)
    start = Pose2(0.3, 0.2, 0.4)
    poses = [start * Pose2.Expmap(t * np.array(twist)) * base_T_laser for t in times]
    rows = np.array([[p.x(), p.y(), p.theta()] for p in poses])
    moving = take_moving_scan(ROOM, rows, config, rng)
    resting = take_scan(ROOM, poses[0], config, np.random.default_rng(0))
    moved = Pose2.Expmap(times[-1] * np.array(twist))
    return moving, resting, (moved.x(), moved.y(), moved.theta())


@pytest.mark.parametrize("twist", [(1.5, 0, 0), (0, 0, 2.0), (0.8, 0, -1.5), (-1.0, 0, 3.0)])
def test_a_scan_on_the_move_becomes_one_at_rest(twist):
    moving, resting, moved = both(twist)
    straight = deskew(moving, MOUNT, moved)
    before = np.abs(moving.ranges - resting.ranges)
    after = np.abs(straight.ranges - resting.ranges)
    seen = np.isfinite(after)
    assert seen.mean() > 0.98
    assert np.quantile(after[seen], 0.98) < 0.002
    assert np.quantile(before, 0.9) > 10 * np.quantile(after[seen], 0.9)


def test_a_robot_that_stands_changes_nothing():
    moving, _, _ = both((0, 0, 0))
    assert deskew(moving, MOUNT, (0.0, 0.0, 0.0)) is moving


def test_no_reading_is_made_up_where_none_was():
    moving, _, moved = both((0.5, 0, 1.0))
    ranges = moving.ranges.copy()
    ranges[200:400], ranges[600:700] = np.inf, np.nan
    holes = type(moving)(0, moving.angle_min, moving.angle_step, ranges, beam_period_s=STEP_S)
    found = deskew(holes, MOUNT, moved).ranges
    assert abs(np.isinf(found).sum() - 200) <= 2
    assert np.isinf(found[210:390]).all()
    assert np.isnan(found[610:690]).all()


def test_edges_are_not_bridged():
    moving, resting, moved = both((0.3, 0, 2.0))
    found = deskew(moving, MOUNT, moved).ranges
    true = np.sort(resting.ranges)
    nearest = np.abs(true[np.clip(np.searchsorted(true, found), 1, 1080)] - found)
    assert np.nanmax(nearest) < 0.1  # a bridge over the jump behind the corner has all of 0.5 m


def test_a_sweep_takes_as_long_as_its_beams():
    moving, _, _ = both((0, 0, 0))
    assert sweep_ns(moving) == 18_750_000
    assert sweep_ns(type(moving)(0, 0.0, 0.1, np.zeros(5, np.float32))) == 0
