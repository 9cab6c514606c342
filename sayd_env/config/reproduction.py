"""Schema of the reproduction: on which tracks and at which speeds the paper's statements are measured."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from sayd_env.config.base import Model, Number, Seed
from sayd_env.config.contact import CreepLaw
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import shown
from sayd_env.config.loader import read_study
from sayd_env.config.scenario import Scenario
from sayd_env.config.track import read_track
from sayd_env.config.units import KMH

Grid = Annotated[tuple[Annotated[Number, Field(gt=0.0)], ...], Field(min_length=2)]


NEEDED = {"new": (280.0,), "worn": (320.0, 350.0), "sayd": (300.0, 400.0)}
"""Speeds (km/h) that rows are about."""


class SpeedGrids(Model):
    """Speeds (km/h), rising."""

    new: Grid = Field(description="Passive dampers on new wheels (km/h)")
    worn: Grid = Field(description="Passive dampers on worn wheels (km/h)")
    sayd: Grid = Field(description="Semi-active dampers (km/h)")
    creep_laws: Grid = Field(description="Of a comparison of creep laws (km/h)")

    @field_validator("*")
    @classmethod
    def _rising(cls, speeds: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        for speed in NEEDED.get(str(info.field_name), ()):
            if speed not in speeds:
                raise ValueError(f"must hold {speed:g}, which a row is about")
        for before, after in pairwise(speeds):
            if after <= before:
                raise ValueError(f"speeds must rise: {after:g} follows {before:g}")
        return speeds


class Assumption(Model):
    """What else than the study's own could be assumed: a creep law, irregularities of the track."""

    name: str = Field(min_length=1, description="How tables call it")
    creep_law: CreepLaw | None = Field(None, description="Creep law; null: the study's")
    track: str | None = Field(None, description="Track with other irregularities; null: the study's")
    seeds: int = Field(description="How many of the seeds", strict=True, ge=1)

    @field_validator("track")
    @classmethod
    def _known(cls, track: str | None) -> str | None:
        try:
            if track is not None:
                read_track(track)
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return track

    def applied(self, scenario: Scenario) -> Scenario:
        """The scenario under this assumption; section and gauge of its track stay."""
        contact, track = scenario.contact, scenario.track
        if self.creep_law is not None:
            contact = contact.model_copy(update={"creep_law": self.creep_law})
        if self.track is not None:
            track = track.model_copy(update={"irregularity": read_track(self.track).irregularity})
        return scenario.model_copy(update={"contact": contact, "track": track})


class ReproductionConfig(Model):
    """Seeds and speeds of the paper's statements, and what stands beside them."""

    description: str = ""
    seeds: tuple[Seed, ...] = Field(
        min_length=1, description="Track seeds, none of which anything was fitted to"
    )
    least_seeds: int = Field(description="Track realisations that a verdict needs", strict=True, ge=1)
    quick_seeds: int = Field(description="Track realisations of a look", strict=True, ge=1)
    speeds_kmh: SpeedGrids
    fixed: tuple[str, ...] = Field(description="Policies of one command, through the same rows")
    assumptions: tuple[Assumption, ...] = Field((), description="Under which the rows are judged again")

    @field_validator("fixed")
    @classmethod
    def _one_command(cls, policies: tuple[str, ...]) -> tuple[str, ...]:
        for policy in policies:
            if not policy.startswith("constant"):
                raise ValueError(f"{shown(policy)}: expected policies of one command, such as constant:0.4")
        return policies

    @model_validator(mode="after")
    def _once(self) -> Self:
        for what, values in (
            ("seeds", self.seeds),
            ("fixed", self.fixed),
            ("assumptions", [assumption.name for assumption in self.assumptions]),
        ):
            for value in values:
                if list(values).count(value) > 1:
                    raise ValueError(f"{what}: {value} is a duplicate")
        return self

    def first_seeds(self, count: int) -> tuple[int, ...]:
        """The first seeds of the list.

        Raises
        ------
        ConfigError
            It has not so many.
        """
        if count > len(self.seeds):
            raise ConfigError(f"{count} seeds: the study has {len(self.seeds)}; name the first with --seed")
        return self.seeds[:count]

    def speeds(self, which: Literal["new", "worn", "sayd", "creep_laws"]) -> tuple[float, ...]:
        """A grid of speeds, m/s."""
        return tuple(speed / KMH for speed in getattr(self.speeds_kmh, which))


def load_reproduction(name: str = "reproduce", overrides: Iterable[str] = ()) -> ReproductionConfig:
    """Read a reproduction by packaged name or path; paths in it are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    return read_study(ReproductionConfig, name, overrides, "assumptions.*.track")
