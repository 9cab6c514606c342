"""Schema of a comparison: the conditions that policies meet, and how they are assessed there.

The packaged comparison holds conditions that nothing may be tuned or trained on: it is read here alone, and
this module is imported by the comparison alone.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from sayd_env.config.base import Model, Number, Seed, Share, quantity
from sayd_env.config.limits import LIMITS
from sayd_env.config.loader import read_study
from sayd_env.config.map import MapWheel
from sayd_env.config.scenario import Scenario
from sayd_env.config.track import IrregularityConfig, TrackClass, check_track, read_irregularity

HELD_OUT = "heldout"
"""Name of the packaged comparison."""


def _distinct(values: tuple[float, ...]) -> tuple[float, ...]:
    for value in values:
        if values.count(value) > 1:
            raise ValueError(f"{value:g} is a duplicate")
    return values


def _allowed(values: tuple[float, ...], name: str) -> tuple[float, ...]:
    for value in values:
        if not LIMITS[name].low <= value <= LIMITS[name].high:
            raise ValueError(f"found {value:g}; allowed are {LIMITS[name]}")
    return _distinct(values)


def _rising(speeds: tuple[float, ...]) -> tuple[float, ...]:
    for before, after in pairwise(speeds):
        if after <= before:
            raise ValueError(f"speeds must rise: {after:g} follows {before:g}")
    return _allowed(speeds, "speed_kmh")


class ComparedTrack(Model):
    """A track whose irregularities the vehicles meet; section and gauge stay those of the study."""

    name: str = Field(min_length=1, description="Name of a track, or a path to its YAML file")
    scale: float | None = quantity(
        "-", "Factor on all amplitudes; null: the track's own", default=None, gt=0.0, le=5.0
    )

    @model_validator(mode="after")
    def _known(self) -> ComparedTrack:
        check_track(self.name, scaled=self.scale is not None)
        return self

    @property
    def irregularity(self) -> IrregularityConfig:
        """The irregularities at this scale."""
        own = read_irregularity(self.name)
        return own if self.scale is None else own.model_copy(update={"scale": self.scale})


class ComparedWheels(MapWheel):
    """Wheels on a track gauge: together they make the conicity."""

    gauge: float | None = quantity(
        "m",
        "Track gauge; null: the study's",
        default=None,
        ge=LIMITS["gauge"].low,
        le=LIMITS["gauge"].high,
    )

    def under(self, scenario: Scenario) -> Scenario:
        """A scenario on these wheels and this gauge."""
        gauge = scenario.track.gauge if self.gauge is None else self.gauge
        track = scenario.track.model_copy(update={"gauge": gauge})
        wheel = self.of(scenario.wheel)
        return scenario.model_copy(update={"wheel": wheel, "wear": self.wear, "track": track})


class ComparedLines(Model):
    """Lines that an environment draws, on tracks of their own."""

    environment: str = Field(min_length=1, description="Environment with `lines`: a name or a path")
    seeds: tuple[Seed, ...] = Field(
        min_length=1,
        description="Of the lines; each has the next of `wheels`, and all of the seeds run on it",
    )
    tracks: tuple[TrackClass, ...] = Field(min_length=1, description="In place of the lines' own")

    _seeds = field_validator("seeds")(_distinct)


class CriticalSpeedConfig(Model):
    """Where the critical speed of EN 14363 is searched."""

    study: str = Field(min_length=1, description="Scenario: name of a packaged study, or a path")
    speeds_kmh: tuple[Number, ...] = Field(min_length=2, description="Grid of speeds (km/h), rising")
    wear: float = quantity("-", "Wear of the treads", ge=0.0, le=1.0)
    seeds: tuple[Seed, ...] = Field(
        min_length=1, description="Seeds of tracks; medians over them are assessed"
    )

    _speeds = field_validator("speeds_kmh")(_rising)
    _seeds = field_validator("seeds")(_distinct)


class BootstrapConfig(Model):
    """How confidence intervals are computed."""

    samples: int = Field(description="Resamples", strict=True, ge=100, le=1_000_000)
    seed: Seed = Field(description="Of the resampling")


class ComparisonConfig(Model):
    """A comparison.

    Its scenarios are all combinations of tracks, speeds, wheels, friction and seeds, and of lines and seeds.
    """

    description: str = ""
    environment: str = Field(min_length=1, description="Name of an environment, or a path to its YAML file")
    length: float = quantity("m", "Assessed length of a run", gt=0.0, le=100e3)
    tracks: tuple[ComparedTrack, ...] = Field(min_length=1)
    speeds_kmh: tuple[Number, ...] = Field(min_length=1, description="Speeds (km/h), rising")
    wheels: tuple[ComparedWheels, ...] = Field(min_length=1, description="Wheels and gauges")
    friction: tuple[Number, ...] = Field(min_length=1, description="Coefficients of friction (-)")
    seeds: tuple[Seed, ...] = Field(min_length=1, description="Of tracks, tolerances and sensor errors")
    lines: ComparedLines | None = Field(None, description="Lines beside them; null: none")
    initial_current: float = quantity("-", "Valve command of the run-in", ge=0.0, le=1.0)
    critical_speed: CriticalSpeedConfig
    constants: tuple[Share, ...] = Field(
        min_length=1,
        description="Valve commands (-), of which the best in each condition is a bound",
    )
    force_weights: tuple[Annotated[Number, Field(gt=0.0)], ...] = Field(
        min_length=1, description="Factors on k_F for which J is assessed (-), including 1"
    )
    bootstrap: BootstrapConfig

    _speeds = field_validator("speeds_kmh")(_rising)
    _once = field_validator("seeds", "constants")(_distinct)

    @field_validator("wheels")
    @classmethod
    def _named_once(cls, wheels: tuple[ComparedWheels, ...]) -> tuple[ComparedWheels, ...]:
        names = [each.name for each in wheels]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"'{name}' is a duplicate")
        return wheels

    @field_validator("friction")
    @classmethod
    def _possible(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        return _allowed(values, "friction")

    @field_validator("force_weights")
    @classmethod
    def _with_the_own(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if 1.0 not in values:
            raise ValueError("must include 1: the weight as it is")
        return _distinct(values)

    @field_validator("tracks")
    @classmethod
    def _different(cls, tracks: tuple[ComparedTrack, ...]) -> tuple[ComparedTrack, ...]:
        for track in tracks:
            if tracks.count(track) > 1:
                raise ValueError(f"track '{track.name}' is a duplicate with the same scale")
        return tracks


def load_comparison(name: str = HELD_OUT, overrides: Iterable[str] = ()) -> ComparisonConfig:
    """Read a comparison by packaged name or path; paths in it are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    references = (
        *("environment", "critical_speed.study", "tracks.*.name", "wheels.*.profile"),
        *("lines.environment", "lines.tracks.*.name"),
    )
    return read_study(ComparisonConfig, name, overrides, *references)
