"""What lies along the way, resolved: the one object that everything reads, whatever file or draw made it.

Distance s (m) is 0 where the assessed run begins (step 0 of an episode). What lies before, the run-in, is
straight and has the conditions of s = 0; beyond the last section the line goes on as it ends.

Signs: x forward, y left. A left curve has a curvature kappa > 0. Cant is positive where it serves a left
curve, that is, where the right rail is the higher one; the frame's roll about x is then negative.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sayd_env.config.limits import LIMITS, AllowedRange
from sayd_env.config.profile import RailProfileConfig
from sayd_env.config.track import DefectConfig, IrregularityConfig
from sayd_env.config.units import GRAVITY, KMH, Array

CANT_BASE = 1.5
"""Distance of the contacts over which cant is measured (m): EN 13803, standard gauge."""
MOST_ACCELERATION = 0.7
"""Of a train that gathers speed or brakes (m/s2)."""
TIGHTEST = 150.0
"""Smallest radius (m): EN 13803."""
MOST_CANT = 0.18
"""Highest cant (m): EN 13803, exceptional limit."""
LINE_STEP = 10.0
"""Distance (m) of the places along a run where curvature, cant, speed, friction and rail shape are known."""
SHORTEST_TRANSITION = 20.0
"""Transition (m) that the kinks of curvature and cant, rounded over 20 m each way, still leave one."""
MOST_DEFICIENCY = 0.3
"""Most that cant may lack or exceed (m): tilting trains reach as far (EN 13803)."""
MOST_TWIST = 1.0 / 400.0
"""Steepest cant ramp (-): EN 13803, exceptional limit."""
SAYABLE = ("speed_kmh", "gauge", "friction", "track", "track_scale")
"""Options of an episode that a line may say itself."""
Rails = tuple[RailProfileConfig | None, RailProfileConfig]
"""The two profiles that a blend goes between; the first None: the scenario's."""
_ROUNDING = 1e-9
_SAME_PLACE = 1e-6
"""Knots closer than this are one (m): sums of lengths are rounded."""
# Places within a piece where speed and curvature change together, at which their product is looked at.
_WITHIN = np.linspace(0.0, 1.0, 9)


@dataclass(frozen=True)
class Knots:
    """A quantity over distance: linear between knots, constant outside.

    Attributes
    ----------
    s : tuple of float
        Ascending distances of the knots (m).
    value : tuple of float
        Its values there.
    """

    s: tuple[float, ...]
    value: tuple[float, ...]

    def at(self, s: npt.ArrayLike) -> Array:
        """Values at distances s (m), of the same shape."""
        return np.asarray(np.interp(np.asarray(s, dtype=np.float64), self._table.s, self._table.value))

    def slope(self, s: npt.ArrayLike) -> Array:
        """Derivatives by distance at s (m), of the same shape; at a knot that of the piece behind it."""
        return np.asarray(self._table.slope[np.searchsorted(self._table.s, s, side="right")])

    def integral(self, s: npt.ArrayLike) -> Array:
        """Integrals from the first knot to s (m), of the same shape: of the curvature, the heading (rad)."""
        s, table = np.asarray(s, dtype=np.float64), self._table
        place = np.clip(np.searchsorted(table.s, s, side="right") - 1, 0, None)
        height = 0.5 * (table.value[place] + self.at(s))
        return np.asarray(table.integral[place] + height * (s - table.s[place]))

    def times(self, factor: float) -> Knots:
        """The same, multiplied by a number."""
        return Knots(self.s, tuple(factor * value for value in self.value))

    @property
    def constant(self) -> bool:
        """Whether it has one value all along."""
        return min(self.value) == max(self.value)

    @cached_property
    def _table(self) -> _Table:
        s, value = np.asarray(self.s), np.asarray(self.value)
        areas, slopes = 0.5 * (value[1:] + value[:-1]) * np.diff(s), np.diff(value) / np.diff(s)
        return _Table(
            s,
            value,
            integral=np.concatenate(([0.0], np.cumsum(areas))),
            slope=np.concatenate(([0.0], slopes, [0.0])),
        )


