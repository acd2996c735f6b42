"""What is said about covariances: direction, size and cause."""

import numpy as np
import pytest

from slam.evaluation.metrics import credibility
from slam.evaluation.report.credibility import credibility_figures, explanation

WIDENED = {"graph": {"match_sigma_trans": 0.008, "match_sigma_rot": 0.004}}


def weighed(scale: float, n: int = 3000):
    """NEES of errors that are `scale` times as large as claimed."""
    return credibility(scale**2 * np.random.default_rng(0).chisquare(3, n))


def test_honest_covariances_are_called_so():
    found = weighed(1.0)
    assert credibility_figures(found)["verdict"] == "honest"
    assert explanation(found, WIDENED).startswith("Honest")


def test_too_small_ones_are_warned_of():
    found = weighed(3.0)
    assert credibility_figures(found)["verdict"] == "over-confident"
    assert "3 times as large as the sigmas claim" in explanation(found, WIDENED)


def test_too_large_ones_are_explained_by_what_made_them_so():
    found = weighed(0.14)
    figures = credibility_figures(found)
    assert figures["verdict"] == "cautious"
    assert figures["error_over_sigma"] == pytest.approx(0.14, rel=0.05)
    text = explanation(found, WIDENED)
    assert "7.1 times as large as the errors" in text or "7.2 times" in text
    assert "8 mm and 0.23 degrees" in text
    for unknown in ({}, {"graph": {"match_sigma_trans": 0.0, "match_sigma_rot": 0.0}}):
        assert "widened" not in explanation(found, unknown)


def test_nothing_is_said_of_nothing():
    found = credibility(np.array([np.nan]))
    assert explanation(found, WIDENED) == ""
    assert credibility_figures(found)["verdict"] is None
