"""A line: sections that follow each other, or a measured file, each saying what lies along the way."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from itertools import pairwise
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from sayd_env.config.base import Model, Part, quantity
from sayd_env.config.conditions import (
    LINE_STEP,
    MOST_ACCELERATION,
    MOST_CANT,
    SHORTEST_TRANSITION,
    TIGHTEST,
    Knots,
    Line,
    Rails,
    Section,
    TrackPiece,
    checked,
    joined,
    smooth_step,
)
from sayd_env.config.errors import ConfigError
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.limits import LIMITS
from sayd_env.config.loader import is_path
from sayd_env.config.profile import RailProfileConfig, load_rail
from sayd_env.config.track import (
    Defect,
    DefectConfig,
    GeometryConfig,
    check_track,
    read_irregularity,
)
from sayd_env.config.units import KMH

LONGEST_SECTION = 1e6
"""Longest section of a line (m)."""
LINE = Kind("line", names=("rails.*", "sections.*.track"), data=("file",), measured="line")

# A change between sections, as knots: linear pieces depart from the smooth step by 0.7 % of the change.
_STEPS = np.linspace(0.0, 1.0, 11)
_SHARES = smooth_step(_STEPS)


def _limited(name: str, doc: str) -> float | None:
    low, high, unit = LIMITS[name]
    found: float | None = quantity(unit, f"{doc}; null: the episode's", default=None, ge=low, le=high)
    return found


class LineSectionConfig(Model):
    """A section; what it leaves out is as the scenario or the episode has it."""

    name: str | None = Field(None, min_length=1, description="What tables call it; null: its number from 1")
    length: float = quantity("m", "Length with all changes at its start", gt=0.0, le=LONGEST_SECTION)
    speed_kmh: float | None = _limited("speed_kmh", "Speed, after a ramp from the section's start")
    acceleration: float = quantity(
        "m/s2", "Of this ramp, up or down", default=0.5, gt=0.0, le=MOST_ACCELERATION
    )
    radius: float | None = quantity("m", "Radius of the curve; null: straight", default=None, ge=TIGHTEST)
    turn: Literal["left", "right"] | None = Field(None, description="Where the curve goes")
    cant: float = quantity(
        "m", "Height of the outer rail above the inner one, over 1.5 m", default=0.0, ge=0.0, le=MOST_CANT
    )
    transition: float | None = quantity(
        "m",
        "Length from the section's start over which curvature and cant change linearly from those before",
        default=None,
        ge=SHORTEST_TRANSITION,
    )
    gauge: float | None = _limited("gauge", "Track gauge")
    rail: float | None = quantity(
        "-", "Share of the second of the line's rails; null: 0", default=None, ge=0.0, le=1.0
    )
    friction: float | None = _limited("friction", "Coefficient of friction")
    track: str | None = Field(
        None, min_length=1, description="Track whose irregularities lie here, a name or a path"
    )
    track_scale: float | None = _limited("track_scale", "Factor on their amplitudes, in place of their own")
    defects: tuple[Defect, ...] = Field((), description="Single defects; positions from the section's start")

    @model_validator(mode="after")
    def _whole(self) -> LineSectionConfig:
        if (self.radius is None) != (self.turn is None):
            raise ValueError("radius and turn (left or right) belong together")
        if self.cant and self.radius is None:
            raise ValueError(f"cant: found {self.cant:g} m in a section without a radius")
        for defect in self.defects:
            if defect.position + defect.length > self.length:
                raise ValueError(
                    f"defects: one ends at {defect.position + defect.length:g} m; "
                    f"the section is {self.length:g} m long"
                )
        if self.track is not None:
            check_track(self.track, scaled=self.track_scale is not None)
        return self

    @property
    def signed_curvature(self) -> float:
        """Kappa where the transition has ended (1/m), positive in left curves."""
        return 0.0 if self.radius is None else self._side / self.radius

    @property
    def signed_cant(self) -> float:
        """Cant there (m), positive where the right rail is higher."""
        return self._side * self.cant

    def bends_as(self, before: LineSectionConfig | None) -> bool:
        """Whether curvature and cant are those of the section before; None: of the straight run-in."""
        former = (0.0, 0.0) if before is None else (before.signed_curvature, before.signed_cant)
        return former == (self.signed_curvature, self.signed_cant)

    @property
    def _side(self) -> float:
        return -1.0 if self.turn == "right" else 1.0


class LineConfig(Part, GeometryConfig):
    """Conditions along a line; what `GeometryConfig` has is of the irregularities of its file."""

    description: str = ""
    sections: tuple[LineSectionConfig, ...] = Field((), description="In the order in which they are run over")
    file: str | None = Field(
        None, min_length=1, description="Measured line (CSV), in place of sections; relative to this file"
    )
    section_length: float = quantity(
        "m", "Length of a measured line's sections, as tables count", default=1000.0, ge=100.0
    )
    blend: float = quantity(
        "m",
        "Length of the change from a section to the next of all but speed, curvature and cant, about their "
        "boundary; of friction and rail shape at least 10 m",
        default=25.0,
        gt=0.0,
        le=1000.0,
    )
    rails: tuple[str | None, str] | None = Field(
        None, description="Rail profiles that `rail` goes between, names or paths; first null: the scenario's"
    )

    @model_validator(mode="after")
    def _possible(self) -> LineConfig:
        if (self.file is None) == (not self.sections):
            raise ValueError("give either sections, one at least, or a file")
        names = [_name(number, section) for number, section in enumerate(self.sections)]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two sections have the name '{name}'")
        try:
            resolve_rails(self)
        except ConfigError as error:
            raise ValueError(f"rails: {error}") from None
        if self.sections:
            self._refuse_unused()
            self._refuse_short()
            outline(self)
        return self

    def _refuse_short(self) -> None:
        """Refuse sections so short that what they say could lie between the places where it is known."""
        for number, section in enumerate(self.sections):
            said = [name for name in ("friction", "rail") if getattr(section, name) is not None]
            least = self.blend + LINE_STEP
            if said and section.length < least:
                raise ValueError(
                    f"section '{_name(number, section)}': {said[0]}: lasts {section.length:g} m; with this "
                    f"blend, and since a run knows it every {LINE_STEP:g} m, it needs {least:g} m"
                )

    def _refuse_unused(self) -> None:
        """Refuse what has no effect; a default may stand anywhere, as it does in a record of all keys."""
        for name in ("section_length", *GeometryConfig.model_fields):
            if getattr(self, name) != LineConfig.model_fields[name].default:
                raise ValueError(f"{name}: has no effect beside sections; it belongs to a measured file")
        blended = any(section.rail is not None for section in self.sections)
        if self.rails is not None and self.rails[0] is None and not blended:
            raise ValueError("rails: have no effect where no section has a rail, the share of the second one")
        usual = LineSectionConfig.model_fields["acceleration"].default
        timed = any(section.speed_kmh is not None for section in self.sections)
        before: LineSectionConfig | None = None
        for number, section in enumerate(self.sections):
            where = f"section '{_name(number, section)}'"
            if section.acceleration != usual and not timed:
                raise ValueError(f"{where}: acceleration: has no effect: no section has a speed_kmh")
            if section.transition is not None and section.bends_as(before):
                raise ValueError(
                    f"{where}: transition: has no effect: neither curvature nor cant changes here"
                )
            before = section


def read_line(name_or_path: str, overrides: Iterable[str] = ()) -> LineConfig:
    """Read and validate a line.

    Parameters
    ----------
    name_or_path : str
        Packaged name (``highspeed``) or path to a YAML file. Files that it names are taken relative to it.
    overrides : iterable of str
        ``key=value`` assignments, for example ``sections.curve.radius=6000.0``.

    Raises
    ------
    ConfigError
        Unknown name, unreadable file, unknown key, or a value or line that is not allowed.
    """
    return read_layered(LineConfig, LINE, name_or_path, overrides)


def resolve(
    config: LineConfig,
    *,
    speed: float | None = None,
    gauge: float | None = None,
    friction: float | None = None,
    source: str = "line",
) -> Line:
    """Conditions over distance of a line that is given by sections.

    Parameters
    ----------
    config : LineConfig
        The line.
    speed, gauge, friction : float, optional
        What the episode has (m/s, m, -): the value of sections that leave out what others say. A quantity
        that all of them leave out stays None.
    source : str
        What messages call the line.

    Raises
    ------
    ConfigError
        A section leaves out what others say, and the episode's value is missing; a ramp of the speed does not
        fit, or the cant deficiency is too large, at the episode's speed; a line that is measured.
    """
    if config.file is not None:
        raise ConfigError(f"{source}: is measured ({config.file}), not given by sections")
    try:
        return _Course(config, speed, gauge, friction, complete=True).line()
    except ValueError as error:
        raise ConfigError(f"{source}: {error}") from None


def outline(config: LineConfig) -> Line:
    """A line given by sections without what some of them leave out.

    Raises
    ------
    ValueError
        It is none that a railway could have.
    """
    return _Course(config, None, None, None, complete=False).line()


def resolve_rails(config: LineConfig) -> Rails | None:
    """Rail profiles of a line.

    Raises
    ------
    ConfigError
        One that cannot be read.
    """
    if config.rails is None:
        return None
    first, second = config.rails
    return None if first is None else _rail(first), _rail(second)


def _rail(name: str) -> RailProfileConfig:
    # A packaged profile stays as it is, a user's file may be edited between episodes.
    return load_rail(name) if is_path(name) else _packaged_rail(name)


@lru_cache(maxsize=64)
def _packaged_rail(name: str) -> RailProfileConfig:
    return load_rail(name)


def _name(number: int, section: LineSectionConfig) -> str:
    return section.name or str(number + 1)


class _Course:
    """From sections to conditions over distance."""

    def __init__(
        self,
        config: LineConfig,
        speed: float | None,
        gauge: float | None,
        friction: float | None,
        *,
        complete: bool,
    ) -> None:
        self._config = config
        self._sections = config.sections
        self._bounds = [0.0, *np.cumsum([each.length for each in config.sections]).tolist()]
        self._speed, self._gauge, self._friction = speed, gauge, friction
        self._complete = complete
        """Whether a section may not leave out what others say and the episode does not."""

    def line(self) -> Line:
        """The line; raises ValueError where it is none that a railway could have."""
        self._check_room()
        line = Line(
            curvature=self._transitions(lambda each: each.signed_curvature),
            cant=self._transitions(lambda each: each.signed_cant),
            sections=tuple(self._named()),
            speed_squared=self._ramps(),
            gauge=self._blended("gauge", [each.gauge for each in self._sections], self._gauge),
            friction=self._blended("friction", [each.friction for each in self._sections], self._friction),
            rail_blend=self._rail_blend(),
            rails=resolve_rails(self._config),
            tracks=tuple(self._tracks()),
            blend=self._config.blend,
            defects=tuple(self._defects()),
        )
        return checked(line, self._speed)

    def _each(self) -> Iterator[tuple[float, str, LineSectionConfig]]:
        """Start, name and content of each section."""
        for number, (start, section) in enumerate(zip(self._bounds, self._sections, strict=False)):
            yield start, f"section '{_name(number, section)}'", section

    def _transitions(self, of: Callable[[LineSectionConfig], float]) -> Knots:
        points, before = [(0.0, 0.0)], 0.0
        for start, name, section in self._each():
            now = of(section)
            if now != before:
                if section.transition is None:
                    raise ValueError(f"{name}: transition: is missing where curvature or cant changes (m)")
                if section.transition > section.length:
                    raise ValueError(
                        f"{name}: transition: found {section.transition:g} m; "
                        f"the section is {section.length:g} m long"
                    )
                points += [(start, before), (start + section.transition, now)]
            before = now
        return joined(points)

    def _named(self) -> Iterator[Section]:
        curved = False
        for number, (start, _, section) in enumerate(self._each()):
            straight_from = start + (section.transition or 0.0) if curved else start
            name, curved = _name(number, section), section.radius is not None
            yield Section(name, start, self._bounds[number + 1], None if curved else straight_from)

    def _ramps(self) -> Knots | None:
        own = None if self._speed is None else KMH * self._speed
        speeds = self._filled("speed_kmh", [each.speed_kmh for each in self._sections], own)
        if speeds is None:
            return None
        before = (speeds[0] / KMH) ** 2
        points = [(0.0, before)]
        for (start, name, section), speed in zip(self._each(), speeds, strict=True):
            now = (speed / KMH) ** 2
            ramp = abs(now - before) / (2.0 * section.acceleration)
            if ramp > section.length:
                raise ValueError(
                    f"{name}: speed_kmh: the change to {speed:g} km/h at {section.acceleration:g} m/s2 "
                    f"takes {ramp:.0f} m; the section is {section.length:g} m long"
                )
            if ramp > 0.0:
                points += [(start, before), (start + ramp, now)]
            before = now
        return joined(points)

    def _rail_blend(self) -> Knots | None:
        shares = [each.rail for each in self._sections]
        if self._config.rails is None and any(share is not None for share in shares):
            raise ValueError("rail: the line's two rails are missing, for example rails: [null, 60e1_30]")
        return self._blended("rail", shares, 0.0)

    def _blended(self, name: str, values: list[float | None], episodes: float | None) -> Knots | None:
        filled = self._filled(name, values, episodes)
        if filled is None:
            return None
        points = [(0.0, filled[0])]
        for boundary, (before, after) in zip(self._bounds[1:], pairwise(filled), strict=False):
            if before != after:
                t = boundary + self._config.blend * (_STEPS - 0.5)
                values_there = before + (after - before) * _SHARES
                points += zip(t.tolist(), values_there.tolist(), strict=True)
        return joined(points)

    def _filled(self, name: str, values: list[float | None], episodes: float | None) -> list[float] | None:
        """Values of all sections; None where no section says one."""
        if all(value is None for value in values):
            return None
        filled = [episodes if value is None else value for value in values]
        known = [value for value in filled if value is not None]
        if len(known) == len(filled):
            return known
        if self._complete:
            raise ValueError(f"{name}: some sections leave it out: the episode's own is needed")
        return None

    def _check_room(self) -> None:
        for _, name, section in self._each():
            if len(self._sections) > 1 and section.length < self._config.blend:
                raise ValueError(
                    f"{name}: length: found {section.length:g} m; expected the {self._config.blend:g} m of "
                    "`blend` or more"
                )

    def _tracks(self) -> Iterator[TrackPiece]:
        pieces: list[TrackPiece] = []
        for number, section in enumerate(self._sections):
            track = None if section.track is None else read_irregularity(section.track)
            start, end = self._bounds[number : number + 2]
            if pieces and (pieces[-1].irregularity, pieces[-1].scale) == (track, section.track_scale):
                start = pieces.pop().start
            pieces.append(TrackPiece(start, end, track, section.track_scale))
        if any(piece.irregularity is not None or piece.scale is not None for piece in pieces):
            yield from pieces

    def _defects(self) -> Iterator[DefectConfig]:
        for start, _, section in self._each():
            for defect in section.defects:
                content = dict(defect) | {"position": start + defect.position}
                yield DefectConfig.model_validate({"type": "defect", **content})
