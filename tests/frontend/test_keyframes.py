"""How far the robot may go, and when a scan must become a keyframe."""

import numpy as np
import pytest
from gtsam import Pose2
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from slam.drivers.simulators.laser import LASERS, take_scan
from slam.drivers.simulators.world import World
from slam.frontend.keyframes import Interval, KeyframeConfig, interval_after, reason_to_keep
from slam.frontend.scan import ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics

MOUNT = LaserExtrinsics(0, 0.0, 0.0, 0.0)
PLAIN = World(np.array([[-20.0, 1.5, 20.0, 1.5], [-20.0, -1.5, 20.0, -1.5]]))
ONE_WALL = World(PLAIN.segments[:1])
GLASS = World(PLAIN.segments[:1], panes=PLAIN.segments[1:])


def niches(depth):
    """A corridor whose left wall has a niche of this depth every other metre."""
    corners = []
    for x in range(-10, 10, 2):
        corners += [(x, 1.5), (x, 1.5 + depth), (x + 1, 1.5 + depth), (x + 1, 1.5)]
    return World.from_polygon([(-12, 1.5), *corners, (12, 1.5), (12, -1.5), (-12, -1.5)])


def prepared(world, laser="hokuyo-181"):
    scan = take_scan(world, Pose2(), LASERS[laser], np.random.default_rng(0))
    return prepare(scan, MOUNT, ScanConfig())


def interval(world, **settings):
    return interval_after(prepared(world), KeyframeConfig(method="sdp-pe", **settings))


def test_more_complex_walls_allow_longer_intervals():
    lengths = [interval(niches(depth)).length for depth in (0.0, 0.2, 0.4, 0.8)]
    assert lengths == sorted(lengths)
    assert lengths[0] < lengths[-1]


@pytest.mark.parametrize("world", [PLAIN, ONE_WALL, GLASS, World(), niches(3.0)])
def test_the_interval_stays_between_its_limits_whatever_is_seen(world):
    config = KeyframeConfig(method="sdp-pe")
    found = interval_after(prepared(world), config)
    assert config.min_interval <= found.length <= config.max_interval
    assert found.complexity is not None
    assert np.isfinite(found.complexity.t_pe)


@pytest.mark.parametrize("world", [ONE_WALL, GLASS])
def test_a_side_where_nothing_is_seen_counts_for_nothing(world):
    found = interval(world)
    assert found.complexity.right.diff == found.complexity.right.diff2 == 0.0
    assert found.complexity.left.diff > 0.0


def test_no_walls_give_the_shortest_interval():
    assert interval(World(), min_interval=0.25).length == 0.25


def test_a_constant_interval_does_not_look_at_the_walls():
    config = KeyframeConfig(method="constant", interval=0.7)
    assert interval_after(prepared(niches(1.0)), config) == Interval(0.7, None)


CONFIG = KeyframeConfig(max_turn=0.3, max_time=10.0, still=0.02)
LENGTH = Interval(0.5, None)


@pytest.mark.parametrize(
    ("moved", "seconds", "reason"),
    [
        (Pose2(0.49, 0.0, 0.0), 1.0, ""),
        (Pose2(0.51, 0.0, 0.0), 1.0, "distance"),
        (Pose2(-0.3, -0.41, 0.0), 1.0, "distance"),  # backwards and sideways count alike
        (Pose2(0.0, 0.0, 0.31), 1.0, "turn"),
        (Pose2(0.0, 0.0, -0.31), 1.0, "turn"),
        (Pose2(0.6, 0.0, 0.31), 1.0, "turn"),  # a turn costs more overlap than a step
        (Pose2(0.03, 0.0, 0.0), 9.9, ""),
        (Pose2(0.03, 0.0, 0.0), 10.0, "time"),
        (Pose2(0.0, 0.0, 0.03), 10.0, "time"),
        (Pose2(0.01, 0.0, 0.01), 3600.0, ""),  # standing still is no reason, however long
    ],
)
def test_the_limits_in_metres(moved, seconds, reason):
    assert reason_to_keep(moved, 500, seconds, LENGTH, CONFIG) == reason


def test_intervals_can_count_scans_as_the_paper_does():
    config = KeyframeConfig(unit="scans", max_turn=0.3)
    far = Pose2(5.0, 0.0, 0.0)
    assert reason_to_keep(far, 14, 1.0, Interval(15, None), config) == ""
    assert reason_to_keep(far, 15, 1.0, Interval(15, None), config) == "scans"
    assert reason_to_keep(Pose2(0, 0, 1.0), 1, 0.1, Interval(15, None), config) == "turn"


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3), st.floats(0, 100))
def test_whoever_has_moved_beyond_a_limit_becomes_a_keyframe(x, y, theta, seconds):
    reason = reason_to_keep(Pose2(x, y, theta), 1, seconds, LENGTH, CONFIG)
    beyond = np.hypot(x, y) >= 0.5 or abs(theta) >= 0.3
    late = seconds >= 10.0 and max(np.hypot(x, y), abs(theta)) > 0.02
    assert bool(reason) == bool(beyond or late)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"min_interval": 2.0, "max_interval": 1.0}, "min_interval must not exceed"),
        ({"t_low": 3.0, "t_high": 3.0}, "t_low must be below t_high"),
        ({"widest": 0.12}, "widest\n.*greater than 0.125"),
    ],
)
def test_limits_must_be_in_order(settings, message):
    with pytest.raises(ValidationError, match=message):
        KeyframeConfig(**settings)


def test_an_open_chain_is_built_with_more_care():
    closed = KeyframeConfig()
    assert closed.open.tolerance < closed.tolerance
    assert closed.open.widest < closed.widest
    assert closed.open.tolerance == 0.25 * closed.tolerance
    assert closed.open.interval == closed.interval
