"""From ranges to points and lines in the base frame."""

from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from slam.drivers.simulators.laser import LASERS, LaserConfig, take_scan
from slam.drivers.simulators.world import World
from slam.frontend.scan import LINE, VALID, ScanConfig, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan

CENTRED = LaserExtrinsics(0, 0.0, 0.0, 0.0)
ROOM = World.from_polygon([(-3, -2), (5, -2), (5, 3), (-3, 3)])
QUIET = replace(LASERS["hokuyo-181"], sigma=0.0, quantum=0.0)
CONFIG = ScanConfig()

any_ranges = npst.arrays(
    np.float32, st.integers(0, 60), elements=st.floats(width=32, allow_nan=True)
)


def scan_of(world=ROOM, laser=QUIET, pose=None):
    return take_scan(world, pose or Pose2(), laser, np.random.default_rng(0))


def test_points_lie_where_the_beams_end():
    prepared = prepare(scan_of(), CENTRED, CONFIG)
    bearings = np.arctan2(prepared.points[:, 1], prepared.points[:, 0])
    np.testing.assert_allclose(bearings, QUIET.bearings, atol=1e-9)
    np.testing.assert_allclose(prepared.ranges, scan_of().ranges, rtol=1e-6)
    assert prepared.valid == 181


def test_points_are_given_in_the_base_frame():
    base_T_laser = Pose2(0.2, -0.1, 0.4)
    extrinsics = LaserExtrinsics(0, base_T_laser.x(), base_T_laser.y(), base_T_laser.theta())
    scan = scan_of()
    plain, mounted = prepare(scan, CENTRED, CONFIG), prepare(scan, extrinsics, CONFIG)
    expected = base_T_laser.transformFrom(np.asfortranarray(plain.points.T)).T
    np.testing.assert_allclose(mounted.points, expected, atol=1e-9)
    np.testing.assert_allclose(mounted.ranges, plain.ranges, atol=1e-9)


def test_a_laser_that_turns_clockwise_sees_the_same():
    scan = scan_of()
    clockwise = replace(
        scan, angle_min=-scan.angle_min, angle_step=-scan.angle_step, ranges=scan.ranges[::-1]
    )
    one, other = prepare(scan, CENTRED, CONFIG), prepare(clockwise, CENTRED, CONFIG)
    np.testing.assert_allclose(other.points, one.points, atol=1e-9)
    np.testing.assert_allclose(other.lines, one.lines, atol=1e-6)


def test_unusable_readings_have_no_point():
    bad = [np.nan, np.inf, -np.inf, -1.0, 0.0, 0.01, 31.0]
    ranges = np.full(20, 2.0, dtype=np.float32)
    ranges[: len(bad)] = bad
    scan = LaserScan(0, -0.5, 0.05, ranges, range_min=0.02, range_max=30.0)
    prepared = prepare(scan, CENTRED, CONFIG)
    assert prepared.valid == 20 - len(bad)
    assert not (prepared.flags[: len(bad)] & VALID).any()
    assert np.isnan(prepared.points[: len(bad)]).all()
    assert (prepared.flags[len(bad) :] & VALID).all()


@pytest.mark.parametrize("sigma", [0.0, 0.01])
def test_lines_are_the_walls(sigma):
    laser = LaserConfig(beams=361, angle_min=-np.pi / 2, angle_step=np.pi / 360, sigma=sigma)
    prepared = prepare(scan_of(laser=laser), CENTRED, CONFIG)
    points, lines = prepared.points, prepared.lines
    straight = (prepared.flags & LINE) > 0
    assert straight.mean() > 0.9
    normals, offsets = lines[straight, :2], lines[straight, 2]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-9)
    # Every normal points to the laser, which stands at the origin: n . 0 > d.
    assert (offsets < 0).all()
    # Three walls are in view, x = 5, y = 3 and y = -2.
    walls = np.array([[-1.0, 0.0, -5.0], [0.0, -1.0, -3.0], [0.0, 1.0, -2.0]])
    found = np.column_stack([normals, offsets])
    apart = np.abs(found[:, None] - walls[None]).max(axis=2).min(axis=1)
    # A line may run a little into a corner, as far as the noise would hide it.
    assert np.median(apart) < 1e-3 + 2 * sigma
    assert np.quantile(apart, 0.9) < 0.02 + 5 * sigma
    residuals = np.einsum("ij,ij->i", normals, points[straight]) - offsets
    assert np.sqrt(np.mean(residuals**2)) < 2e-3 + 1.2 * sigma


def test_the_claimed_uncertainty_of_normals_is_the_real_one():
    laser = LaserConfig(beams=361, angle_min=-np.pi / 2, angle_step=np.pi / 360, sigma=0.01)
    wall = World(np.array([[2.0, -3.0, 2.0, 3.0]]))
    rng = np.random.default_rng(3)
    normalised = []
    for _ in range(40):
        prepared = prepare(take_scan(wall, Pose2(), laser, rng), CENTRED, CONFIG)
        nx, ny, _, s2 = prepared.lines[180, :4]
        normalised.append(np.arctan2(-ny, -nx) / np.sqrt(s2))
    assert 0.5 < np.std(normalised) < 1.5


def test_a_step_between_two_walls_parts_their_lines():
    steps = World(np.array([[2.0, -4.0, 2.0, 0.0], [3.0, 0.0, 3.0, 4.0]]))
    prepared = prepare(scan_of(steps), CENTRED, CONFIG)
    straight = (prepared.flags & LINE) > 0
    # A line across the step would be a wall that is not there.
    assert np.abs(prepared.lines[straight, 1]).max() < 0.02


def test_a_scan_cannot_be_changed_by_its_readers():
    prepared = prepare(scan_of(), CENTRED, CONFIG)
    for array in (prepared.points, prepared.lines, prepared.flags):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


@settings(deadline=None)
@given(any_ranges, st.floats(-4, 4), st.floats(-0.1, 0.1).filter(lambda s: abs(s) > 1e-4))
def test_any_ranges_give_finite_points_and_lines_or_none(ranges, angle_min, step):
    prepared = prepare(LaserScan(0, angle_min, step, ranges, 0.02, 30.0), CENTRED, CONFIG)
    valid = (prepared.flags & VALID) > 0
    assert prepared.valid == valid.sum()
    assert np.isfinite(prepared.points[valid]).all()
    assert np.isfinite(prepared.lines[(prepared.flags & LINE) > 0]).all()
    assert not ((prepared.flags & LINE) > 0)[~valid].any()
    assert np.isfinite(prepared.centre).all()
