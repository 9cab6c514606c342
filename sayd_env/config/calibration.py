"""Schema of a calibration study: what may vary, within which sourced range, and how hard to search."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

from pydantic import Field, field_validator, model_validator

from sayd_env.config.base import Model, Number, quantity
from sayd_env.config.loader import read_study


class Parameter(Model):
    """One free parameter: its value times a factor goes to each of its keys."""

    name: str
    unit: str
    low: Number = Field(description="Lower end of the range, in the unit above", allow_inf_nan=False)
    high: Number = Field(description="Upper end of the range", allow_inf_nan=False)
    guess: float = Field(description="A first guess, screened with the random points")
    scale: Literal["linear", "log"] = "linear"
    keys: dict[str, Number] = Field(description="Scenario key -> factor", min_length=1)
    source: str = Field(description="Where the range comes from")

    @model_validator(mode="after")
    def _range(self) -> Parameter:
        if not self.low < self.high or (self.scale == "log" and self.low <= 0.0):
            raise ValueError("needs low < high, and low > 0 on a log scale")
        if not self.low <= self.guess <= self.high:
            raise ValueError("the guess must lie within the range")
        return self

    def value(self, unit: float) -> float:
        """Value at a place of the unit interval."""
        if self.scale == "log":
            return float(self.low * (self.high / self.low) ** unit)
        return self.low + (self.high - self.low) * unit

    def assignments(self, value: float) -> dict[str, float]:
        """Numbers of its keys at a value, to five digits."""
        return {key: float(f"{factor * value:.5g}") for key, factor in self.keys.items()}

    def place(self, value: float) -> float:
        """Place of a value in the unit interval."""
        if self.scale == "log":
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


class Search(Model):
    """A bounded Gauss-Newton search."""

    name: str
    seeds: int = quantity("-", "Track seeds of each evaluation", ge=1)
    iterations: int = quantity("-", "Number of iterations, each of parameters + 1 evaluations or more", ge=1)
    step: float = quantity("-", "Difference step, as a share of the ranges", gt=0.0, le=0.5)


class CalibrationConfig(Model):
    """A calibration: parameters, seeds and the budget of its stages."""

    base: str = Field(description="Study whose free numbers are calibrated")
    parameters: tuple[Parameter, ...] = Field(min_length=1)
    first_seed: int = quantity("-", "First track seed; apart from those of the reproduction", ge=0)
    screening_samples: int = quantity("-", "Points of the Latin hypercube", ge=1)
    screening_seeds: int = quantity("-", "Track seeds of each of them", ge=1)
    searches: tuple[Search, ...] = Field(description="Searches, each from the best point so far")
    new_speeds: tuple[Number, ...] = Field(min_length=2, description="Speeds on new wheels (m/s)")
    worn_speeds: tuple[Number, ...] = Field(min_length=2, description="Speeds on worn wheels (m/s)")

    @field_validator("new_speeds", "worn_speeds")
    @classmethod
    def _rising(cls, speeds: tuple[float, ...]) -> tuple[float, ...]:
        for before, after in pairwise((0.0, *speeds)):
            if after <= before:
                raise ValueError(f"speeds must be positive and rise: {after:g} follows {before:g}")
        return speeds

    def values(self, place: Sequence[float]) -> dict[str, float]:
        """Value of each parameter by name at a place of the unit cube."""
        return {p.name: p.value(float(u)) for p, u in zip(self.parameters, place, strict=True)}


def load_calibration(name: str = "calibration", overrides: tuple[str, ...] = ()) -> CalibrationConfig:
    """Read a calibration study by packaged name or path.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(CalibrationConfig, name, overrides, "base")
