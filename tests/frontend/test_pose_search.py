"""A scan is found anywhere in a map, at any heading."""

import numpy as np
import pytest
from gtsam import Pose2
from slam.drivers.simulators.laser import LASERS
from slam.drivers.simulators.worlds import scenario
from slam.frontend.pose_search import APART_M, APART_RAD, likely_poses, pose_field

WORLD = scenario("office", 3).world
BEARINGS = LASERS["hokuyo-181"].bearings


def seen(pose):
    """Points (n, 2) m that a laser at a pose sees, in its own frame."""
    ranges = WORLD.cast(pose, BEARINGS, 30.0)
    points = ranges[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])
    return points[np.isfinite(ranges)]


@pytest.fixture(scope="module")
def ways():
    """Where a robot has mapped the office, (n, 3)."""
    lane = [(x, 5.45) for x in np.arange(6.0, 16.0, 0.5)]
    lane += [(16.5, y) for y in np.arange(5.5, 10.5, 0.5)]
    return [Pose2(x, y, theta) for x, y in lane for theta in (0.0, 1.57, 3.14, -1.57)]


@pytest.fixture(scope="module")
def field(ways):
    points = np.vstack([pose.transformFrom(np.asfortranarray(seen(pose).T)).T for pose in ways])
    return pose_field(points, np.array([(p.x(), p.y()) for p in ways]), 1.0)


@pytest.mark.parametrize("pose", [(7.3, 5.6, 0.4), (12.1, 5.2, -2.6), (16.4, 8.7, 1.9)])
def test_the_true_pose_is_among_the_best(field, pose):
    true = Pose2(*pose)
    found = likely_poses(field, seen(true), 20)
    off = [c.map_T_base.between(true) for c in found]
    near = [np.hypot(e.x(), e.y()) < 0.25 and abs(e.theta()) < 0.06 for e in off]
    assert any(near[:3])
    assert [c.score for c in found] == sorted((c.score for c in found), reverse=True)


def test_results_are_different_places(field):
    found = likely_poses(field, seen(Pose2(7.3, 5.6, 0.4)), 20)
    assert len(found) == 20
    for k, one in enumerate(found):
        for other in found[:k]:
            e = one.map_T_base.between(other.map_T_base)
            assert np.hypot(e.x(), e.y()) > APART_M or abs(e.theta()) > APART_RAD


def test_a_search_about_a_place_stays_there(field):
    near = field.about(8.0, 5.5, 1.0)
    assert 0.0 < near.area < field.area
    found = likely_poses(near, seen(Pose2(7.8, 5.5, 0.2)), 5, heading=0.0, turn=0.5)
    for candidate in found:
        pose = candidate.map_T_base
        assert np.hypot(pose.x() - 8.0, pose.y() - 5.5) < 1.2
        assert abs(pose.theta()) < 0.6


def test_nothing_seen_is_nowhere(field):
    assert likely_poses(field, np.empty((0, 2)), 5) == []
