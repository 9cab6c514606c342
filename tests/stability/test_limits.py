"""Limits and critical speeds."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.assessment import load_assessment
from sayd_env.stability import Crossing, critical_speed, grid_sensitivity, limits, thinned_grids


def test_limits_of_the_paper_vehicle() -> None:
    """30.0 kN and 5.44 m/s2: eq. 25 and 26 with P = 150 kN and m_b = 2.5 + 2 x 1.55 = 5.6 t, by hand."""
    force, acceleration = limits(150e3, 5600.0)
    assert force == pytest.approx(30.0e3)
    assert acceleration == pytest.approx(5.44)


@pytest.mark.parametrize(
    ("load", "mass"), [(0, 5600), (-1, 5600), (float("nan"), 5600), (150e3, 0), (150e3, 60e3)]
)
def test_impossible_vehicles(load: float, mass: float) -> None:
    with pytest.raises(ConfigError, match="found"):
        limits(load, mass)


SPEEDS = np.array([320.0, 350, 370, 395, 420, 445])


def test_critical_speed_on_a_straight_line() -> None:
    values = 2.0 + 0.05 * (SPEEDS - 300)  # reaches 5.44 at 300 + 3.44 / 0.05
    result = critical_speed(SPEEDS, values, 5.44)
    assert result.crossing is Crossing.FOUND
    assert result.speed == pytest.approx(368.8)
    assert [other.speed for other in thinned_grids(SPEEDS, values, 5.44)] == pytest.approx([368.8] * 4)
    assert not grid_sensitivity(result, thinned_grids(SPEEDS, values, 5.44), 8).sensitive


def test_first_of_several_crossings_counts() -> None:
    assert critical_speed([1, 2, 3, 4], [0, 2, 0, 4], 1.0).speed == pytest.approx(1.5)


def test_no_crossing_and_crossing_below_the_grid() -> None:
    below = critical_speed(SPEEDS, np.full(6, 5.0), 5.0)  # equal to the limit does not exceed it
    assert (below.speed, below.crossing) == (None, Crossing.NOT_REACHED)
    above = critical_speed(SPEEDS, np.full(6, 5.1), 5.0)
    assert (above.speed, above.crossing) == (None, Crossing.BELOW_GRID)
    assert grid_sensitivity(below, [above], 8).sensitive
    assert not grid_sensitivity(below, [below], 8).sensitive


def test_sensitivity_to_the_grid() -> None:
    """A kink at 350: with it 350 + 2, without it the line from (320, 0) to (370, 10) crosses 1 at 325."""
    speeds, values = np.array([320.0, 350, 370]), np.array([0.0, 0, 10])
    result = critical_speed(speeds, values, 1.0)
    assert result.speed == pytest.approx(352)
    others = thinned_grids(speeds, values, 1.0)
    assert [other.speed for other in others] == pytest.approx([325])
    sensitivity = grid_sensitivity(result, others, 8.0)
    assert sensitivity.shift == pytest.approx(27)
    assert sensitivity.sensitive


def test_what_no_other_grid_confirms_is_sensitive() -> None:
    speeds, values = np.array([300.0, 320.0]), np.array([1.0, 3.0])
    result = critical_speed(speeds, values, 2.0)
    assert result.speed == pytest.approx(310.0)
    assert grid_sensitivity(result, thinned_grids(speeds, values, 2.0), 8.0).sensitive


@pytest.mark.parametrize("limit", [np.nan, np.inf])
def test_a_limit_is_a_number(limit: float) -> None:
    with pytest.raises(DataError, match="limit: found"):
        critical_speed(np.array([1.0, 2.0]), np.array([1.0, 3.0]), limit)


@pytest.mark.parametrize(
    ("speeds", "values"), [([], []), ([1, 2], [1]), ([2, 1], [1, 2]), ([1, 1], [1, 2]), ([1, 2], [1, np.nan])]
)
def test_unusable_grids(speeds: list[float], values: list[float]) -> None:
    with pytest.raises(DataError):
        critical_speed(speeds, values, 1.0)


def test_settings_refuse_contradictions() -> None:
    for override in (
        "frequency_max=1",
        "band_min=4",
        "minimum_sample_rate=20",
        "length=100",
        "window_length=-1",
    ):
        with pytest.raises(ConfigError):
            load_assessment(overrides=[override])
    assert load_assessment(overrides=["length=null"]).length is None
