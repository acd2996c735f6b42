"""Figures that need no truth: each grows with the fault that it is named after."""

import numpy as np
import pytest

from slam.evaluation.report.consistency import (
    closure_residuals,
    odometry_against_matches,
    wall_thickness,
)


def walls(noise_m: float, apart_m: float = 0.0, scans: int = 8, seed: int = 0):
    """Two walls at an angle to the grid, seen by many scans; half of these may be displaced."""
    rng = np.random.default_rng(seed)
    along = rng.uniform(0.0, 10.0, 8000)
    source = rng.integers(0, scans, 8000)
    across = rng.normal(0.0, noise_m, 8000) + apart_m * (source % 2)
    turn = np.where(rng.random(8000) < 0.5, 0.3, 1.9)
    x = along * np.cos(turn) - across * np.sin(turn)
    y = along * np.sin(turn) + across * np.cos(turn)
    return np.column_stack([x, y]), source


@pytest.mark.parametrize("noise_m", [0.005, 0.01, 0.02])
def test_walls_are_as_thick_as_the_noise(noise_m):
    thickness = wall_thickness(*walls(noise_m))
    assert len(thickness) > 50
    assert np.median(thickness) == pytest.approx(noise_m, rel=0.1)


def test_a_doubled_wall_is_thicker():
    sharp, doubled = (np.median(wall_thickness(*walls(0.005, apart))) for apart in (0.0, 0.04))
    assert doubled == pytest.approx(0.02, rel=0.2)
    assert doubled > 3 * sharp


def test_the_frame_does_not_matter():
    points, source = walls(0.01)
    c, s = np.cos(0.7), np.sin(0.7)
    turned = points @ np.array([[c, s], [-s, c]]) + [1e4, -2e4]
    a, b = (np.median(wall_thickness(p, source)) for p in (points, turned))
    assert a == pytest.approx(b, rel=0.05)


def test_what_one_scan_saw_alone_or_is_no_wall_does_not_count():
    points, _ = walls(0.01)
    assert len(wall_thickness(points, np.zeros(len(points), dtype=np.int64))) == 0
    cloud = np.random.default_rng(0).uniform(0, 3, (8000, 2))
    assert len(wall_thickness(cloud, np.arange(8000) % 8)) == 0
    assert len(wall_thickness(np.zeros((0, 2)), np.zeros(0, dtype=np.int64))) == 0


def test_nothing_is_claimed_where_nothing_is_known():
    assert closure_residuals([], None) == {}
    assert odometry_against_matches([]) == {}
