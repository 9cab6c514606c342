"""Scores of a comparison: what costs and ratios by hand come to, and which targets hold."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config.comparison import BootstrapConfig, ComparedTrack, ComparedWheels
from sayd_env.runs.policies import PolicySpec
from sayd_env.stability import Crossing
from sayd_env.studies.comparison.entrants import Entrant
from sayd_env.studies.comparison.grid import OWN, Condition
from sayd_env.studies.comparison.scores import (
    Score,
    Stability,
    best_constants,
    least_stable,
    score,
    stability_of,
    targets,
)
from sayd_env.studies.comparison.statistics import Bootstrap, geometric_reduction
from sayd_env.studies.map import Cell

WORN = ComparedWheels(name="worn", wear=1.0)
CONDITIONS = [Condition(WORN, ComparedTrack(name="china"), 300.0, friction) for friction in (0.3, 0.4)]


def made_up(learned: list[list[float]]) -> Score:
    """Score of trainings with J in two conditions: MPPT2 has 1 and 3, tuned 1 and 2, the passive one 2."""
    costs = {
        "passive": np.full((1, 2, 1), 2.0),
        "mppt2": np.array([[[1.0], [3.0]]]),
        "mppt1": np.full((1, 2, 1), 4.0),
        "mppt2-tuned": np.array([[[1.0], [2.0]]]),
        "constant-tuned@mine": np.array([[[0.9], [2.4]]]),
        "ppo": np.array(learned)[..., None],
    }
    bound = np.full((1, 2, 1), 0.5)
    return score("ppo", costs, bound, CONDITIONS, Bootstrap(2, 1, BootstrapConfig(samples=500, seed=0)))


def test_a_score_compares_scenario_by_scenario():
    found = made_up([[0.5, 1.5], [0.5, 2.1]])
    assert pytest.approx(4.6 / 4) == found.J
    assert found.J_by_training_seed.tolist() == [1.0, pytest.approx(1.3)]
    assert found.best_of_paper == "mppt2"
    assert found.relative_to_mppt2.value == 0.5  # the middle two of 0.5, 0.5, 0.5 and 0.7
    assert found.probability_of_improvement["mppt2"].value == 1.0
    assert found.reduction.value == pytest.approx(1 - 1.15 / 2)
    assert found.reduction_by_controller["passive"].value == pytest.approx(1 - 1.15 / 2)
    assert (
        found.probability_of_improvement["passive"].value == 0.75
    )  # 2.1 in one of four is above the passive 2
    assert found.worst_vs_passive == pytest.approx(0.9)
    assert found.worst_condition == CONDITIONS[1]
    assert (found.conditions_worse_than_passive, found.conditions_of_training_seeds_worse_than_passive) == (
        0,
        1,
    )
    assert found.relative_to_best_constant == pytest.approx(2.3)


def test_geometric_means_are_over_conditions_of_means():
    """J of 0.5 and 1.8 over 0.5 each; MPPT2 has 1 and 3, the tuned ones 1 and 2, 0.9 and 2.4."""
    found = made_up([[0.5, 1.5], [0.5, 2.1]])
    assert found.geometric.value == pytest.approx((1.0 * 3.6) ** 0.5)
    assert found.best_of["paper"] == ("mppt2", "mppt2")
    assert found.best_of["tuned"] == ("mppt2-tuned", "mppt2-tuned")  # sqrt(2) and 1.5; sqrt(2.16) and 1.65
    gain = found.geometric_by_controller["mppt2-tuned"]
    assert gain.value == pytest.approx(1.0 - (0.9 / 2.0) ** 0.5)
    # Resamples of two conditions: both alike (0.5, or 0.9 with trainings of 0.75 to 1.05), or one of each.
    assert 1.0 - 1.05 - 1e-9 <= gain.low <= gain.value <= gain.high <= 0.5 + 1e-9


def test_a_factor_on_every_condition_has_no_spread():
    """20 % less in every condition and seed is 20 % less, whatever is drawn."""
    random = np.random.default_rng(1)
    theirs = random.uniform(0.1, 9.0, (1, 7, 3))
    bootstrap = Bootstrap(7, 3, BootstrapConfig(samples=300, seed=0))
    found = geometric_reduction(0.8 * theirs, theirs, bootstrap)
    assert (found.value, found.low, found.high) == pytest.approx((0.2, 0.2, 0.2))


STABLE = Stability(None, "not_reached", {}, (340.0, 400.0), {"acceleration": 0.4}, 0.5)


CRITICAL = Stability(390.0, "found", {}, (340.0, 400.0), {"acceleration": 1.1}, 1.2)
UNKNOWN = Stability(None, "not_reached", {}, (340.0, 370.0), {"acceleration": 0.4}, 0.5)


@pytest.mark.parametrize(
    ("learned", "stability", "holds"),
    [
        ([0.5, 1.5], STABLE, [True, True, True, True]),
        ([0.85, 1.95], STABLE, [True, True, True, True]),  # 26 % below MPPT2, 9 % below the tuned one
        ([0.9, 1.95], STABLE, [True, False, True, True]),  # 6 % below the tuned one
        ([0.9, 2.8], STABLE, [False, False, False, True]),  # 8 % below MPPT2
        (
            [0.5, 2.05],
            STABLE,
            [True, False, False, True],
        ),  # 28 % below tuned; 2.5 % above passive
        ([0.5, 1.5], CRITICAL, [True, True, True, False]),
        ([0.5, 1.5], UNKNOWN, [True, True, True, False]),  # nobody knows about 400 km/h
    ],
)
def test_targets(learned: list[float], stability: Stability, holds: list[bool]):
    parts = {"stationary": {OWN: made_up([learned])}}
    rows = targets(Entrant("ppo", (PolicySpec("ppo-s0"),)), parts, stability, 0.6)
    assert [row.holds for row in rows] == holds


def test_the_best_constant_is_that_of_the_mean_over_the_seeds():
    one, other = np.array([[[1.0, 9.0], [2.0, 2.0]]]), np.array([[[4.0, 4.0], [3.0, 0.5]]])
    found = best_constants([0.0, 0.4], [one, other])
    assert found.currents.tolist() == [0.4, 0.4]
    assert found.costs.tolist() == [[[4.0, 4.0], [3.0, 0.5]]]


def test_stability_is_judged_by_medians_up_to_400_km_h():
    ratios = {
        "acceleration": {340.0: (0.2, 0.4, 3.0), 400.0: (0.9, 0.8, 0.7), 430.0: (2.0, 2.0, 2.0)},
        "track_shift_force": {340.0: (0.1, 0.1, 0.1), 400.0: (0.1, 0.1, 0.2), 430.0: (0.1, 0.1, 0.1)},
    }
    found = stability_of(
        Cell(
            "x",
            1.0,
            0.4,
            {"acceleration": (405.0, Crossing.FOUND), "track_shift_force": (None, Crossing.NOT_REACHED)},
            ratios,
        )
    )
    assert found.critical_speed_kmh == 405.0
    assert found.ratios == {"acceleration": 0.8, "track_shift_force": 0.1}
    assert found.largest_run == 3.0
    assert found.stable
    below = Stability(None, "below_grid", {}, (340.0,), {"acceleration": 2.0, "track_shift_force": 0.1}, 2.0)
    both = least_stable([found, below])
    assert (both.critical_speed_kmh, both.status, both.stable) == (None, "below_grid", False)
