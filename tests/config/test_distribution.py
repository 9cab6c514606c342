"""Laws of random numbers: bounds, moments from SciPy's distributions, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sayd_env.config import ConfigError, Model, validate
from sayd_env.config.distribution import (
    ChoiceDistribution,
    Distribution,
    FixedDistribution,
    NormalDistribution,
    UniformDistribution,
    chosen,
)

U = (np.arange(100_000) + 0.5) / 100_000
"""Mid-points: their means are integrals over u, to about 1e-9."""


class Holder(Model):
    drawn: Distribution


def test_a_fixed_distribution_has_one_number_of_any_shape():
    drawn = FixedDistribution(distribution="fixed", value=0.3)
    assert drawn.bounds == (0.3, 0.3)
    np.testing.assert_array_equal(drawn.at(np.zeros((2, 3))), np.full((2, 3), 0.3))
    assert float(drawn.at(0.7)) == 0.3


def test_a_uniform_one_has_the_moments_of_the_uniform_distribution():
    values = UniformDistribution(distribution="uniform", low=200.0, high=400.0).at(U)
    assert values.min() >= 200.0
    assert values.max() <= 400.0
    assert values.mean() == pytest.approx(300.0, rel=1e-9)
    assert values.std() == pytest.approx(200.0 / np.sqrt(12.0), rel=1e-6)


def test_a_grid_has_its_ends_and_all_its_numbers_alike():
    values = UniformDistribution(distribution="uniform", low=0.0, high=1.0, step=0.05).at(U)
    found, counts = np.unique(values, return_counts=True)
    np.testing.assert_array_equal(found, [round(0.05 * k, 2) for k in range(21)])
    np.testing.assert_allclose(counts, len(U) / 21, atol=1.0)


def test_a_truncated_one_has_the_moments_of_the_truncated_normal_distribution():
    drawn = NormalDistribution(distribution="normal", mean=1.0, deviation=0.075, low=0.9, high=1.225)
    values = drawn.at(U)
    exact = stats.truncnorm((0.9 - 1.0) / 0.075, (1.225 - 1.0) / 0.075, loc=1.0, scale=0.075)
    assert (values.min() >= 0.9, values.max() <= 1.225) == (True, True)
    assert values.mean() == pytest.approx(exact.mean(), abs=1e-6)
    assert values.std() == pytest.approx(exact.std(), abs=1e-5)
    np.testing.assert_allclose(drawn.at([0.1, 0.5, 0.9]), exact.ppf([0.1, 0.5, 0.9]), rtol=1e-12)


def test_a_choice_comes_as_often_as_its_weight_says():
    values = ChoiceDistribution(distribution="choice", values=(3.0, 1.0, 2.0), weights=(5.0, 0.0, 15.0)).at(U)
    assert np.mean(values == 3.0) == pytest.approx(0.25, abs=1e-5)
    assert np.mean(values == 2.0) == pytest.approx(0.75, abs=1e-5)
    alike = ChoiceDistribution(distribution="choice", values=(1.0, 2.0, 4.0)).at(U)
    assert np.mean(alike) == pytest.approx(7.0 / 3.0, abs=1e-4)


@pytest.mark.parametrize("weights", [(0.1,) * 10, (1.0, 0.0), (0.0, 1.0), (0.3, 0.3, 0.1, 0.0)])
def test_no_rounding_leads_to_a_place_without_weight(weights: tuple[float, ...]):
    places = chosen(weights, [0.0, np.nextafter(1.0, 0.0)])
    assert all(weights[place] > 0.0 for place in places)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (
            {"distribution": "unifrm"},
            "drawn.distribution: found 'unifrm', did you mean 'uniform'?; expected fixed, uniform",
        ),
        (
            {"low": 0.0, "high": 1.0},
            "key 'drawn.distribution' is missing: it says of which kind the entry is; expected fixed",
        ),
        (3.0, "drawn: found 3.0; expected keys and values"),
        ({"distribution": "uniform", "low": 1.0, "high": 0.0}, "drawn: low (1) must not exceed high (0)"),
        (
            {"distribution": "uniform", "low": 0.0, "high": 1.0, "step": 0.3},
            "must be a whole number of steps",
        ),
        (
            {"distribution": "uniform", "low": 0.0, "hig": 1.0},
            "unknown key 'drawn.hig', did you mean 'high'?",
        ),
        (
            {"distribution": "uniform", "low": "0", "high": 1.0},
            "drawn.low: found '0'; expected a number: Smallest",
        ),
        (
            {"distribution": "normal", "mean": 0, "deviation": 0, "low": -1, "high": 1},
            "drawn.deviation: found 0; expect",
        ),
        (
            {"distribution": "normal", "mean": 2, "deviation": 1, "low": -1, "high": 1},
            "mean (2) must lie between low",
        ),
        ({"distribution": "choice", "values": []}, "drawn.values: found []; expected at least 1 entries"),
        (
            {"distribution": "choice", "values": [1, 2], "weights": [1]},
            "2 values need as many weights, found 1",
        ),
        (
            {"distribution": "choice", "values": [1, 2], "weights": [0, 0]},
            "at least one weight must be positive",
        ),
        (
            {"distribution": "fixed", "value": float("nan")},
            "drawn.value: found nan; expected a finite number",
        ),
    ],
)
def test_a_bad_distribution_is_one_clear_line(content: object, expected: str):
    with pytest.raises(ConfigError) as caught:
        validate(Holder, {"drawn": content}, "some.yaml")
    assert str(caught.value).startswith("some.yaml: ")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)
