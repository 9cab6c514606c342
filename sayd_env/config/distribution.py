"""Distributions of random numbers, as data.

Each makes its number from one uniform number u in [0, 1) by the inverse of its distribution function, so that
one which is exchanged for another leaves all other draws as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator
from scipy.special import ndtr, ndtri

from sayd_env.config.base import Model, Number, is_multiple
from sayd_env.config.units import Array


class FixedDistribution(Model):
    """A constant."""

    distribution: Literal["fixed"]
    value: Number = Field(description="The number")

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest number that can be drawn."""
        return self.value, self.value

    def at(self, u: npt.ArrayLike) -> Array:
        """Numbers that belong to uniform ones u in [0, 1), of the same shape."""
        return np.full(np.shape(u), self.value)


class UniformDistribution(Model):
    """All numbers between two limits, or those of a grid between them, equally likely."""

    distribution: Literal["uniform"]
    low: Number = Field(description="Smallest number")
    high: Number = Field(description="Largest number")
    step: Annotated[Number, Field(gt=0.0)] | None = Field(
        None, description="Distance of the grid's numbers; null: no grid"
    )

    @model_validator(mode="after")
    def _ordered(self) -> UniformDistribution:
        if self.low > self.high:
            raise ValueError(f"low ({self.low:g}) must not exceed high ({self.high:g})")
        width = self.high - self.low
        if self.step is not None and width > 0.0 and not is_multiple(width, self.step):
            raise ValueError(
                f"high - low ({width:g}) must be a whole number of steps, found step {self.step:g}"
            )
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest number that can be drawn."""
        return self.low, self.high

    def at(self, u: npt.ArrayLike) -> Array:
        """Numbers that belong to uniform ones u in [0, 1), of the same shape."""
        if self.step is None:
            return self.low + np.asarray(u) * (self.high - self.low)
        count = round((self.high - self.low) / self.step) + 1
        values = self.low + self.step * np.minimum(np.floor(np.asarray(u) * count), count - 1)
        return np.asarray(np.round(values, 12))  # 0.15 instead of 0.15000000000000002


class NormalDistribution(Model):
    """The normal distribution, truncated at two limits."""

    distribution: Literal["normal"]
    mean: Number = Field(description="Mean before truncation")
    deviation: Annotated[Number, Field(gt=0.0)] = Field(description="Standard deviation before truncation")
    low: Number = Field(description="Smallest number")
    high: Number = Field(description="Largest number")

    @model_validator(mode="after")
    def _ordered(self) -> NormalDistribution:
        if not self.low < self.high:
            raise ValueError(f"low ({self.low:g}) must be below high ({self.high:g})")
        if not self.low <= self.mean <= self.high:
            raise ValueError(f"mean ({self.mean:g}) must lie between low ({self.low:g}) and high")
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest number that can be drawn."""
        return self.low, self.high

    def at(self, u: npt.ArrayLike) -> Array:
        """Numbers that belong to uniform ones u in [0, 1), of the same shape."""
        first = ndtr((self.low - self.mean) / self.deviation)
        last = ndtr((self.high - self.mean) / self.deviation)
        values = self.mean + self.deviation * ndtri(first + np.asarray(u) * (last - first))
        return np.asarray(np.clip(values, self.low, self.high))


class ChoiceDistribution(Model):
    """One of several given numbers."""

    distribution: Literal["choice"]
    values: tuple[Number, ...] = Field(min_length=1, description="The numbers")
    weights: tuple[Annotated[Number, Field(ge=0.0, le=1e9)], ...] | None = Field(
        None, description="Relative frequency of each (-); equal when absent"
    )

    @model_validator(mode="after")
    def _weighted(self) -> ChoiceDistribution:
        if self.weights is not None and len(self.weights) != len(self.values):
            raise ValueError(f"{len(self.values)} values need as many weights, found {len(self.weights)}")
        if self.weights is not None and sum(self.weights) == 0.0:
            raise ValueError("at least one weight must be positive")
        return self

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest number that can be drawn."""
        return min(self.values), max(self.values)

    def at(self, u: npt.ArrayLike) -> Array:
        """Numbers that belong to uniform ones u in [0, 1), of the same shape."""
        weights = self.weights or (1.0,) * len(self.values)
        return np.array(self.values)[chosen(weights, u)]


Distribution = Annotated[
    FixedDistribution | UniformDistribution | NormalDistribution | ChoiceDistribution,
    Field(discriminator="distribution"),
]


def chosen(weights: Sequence[float], u: npt.ArrayLike) -> npt.NDArray[np.intp]:
    """Indices for uniform numbers u in [0, 1), each as frequent as its weight says, of u's shape."""
    steps = np.cumsum(weights)
    places = np.searchsorted(steps, np.asarray(u) * steps[-1], side="right")
    last = np.flatnonzero(weights)[-1]  # u times the sum may round up to the sum
    return np.asarray(np.minimum(places, last))
