"""The kernels on their own: the search by bearing, small matrices, lines."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slam.frontend import (
    correspondence_kernels,
    covariance_kernels,
    degeneracy,
    icp_kernels,
    scan_kernels,
)
from slam.frontend.compiled import kernel
from slam.frontend.scan import LINE, prepare
from slam.logs.messages import LaserExtrinsics, LaserScan

from tests.frontend.scans import CENTRED, SCAN, stacked

finite = st.floats(-8, 8)

# Parts are compiled into the kernels that call them; here each is a kernel of its own.
combine = kernel(covariance_kernels.combine.py_func)
invert3 = kernel(covariance_kernels.invert3.py_func)
weakest_direction = kernel(degeneracy.weakest_direction.py_func)
bearing_of = kernel(correspondence_kernels.bearing_of.py_func)
weak_direction = kernel(degeneracy.weak_direction.py_func)
nearest_beam = kernel(correspondence_kernels.nearest_beam.py_func)
solve3 = kernel(icp_kernels.solve3.py_func)
fit_lines = kernel(scan_kernels.fit_lines.py_func)


@st.composite
def fields(draw):
    """A scan of any field of view, start and direction, with beams that bring nothing back."""
    n = draw(st.integers(3, 90))
    full = draw(st.booleans())
    step = 2 * np.pi / n if full else draw(st.floats(0.002, 2 * np.pi / (n + 1)))
    step *= draw(st.sampled_from([1, -1]))
    rng = np.random.default_rng(draw(st.integers(0, 9999)))
    ranges = rng.uniform(0.1, 8.0, n).astype(np.float32)
    if draw(st.booleans()):  # walls instead of confetti
        ranges = (2 + np.cumsum(rng.normal(0, 0.05, n))).clip(0.1).astype(np.float32)
    ranges[rng.random(n) < draw(st.sampled_from([0.0, 0.2, 0.9]))] = np.nan
    extrinsics = LaserExtrinsics(0, draw(finite) * 0.1, draw(finite) * 0.1, draw(st.floats(-3, 3)))
    return prepare(LaserScan(0, draw(st.floats(-7, 7)), step, ranges, 0.02, 30.0), extrinsics, SCAN)


@settings(deadline=None, max_examples=400)
@given(fields(), finite, finite, st.floats(0.01, 20))
def test_nearest_beam_is_the_nearest_of_all(scan, x, y, gate):
    j, d2 = nearest_beam(x, y, stacked([scan]), 0, gate * gate)
    distances2 = ((scan.points - [x, y]) ** 2).sum(axis=1)
    near = np.nan_to_num(distances2, nan=np.inf)
    if near.min() < gate * gate:
        assert d2 == pytest.approx(near.min(), rel=1e-9)
        assert near[j] == pytest.approx(near.min(), rel=1e-9)
    else:
        assert j == -1


@settings(deadline=None, max_examples=100)
@given(fields(), fields(), finite, finite)
def test_nearest_beam_looks_at_its_own_reference_only(one, other, x, y):
    joined = nearest_beam(x, y, stacked([one, other]), 1, 4.0)
    alone = nearest_beam(x, y, stacked([other]), 0, 4.0)
    assert joined == alone


@settings(deadline=None)
@given(finite, finite)
def test_bearing_is_good_to_a_fiftieth_of_a_beam(x, y):
    if x == y == 0.0:
        assert bearing_of(y, x) == 0.0
    else:
        apart = bearing_of(y, x) - np.arctan2(y, x)
        assert abs((apart + np.pi) % (2 * np.pi) - np.pi) < 2e-4


@settings(deadline=None)
@given(st.integers(0, 9999), st.floats(-6, 6))
def test_small_matrices_are_inverted_and_solved(seed, scale):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) + 2 * np.eye(3)
    a = root @ root.T * 10**scale
    out, step, g = np.empty((3, 3)), np.empty(3), rng.normal(size=3)
    invert3(a, out)
    if np.linalg.cond(a) < 1e6:
        np.testing.assert_allclose(out @ a, np.eye(3), atol=1e-6)
        assert solve3(a[np.triu_indices(3)].copy(), g, step)
        np.testing.assert_allclose(a @ step, -g, atol=1e-6)


@pytest.mark.parametrize("a", [np.zeros(6), np.array([1.0, 1, 0, 1, 0, 1]), np.full(6, np.nan)])
def test_singular_systems_are_refused(a):
    assert not solve3(a, np.ones(3), np.empty(3))


@settings(deadline=None)
@given(st.floats(0.1, 5), st.floats(0.1, 5), st.floats(-1.5, 1.5))
def test_the_weak_direction_is_that_of_the_smaller_eigenvalue(low, extra, angle):
    c, s = np.cos(angle), np.sin(angle)
    high = low + extra
    a, b, d = low * c * c + high * s * s, (low - high) * c * s, low * s * s + high * c * c
    small, large, found = weak_direction(a, b, d)
    assert small == pytest.approx(low, rel=1e-6)
    assert large == pytest.approx(high, rel=1e-6)
    assert abs(np.sin(found - angle)) < 1e-5


def test_the_weakest_axis_is_measured_against_what_is_known():
    information = np.diag([100.0, 1e6, 1e6])  # sigma of 0.1 m along x
    angle, condition_ratio = weakest_direction(information, np.diag([0.05, 0.05, 0.02]) ** 2)
    assert abs(np.sin(angle)) < 1e-9
    assert condition_ratio == pytest.approx(2.0)


def test_information_adds_up():
    information, known, out = np.diag([0.0, 4.0, 9.0]), np.diag([1.0, 5.0, 7.0]), np.empty((3, 3))
    combine(information, known, out)
    np.testing.assert_allclose(out, np.diag([1.0, 1 / 9, 1 / 16]))


@settings(deadline=None, max_examples=60)
@given(fields())
def test_windows_lie_on_one_surface_and_hold_their_beam(scan):
    for i in np.flatnonzero(scan.flags & LINE):
        a, b = scan.windows[i]
        assert a <= i <= b
        assert b - a >= 2
        assert np.isfinite(scan.points[a : b + 1]).all()


def test_a_line_is_the_least_squares_line_of_its_window():
    rng = np.random.default_rng(4)
    ranges = (2 / np.cos(np.linspace(-0.6, 0.6, 90)) + rng.normal(0, 0.01, 90)).astype(np.float32)
    scan = prepare(LaserScan(0, -0.6, 1.2 / 89, ranges, 0.02, 30.0), CENTRED, SCAN)
    straight = np.flatnonzero(scan.flags & LINE)
    assert len(straight) > 80
    for i in straight:
        a, b = scan.windows[i]
        points = scan.points[a : b + 1]
        values, vectors = np.linalg.eigh(np.cov(points.T, bias=True) * len(points))
        normal, offset, variance = scan.lines[i, :2], scan.lines[i, 2], scan.lines[i, 3]
        assert abs(normal @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-9)
        assert offset == pytest.approx(normal @ points.mean(axis=0), abs=1e-9)
        assert variance == pytest.approx(SCAN.range_noise**2 / values[1], rel=1e-6)
        assert scan.lines[i, 4] == pytest.approx(
            np.array([-normal[1], normal[0]]) @ points.mean(axis=0), abs=1e-9
        )


def test_points_that_coincide_have_no_line():
    points, flags = np.full((5, 2), 0.5), np.ones(5, dtype=np.uint8)
    lines, windows = np.zeros((5, 5)), np.zeros((5, 2), dtype=np.int32)
    geometry = np.array([0.0, 1e-9, 0.0, 0.0, 0.0])
    fit_lines(points, flags, geometry, 0.01, 1.0, 10.0, 0.2, lines, windows)
    assert not (flags & LINE).any()
    assert np.isfinite(lines).all()


def test_a_part_is_plain_python_to_python():
    assert degeneracy.weak_direction(2.0, 0.0, 1.0) == weak_direction(2.0, 0.0, 1.0)
