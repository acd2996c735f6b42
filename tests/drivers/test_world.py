import numpy as np
import pytest
from gtsam import Pose2
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.drivers.simulators.outlines import box, pillar
from slam.drivers.simulators.world import World

BEARINGS = np.radians(np.arange(-135.0, 135.1, 0.25))
FAR = 1e6  # m, out of the way of every test that is not about range_max

inside = st.floats(0.05, 0.95)
angle = st.floats(-np.pi, np.pi, allow_subnormal=False)
size = st.floats(0.5, 40.0)


def room(length: float, width: float) -> World:
    return World.from_polygon([(0, 0), (length, 0), (length, width), (0, width)])


def range_in_room(length: float, width: float, x: float, y: float, angles):
    """The nearer of the two walls that a beam runs towards, by similar triangles."""
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore", over="ignore"):
        to_x = np.where(cos > 0.0, length - x, x) / np.abs(cos)
        to_y = np.where(sin > 0.0, width - y, y) / np.abs(sin)
    return np.minimum(to_x, to_y)


def random_walls(seed: int, count: int = 60) -> World:
    rng = np.random.default_rng(seed)
    start = rng.uniform(-10.0, 10.0, (count, 2))
    return World(np.hstack([start, start + rng.uniform(-3.0, 3.0, (count, 2))]))


def slow_cast(world: World, pose: Pose2, bearings):
    """Solve start + u along = origin + r direction for every beam and wall by numpy."""
    out = np.full(len(bearings), np.inf)
    for i, angle_ in enumerate(bearings + pose.theta()):
        direction = [np.cos(angle_), np.sin(angle_)]
        for x1, y1, x2, y2 in world.segments:
            system = np.array([direction, [x1 - x2, y1 - y2]]).T
            r, u = np.linalg.solve(system, [x1 - pose.x(), y1 - pose.y()])
            if r >= 0.0 and 0.0 <= u <= 1.0:
                out[i] = min(out[i], r)
    return out


@settings(deadline=None)  # the first call compiles or loads the kernel
@given(size, size, inside, inside, angle)
def test_a_box_room_is_measured_as_geometry_says(length, width, u, v, theta):
    x, y = u * length, v * width
    ranges = room(length, width).cast(Pose2(x, y, theta), BEARINGS, FAR)
    expected = range_in_room(length, width, x, y, BEARINGS + theta)
    np.testing.assert_allclose(ranges, expected, rtol=1e-9)


def test_no_beam_slips_through_a_corner():
    corners = np.array([(0, 0), (10, 0), (10, 8), (0, 8)])
    for x, y in np.random.default_rng(0).uniform([0.1, 0.1], [9.9, 7.9], (200, 2)):
        to_corners = np.sort(np.arctan2(corners[:, 1] - y, corners[:, 0] - x))
        assert np.isfinite(room(10, 8).cast(Pose2(x, y, 0), to_corners, FAR)).all()


def test_random_walls_agree_with_a_plain_solver():
    pose, bearings = Pose2(0.3, -0.2, 0.7), BEARINGS[::9]
    ranges = random_walls(1).cast(pose, bearings, FAR)
    np.testing.assert_allclose(ranges, slow_cast(random_walls(1), pose, bearings), rtol=1e-9)


@settings(deadline=None)  # the first call compiles or loads the kernel
@given(st.integers(0, 50), angle)
def test_a_beam_of_its_own_pose_sees_what_the_sweep_sees(seed, theta):
    world = random_walls(seed)
    one_by_one = world.cast_moving(np.tile([0.5, 0.1, theta], (1081, 1)), BEARINGS, 30.0)
    at_once = world.cast(Pose2(0.5, 0.1, theta), BEARINGS, 30.0)
    np.testing.assert_allclose(at_once, one_by_one, rtol=1e-9)


@settings(deadline=None)  # the first call compiles or loads the kernel
@given(st.integers(0, 50), angle, st.floats(-50, 50), st.floats(-50, 50))
def test_moving_world_and_laser_together_changes_nothing(seed, theta, x, y):
    world, pose, moved = World(box(1, 2, 9, 8)), Pose2(0.5, 0.1, 0.2), Pose2(x, y, theta)
    world = World.joined([world, World(box(3, 3, 0.5, 0.7, 0.3 * seed))])
    before = world.cast(pose, BEARINGS, FAR)
    after = world.moved(moved).cast(moved * pose, BEARINGS, FAR)
    # A beam that just misses an edge of the crate may meet it after the rounding of a turn.
    assert np.mean(np.abs(after - before) < 1e-6) > 0.995


