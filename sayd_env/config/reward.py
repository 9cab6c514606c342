"""Named weights of the cost J, eq. (27)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import AfterValidator

from sayd_env.config.base import Model, quantity
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import nearest
from sayd_env.config.loader import read_config, section, validate
from sayd_env.config.scenario import CostConfig, Scenario

MeanName = Literal["geometric", "arithmetic"]
"""Mean of J over conditions; in the geometric one, rough and smooth conditions count alike."""
REPORTED = {"J_mppt2": "mppt2", "J_low_force": "low-force"}
"""Weights whose J a comparison gives in such a column, unless they are its own."""


class RewardConfig(Model):
    """Weights of J."""

    k_y: float = quantity("-", "Weight of the acceleration", ge=0.0)
    k_F: float = quantity("-", "Weight of the damper force", ge=0.0)

    def of(self, cost: CostConfig) -> CostConfig:
        """A cost with these weights."""
        return cost.model_copy(update={"acceleration_weight": self.k_y, "force_weight": self.k_F})


@cache
def named_rewards() -> Mapping[str, RewardConfig]:
    """Weights by name, of configs/study/rewards.yaml."""
    content, source = read_config("study", "rewards")
    named = section(content, source)
    return MappingProxyType({name: validate(RewardConfig, each, source) for name, each in named.items()})


def _known(name: str | None) -> str | None:
    known = named_rewards()
    if name is not None and name not in known:
        raise ValueError(f"found '{name}'{nearest(name, known)}; expected {', '.join(known)}")
    return name


RewardName = Annotated[str | None, AfterValidator(_known)]
"""Name of weights in a configuration; None: those of the study."""


def with_reward(scenario: Scenario, name: str) -> Scenario:
    """Scenario whose cost has named weights, as the keyword ``reward`` of the environments.

    Raises
    ------
    ConfigError
        An unknown name.
    """
    try:
        _known(name)
    except ValueError as error:
        raise ConfigError(f"--reward: {error}") from None
    return scenario.model_copy(update={"cost": named_rewards()[name].of(scenario.cost)})


def reported_costs(own: CostConfig) -> dict[str, CostConfig]:
    """A cost with those of the `REPORTED` weights that are not its own, by column."""
    costs = {column: named_rewards()[name].of(own) for column, name in REPORTED.items()}
    return {column: cost for column, cost in costs.items() if cost != own}
