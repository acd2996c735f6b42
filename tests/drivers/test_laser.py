from dataclasses import replace

import numpy as np
import pytest
from gtsam import Pose2
from scipy.stats import kstest
from slam.drivers.simulators.laser import LASERS, LaserConfig, take_moving_scan, take_scan
from slam.drivers.simulators.world import World

ROOM = World.from_polygon([(0, 0), (10, 0), (10, 8), (0, 8)])
QUIET = replace(LASERS["hokuyo-181"], sigma=0.0, quantum=0.0)


MIDDLE = Pose2(5, 4, 0)


def scan(laser, pose=MIDDLE, seed=0):
    return take_scan(ROOM, pose, laser, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("name", "beams", "first_deg", "last_deg"),
    [
        ("hokuyo-181", 181, -90.0, 90.0),
        ("utm-30lx", 1081, -135.0, 135.0),
        ("sick-361", 361, -90.0, 90.0),
        ("urg-04lx", 682, -119.53, 119.88),
        ("lds-01", 360, 0.0, 359.0),
    ],
)
def test_presets_have_the_geometry_of_their_device(name, beams, first_deg, last_deg):
    got = scan(LASERS[name])
    assert got.ranges.shape == (beams,)
    assert got.ranges.dtype == np.float32
    ends = np.degrees([got.angle_min, got.angle_min + (beams - 1) * got.angle_step])
    assert ends == pytest.approx([first_deg, last_deg], abs=0.01)


def test_a_quiet_laser_tells_the_truth():
    expected = ROOM.cast(Pose2(5, 4, 0), QUIET.bearings, 30.0)
    np.testing.assert_allclose(scan(QUIET).ranges, expected, rtol=1e-6)


def test_noise_is_normal_with_the_stated_sigma():
    laser = replace(QUIET, sigma=0.010)
    errors = np.concatenate([scan(laser, seed=s).ranges - scan(QUIET).ranges for s in range(50)])
    assert kstest(errors / 0.010, "norm").pvalue > 1e-6


def test_ranges_come_in_whole_millimetres():
    ranges = scan(LASERS["hokuyo-181"]).ranges.astype(np.float64)
    np.testing.assert_allclose(ranges, np.round(ranges, 3), atol=1e-6)


def test_too_near_reads_nan_and_too_far_reads_inf():
    near = scan(replace(QUIET, range_min=3.0), pose=Pose2(8, 4, 0))
    assert np.isnan(near.ranges[90])
    assert near.ranges[0] == pytest.approx(4.0)
    assert np.isinf(scan(replace(QUIET, range_max=4.5)).ranges[90])
    noisy = replace(LASERS["hokuyo-181"], range_max=5.0)
    straight_ahead = np.array([scan(noisy, seed=s).ranges[90] for s in range(40)])
    assert np.isinf(straight_ahead).any()  # noise beyond the limit never shows as a range
    assert np.all(np.isinf(straight_ahead) | (straight_ahead <= 5.0))


def test_dropouts_have_the_stated_share():
    laser = replace(LASERS["utm-30lx"], dropout=0.1)
    lost = sum(np.isinf(scan(laser, seed=s).ranges).sum() for s in range(20))
    expected, spread = 0.1 * 21620, (21620 * 0.1 * 0.9) ** 0.5
    assert abs(lost - expected) < 5 * spread


def test_a_sweep_on_the_move_measures_each_beam_from_its_own_place():
    along = np.linspace(0.0, 0.5, 181)
    poses = np.column_stack([5 + along, np.full(181, 4.0), np.zeros(181)])
    moving = take_moving_scan(ROOM, poses, QUIET, np.random.default_rng(0))
    assert moving.ranges[90] == pytest.approx(10 - poses[90, 0])
    at_rest = take_moving_scan(
        ROOM, np.tile([5.0, 4.0, 0.0], (181, 1)), QUIET, np.random.default_rng(0)
    )
    np.testing.assert_allclose(at_rest.ranges, scan(QUIET).ranges, rtol=1e-6)


@pytest.mark.parametrize(
    "wrong",
    [
        {"beams": 0},
        {"angle_step": 0.1},
        {"range_min": 40.0},
        {"dropout": 1.5},
        {"sigma": -1.0},
        {"beam_period_s": 0.01},
        {"rate_hz": 0.0},
    ],
)
def test_impossible_lasers_are_refused(wrong):
    with pytest.raises(ValueError, match=r"."):
        replace(LaserConfig(beams=181, angle_min=-1.5, angle_step=0.017), **wrong)


@pytest.mark.parametrize("name", ["rplidar-a1", "ld06"])
def test_motors_that_turn_unevenly_give_other_beam_counts_over_the_same_view(name):
    laser, rng = LASERS[name], np.random.default_rng(1)
    sweeps = [laser.sweep(rng) for _ in range(200)]
    counts = {one.beams for one in sweeps}
    assert counts == set(range(laser.beams - laser.spare_beams, laser.beams + 1))
    views = [one.beams * one.angle_step for one in sweeps]
    assert np.allclose(views, laser.beams * laser.angle_step)
    assert all(one.beams * one.beam_period_s <= 1.0 / one.rate_hz for one in sweeps)


def test_noise_may_grow_with_the_range():
    laser = replace(QUIET, sigma=0.003, sigma_share=0.01)
    exact = ROOM.cast(MIDDLE, QUIET.bearings, 30.0)
    errors = np.array([scan(laser, seed=k).ranges - exact for k in range(300)])
    np.testing.assert_allclose(
        errors.std(axis=0), np.hypot(0.003, 0.01 * exact), rtol=0.25
    )  # of 300 draws each


def test_a_laser_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="left in a sweep"):
        replace(QUIET, spare_beams=QUIET.beams)
