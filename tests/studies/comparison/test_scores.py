"""Scores of a comparison: what costs and ratios by hand come to, and which targets hold."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config.comparison import BootstrapConfig, ComparedTrack
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
from sayd_env.studies.comparison.statistics import Bootstrap
from sayd_env.studies.map import Cell

CONDITIONS = [Condition(ComparedTrack(name="china"), 300.0, 1.0, friction) for friction in (0.3, 0.4)]


def made_up(learned: list[list[float]]) -> Score:
    """Score of trainings with the given J in two conditions, where MPPT2 has 1 and 3, the passive one 2."""
    costs = {
        "passive": np.full((1, 2, 1), 2.0),
        "mppt2": np.array([[[1.0], [3.0]]]),
        "mppt1": np.full((1, 2, 1), 4.0),
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


STABLE = Stability(None, "not reached", {}, (340.0, 400.0), {"acceleration": 0.4}, 0.5)


@pytest.mark.parametrize(
    ("learned", "stability", "holds"),
    [
        ([0.5, 1.5], STABLE, [True, True, True]),
        ([0.95, 2.85], STABLE, [False, False, True]),  # 5 % below MPPT2, and 2.85 above 2
        ([0.5, 2.1], STABLE, [True, False, True]),
        ([1.9, 0.1], STABLE, [False, True, True]),  # half of MPPT2's on average, not in each condition
        (
            [0.5, 1.5],
            Stability(390.0, "found", {}, (340.0, 400.0), {"acceleration": 1.1}, 1.2),
            [True, True, False],
        ),
        (
            [0.5, 1.5],
            Stability(None, "not reached", {}, (340.0, 370.0), {"acceleration": 0.4}, 0.5),
            [True, True, False],  # nobody knows about 400 km/h
        ),
    ],
)
def test_targets(learned: list[float], stability: Stability, holds: list[bool]):
    rows = targets(Entrant("ppo", (PolicySpec("ppo-s0"),)), {OWN: made_up([learned])}, stability, 0.6)
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
    below = Stability(None, "below grid", {}, (340.0,), {"acceleration": 2.0, "track_shift_force": 0.1}, 2.0)
    both = least_stable([found, below])
    assert (both.critical_speed_kmh, both.status, both.stable) == (None, "below grid", False)
