"""The fit of SDP-PE's weights: its budget, its measure, and that it finds what is there."""

import numpy as np
import pytest
from slam.frontend.keyframes import KeyframeConfig

from benchmarks.paper.weights import (
    DISTANCES_M,
    MEAN_M,
    OTHER,
    SEEDS,
    TRAINING,
    Samples,
    Weights,
    fit,
    joined,
    judged,
    mean_interval,
    sampled,
    within_budget,
)

CONFIG = KeyframeConfig()


def made_up(law, seed=0, count=400):
    """Keyframes whose square error after d is law(diff, diff2, d)."""
    rng = np.random.default_rng(seed)
    sums = rng.uniform(0.0, 4.0, (count, 4))
    diff, diff2 = (sums[:, [0]] + sums[:, [2]]) / 2, (sums[:, [1]] + sums[:, [3]]) / 2
    return Samples(np.array(["made-up"] * count), sums, law(diff, diff2, DISTANCES_M))


@pytest.fixture(scope="module")
def bed():
    return sampled("testbed", 1)


def test_a_drive_gives_keyframes_with_the_errors_of_their_matches(bed):
    assert bed.sums.shape == (len(bed.world), 4)
    assert bed.square_error.shape == (len(bed.world), len(DISTANCES_M))
    assert len(bed.world) >= 8
    assert (bed.sums >= 0).all()
    assert 1e-8 < np.median(bed.square_error) < 4e-4  # between 0.1 and 20 mm


def test_training_and_judging_share_no_drive():
    assert not set(TRAINING) & set(OTHER)
    (first, count), (fresh, _) = SEEDS["training"], SEEDS["fresh"]
    assert fresh >= first + count


def test_the_budget_of_matches_is_kept(bed):
    for second in (0.1, 1.0, 10.0):
        weights = within_budget(second, 0.1, bed)
        lengths = weights.lengths(bed)
        assert mean_interval(lengths, bed) == pytest.approx(MEAN_M, abs=1e-6)
        assert CONFIG.min_interval <= lengths.min() <= lengths.max() <= CONFIG.max_interval


def test_the_fit_weighs_as_the_pipeline_does(bed):
    """Equation 2 and the mapping, here on arrays, are those that choose keyframes."""
    weights = Weights(CONFIG.weights[1] / CONFIG.weights[0], CONFIG.t_low, CONFIG.t_high)
    t_pe = bed.sums @ np.array(CONFIG.weights) / 2.0
    share = np.clip((t_pe - CONFIG.t_low) / (CONFIG.t_high - CONFIG.t_low), 0.0, 1.0)
    span = CONFIG.max_interval - CONFIG.min_interval
    np.testing.assert_allclose(weights.lengths(bed), CONFIG.min_interval + share * span)
    assert CONFIG.weights[0] == CONFIG.weights[2]
    assert CONFIG.weights[1] == CONFIG.weights[3]


def test_errors_between_two_distances_are_interpolated():
    samples = made_up(lambda diff, diff2, d: 1.0 + 0.0 * diff + np.log(d))
    middle = np.full(len(samples.world), np.sqrt(DISTANCES_M[3] * DISTANCES_M[4]))
    usual = np.mean(samples.square_error)
    np.testing.assert_allclose(samples.error_after(middle), (1.0 + np.log(middle)) / usual)


@pytest.mark.parametrize(("which", "low", "high"), [(0, 0.05, 0.3), (1, 5.0, 20.0)])
def test_the_sum_that_tells_is_found(which, low, high):
    """Overlap is lost early where the one sum is small, and late where it is large."""

    def law(diff, diff2, d):
        return 1.0 + (d / (0.1 + 0.2 * (diff, diff2)[which])) ** 4

    fitted = fit(made_up(law))
    assert low <= fitted.second <= high
    assert judged(fitted, made_up(law, seed=1))["variance_ratio"] < 0.9


def test_where_walls_tell_nothing_weights_gain_nothing():
    samples = made_up(lambda diff, diff2, d: 1e-6 + 0.0 * diff * d)
    found = judged(within_budget(0.2, 0.0, samples), samples)
    assert found["variance_ratio"] == pytest.approx(1.0)
    assert found["mean_interval_m"] == pytest.approx(MEAN_M)


def test_each_world_counts_the_same():
    many, few = (
        made_up(lambda a, b, d: 1.0 + 0 * a * d),
        made_up(lambda a, b, d: 9.0 + 0 * a * d, 1, 20),
    )
    few = Samples(np.array(["other"] * 20), few.sums, few.square_error)
    both = joined([many, few])
    assert both.share[both.world == "other"].sum() == pytest.approx(0.5)
    assert np.unique(both.error_after(np.full(420, 0.3)).round(12)).tolist() == [1.0]


@pytest.mark.slow
def test_the_weights_that_ship_are_those_that_are_found():
    first, count = SEEDS["training"]
    found = fit(
        joined([sampled(world, seed) for world in TRAINING for seed in range(first, first + count)])
    )
    assert CONFIG.weights[1] == pytest.approx(found.second, rel=0.1)
    assert CONFIG.t_low == pytest.approx(found.t_low, abs=0.05)
    assert CONFIG.t_high == pytest.approx(found.t_high, rel=0.05)
