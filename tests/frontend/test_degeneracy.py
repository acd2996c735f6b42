"""One definition of a degenerate direction: the kernels' and that for whole matrices agree."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from slam.frontend.degeneracy import (
    STRONGEST_PAIRS,
    is_degenerate,
    keep_strongest,
    quiet_spurious_gradient,
    taken_by_heading,
    weak_direction,
    weak_sigmas,
    weakest_direction,
    well_constrained,
)
from slam.frontend.match_arrays import SPURIOUS, SYSTEM


@given(st.integers(0, 9999))
def test_kernels_and_whole_matrices_name_the_same_direction(seed):
    root = np.random.default_rng(seed).normal(size=(3, 3)) * [10.0, 40.0, 90.0]
    information = root.T @ root + np.diag([1.0, 2.0, 3.0])
    bxx, bxy, byy = taken_by_heading(*information[:, 2])
    (xx, xy), (_, yy) = information[:2, :2]
    low, high, angle = weak_direction(xx - bxx, xy - bxy, yy - byy)
    along, weak, strong = weak_sigmas(information)
    assert weak == pytest.approx(low**-0.5, rel=1e-6)
    assert strong == pytest.approx(high**-0.5, rel=1e-6)
    if high > 1.01 * low:
        assert abs(along @ [np.cos(angle), np.sin(angle)]) == pytest.approx(1.0, abs=1e-6)
    # Sigmas of the covariance, as far as they are its axes: the heading is marginalised.
    values = np.linalg.eigvalsh(np.linalg.inv(information)[:2, :2])
    np.testing.assert_allclose([strong, weak], np.sqrt(values), rtol=1e-6)


def test_a_match_that_knows_less_than_its_prior_is_degenerate():
    prior = np.diag([0.02, 0.02, 0.01]) ** 2
    for sigma, degenerate in ((0.03, True), (0.01, False)):
        information = np.diag([sigma**-2, 1e8, 1e8])
        angle, ratio = weakest_direction(information, prior)
        assert ratio == pytest.approx(sigma / 0.02)
        assert abs(np.sin(angle)) < 1e-9
        assert is_degenerate(ratio) == degenerate


def test_no_information_is_degenerate_whatever_the_prior():
    assert is_degenerate(weakest_direction(np.zeros((3, 3)), np.eye(3) * 1e-4)[1])
    assert weak_sigmas(np.zeros((3, 3)))[1] == np.inf


@pytest.mark.parametrize(("share", "left"), [(0.0, 1.0), (0.25, 0.75), (1.0, 0.0), (3.0, 0.0)])
def test_the_gradient_keeps_the_share_of_the_information_that_is_real(share, left):
    system = np.zeros(SYSTEM)
    system[0], system[3], system[5] = 4.0, 900.0, 50.0  # weak along x
    system[6:9] = 2.0, 3.0, 5.0
    system[SPURIOUS] = share * 4.0
    quiet_spurious_gradient(system)
    np.testing.assert_allclose(system[6:9], [left * 2.0, 3.0, 5.0], atol=1e-12)


def test_the_strongest_pairs_are_kept_in_order():
    strongest, pairs = np.zeros(STRONGEST_PAIRS), np.random.default_rng(3).uniform(size=50)
    for information in pairs:
        keep_strongest(information, strongest)
    np.testing.assert_array_equal(strongest, np.sort(pairs)[::-1][:STRONGEST_PAIRS])


def test_a_map_that_hangs_on_an_edge_along_a_corridor_is_not_well_constrained():
    along, across, turn = 0.5, 1e4, 1e4  # 1.4 m along the corridor
    assert not well_constrained(np.diag([along, across, turn]), 1.0)
    assert well_constrained(np.diag([along, across, turn]), 1.5)
