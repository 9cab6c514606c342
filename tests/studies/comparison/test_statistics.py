"""Statistics of a comparison against closed forms, hand calculations and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from sayd_env.config.comparison import BootstrapConfig
from sayd_env.studies.comparison.statistics import (
    Bootstrap,
    difference,
    estimate,
    improvement,
    improvements,
    interquartile_mean,
    iqm,
    profile,
    reduction,
)

RANDOM = np.random.default_rng(0)


def bootstrap(conditions: int, scenarios: int, samples: int = 10_000, seed: int = 0) -> Bootstrap:
    return Bootstrap(conditions, scenarios, BootstrapConfig(samples=samples, seed=seed))


def test_the_interquartile_mean_is_that_of_the_middle_half():
    assert interquartile_mean(np.array([8.0, 1, 2, 7, 3, 6, 4, 5])) == 4.5  # (3 + 4 + 5 + 6) / 4
    assert interquartile_mean(np.array([[8e9, 1, 2, 7, 3, 6, 4, 5]])) == 4.5


def test_an_interval_spans_95_percent():
    found = estimate(500.0, np.arange(1001.0))
    assert (found.low, found.high) == (pytest.approx(25.0), pytest.approx(975.0))


def test_constant_data_have_no_interval():
    values = np.full((3, 4, 2), 0.7)
    draws = bootstrap(4, 2, 500)
    for found in (iqm(values, draws), reduction(values, values[:1], draws)):
        assert found.low == pytest.approx(found.value)
        assert found.high == pytest.approx(found.value)
    assert iqm(values, draws).value == pytest.approx(0.7)


def test_what_differs_between_conditions_alone_is_no_uncertainty_of_a_stratified_mean():
    values = np.broadcast_to(10.0 ** np.arange(5)[None, :, None], (1, 5, 3))
    found = iqm(values, bootstrap(5, 3, 500))
    assert found.low == found.high == found.value == pytest.approx((10 + 100 + 1000) / 3)


def test_a_stratified_mean_has_the_variance_of_its_strata():
    """Seeds are drawn once for all conditions: the variance of their means over the conditions, over S."""
    values = RANDOM.normal(size=(1, 6, 4)) + 100.0 * np.arange(6)[None, :, None]
    expected = values[0].mean(axis=0).var() / 4
    means = bootstrap(6, 4).means(values[..., None])[:, 0]
    assert means.var() == pytest.approx(expected, rel=0.06)
    assert means.mean() == pytest.approx(values.mean(), abs=4 * np.sqrt(expected / 10_000))


def test_training_seeds_are_drawn_once_for_all_conditions():
    """A training that is better everywhere: variance of the seeds over R, for any number of conditions."""
    values = np.broadcast_to(np.arange(5.0)[:, None, None], (5, 40, 2))
    assert bootstrap(40, 2).means(values[..., None]).var() == pytest.approx(2.0 / 5, rel=0.06)


def test_a_seed_that_is_worse_everywhere_is_no_less_uncertain_in_many_conditions():
    """One vehicle of a seed runs in all conditions: the variance of two seeds over 2."""
    values = np.broadcast_to(np.array([0.0, 2.0]), (1, 40, 2))
    draws = bootstrap(40, 2)
    assert draws.means(values[..., None]).var() == pytest.approx(1.0 / 2, rel=0.06)
    mine, theirs = draws.paired(1.0 + values, np.ones((1, 40, 2)))
    assert mine.var() == pytest.approx(1.0 / 2, rel=0.06)
    assert theirs.var() == pytest.approx(0.0, abs=1e-20)


def test_both_ways_to_a_stratified_mean_agree():
    values, draws = RANDOM.normal(size=(3, 4, 2)), bootstrap(4, 2, 300)
    assert draws.means(values[..., None])[:, 0] == pytest.approx(
        draws.stratified(values, lambda x, axis: x.mean(axis=axis))
    )


def test_resamples_come_from_the_seed():
    values = RANDOM.normal(size=(3, 4, 2))
    same, again = iqm(values, bootstrap(4, 2, 300)), iqm(values, bootstrap(4, 2, 300))
    assert same == again
    assert iqm(values, bootstrap(4, 2, 300, seed=1)) != same


def test_improvement_is_the_mann_whitney_statistic_of_each_scenario():
    values, reference = RANDOM.integers(0, 4, (5, 3, 2)).astype(float), np.full((1, 3, 2), 2.0)
    pairs = mannwhitneyu(
        reference.reshape(1, -1), values.reshape(5, -1), method="asymptotic", use_continuity=False
    )
    assert improvements(values, reference).mean(axis=0).ravel() == pytest.approx(pairs.statistic / 5)


def test_improvement_in_closed_form():
    reference = np.full((1, 1, 4), 2.0)
    values = np.array([[[1.0, 1.0, 2.0, 3.0]]])  # lower, lower, a tie, higher
    found = improvement(values, reference, bootstrap(1, 4))
    assert found.value == (1 + 1 + 0.5 + 0) / 4
    # Resampled means of {1, 1, 0.5, 0} have the variance of these four over four.
    spread = bootstrap(1, 4).means(improvements(values, reference)[..., None]).var()
    assert spread == pytest.approx(np.var([1.0, 1.0, 0.5, 0.0]) / 4, rel=0.06)


def test_a_common_effect_of_the_conditions_cancels_out():
    reference = 10.0 ** RANDOM.uniform(-2, 2, (1, 30, 2))
    found = reduction(0.8 * reference, reference, bootstrap(30, 2, 1000))
    assert (found.value, found.low, found.high) == tuple(pytest.approx(0.2) for _ in range(3))


def test_a_paired_difference_has_the_variance_of_the_differences():
    """Over conditions drawn whole, with one seed: that of the differences over C."""
    common, gain = 1e3 * RANDOM.normal(size=(1, 50, 1)), RANDOM.normal(size=(1, 50, 1))
    mine, theirs = bootstrap(50, 1).paired(common + gain, common)
    assert (mine - theirs).var() == pytest.approx(gain.mean(axis=2).var() / 50, rel=0.06)
    assert mine.var() == pytest.approx(common.mean(axis=2).var() / 50, rel=0.06)
    found = difference(common + gain, common, bootstrap(50, 1))
    half = 1.96 * np.sqrt(gain.mean(axis=2).var() / 50)  # the quantiles of a normal law
    assert found.high - found.value == pytest.approx(half, rel=0.1)
    assert found.value == pytest.approx(gain.mean())


def test_a_paired_reduction_knows_the_spread_of_the_trainings():
    reference = np.ones((1, 20, 1))
    values = np.array([0.6, 0.8, 1.0, 0.6, 0.8])[:, None, None] * reference
    found = reduction(values, reference, bootstrap(20, 1))
    assert found.value == pytest.approx(1 - 0.76)
    mine, _ = bootstrap(20, 1).paired(values, reference)
    assert mine.var() == pytest.approx(np.var([0.6, 0.8, 1.0, 0.6, 0.8]) / 5, rel=0.06)
    assert found.low < found.value < found.high


def test_a_profile_counts_runs_up_to_a_threshold():
    values = np.array([[[0.5], [1.0]], [[0.7], [3.0]]])
    share, low, high = profile(values, np.array([0.4, 0.5, 0.9, 1.0, 2.9, 3.0]), bootstrap(2, 1, 1000))
    assert share.tolist() == [0.0, 0.25, 0.5, 0.75, 0.75, 1.0]
    assert np.all(low <= share)
    assert np.all(share <= high)
    # Trainings are drawn whole: both the first one, both the second one, or one of each.
    assert (low[3], high[3]) == (0.5, 1.0)
