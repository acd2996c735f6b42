"""The occupancy grid: what a beam says, what it does not, and how much memory it may take."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from slam.logs.messages import LaserScan

from slam.maps.occupancy import MapConfig, build_map
from slam.runs.config_file import load_config
from slam.runs.errors import ConfigError

CONFIG = MapConfig(resolution=0.1, margin=0.0)


def scan_of(*ranges: float, angle_min: float = 0.0, angle_step: float = 0.1, **limits) -> LaserScan:
    return LaserScan(7, angle_min, angle_step, np.array(ranges, dtype=np.float32), **limits)


def cell(grid, x: float, y: float) -> int:
    row = math.floor((y - grid.origin_y) / grid.resolution + 1e-9)
    column = math.floor((x - grid.origin_x) / grid.resolution + 1e-9)
    rows, columns = grid.cells.shape
    return int(grid.cells[row, column]) if 0 <= row < rows and 0 <= column < columns else -1


def room_scan(x: float, y: float, theta: float, half: float = 5.05, beams: int = 720) -> LaserScan:
    """What an all-round laser sees from inside a square room."""
    angles = -math.pi + np.arange(beams) * 2 * math.pi / beams
    dx, dy = np.cos(angles + theta), np.sin(angles + theta)
    with np.errstate(divide="ignore"):
        to_x = np.where(dx >= 0, half - x, -half - x) / dx
        to_y = np.where(dy >= 0, half - y, -half - y) / dy
    return scan_of(*np.minimum(to_x, to_y), angle_min=-math.pi, angle_step=2 * math.pi / beams)


def test_a_beam_clears_its_way_and_marks_its_end():
    grid = build_map([scan_of(2.05)], np.array([[0.05, 0.05, 0.0]]), CONFIG)
    row = [cell(grid, x, 0.05) for x in np.arange(0.05, 2.2, 0.1)]
    assert row[:20] == [40] * 20  # miss_probability
    assert row[20:22] == [40, 70] or row[20:22] == [70, -1]
    assert np.count_nonzero(grid.cells >= 0) <= 22
    assert grid.stamp_ns == 7


def test_a_room_is_closed_free_inside_and_unknown_outside():
    poses = np.array([[0.3 * k, 0.2 * k, 0.5 * k] for k in range(-5, 6)])
    grid = build_map([room_scan(*pose) for pose in poses], poses, MapConfig(resolution=0.1))
    inside = [
        cell(grid, x, y) for x in np.arange(-4.75, 4.8, 0.5) for y in np.arange(-4.75, 4.8, 0.5)
    ]
    assert max(inside) < 10
    for s in np.arange(-4.95, 5.0, 0.1):
        assert min(cell(grid, side * 5.05, s) for side in (1, -1)) > 65
        assert min(cell(grid, s, side * 5.05) for side in (1, -1)) > 65
    assert cell(grid, 5.25, 0.0) == -1


def test_a_grazing_beam_does_not_erase_the_hit_of_its_neighbour():
    near_and_past = scan_of(3.0, 9.0, angle_min=0.0, angle_step=0.002)
    grid = build_map([near_and_past] * 5, np.tile([0.05, 0.05, 0.0], (5, 1)), CONFIG)
    assert cell(grid, 3.0, 0.05) > 90 or cell(grid, 3.05, 0.05) > 90


def test_nan_and_too_near_readings_say_nothing():
    scan = scan_of(math.nan, 0.0, -1.0, 0.05, range_min=0.1)
    grid = build_map([scan], np.zeros((1, 3)), CONFIG)
    assert np.all(grid.cells == -1)


@pytest.mark.parametrize("reading", [math.inf, 12.0])
def test_no_return_clears_a_little_and_hits_nothing(reading):
    scan = scan_of(reading, range_max=8.0)
    grid = build_map([scan], np.array([[0.05, 0.05, 0.0]]), CONFIG)
    assert cell(grid, 1.9, 0.05) == 40
    assert cell(grid, 2.25, 0.05) == -1
    assert grid.cells.max() == 40
    silent = build_map([scan], np.zeros((1, 3)), CONFIG.model_copy(update={"no_return_free": 0.0}))
    assert np.all(silent.cells == -1)


def test_a_reading_beyond_max_range_clears_that_far_only():
    config = MapConfig(resolution=0.1, max_range=5.0)
    grid = build_map([scan_of(20.0)], np.array([[0.05, 0.05, 0.0]]), config)
    assert cell(grid, 4.9, 0.05) == 40
    assert grid.cells.max() == 40
    assert grid.cells.shape[1] < 70


def test_a_moved_laser_moves_the_map_with_it():
    scan = room_scan(0.0, 0.0, 0.0, half=2.0)
    still = build_map([scan], np.array([[0.02, 0.02, 0.0]]), CONFIG)
    moved = build_map([scan], np.array([[10.02, -20.98, 0.0]]), CONFIG)
    assert np.array_equal(still.cells, moved.cells)
    assert moved.origin_x - still.origin_x == pytest.approx(10.0)
    assert moved.origin_y - still.origin_y == pytest.approx(-21.0)


def test_the_same_input_gives_the_same_bytes_however_it_is_cut():
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-3, 3, (1500, 2)), rng.uniform(-3, 3, 1500)])
    scans = [room_scan(*pose, beams=90) for pose in poses]
    once = build_map(scans, poses, CONFIG)
    assert once.cells.tobytes() == build_map(tuple(scans), poses, CONFIG).cells.tobytes()


def test_a_scan_with_a_lost_pose_is_left_out():
    scans = [room_scan(0, 0, 0)] * 3
    poses = np.array([[0, 0, 0], [math.nan, 0, 0], [0, math.inf, 0]])
    one, three = build_map(scans[:1], poses[:1], CONFIG), build_map(scans, poses, CONFIG)
    assert np.array_equal(one.cells, three.cells)


@pytest.mark.parametrize("stray", [1e4, 1e9, 1e100])
def test_a_stray_pose_costs_no_memory_and_does_not_spoil_the_map(stray):
    poses = np.zeros((300, 3))
    poses[150, :2] = stray, -stray
    config = MapConfig(resolution=0.1, max_cells=2_000_000)
    grid = build_map([room_scan(0, 0, 0, beams=90)] * 300, poses, config)
    assert grid.cells.size <= 2_000_000
    assert 0 <= cell(grid, 0.05, 0.05) < 5
    assert cell(grid, 5.05, 0.05) > 90 or cell(grid, 5.05, -0.05) > 90


def test_a_place_too_large_is_cropped_around_its_middle():
    poses = np.zeros((1000, 3))
    poses[:, 0] = np.linspace(0, 1000, 1000)
    config = MapConfig(resolution=0.1, max_cells=100_000, max_range=10.0)
    grid = build_map([scan_of(3.0, 3.0, angle_step=1.5)] * 1000, poses, config)
    assert grid.cells.size <= 100_000
    assert cell(grid, 500.0, 0.0) >= 0


def test_nothing_gives_one_unknown_cell():
    grid = build_map([], np.zeros((0, 3)))
    assert grid.cells.tolist() == [[-1]]
    with pytest.raises(ValueError, match="need"):
        build_map([scan_of(1.0)], np.zeros((2, 3)))


def test_scans_without_beams_are_harmless():
    grid = build_map([scan_of(), scan_of(1.0)], np.zeros((2, 3)), CONFIG)
    assert np.count_nonzero(grid.cells >= 0) > 5


def test_a_misspelt_setting_is_refused():
    with pytest.raises(ValidationError, match="resolutoin"):
        MapConfig(resolutoin=0.1)


@pytest.mark.parametrize(
    "setting",
    [
        "resolution=1e-6",
        "resolution=1e300",
        "max_range=1e300",
        "margin=1e9",
        "max_cells=1000000000",
    ],
)
def test_settings_that_no_memory_could_hold_are_refused_before_the_run(setting):
    name = setting.partition("=")[0]
    with pytest.raises(ConfigError, match=f"map.{name}: Input should be .*got"):
        load_config(None, [f"map.{setting}"])


def test_the_finest_and_longest_settings_still_draw():
    finest = MapConfig(resolution=0.001, max_range=1000.0, no_return_free=1000.0)
    beams = scan_of(2.0, math.inf, 900.0)
    grid = build_map([beams], np.zeros((1, 3)), finest.model_copy(update={"max_cells": 4_000_000}))
    assert grid.cells.size <= 4_000_000
