"""Schema of a calibration study: what may vary, within which sourced range, and how hard to search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from pydantic import Field, field_validator, model_validator

from sayd_env.config.base import Model, Number, quantity
from sayd_env.config.control import controller_of
from sayd_env.config.loader import read_study

SKYHOOKS = ("skyhook-onoff", "skyhook-continuous")
"""Controllers whose common numbers have keys of ``control.skyhook``."""
BEGINNINGS = ("damper.", "control.mppt1.", "control.mppt2.", "control.skyhook.")
"""Beginnings of the keys of the semi-active stage."""
LENGTH = "Assessed distance of each run; rows M6 and M7 look at what follows after 15 s at 300 km/h"


class Parameter(Model):
    """One free number: its value times a factor is added to each of its keys."""

    name: str
    unit: str
    low: Number = Field(description="Lower end of the range, in the unit above", allow_inf_nan=False)
    high: Number = Field(description="Upper end of the range", allow_inf_nan=False)
    scale: Literal["linear", "log"] = "linear"
    keys: dict[str, Number] = Field(description="Scenario or controller key -> factor", min_length=1)
    source: str = Field(description="Where the range comes from")

    @model_validator(mode="after")
    def _range(self) -> Parameter:
        if not self.low < self.high or (self.scale == "log" and self.low <= 0.0):
            raise ValueError("needs low < high, and low > 0 on a log scale")
        return self

    def value(self, unit: float) -> float:
        """Value at a place of the unit interval, to five digits."""
        if self.scale == "log":
            value = self.low * (self.high / self.low) ** unit
        else:
            value = self.low + (self.high - self.low) * unit
        return float(f"{value:.5g}")


class Search(Model):
    """A search by response surfaces in a box around the best place of the one before."""

    name: str
    seeds: int = quantity("-", "Track seeds of each evaluation", ge=1)
    length: float = quantity("m", LENGTH, ge=1500.0)
    samples: int = quantity("-", "Points of a Latin hypercube that the first surfaces pass", ge=2)
    evaluations: int = quantity("-", "Number of evaluations, these points included", ge=2)
    radius: float = quantity("-", "Half the width of the box, as a share of the ranges", gt=0.0, le=1.0)


class Stage(Model):
    """The free numbers of one part of the plant, and how they are looked for."""

    parameters: tuple[Parameter, ...] = Field(min_length=1)
    searches: tuple[Search, ...] = Field(
        description="Each around the best point of the one before", min_length=1
    )
    starts: int = quantity("-", "Starts at most; the last search goes on from the best", default=1, ge=1)
    good_cost: float = quantity(
        "-",
        "No further start is made once one has come to this cost or a lower one before the last search",
        default=0.0,
        ge=0.0,
    )

    @field_validator("parameters")
    @classmethod
    def _distinct(cls, parameters: tuple[Parameter, ...]) -> tuple[Parameter, ...]:
        names = [parameter.name for parameter in parameters]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"parameter '{name}' appears twice")
        return parameters

    @model_validator(mode="after")
    def _enough(self) -> Stage:
        if self.starts > 1 and len(self.searches) == 1:
            raise ValueError(f"starts: found {self.starts} with one search, which is the last; expected 1")
        least = len(self.parameters) + 2
        for search in self.searches:
            if not least <= search.samples <= search.evaluations:
                raise ValueError(
                    f"search '{search.name}': {search.samples} samples; surfaces over {least - 2} parameters "
                    f"need {least} or more, and at most all {search.evaluations} evaluations"
                )
        return self

    def values(self, place: Sequence[float]) -> dict[str, float]:
        """Value of each parameter by name at a place of the unit cube."""
        return {p.name: p.value(float(u)) for p, u in zip(self.parameters, place, strict=True)}

    def assignments(self, values: Mapping[str, float]) -> dict[str, float]:
        """Keys and their numbers, to five digits; what several parameters give to one key is added up."""
        found: dict[str, float] = {}
        for parameter in self.parameters:
            for key, factor in parameter.keys.items():
                found[key] = found.get(key, 0.0) + factor * values[parameter.name]
        return {key: float(f"{number:.5g}") for key, number in found.items()}

    def parameters_of(self, key: str) -> list[Parameter]:
        """Parameters that set a key."""
        return [parameter for parameter in self.parameters if key in parameter.keys]


class Sensitivity(Model):
    """The table of what each free number does."""

    seeds: int = quantity("-", "Track seeds of each evaluation", ge=1)
    length: float = quantity("m", LENGTH, ge=1500.0)
    share: float = quantity("-", "Change of each number, as a share of its range", gt=0.0, le=0.5)


class CalibrationConfig(Model):
    """A calibration: parameters, seeds and the budget of its stages."""

    base: str = Field(description="Study whose free numbers are calibrated, with passive yaw dampers")
    semi_active_damper: str = Field(description="Semi-active damper whose free numbers are calibrated")
    controllers: tuple[str, ...] = Field(
        description="Files of controllers whose free numbers are calibrated: own/mppt1.yaml; else ours",
        default=(),
    )
    first_seed: int = quantity("-", "First track seed; apart from those of the reproduction", ge=0)
    passive: Stage = Field(description="Vehicle, wheels, track and passive damper, from rows P1 to P10")
    semi_active: Stage = Field(
        description="Damper, valve and controllers, from rows M1 to M9 and S1 to S5; keys begin with "
        "damper (the semi-active one), control.mppt1, control.mppt2 or control.skyhook (both)"
    )
    sensitivity: Sensitivity

    @field_validator("semi_active")
    @classmethod
    def _of_controllers(cls, semi_active: Stage) -> Stage:
        for parameter in semi_active.parameters:
            for key in parameter.keys:
                if not key.startswith(BEGINNINGS):
                    raise ValueError(
                        f"parameter '{parameter.name}': found key '{key}'; expected one that begins with "
                        f"{', '.join(BEGINNINGS)}"
                    )
        return semi_active

    @property
    def controller_files(self) -> dict[str, str]:
        """Files of one's own by the controllers that they are of."""
        return {controller_of(file): file for file in self.controllers}


def load_calibration(name: str = "calibration", overrides: tuple[str, ...] = ()) -> CalibrationConfig:
    """Read a calibration study by packaged name or path.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(CalibrationConfig, name, overrides, "base", "semi_active_damper", "controllers.*")
