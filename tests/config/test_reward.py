"""Named weights of the cost: the paper's, and those in which a fixed command does worse."""

from __future__ import annotations

import pytest

from sayd_env.config import ConfigError
from sayd_env.config.control import load_controller
from sayd_env.config.reward import REPORTED, named_rewards, reported_costs, with_reward
from sayd_env.config.scenario import load_scenario


def test_the_papers_weights_are_those_of_its_controllers_and_of_the_study():
    for name in ("mppt1", "mppt2"):
        controller = load_controller(name).model_dump()
        assert named_rewards()[name].model_dump() == {key: controller[key] for key in ("k_y", "k_F")}
    scenario = load_scenario()
    assert with_reward(scenario, "mppt2") == scenario


def test_the_third_set_is_within_the_papers_sense():
    """The force never counts more than twice the acceleration, each against its limit."""
    assert set(named_rewards()) == {"mppt1", "mppt2", "low-force"}
    assert 0.5 < named_rewards()["low-force"].k_F / named_rewards()["low-force"].k_y <= 2.0


def test_weights_change_nothing_else():
    scenario = load_scenario()
    other = with_reward(scenario, "mppt1")
    assert (other.cost.acceleration_weight, other.cost.force_weight) == (1.0, 0.0)
    assert other.cost.force_reference == scenario.cost.force_reference
    assert other.model_copy(update={"cost": scenario.cost}) == scenario


def test_other_weights_than_the_own_are_reported():
    own = load_scenario().cost
    assert set(reported_costs(own)) == {"J_low_force"}
    assert set(reported_costs(named_rewards()["low-force"].of(own))) == {"J_mppt2"}
    assert set(reported_costs(named_rewards()["mppt1"].of(own))) == set(REPORTED)


def test_an_unknown_name_is_refused():
    with pytest.raises(ConfigError, match="found 'mppt3', did you mean 'mppt2'"):
        with_reward(load_scenario(), "mppt3")
