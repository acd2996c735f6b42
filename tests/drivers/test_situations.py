"""Situations: by name and seed, the same to the bit; each trait does what it says."""

import math
from dataclasses import replace

import numpy as np
import pytest
from slam.drivers.simulators.outlines import way_points
from slam.drivers.simulators.situations import SITUATIONS, situation_drive
from slam.drivers.simulators.traits import (
    Person,
    with_creeping_heading,
    with_heavy_tails,
    with_nothing_code,
    with_people,
    with_sparse_scans,
    with_stale_odometry,
)
from slam.logs.messages import LaserExtrinsics, LaserScan, WheelOdometry

NS = 1_000_000_000
RANGES = np.full(181, np.inf, dtype=np.float32)
SCAN = LaserScan(0, -0.5 * math.pi, math.pi / 180, RANGES, 0.02, 6.0)


def straight(seconds=10):
    """Odometry and a scan each second, a metre apart."""
    for k in range(seconds):
        yield WheelOdometry(k * NS, float(k), 0.0, 0.0)
        yield replace(SCAN, stamp_ns=k * NS)


def odometry(messages):
    return [m for m in messages if isinstance(m, WheelOdometry)]


def scans(messages):
    return [m for m in messages if isinstance(m, LaserScan)]


@pytest.mark.parametrize("name", ["person-behind", "posts-0.36", "nothing-code"])
def test_equal_names_and_seeds_give_equal_messages(name):
    first, again = (scans(situation_drive(name, 2)) for _ in range(2))
    assert len(first) == len(again) > 50
    assert all(np.array_equal(a.ranges, b.ranges, True) for a, b in zip(first, again, strict=True))
    other = scans(situation_drive(name, 3))
    same = [np.array_equal(a.ranges, b.ranges, True) for a, b in zip(first, other, strict=False)]
    assert not all(same)


@pytest.mark.parametrize("name", ["person-behind", "posts-0.36", "grove-8m", "courtyard"])
def test_ways_through_open_places_keep_off_the_walls_and_differ_by_seed(name):
    (world, path), (other, _) = (SITUATIONS[name].plan(np.random.default_rng(s)) for s in (1, 2))
    assert world.clearance(way_points(path, 1.0)).min() > 0.25
    assert not np.array_equal(world.segments, other.segments) or "posts" in name


def test_unknown_situation_names_the_known_ones():
    with pytest.raises(ValueError, match="person-behind"):
        situation_drive("nowhere", 1)


def test_person_is_seen_where_they_walk_and_only_from_the_mount():
    person = Person(1.5, 0.0, jitter=0.0)
    (ahead,) = with_people([SCAN], [person], 0, sigma=0.0)
    assert ahead.ranges[90] == pytest.approx(1.3)
    assert np.isfinite(ahead.ranges).sum() == pytest.approx(
        2 * math.degrees(math.asin(0.2 / 1.5)), abs=2
    )
    mounted = scans(with_people([LaserExtrinsics(0, 0.5, 0.0, 0.0), SCAN], [person], 0, 0.0))
    assert mounted[0].ranges[90] == pytest.approx(0.8)
    (behind,) = with_people([SCAN], [Person(-0.9, 0.0)], 0)
    assert not np.isfinite(behind.ranges).any()


def test_nothing_is_coded_for_about_the_share_asked_for():
    (coded,) = with_nothing_code([SCAN], 5.996, 0.25, 0)
    assert set(np.unique(coded.ranges)) == {np.float32(5.996), np.float32(np.inf)}
    assert 20 < (coded.ranges < 6.0).sum() < 70


def test_stale_odometry_is_an_older_pose_under_a_newer_stamp():
    told = odometry(with_stale_odometry(straight(), 1.0, 0, stale_s=(2.0, 2.0)))
    assert [m.stamp_ns for m in told] == [k * NS for k in range(10)]
    assert [m.x for m in told] == [0, 0, 0, 1, 2, 3, 4, 5, 6, 7]
    usual = odometry(with_stale_odometry(straight(), 0.0, 0, lag_s=0.0))
    assert [m.x for m in usual] == list(range(10))


def test_heavy_tails_leave_the_way_and_turn_the_robot():
    told = odometry(with_heavy_tails(straight(200), 0))
    steps = np.hypot(*np.diff([(m.x, m.y) for m in told], axis=0).T)
    assert np.allclose(steps, 1.0)
    turns = np.abs(np.diff([m.theta for m in told]))
    turns = np.minimum(turns, 2 * np.pi - turns)
    assert turns.max() > 5 * np.median(turns) > 0


def test_sparse_scans_keep_their_distance_and_time():
    assert [m.stamp_ns // NS for m in scans(with_sparse_scans(straight(), 3.0, 0.0))] == [
        0,
        3,
        6,
        9,
    ]
    assert [m.stamp_ns // NS for m in scans(with_sparse_scans(straight(), 0.0, 4.0))] == [0, 4, 8]


def test_heading_creeps_at_its_rate():
    told = odometry(with_creeping_heading(straight(), 0.01))
    assert told[-1].theta == pytest.approx(0.09)
