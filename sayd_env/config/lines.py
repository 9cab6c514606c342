"""A distribution over lines: what each section of a drawn line is drawn from."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from sayd_env.config.base import Model, Part, quantity
from sayd_env.config.conditions import (
    CANT_BASE,
    LINE_STEP,
    MOST_ACCELERATION,
    MOST_CANT,
    MOST_DEFICIENCY,
    SHORTEST_TRANSITION,
    TIGHTEST,
    Line,
)
from sayd_env.config.distribution import ChoiceDistribution, Distribution, chosen
from sayd_env.config.errors import ConfigError
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.limits import within
from sayd_env.config.line import LONGEST_SECTION, LineConfig, LineSectionConfig, resolve
from sayd_env.config.track import HIGHEST, SHORTEST_DEFECT, Channel, Defect, TrackClass
from sayd_env.config.units import GRAVITY, KMH

LINES = Kind("lines", names=("tracks.*.name", "rails.*"))

_SEARCH = 1e-12
"""To which the lowest uniform number of a radius is found."""
Uniform = Callable[[str], float]
"""Uniform number in [0, 1) that belongs to a name alone."""


class CurvesConfig(Model):
    """Curves; the radius fits the speed, so that the limits of cant and deficiency hold by construction."""

    share: float = quantity("-", "Share of sections that are curves", ge=0.0, le=1.0)
    radius: Distribution = Field(description="Radius (m), cut off below what the section's speed needs")
    cant_deficiency: Distribution = Field(
        description="Cant deficiency at the section's highest speed (m); less in curves that need no cant, "
        "more where the cant is at its limit"
    )
    most_cant: float = quantity("m", "Highest cant", gt=0.0, le=MOST_CANT)
    most_deficiency: float = quantity("m", "Largest cant deficiency", gt=0.0, le=MOST_DEFICIENCY)
    transition: Distribution = Field(description="Length of transitions (m)")

    @model_validator(mode="after")
    def _allowed(self) -> CurvesConfig:
        _reaches("radius", self.radius, TIGHTEST)
        _reaches("transition", self.transition, SHORTEST_TRANSITION)
        radius = self.radius
        if isinstance(radius, ChoiceDistribution) and sorted(radius.values) != list(radius.values):
            raise ValueError("radius: the values of a choice must ascend")
        if self.cant_deficiency.bounds[0] < 0.0 or self.cant_deficiency.bounds[1] > self.most_deficiency:
            raise ValueError(f"cant_deficiency reaches beyond 0 to {self.most_deficiency:g} m")
        return self


class DefectsConfig(Model):
    """Single defects, one in a section at most, anywhere in it."""

    share: float = quantity("-", "Share of sections that have one", ge=0.0, le=1.0)
    channels: tuple[Channel, ...] = Field(min_length=1, description="Channels, equally frequent")
    amplitude: Distribution = Field(description="Height (m, or rad for cross_level)")
    length: Distribution = Field(description="Length (m)")

    @model_validator(mode="after")
    def _allowed(self) -> DefectsConfig:
        _reaches("amplitude", self.amplitude, -HIGHEST, HIGHEST)
        _reaches("length", self.length, SHORTEST_DEFECT)
        return self


class LinesConfig(Part):
    """What lines are drawn from; null, or an empty list: as the episode has it."""

    description: str = ""
    sections: Distribution = Field(description="Number of sections (-), rounded")
    length: Distribution = Field(description="Length of a section (m)")
    speed_kmh: Distribution | None = Field(
        None, description="Speed (km/h), moved towards that before so far as the section's length allows"
    )
    acceleration: float = quantity("m/s2", "Of the ramps between speeds", gt=0.0, le=MOST_ACCELERATION)
    curves: CurvesConfig | None = Field(None, description="Curves; null: straight")
    gauge: Distribution | None = Field(None, description="Track gauge (m)")
    friction: Distribution | None = Field(None, description="Coefficient of friction (-)")
    rail: Distribution | None = Field(None, description="Share of the second of `rails` (-)")
    rails: tuple[str | None, str] | None = Field(None, description="Rail profiles as of a line")
    tracks: tuple[TrackClass, ...] = Field((), description="Classes of track")
    defects: DefectsConfig | None = Field(None, description="Single defects; null: none")
    blend: float = quantity("m", "Length of changes between sections, as of a line", gt=0.0, le=1000.0)

    @field_validator("speed_kmh", "gauge", "friction")
    @classmethod
    def _within(cls, distribution: Distribution | None, info: ValidationInfo) -> Distribution | None:
        return None if distribution is None else within(distribution, str(info.field_name))

    @model_validator(mode="after")
    def _possible(self) -> LinesConfig:
        _reaches("sections", self.sections, 1.0)
        known_at_steps = self.friction is not None or self.rail is not None
        _reaches("length", self.length, self.blend + LINE_STEP * known_at_steps, LONGEST_SECTION)
        shortest = self.length.bounds[0]
        if self.curves is not None:
            if self.curves.transition.bounds[1] > shortest:
                raise ValueError(f"curves.transition reaches beyond the shortest section ({shortest:g} m)")
            if self.speed_kmh is None:
                raise ValueError("curves need a speed_kmh, which their radii must fit")
        if self.defects is not None and self.defects.length.bounds[1] > shortest:
            raise ValueError(f"defects.length reaches beyond the shortest section ({shortest:g} m)")
        if self.rail is not None and not (self.rail.bounds[0] >= 0.0 and self.rail.bounds[1] <= 1.0):
            raise ValueError("rail reaches beyond 0 to 1")
        if self.rail is not None and self.rails is None:
            raise ValueError("rail needs the two rails that it goes between")
        if self.tracks and not any(each.weight for each in self.tracks):
            raise ValueError("tracks: at least one weight must be positive")
        return self

    def without(self, names: Iterable[str]) -> LinesConfig:
        """The same, but friction, gauge or tracks are not drawn."""
        drawn = {"friction": None, "gauge": None, "tracks": ()}
        return self.model_copy(update={name: drawn[name] for name in names if name in drawn})

    def refuse_speed(self, source: str) -> None:
        """Refuse a speed beside those of the lines.

        Raises
        ------
        ConfigError
            The lines have speeds, to which their curves are fitted.
        """
        if self.speed_kmh is not None:
            raise ConfigError(
                f"{source}: the lines of this environment have speeds of their own; give a line without "
                "them, such as the option line='conditions'"
            )


def read_lines(name_or_path: str, overrides: Iterable[str] = ()) -> LinesConfig:
    """Read and validate a distribution over lines.

    Parameters
    ----------
    name_or_path : str
        Packaged name (``highspeed``) or path to a YAML file.
    overrides : iterable of str
        ``key=value`` assignments, for example ``curves.share=0.0``.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used.
    """
    return read_layered(LinesConfig, LINES, name_or_path, overrides)


def draw_line(config: LinesConfig, uniform: Uniform) -> Line:
    """Draw a line.

    Parameters
    ----------
    config : LinesConfig
        What it is drawn from.
    uniform : callable
        Gives the uniform number in [0, 1) of a name. Every quantity of every section has a name of its own:
        another distribution of one leaves all other draws as they are. What must fit follows: radii and cants
        the speeds, the places of defects the lengths.

    Raises
    ------
    ConfigError
        A line that is not allowed, which no packaged distribution makes.
    """
    count = round(float(config.sections.at(uniform("line.sections"))))
    draws = [_Draws(config, number, uniform) for number in range(count)]
    contents = [draw.quantities() for draw in draws]
    if config.speed_kmh is not None:
        speeds = _speeds(config.acceleration, config.speed_kmh, draws)
        for number, content in enumerate(contents):
            content.update(speed_kmh=KMH * speeds[number], acceleration=config.acceleration)
            if config.curves is not None:
                fastest = _fastest(config.acceleration, speeds, draws, number)
                content.update(draws[number].curve(config.curves, fastest))
    rails = None if config.rail is None and config.rails and config.rails[0] is None else config.rails
    try:
        sections = _with_needed_transitions(map(LineSectionConfig.model_validate, contents))
        return resolve(LineConfig(sections=sections, blend=config.blend, rails=rails))
    except ValidationError as error:
        reason = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise ConfigError(f"a line that was drawn is not allowed: {reason}") from None


def _with_needed_transitions(sections: Iterable[LineSectionConfig]) -> tuple[LineSectionConfig, ...]:
    """Sections without the transitions in which nothing changes."""
    found: list[LineSectionConfig] = []
    for section in sections:
        straight_on = section.bends_as(found[-1] if found else None)
        found.append(section.model_copy(update={"transition": None}) if straight_on else section)
    return tuple(found)


class _Draws:
    """Draws of a section."""

    def __init__(self, config: LinesConfig, number: int, uniform: Uniform) -> None:
        self._config, self._number, self._uniform = config, number, uniform
        self.length = self.of(config.length, "length")

    def of(self, distribution: Distribution, name: str) -> float:
        return float(distribution.at(self.uniform(name)))

    def uniform(self, name: str) -> float:
        return self._uniform(f"line.{self._number}.{name}")

    @property
    def transition(self) -> float:
        curves = self._config.curves
        return 0.0 if curves is None else self.of(curves.transition, "transition")

    def quantities(self) -> dict[str, Any]:
        """Everything but speed and curve."""
        config = self._config
        content: dict[str, Any] = {"length": self.length}
        for name in ("gauge", "friction", "rail"):
            distribution = getattr(config, name)
            if distribution is not None:
                content[name] = self.of(distribution, name)
        if config.tracks:
            weights = tuple(each.weight for each in config.tracks)
            drawn = config.tracks[int(chosen(weights, self.uniform("tracks")))]
            content["track"] = drawn.name
            if drawn.scale is not None:
                content["track_scale"] = self.of(drawn.scale, "track_scale")
        defects = config.defects
        if defects is not None and self.uniform("defects") < defects.share:
            content["defects"] = (self._defect(defects),)
        return content

    def _defect(self, config: DefectsConfig) -> Defect:
        length = self.of(config.length, "defects.length")
        return Defect(
            channel=config.channels[int(self.uniform("defects.channel") * len(config.channels))],
            amplitude=self.of(config.amplitude, "defects.amplitude"),
            length=length,
            position=self.uniform("defects.position") * (self.length - length),
        )

    def curve(self, curves: CurvesConfig, speed: float) -> dict[str, Any]:
        """Transition, and radius and cant that fit a speed (m/s) unless the section is straight."""
        content: dict[str, Any] = {"transition": self.transition}
        if self.uniform("curves") >= curves.share:
            return content
        balanced = speed**2 * CANT_BASE / GRAVITY  # times the curvature: the cant at which nothing is missing
        tightest = balanced / (curves.most_cant + curves.most_deficiency)
        radius = _at_least(curves.radius, tightest, self.uniform("radius"))
        missing = self.of(curves.cant_deficiency, "cant_deficiency")
        return content | {
            "radius": radius,
            "turn": "left" if self.uniform("turn") < 0.5 else "right",
            "cant": min(max(balanced / radius - missing, 0.0), curves.most_cant),
        }


def _speeds(acceleration: float, distribution: Distribution, draws: list[_Draws]) -> list[float]:
    """Speeds of sections (m/s), each reached within its section."""
    speeds: list[float] = []
    for draw in draws:
        squared = (draw.of(distribution, "speed_kmh") / KMH) ** 2
        if speeds:
            reach = 2.0 * acceleration * draw.length * (1.0 - 1e-9)
            squared = min(max(squared, speeds[-1] ** 2 - reach), speeds[-1] ** 2 + reach)
        speeds.append(math.sqrt(squared))
    return speeds


def _fastest(acceleration: float, speeds: list[float], draws: list[_Draws], number: int) -> float:
    """Highest speed (m/s) between a section's start and the end of the transition behind it."""
    fastest = max(speeds[max(number - 1, 0) : number + 1])
    if number + 1 == len(speeds):
        return fastest
    gained = 2.0 * acceleration * draws[number + 1].transition
    return max(fastest, min(speeds[number + 1], math.sqrt(speeds[number] ** 2 + gained)))


def _at_least(distribution: Distribution, low: float, u: float) -> float:
    """Number that belongs to u in a distribution cut off below a limit; the limit where all is below."""
    smallest, largest = distribution.bounds
    if largest <= low:
        return low
    first, last = (0.0, 1.0) if smallest < low else (0.0, 0.0)
    while last - first > _SEARCH:  # the number grows with u
        middle = 0.5 * (first + last)
        first, last = (first, middle) if float(distribution.at(middle)) >= low else (middle, last)
    return max(low, float(distribution.at(last + u * (1.0 - last))))


def _reaches(name: str, distribution: Distribution, low: float, high: float = math.inf) -> None:
    smallest, largest = distribution.bounds
    if smallest < low:
        raise ValueError(f"{name} reaches down to {smallest:g}; at least {low:g} is needed")
    if largest > high:
        raise ValueError(f"{name} reaches up to {largest:g}; at most {high:g} is possible")
