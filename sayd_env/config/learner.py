"""What a learner sees: fixed maps of signals to order 1, rewards in multiples of an ordinary J."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from sayd_env.config.base import Model, Number, quantity
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.units import Array

LARGEST = 1e12
"""Larger numbers than any signal's in SI units."""
WIDEST = 3.4028234663852886e38
"""Largest number in single precision."""


class InputConfig(Model):
    """How a quantity enters the network: a fixed map."""

    scale: Literal["linear", "log"] = Field(
        "linear", description="linear: (value - middle) / half. log: ln(value / middle) / half"
    )
    middle: Number = Field(ge=-LARGEST, le=LARGEST, description="Value that becomes 0, in the signal's unit")
    half: Number = Field(
        ge=1.0 / LARGEST,
        le=LARGEST,
        description="What becomes 1: a difference in the signal's unit, or a logarithm of a ratio",
    )

    @model_validator(mode="after")
    def _has_logarithm(self) -> InputConfig:
        if self.scale == "log" and self.middle <= 0.0:
            raise ValueError(f"middle ({self.middle:g}) must be positive with scale 'log'")
        return self


class RewardReferenceConfig(Model):
    """J of an ordinary policy in an episode: cost (v / speed)^p (level / track_level)^q.

    Rewards are given in its multiples. It knows the conditions alone, so that it makes episodes alike for the
    learner and leaves open which of two policies is the better one there.
    """

    cost: float = quantity("-", "J at the reference's speed and track level", gt=0.0)
    speed: float = quantity("m/s", "Speed of the reference", gt=0.0)
    speed_exponent: float = quantity("-", "p")
    track_level: float = quantity("-", "Factor on the amplitudes of the track's spectrum", gt=0.0)
    track_exponent: float = quantity("-", "q; an episode whose level is not drawn counts as the reference")

    def ordinary(self, speeds: Iterable[float], levels: Iterable[float | None]) -> Array:
        """J of the ordinary policy at speeds (m/s) and track levels, shape (N)."""
        speed = np.array([*speeds]) / self.speed
        level = np.array([each or self.track_level for each in levels]) / self.track_level
        cost: Array = self.cost * speed**self.speed_exponent * level**self.track_exponent
        return cost


class LearnerConfig(Model):
    """Observations and rewards of order 1."""

    inputs: dict[str, InputConfig] = Field(description="Map of each quantity of an observation")
    clip: float = quantity("-", "Largest number of an observation", gt=0.0, le=WIDEST)
    reward: RewardReferenceConfig
    worst: float = quantity("-", "Largest cost of a step: lower rewards are cut off", gt=0.0)


@cache
def load_learner(name: str = "scaled") -> LearnerConfig:
    """Read what scaled environments and trainings scale by.

    Raises
    ------
    ConfigError
        The file, a key or a value cannot be used.
    """
    return read_layered(LearnerConfig, Kind("learner"), name)
