"""Altered logs: pure, seeded, and each alteration does what its name says."""

import math

import numpy as np
import pytest
from slam.logs.messages import LaserScan, WheelOdometry

from benchmarks.alterations import (
    ALTERATIONS,
    beams_deleted,
    every_nth_scan,
    kidnapped,
    mirrored,
    mirrored_back,
    odometry_changed,
    odometry_withheld,
    ranges_cut,
)

NS = 1_000_000_000


@pytest.fixture
def log():
    """A minute: odometry ten times a second along a circle of 1 m/s, a scan each second."""
    rng = np.random.default_rng(0)
    messages = []
    for k in range(600):
        theta = 0.02 * k
        x, y = 5 * math.sin(theta), 5 - 5 * math.cos(theta)
        messages.append(WheelOdometry(k * NS // 10, x, y, math.remainder(theta, 2 * math.pi)))
        if k % 10 == 0:
            ranges = rng.uniform(1, 20, 90).astype(np.float32)
            messages.append(LaserScan(k * NS // 10, -1.5, 0.03, ranges, 0.02, 30.0))
    return messages


def odometry(messages):
    return [m for m in messages if isinstance(m, WheelOdometry)]


def scans(messages):
    return [m for m in messages if isinstance(m, LaserScan)]


def key(message):
    if isinstance(message, LaserScan):
        return message.stamp_ns, message.angle_min, message.ranges.tobytes()
    return message


@pytest.mark.parametrize("name", ALTERATIONS)
def test_alterations_are_pure_and_repeat(log, name):
    before = [key(m) for m in log]
    once, again = (ALTERATIONS[name](log, 4) for _ in range(2))
    assert [key(m) for m in log] == before
    assert [key(m) for m in once] == [key(m) for m in again]
    assert ([key(m) for m in once] == before) == (name == "none")


def test_withheld_odometry_leaves_gaps_of_three_seconds(log):
    stamps = np.array([m.stamp_ns for m in odometry(odometry_withheld(log, 1, places=3))])
    assert (np.diff(stamps) >= 3 * NS).sum() in (1, 2, 3)
    assert len(scans(odometry_withheld(log, 1))) == 60


def test_scaled_odometry_keeps_headings_and_a_bias_turns_with_the_way(log):
    scaled = odometry(odometry_changed(log, 0, scale=0.9))
    assert scaled[300].theta == pytest.approx(odometry(log)[300].theta, abs=1e-6)
    assert math.dist((scaled[0].x, scaled[0].y), (scaled[9].x, scaled[9].y)) == pytest.approx(
        0.9 * math.dist((log[0].x, log[0].y), (odometry(log)[9].x, odometry(log)[9].y))
    )
    biased = odometry(odometry_changed(log, 0, yaw_per_m=0.01))
    turned = math.remainder(biased[100].theta - odometry(log)[100].theta, 2 * math.pi)
    assert turned == pytest.approx(0.1, rel=1e-2)


def test_scans_are_thinned_cut_and_blinded(log):
    assert [m.stamp_ns // NS for m in scans(every_nth_scan(log, 0))] == list(range(0, 60, 3))
    cut = scans(ranges_cut(log, 0))
    assert all(
        m.range_max == 8.0 and not ((m.ranges > 8) & np.isfinite(m.ranges)).any() for m in cut
    )
    share = np.mean([np.isinf(m.ranges).mean() for m in scans(beams_deleted(log, 0))])
    assert 0.2 < share < 0.3


def test_kidnapped_robot_sees_and_feels_nothing_on_ten_metres(log):
    carried = kidnapped(log, 2)
    gap = np.diff([m.stamp_ns for m in scans(carried)]).max() / NS
    assert 10.0 <= gap <= 12.0
    steps = np.hypot(*np.diff([(m.x, m.y) for m in odometry(carried)], axis=0).T)
    assert (steps < 1e-9).sum() == pytest.approx(100, abs=2)


def test_mirror_turns_left_into_right_and_back(log):
    seen = mirrored(log, 0)
    poses = np.array([(m.x, m.y, m.theta) for m in odometry(seen)])
    true = np.array([(m.x, m.y, m.theta) for m in odometry(log)])
    assert np.array_equal(mirrored_back(poses), true)
    a, b = scans(log)[0], scans(seen)[0]
    assert (b.angle_min, b.angle_step) == (-a.angle_min, -a.angle_step)