@pytest.mark.parametrize("offset", [0.0, 0.1, 3.0, -3.0, 6.0])
def test_a_full_turn_starts_anywhere(offset):
    bearings = offset + np.linspace(0.0, 2.0 * np.pi, 721)[:-1]
    ranges = room(6, 4).cast(Pose2(2, 1, 0), bearings, FAR)
    np.testing.assert_allclose(ranges, range_in_room(6, 4, 2, 1, bearings), rtol=1e-9)


def test_a_clockwise_laser_reads_backwards():
    world, pose = random_walls(3), Pose2(1, 1, 1)
    clockwise = world.cast(pose, BEARINGS[::-1], 30.0)
    np.testing.assert_array_equal(clockwise[::-1], world.cast(pose, BEARINGS, 30.0))


def test_a_laser_on_a_wall_reads_zero():
    ranges = room(6, 4).cast(Pose2(3, 0, np.pi / 2), np.radians([-60.0, 0.0, 60.0]), FAR)
    np.testing.assert_array_equal(ranges, [0.0, 0.0, 0.0])


def test_a_wall_seen_edge_on_is_invisible():
    wall = World(np.array([[1.0, 0.0, 3.0, 0.0]]))
    assert np.isinf(wall.cast(Pose2(), np.array([0.0]), FAR)).all()
    beyond = World.joined([wall, World(np.array([[5.0, -1.0, 5.0, 1.0]]))])
    assert beyond.cast(Pose2(), np.array([0.0]), FAR) == pytest.approx([5.0])


@pytest.mark.parametrize("tilt", [1e-3, 1e-5, 1e-7])
def test_a_grazing_beam_meets_the_wall_where_it_crosses_it(tilt):
    wall = World(np.array([[-50.0, 1.0, 1e9, 1.0]]))
    got = wall.cast(Pose2(), np.array([tilt]), np.inf)
    assert got == pytest.approx([1.0 / np.sin(tilt)], rel=1e-6)


def test_nothing_answers_beyond_range_max_or_in_an_empty_world():
    assert np.isinf(room(100, 100).cast(Pose2(50, 50, 0), BEARINGS, 30.0)).all()
    assert np.isinf(World().cast(Pose2(), BEARINGS, 30.0)).all()
    assert World().cast(Pose2(), np.empty(0), 30.0).shape == (0,)


def test_glass_neither_answers_nor_lets_through():
    pane = np.array([[2.0, -1.0, 2.0, 1.0]])
    wall = np.array([[4.0, -9.0, 4.0, 9.0]])
    beams = np.radians([0.0, 40.0])
    ranges = World(wall, panes=pane).cast(Pose2(), beams, 30.0)
    assert np.isinf(ranges[0])
    assert ranges[1] == pytest.approx(4.0 / np.cos(beams[1]))
    behind = World(np.array([[1.0, -9.0, 1.0, 9.0]]), panes=pane).cast(Pose2(), beams, 30.0)
    assert behind == pytest.approx(1.0 / np.cos(beams))


def test_clearance_is_the_distance_to_the_nearest_wall():
    world = World.joined([room(10, 8), World(pillar(5, 4, 1.0, sides=360))])
    got = world.clearance(np.array([[1.0, 4.0], [5.0, 1.0], [8.0, 4.0]]))
    assert got == pytest.approx([1.0, 1.0, 2.0], abs=1e-3)


def test_a_world_keeps_its_own_read_only_walls():
    walls = np.array([[0.0, 0.0, 1.0, 0.0]])
    world = World(walls)
    walls[0, 0] = 9.0
    assert world.segments[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        world.segments[0, 0] = 9.0


def test_bad_walls_and_bearings_are_refused():
    with pytest.raises(ValueError, match="finite"):
        World(np.array([[0.0, 0.0, np.nan, 0.0]]))
    for bearings in ([0.0, 2.0, 1.0, 3.0], [0.0, 7.0]):
        with pytest.raises(ValueError, match="monotone"):
            room(4, 4).cast(Pose2(1, 1, 0), np.array(bearings), 30.0)
