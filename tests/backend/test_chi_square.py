"""The limits of the chi-square test are those of `scipy`."""

import pytest
from scipy.stats import chi2
from slam.backend.chi_square import chi_square_limit


@pytest.mark.parametrize("freedom", [1, 2, 3, 6, 9])
@pytest.mark.parametrize("probability", [0.999, 0.5, 0.1, 0.005, 1e-6])
def test_the_limit_is_exceeded_as_often_as_it_says(probability, freedom):
    limit = chi_square_limit(probability, freedom)
    assert limit == pytest.approx(chi2.isf(probability, freedom), rel=1e-12)