class _Table(NamedTuple):
    s: Array
    value: Array
    integral: Array
    """From the first knot to each."""
    slope: Array
    """Before the first knot, between knots, and beyond the last one."""


@dataclass(frozen=True)
class Section:
    """A part of the line that tables name."""

    name: str
    start: float
    """m."""
    end: float
    """m, where the next one begins."""
    straight_from: float | None
    """Where its transition from a curve ends (m), from where on it is straight; None: it is curved."""

    @property
    def straight(self) -> bool:
        """Whether there is neither a curve nor a transition anywhere in it."""
        return self.straight_from == self.start


@dataclass(frozen=True)
class TrackPiece:
    """Where a class of track lies, and how rough it is there."""

    start: float
    """m."""
    end: float
    """m, where the next one begins."""
    irregularity: IrregularityConfig | None
    """None: the episode's."""
    scale: float | None
    """Factor on the amplitudes, in place of its own; None: its own."""

    def level(self, episodes: float) -> float:
        """Factor on the amplitudes that acts, given that of the episode's track."""
        if self.scale is not None:
            return self.scale
        return episodes if self.irregularity is None else amplitude(self.irregularity)


def amplitude(irregularity: IrregularityConfig) -> float:
    """Factor on the amplitudes of a track's irregularities; measured ones are as they are."""
    return float(getattr(irregularity, "scale", 1.0))


