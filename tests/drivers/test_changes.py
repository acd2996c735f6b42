"""Moved furniture: the walls stay, the way stays free."""

import numpy as np
from slam.drivers.simulators.changes import KEEP_OFF_M, with_things_moved
from slam.drivers.simulators.outlines import way_points
from slam.drivers.simulators.worlds import scenario

OFFICE = scenario("office", 3)


def kept(before, after):
    """Share of the segments that are still there."""
    rows = {tuple(row) for row in after.tolist()}
    return np.mean([tuple(row) in rows for row in before.tolist()])


def test_no_share_moves_nothing():
    assert kept(OFFICE.world.segments, with_things_moved(OFFICE, 0.0, 1).world.segments) == 1.0


def test_a_share_of_the_things_moves_and_the_way_stays_free():
    clutter = scenario("clutter", 1)
    moved = with_things_moved(clutter, 0.3, 1)
    assert 0.55 < kept(clutter.world.segments, moved.world.segments) < 0.85
    assert moved.world.clearance(way_points(clutter.path)).min() >= KEEP_OFF_M


def test_walls_stay_when_everything_moves():
    moved = with_things_moved(OFFICE, 1.0, 1).world.segments
    long = np.hypot(*(OFFICE.world.segments[:, 2:] - OFFICE.world.segments[:, :2]).T) > 2.0
    assert kept(OFFICE.world.segments[long], moved) == 1.0


def test_equal_seeds_give_equal_buildings():
    a, b = (with_things_moved(OFFICE, 0.3, 7).world.segments for _ in range(2))
    np.testing.assert_array_equal(a, b)
