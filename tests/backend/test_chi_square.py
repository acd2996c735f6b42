"""The limits of the chi-square test are those of `scipy`, its distance that of the textbook."""

import numpy as np
import pytest
from scipy.stats import chi2
from slam.backend.chi_square import SUSPICIOUS, chi_square_limit, mahalanobis


@pytest.mark.parametrize("freedom", [1, 2, 3, 6, 9])
@pytest.mark.parametrize("probability", [0.999, 0.5, 0.1, 0.005, 1e-6])
def test_the_limit_is_exceeded_as_often_as_it_says(probability, freedom):
    limit = chi_square_limit(probability, freedom)
    assert limit == pytest.approx(chi2.isf(probability, freedom), rel=1e-12)


def test_the_suspicious_edge_is_one_in_a_thousand():
    assert chi_square_limit(1e-3, 3) == pytest.approx(SUSPICIOUS, abs=0.005)


def test_the_distance_is_that_of_both_covariances_together():
    rng = np.random.default_rng(4)
    a, b = (m @ m.T + 0.1 * np.eye(3) for m in rng.normal(size=(2, 3, 3)))
    error = rng.normal(size=3)
    together = float(error @ np.linalg.solve(a + b, error))
    assert mahalanobis(error, a, np.linalg.inv(b)) == pytest.approx(together, rel=1e-9)


def test_an_axis_that_the_second_estimate_cannot_see_cannot_disagree():
    sees_y = np.diag([0.0, 1e4, 1e4])
    assert mahalanobis(np.array([5.0, 0.0, 0.0]), 1e-4 * np.eye(3), sees_y) == pytest.approx(0.0)
    assert mahalanobis(np.array([0.0, 5.0, 0.0]), 1e-4 * np.eye(3), sees_y) > 1e4