@dataclass(frozen=True)
class Line:
    """Conditions over distance; what is None, or an empty tuple, is as the episode has it.

    Attributes
    ----------
    curvature : Knots
        kappa (1/m), positive in left curves; 0 at and before s = 0.
    cant : Knots
        Height of the right rail above the left one over `CANT_BASE` (m); 0 at and before s = 0.
    speed_squared : Knots or None
        Square of the speed (m2/s2): at a constant acceleration a it grows by 2 a each metre.
    gauge, friction : Knots or None
        Track gauge (m), coefficient of friction (-).
    rail_blend : Knots or None
        Share of the second rail profile of `rails`, 0 to 1 (-).
    rails : Rails or None
        The two rail profiles; None: there is no blend.
    tracks : tuple of TrackPiece
        Irregularities; pieces cover the whole length, one passes into the next over `blend` about their
        boundary.
    blend : float
        Length (m) of the changes between sections, centred at their boundary.
    defects : tuple of DefectConfig
        Single defects beside them, at their distance s.
    sections : tuple of Section
        They cover the whole length.
    """

    curvature: Knots
    cant: Knots
    sections: tuple[Section, ...]
    speed_squared: Knots | None = None
    gauge: Knots | None = None
    friction: Knots | None = None
    rail_blend: Knots | None = None
    rails: Rails | None = None
    tracks: tuple[TrackPiece, ...] = ()
    blend: float = 25.0
    defects: tuple[DefectConfig, ...] = ()

    @property
    def length(self) -> float:
        """Where the last section ends (m)."""
        return self.sections[-1].end

    @cached_property
    def roll(self) -> Knots:
        """Roll phi_c of the track's frame about x (rad), negative in a left curve; for small angles."""
        return self.cant.times(-1.0 / CANT_BASE)

    @property
    def curved(self) -> bool:
        """Whether there is curvature or cant anywhere."""
        return any(self.curvature.value) or any(self.cant.value)

    @property
    def constant_speed(self) -> bool:
        """Whether the speed, the line's or the episode's, never changes."""
        return self.speed_squared is None or self.speed_squared.constant

    @property
    def reshaped(self) -> bool:
        """Whether rails have another profile than the scenario's anywhere."""
        blend = self.rail_blend is not None and any(self.rail_blend.value)
        return blend or (self.rails is not None and self.rails[0] is not None)

    @property
    def plain(self) -> bool:
        """Whether it leaves everything as the episode has it."""
        knots = (self.speed_squared, self.gauge, self.friction)
        return not (self.curved or any(knots) or self.reshaped or self.tracks or self.defects)

    @property
    def said(self) -> frozenset[str]:
        """Those of `SAYABLE` that it says all along: the episode's own has no effect."""
        knots = {"speed_kmh": self.speed_squared, "gauge": self.gauge, "friction": self.friction}
        found = {name for name, values in knots.items() if values is not None}
        if self.tracks and all(piece.irregularity is not None for piece in self.tracks):
            found.add("track")
        # The scale of the episode's track is of use where neither another track nor a scale is said.
        if self.tracks and all(piece.irregularity or piece.scale is not None for piece in self.tracks):
            found.add("track_scale")
        return frozenset(found)

    @property
    def slowest(self) -> float | None:
        """Lowest speed (m/s); None: the episode's."""
        return None if self.speed_squared is None else math.sqrt(min(self.speed_squared.value))

    @property
    def fastest(self) -> float | None:
        """Highest speed (m/s); None: the episode's."""
        return None if self.speed_squared is None else math.sqrt(max(self.speed_squared.value))

    def speed_at(self, s: npt.ArrayLike) -> Array | None:
        """Speeds (m/s) at distances s (m), of the same shape; None: the episode's."""
        return None if self.speed_squared is None else np.sqrt(self.speed_squared.at(s))

    def time_at(self, s: npt.ArrayLike) -> Array | None:
        """Times (s) at which a train that starts at 0 is at distances s (m); None: the episode's speed.

        Exact: where the speed's square is linear over distance, its mean over time is that of both ends.
        """
        if self.speed_squared is None:
            return None
        knots = np.union1d(self.speed_squared.s, 0.0)
        speed = np.sqrt(self.speed_squared.at(knots))
        times = np.concatenate(([0.0], np.cumsum(2.0 * np.diff(knots) / (speed[1:] + speed[:-1]))))
        times -= times[np.searchsorted(knots, 0.0)]
        s = np.asarray(s, dtype=np.float64)
        place = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, None)
        mean = 0.5 * (speed[place] + np.sqrt(self.speed_squared.at(s)))
        return np.asarray(times[place] + (s - knots[place]) / mean)

    def distance_at(self, t: npt.ArrayLike) -> Array | None:
        """Distances (m) at times t >= 0 (s), the inverse of `time_at`; None: the episode's speed."""
        if self.speed_squared is None:
            return None
        knots = np.union1d(self.speed_squared.s, 0.0)
        knots = knots[knots >= 0.0]
        times = self.time_at(knots)
        assert times is not None
        t = np.asarray(t, dtype=np.float64)
        place = np.clip(np.searchsorted(times, t, side="right") - 1, 0, None)
        speed = np.sqrt(self.speed_squared.at(knots))[place]
        acceleration = 0.5 * self.speed_squared.slope(knots)[place]
        after = t - times[place]
        return np.asarray(knots[place] + after * (speed + 0.5 * acceleration * after))

    def section_at(self, s: float) -> Section:
        """Section at a distance (m); the first before 0, the last beyond the end."""
        return next((each for each in self.sections if s < each.end), self.sections[-1])


def smooth_step(t: Array) -> Array:
    """0 below t = 0, 1 above 1, between them 6 t^5 - 15 t^4 + 10 t^3 with two continuous derivatives."""
    t = np.clip(t, 0.0, 1.0)
    return np.asarray(t**3 * (10.0 + t * (6.0 * t - 15.0)))


def joined(points: Iterable[tuple[float, float]]) -> Knots:
    """Knots through points in order of distance; of several in a row with one value the outer ones.

    Raises
    ------
    ValueError
        Two values at one distance.
    """
    kept: list[tuple[float, float]] = []
    for point in points:
        if kept and point[0] < kept[-1][0] + _SAME_PLACE:
            if not math.isclose(point[1], kept[-1][1], rel_tol=_ROUNDING, abs_tol=_ROUNDING):
                raise ValueError(f"jumps from {kept[-1][1]:g} to {point[1]:g} at {point[0]:g} m")
            continue
        if len(kept) > 1 and kept[-1][1] == kept[-2][1] == point[1]:
            kept.pop()
        kept.append(point)
    s, value = zip(*kept, strict=True)
    return Knots(s, value)


