"""Verdicts on rows P1 to P10, on made-up sweeps whose crossings are known in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sayd_env.config.reproduction import load_reproduction
from sayd_env.runs.passive import Sweep
from sayd_env.stability import Limits
from sayd_env.studies.paper.claims import Claim
from sayd_env.studies.paper.passive_claims import PassiveMeasures, passive_claims

NEW = [280, 310, 340, 355, 370, 385, 400]
WORN = [320, 350, 370, 395, 420, 445]
SEEDS = 5


def rising(kmh: float) -> float:
    return 4.0 + 0.01 * (kmh - 375)


def scattered_at_320(kmh: float) -> float:
    return 1.0 if kmh < 350 else 0.1


@pytest.fixture
def judge(synthetic: Callable[..., Sweep], limits: Limits) -> Callable[..., dict[str, Claim]]:
    """Judge a vehicle that shows all that the paper shows, but for what is given."""

    def judge(new: dict[str, Any] | None = None, worn: dict[str, Any] | None = None) -> dict[str, Claim]:
        good_new = {"acceleration_kmh": [375.0] * SEEDS, "slope": 1 / 120, "frequency": rising}
        good_worn = {
            "acceleration_kmh": [330.0] * SEEDS,
            "force_kmh": [361.0] * SEEDS,
            "frequency": rising,
            "scatter": scattered_at_320,
        }
        first = good_new | (new or {})
        sweeps = (
            synthetic(NEW, force_kmh=first["acceleration_kmh"], **first),
            synthetic(WORN, **(good_worn | (worn or {}))),
        )
        return {claim.id: claim for claim in passive_claims(*sweeps, limits)}

    return judge


def failed(claims: dict[str, Claim]) -> set[str]:
    return {claim.id for claim in claims.values() if not claim.holds}


def test_the_grids_are_those_of_the_figures():
    study = load_reproduction()
    assert np.array(study.speeds("new")) * 3.6 == pytest.approx(NEW)
    assert np.array(study.speeds("worn")) * 3.6 == pytest.approx(WORN)
    assert np.array(study.speeds("sayd")) * 3.6 == pytest.approx([300, 320, 350, 375, 400])


def test_a_vehicle_like_the_papers_passes_every_row(judge: Callable[..., dict[str, Claim]]):
    claims = judge()
    assert list(claims) == [f"P{i}" for i in range(1, 11)]
    assert failed(claims) == set()
    assert {claim.fraction for claim in claims.values()} == {1.0}
    assert {c.id: c.by for c in claims.values() if c.by == "seed"} == dict.fromkeys(
        ("P1", "P4", "P6", "P9"), "seed"
    )
    assert claims["P2"].measured == "375 km/h (bootstraps 375 to 375); 80 % of the seeds 375 to 375"
    assert claims["P8"].measured == "361 km/h (bootstraps 361 to 361); 80 % of the seeds 361 to 361"


@pytest.mark.parametrize(
    ("new", "worn", "rows"),
    [
        # a_max = 0.5 of the limit at 280 km/h when 1 + (280 - v) / 120 = 0.5
        ({"acceleration_kmh": [339.0] * 5}, {}, {"P1", "P2"}),
        ({"acceleration_kmh": [364.0] * 5}, {}, {"P2"}),
        ({"acceleration_kmh": [386.0] * 5}, {}, {"P2"}),
        # never above the limit: no crossing at all
        ({"acceleration_kmh": [900.0] * 5, "slope": 1 / 1000}, {}, {"P2", "P3"}),
        ({"frequency": lambda v: 4.6}, {}, {"P3"}),
        ({"frequency": lambda v: 3.4}, {}, {"P3"}),
        # P8 asks for a crossing later than P5's, which lies below the grid and is not known
        ({}, {"acceleration_kmh": [319.0] * 5}, {"P4", "P5", "P8"}),
        ({}, {"acceleration_kmh": [341.0] * 5}, {"P5"}),
        ({}, {"acceleration_kmh": [352.0] * 5}, {"P5", "P6"}),
        ({}, {"acceleration_kmh": [365.0] * 5}, {"P5", "P6", "P8"}),  # the force crosses first
        ({}, {"force_kmh": [349.0] * 5}, {"P8"}),
        ({}, {"force_kmh": [371.0] * 5}, {"P8"}),
        ({}, {"trailing": 1.09}, {"P9"}),
        ({}, {"frequency": lambda v: 4.0}, {"P10"}),  # does not rise
        ({}, {"scatter": lambda v: 1.0 if v < 350 else 0.31}, {"P10"}),
        ({}, {"scatter": lambda v: 0.05 if v < 350 else 0.1}, {"P10"}),
    ],
)
def test_each_row_fails_by_itself(
    new: dict[str, Any],
    worn: dict[str, Any],
    rows: set[str],
    judge: Callable[..., dict[str, Claim]],
):
    assert failed(judge(new, worn)) == rows


def test_falling_quantities_fail_row_7(synthetic: Callable[..., Sweep], limits: Limits):
    worn = synthetic(WORN, [330.0], [361.0], frequency=rising, scatter=scattered_at_320)
    worn.acceleration[-1] = worn.acceleration[-2] * 0.99
    claims = {c.id: c for c in passive_claims(synthetic(NEW, [375.0], [375.0]), worn, limits)}
    assert not claims["P7"].holds
    assert claims["P7"].measured.startswith("-0.010 smallest rise")


@pytest.mark.parametrize(("passing", "holds"), [(10, True), (8, True), (7, False)])
def test_a_row_by_seed_holds_if_four_in_five_seeds_pass(
    passing: int, holds: bool, judge: Callable[..., dict[str, Claim]]
):
    # An acceleration that crosses at 319 km/h lies above its limit at 320 km/h.
    crossings = [330.0] * passing + [319.0] * (10 - passing)
    claim = judge(worn={"acceleration_kmh": crossings, "force_kmh": [361.0] * 10})["P4"]
    assert claim.fraction == passing / 10
    assert claim.holds is holds


@pytest.mark.parametrize("good", [3, 4])
def test_a_row_by_median_needs_four_in_five_bootstraps(good: int, judge: Callable[..., dict[str, Claim]]):
    """The median of five draws is good if three of them are: a binomial share, 0.683 or 0.942."""
    p = good / 5
    share = sum(math.comb(5, k) * p**k * (1 - p) ** (5 - k) for k in (3, 4, 5))
    claim = judge({"acceleration_kmh": [375.0] * good + [395.0] * (5 - good)})["P2"]
    assert claim.fraction == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / 1000))
    assert claim.holds is (share >= 0.8)


def test_measures_on_a_selection_of_seeds(synthetic: Callable[..., Sweep], limits: Limits):
    new = synthetic(NEW, [350.0, 360.0, 380.0], [0.0] * 3, slope=1 / 120, frequency=rising)
    worn = synthetic(WORN, [325.0, 330.0, 340.0], [355.0, 361.0, 380.0])
    m = PassiveMeasures(new, worn, limits)
    assert m.new_acceleration.kmh(np.array([0, 1, 2])) == pytest.approx(360.0)
    assert m.new_acceleration.kmh(np.array([2])) == pytest.approx(380.0)
    assert m.frequency_at_critical(np.array([2])) == pytest.approx(4.05)
    assert m.worn_acceleration.kmh(np.array([0, 2])) == pytest.approx(
        332.5
    )  # the median of two is their mean
    assert m.worn_force.kmh(np.array([2, 2, 2])) == pytest.approx(380.0)
    assert m.stable_280() == pytest.approx(1 + (280 - np.array([350.0, 360.0, 380.0])) / 120)
    assert m.ratios_320() == pytest.approx(1 + (320 - np.array([325.0, 330.0, 340.0])) / 200)
    assert m.lowest_ratio_above() == pytest.approx(1 + (350 - np.array([325.0, 330.0, 340.0])) / 200)
    assert m.trailing_ratio() == pytest.approx([1.25] * 3)
    # Relative rises of a line fall with speed: that of the acceleration from 420 to 445 km/h is the smallest.
    assert m.smallest_rise(np.array([1])) == pytest.approx((25 / 200) / (1 + (420 - 330) / 200))
