"""Schema of the conditions for which the best constant command is looked for."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Annotated, NamedTuple

from pydantic import Field, model_validator

from sayd_env.config.base import Model, Number, Seed, Share, quantity
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import nearest
from sayd_env.config.limits import LIMITS
from sayd_env.config.loader import read_study
from sayd_env.config.profile import WheelProfileConfig, load_wheel, shifted
from sayd_env.config.scenario import Scenario
from sayd_env.config.track import scalable


class MapWheel(Model):
    """A wheel profile and its wear."""

    name: str = Field(min_length=1, description="How tables call it")
    profile: str | None = Field(
        None,
        min_length=1,
        description="Name of a profile, or a path to its YAML file; null: the study's",
    )
    shift: float | None = quantity(
        "m", "Outward shift in place of the profile's own; null: its own", default=None, ge=-0.01, le=0.01
    )
    wear: float = quantity("-", "Wear of the treads, 0 new, 1 worn", ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _known(self) -> MapWheel:
        if self.profile is None:
            return self
        try:
            wears = load_wheel(self.profile).wear is not None
        except ConfigError as error:
            raise ValueError(f"profile: {error}") from None
        if self.wear > 0.0 and not wears:
            raise ValueError(f"profile '{self.profile}' does not say how it wears: wear must be 0")
        return self

    def of(self, own: WheelProfileConfig) -> WheelProfileConfig:
        """The profile, where the study's is `own`."""
        wheel = own if self.profile is None else load_wheel(self.profile)
        return wheel if self.shift is None else shifted(wheel, self.shift)


class MapCondition(NamedTuple):
    """Conditions of runs that differ in their seed alone."""

    speed_kmh: float
    wheel: str
    gauge: float
    """m."""
    friction: float
    level: float | None
    """Factor on the study's irregularities, in place of its own; None: its own."""


class QuickMap(Model):
    """What a look takes of it, on the first gauge, friction and level."""

    speeds_kmh: tuple[Number, ...] = Field(min_length=1)
    wheels: tuple[str, ...] = Field(min_length=1)
    seeds: int = quantity("-", "Number of the first seeds", ge=1)
    openings: tuple[Share, ...] = Field(min_length=1)


class MapConfig(Model):
    """Conditions, commands and weights."""

    description: str = ""
    speeds_kmh: tuple[Number, ...] = Field(min_length=1, description="Speeds (km/h)")
    wheels: tuple[MapWheel, ...] = Field(min_length=1)
    gauges: tuple[Number, ...] = Field(min_length=1, description="Track gauges (m)")
    friction: tuple[Number, ...] = Field(min_length=1, description="Coefficients of friction (-)")
    levels: tuple[Number | None, ...] = Field(
        min_length=1,
        description="Factors on the study's irregularities (-); null: its own one",
    )
    seeds: tuple[Seed, ...] = Field(min_length=1, description="Of tracks")
    episode_s: float = quantity("s", "Time over which J is taken", gt=0.0)
    openings: tuple[Share, ...] = Field(
        min_length=1, description="Commands beside 0, as shares of the valve's travel beyond its overlap (-)"
    )
    refinements: int = quantity("-", "How often the steps around the best commands are halved", ge=0, le=8)
    force_weights: tuple[Annotated[Number, Field(ge=0.0)], ...] = Field(
        min_length=1, description="k_F at k_y = 1 for which commands are judged (-)"
    )
    quick: QuickMap

    @model_validator(mode="after")
    def _within(self) -> MapConfig:
        levels = [level for level in self.levels if level is not None]
        spans = {"speed_kmh": self.speeds_kmh, "gauge": self.gauges, "friction": self.friction}
        for name, values in (spans | {"track_scale": levels}).items():
            for value in values:
                if not LIMITS[name].low <= value <= LIMITS[name].high:
                    raise ValueError(f"{name}: found {value:g}; allowed are {LIMITS[name]}")
        names = [wheel.name for wheel in self.wheels]
        for given in (self.speeds_kmh, self.gauges, self.friction, self.levels, self.seeds, names):
            if len(set(given)) < len(given):
                raise ValueError(f"found a duplicate in {', '.join(map(str, given))}")
        for name in self.quick.wheels:
            if name not in names:
                raise ValueError(f"quick: unknown wheel '{name}'{nearest(name, names)}")
        return self

    def conditions(self) -> tuple[MapCondition, ...]:
        """All conditions: the first friction and level with everything, the others on the first gauge."""
        friction, level = self.friction[0], self.levels[0]
        wheels = [wheel.name for wheel in self.wheels]
        whole = product(self.speeds_kmh, wheels, self.gauges, [friction], [level])
        drier = product(self.speeds_kmh, wheels, self.gauges[:1], self.friction[1:], [level])
        rougher = product(self.speeds_kmh, wheels, self.gauges[:1], [friction], self.levels[1:])
        return tuple(MapCondition(*each) for spans in (whole, drier, rougher) for each in spans)

    def scenario(self, study: Scenario, condition: MapCondition) -> Scenario:
        """The study under a condition.

        Raises
        ------
        ConfigError
            A level of an even track, or wear of a profile that does not wear.
        """
        wheel = next(each for each in self.wheels if each.name == condition.wheel)
        irregularity = study.track.irregularity
        if condition.level is not None:
            try:
                scalable(irregularity, "of the study")
            except ValueError as error:
                raise ConfigError(f"levels: {error}") from None
            irregularity = irregularity.model_copy(update={"scale": condition.level})
        track = study.track.model_copy(update={"gauge": condition.gauge, "irregularity": irregularity})
        changes = {"wheel": wheel.of(study.wheel), "wear": wheel.wear, "friction": condition.friction}
        return study.model_copy(update=changes | {"track": track})

    def shortened(self) -> MapConfig:
        """A few of the conditions and commands: for a look at what comes out."""
        quick = self.quick
        return self.model_copy(
            update={
                "speeds_kmh": quick.speeds_kmh,
                "wheels": tuple(wheel for wheel in self.wheels if wheel.name in quick.wheels),
                "gauges": self.gauges[:1],
                "friction": self.friction[:1],
                "levels": self.levels[:1],
                "seeds": self.seeds[: quick.seeds],
                "openings": quick.openings,
            }
        )


def load_map(name: str = "map", overrides: Iterable[str] = ()) -> MapConfig:
    """Read the conditions by packaged name or path; paths in them are relative to it.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_study(MapConfig, name, overrides, "wheels.*.profile")