def checked(line: Line, speed: float | None = None) -> Line:
    """Return a line that a railway could have.

    Parameters
    ----------
    line : Line
        The line.
    speed : float, optional
        The episode's speed (m/s), for a line that leaves it out.

    Raises
    ------
    ValueError
        A quantity is beyond what is allowed; the message names it, the section and the distance.
    """
    for problem in _problems(line, speed):
        raise ValueError(problem)
    return line


def _problems(line: Line, speed: float | None) -> Iterator[str]:
    curvature, cant, squared = line.curvature, line.cant, line.speed_squared
    radius = 1.0 / max(1e-12, *np.abs(curvature.value))
    if radius < TIGHTEST * (1.0 - _ROUNDING):
        s = curvature.s[int(np.argmax(np.abs(curvature.value)))]
        yield f"{_place(line, s)}: radius: found {radius:g} m; allowed are {TIGHTEST:g} m and more"
    yield from _too_large(line, "cant", cant.s, cant.value, MOST_CANT, "m")
    yield from _too_large(line, "slope of the cant", cant.s, cant.slope(cant.s), MOST_TWIST, "-")
    if squared is not None:
        yield from _outside(line, "speed", squared.s, KMH * np.sqrt(squared.value), LIMITS["speed_kmh"])
        acceleration = 0.5 * squared.slope(squared.s)
        yield from _too_large(line, "acceleration", squared.s, acceleration, MOST_ACCELERATION, "m/s2")
    elif speed is not None:
        squared = Knots((0.0,), (speed**2,))
    shares = AllowedRange(0.0, 1.0, "-")
    for name, knots, allowed in (
        ("gauge", line.gauge, LIMITS["gauge"]),
        ("friction", line.friction, LIMITS["friction"]),
        ("rail", line.rail_blend, shares),
    ):
        if knots is not None:
            yield from _outside(line, name, knots.s, np.asarray(knots.value), allowed)
    if squared is not None:
        places, lacking = cant_deficiency(line, squared)
        yield from _too_large(line, "cant deficiency", places, lacking, MOST_DEFICIENCY, "m")


def cant_deficiency(line: Line, speed_squared: Knots) -> tuple[Array, Array]:
    """Cant that a train misses: V^2 kappa b / g - cant.

    Parameters
    ----------
    line : Line
        The line.
    speed_squared : Knots
        Square of the speed (m2/s2).

    Returns
    -------
    s : ndarray, shape (n,)
        Distances (m), at all knots and close enough between them.
    deficiency : ndarray, shape (n,)
        Signed as the cant (m): in a left curve positive where the train leans outwards.
    """
    knots = np.unique(np.concatenate((line.curvature.s, line.cant.s, speed_squared.s)))
    s = np.unique(knots[:-1] + np.multiply.outer(_WITHIN, np.diff(knots)))
    s = np.append(s, knots[-1])
    equilibrium = speed_squared.at(s) * line.curvature.at(s) * CANT_BASE / GRAVITY
    return s, equilibrium - line.cant.at(s)


def _too_large(
    line: Line, name: str, s: npt.ArrayLike, value: npt.ArrayLike, most: float, unit: str
) -> Iterator[str]:
    size = np.abs(value)
    if size.size and size.max() > most * (1.0 + _ROUNDING):
        place = float(np.asarray(s)[int(size.argmax())])
        found, allowed = f"{size.max():.4g} {unit}", f"{most:g} {unit}"
        yield f"{_place(line, place)}: {name}: found {found}; at most {allowed} is allowed"


def _outside(line: Line, name: str, s: npt.ArrayLike, value: Array, allowed: AllowedRange) -> Iterator[str]:
    slack = _ROUNDING * allowed.high
    wrong = np.flatnonzero((value < allowed.low - slack) | (value > allowed.high + slack))
    if wrong.size:
        place = float(np.asarray(s)[wrong[0]])
        yield f"{_place(line, place)}: {name}: found {value[wrong[0]]:g}; allowed are {allowed}"


def _place(line: Line, s: float) -> str:
    return f"section '{line.section_at(s).name}', at {s:g} m"
