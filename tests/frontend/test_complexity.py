"""The seed paper's complexity, checked against its own tables."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from slam.frontend.complexity import (
    WallSums,
    layered_sums,
    object_score,
    pose_score,
    wall_profiles,
    wall_sums,
)

# Table IV: the depth changes along the left and the right wall of Figure 4.
LEFT_DIFF = [1, -1, -1, 1, 1, 0, -1, 0]
RIGHT_DIFF = [-1, 0, 1, 0, 1, -1, 1, -1]

# Whole millimetres: sums of these are exact in floating point.
depths = npst.arrays(np.float64, st.integers(0, 40), elements=st.integers(-10_000, 10_000))


def profile(diffs):
    return np.concatenate([[3.0], 3.0 + np.cumsum(np.array(diffs, dtype=np.float64))])


def test_table_4():
    left, right = wall_sums(profile(LEFT_DIFF)), wall_sums(profile(RIGHT_DIFF))
    assert (left.diff, left.diff2, right.diff, right.diff2) == (6, 7, 6, 10)


# Surfaces of our own with the sums that Table II gives for Figure 3: a ramp, two staircases
# (a tread between two risers costs two of diff2, one before the first riser costs one) and a
# comb with a flank (a change of direction costs two).
TABLE_2 = {
    "a": ([1] * 10, 10, 0),
    "b": ([0] + [1, 0] * 7 + [1] * 3, 10, 15),
    "c": ([0] + [1, 0] * 3 + [1] * 7, 10, 7),
    "d": ([0] + [1, -1] * 11 + [-1] * 6, 28, 43),
}


@pytest.mark.parametrize("row", TABLE_2)
def test_table_2(row):
    diffs, diff, diff2 = TABLE_2[row]
    assert wall_sums(profile(diffs)) == WallSums(diff, diff2)


@given(depths, st.integers(-10_000, 10_000))
def test_sums_do_not_depend_on_where_the_wall_stands(depth, shift):
    assert wall_sums(depth + shift) == wall_sums(depth)


@given(depths)
def test_sums_are_the_same_read_from_either_end_or_from_behind(depth):
    assert wall_sums(depth[::-1]) == wall_sums(depth) == wall_sums(-depth)


@given(depths, st.integers(0, 50))
def test_sums_grow_with_the_depth_of_the_relief(depth, factor):
    sums = wall_sums(depth)
    assert wall_sums(factor * depth) == WallSums(factor * sums.diff, factor * sums.diff2)


def test_a_gap_is_skipped_not_bridged():
    nan = np.nan
    seen = [1.0, 2.0, nan, 9.0, 9.0, 7.0]
    assert wall_sums(np.array(seen)) == WallSums(1 + 2, 2)
    assert wall_sums(np.array([1.0, nan, 5.0, nan])) == WallSums(0, 0)


@pytest.mark.parametrize("depth", [[], [1.0], [np.nan, np.nan]])
def test_a_wall_that_is_hardly_seen_has_no_complexity(depth):
    assert wall_sums(np.array(depth)) == WallSums(0, 0)


def test_layers_are_summed_apart_and_averaged():
    """Table I as printed would go on summing from layer to layer, and give 15 and 15 here."""
    ramp, stairs = profile(TABLE_2["a"][0]), profile(TABLE_2["b"][0])
    assert layered_sums([ramp, stairs]) == WallSums(10, 7.5)
    assert layered_sums([stairs, stairs, stairs]) == wall_sums(stairs)
    assert layered_sums([]) == WallSums(0, 0)


def test_equation_1():
    layers = [profile(TABLE_2["a"][0]), profile(TABLE_2["b"][0])]
    assert object_score(layers, radius=4.0, c1=2.0, c2=3.0) == (2 * 10 + 3 * 7.5) / 4


def test_equation_1_does_not_grow_with_the_size_of_the_object():
    layers = [profile(TABLE_2["d"][0])]
    larger = [3.0 * layer for layer in layers]
    assert object_score(larger, 3.0, 1.0, 1.0) == object_score(layers, 1.0, 1.0, 1.0)


@pytest.mark.parametrize("radius", [0.0, -1.0, float("nan")])
def test_an_object_needs_a_radius(radius):
    with pytest.raises(ValueError, match="radius must be positive"):
        object_score([profile([1])], radius, 1.0, 1.0)


def test_equation_2():
    complexity = pose_score(WallSums(6, 7), WallSums(6, 10), (1.0, 0.5, 2.0, 0.1))
    assert complexity.t_pe == pytest.approx((6 + 3.5 + 12 + 1.0) / 2)
    assert complexity.sums == (6, 7, 6, 10)


def test_profiles_are_lateral_distances_on_a_grid_in_x():
    left = [[-0.9, 2.0], [-0.1, 1.0], [-0.2, 2.0], [0.6, 3.0]]
    right = [[0.1, -0.5], [0.4, -1.5]]
    ahead = [[0.7, 0.0]]  # on neither side
    elsewhere = [[1.5, 9.0], [-1.01, 9.0], [np.nan, np.nan]]
    points = np.array(left + right + ahead + elsewhere)
    found_left, found_right = wall_profiles(points, reach=1.0, bin_width=0.5)
    np.testing.assert_array_equal(found_left, [2.0, 1.5, np.nan, 3.0])
    np.testing.assert_array_equal(found_right, [np.nan, np.nan, 1.0, np.nan])


def test_a_mirrored_scan_has_its_walls_exchanged():
    rng = np.random.default_rng(1)
    points = rng.uniform(-3, 3, (200, 2))
    left, right = wall_profiles(points, 3.0, 0.25)
    mirrored_left, mirrored_right = wall_profiles(points * [1, -1], 3.0, 0.25)
    np.testing.assert_array_equal(mirrored_left, right)
    np.testing.assert_array_equal(mirrored_right, left)


def test_without_points_every_bin_is_empty():
    left, right = wall_profiles(np.empty((0, 2)), 1.0, 0.5)
    assert len(left) == len(right) == 4
    assert np.isnan(left).all()
    assert np.isnan(right).all()
