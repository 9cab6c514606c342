"""What the user of an environment may fix of an episode: the options of `reset`, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from sayd_env.config import ConfigError, nearest
from sayd_env.config.environment import LIMITS
from sayd_env.config.explain import shown
from sayd_env.config.fault import Fault, parse_faults

PROFILES = {"new": 0.0, "worn": 1.0}
"""Names for the ends of wear."""
NUMBERS = ("speed_kmh", "wear", "friction", "payload", "initial_current")
"""Quantities of an episode that have a distribution of their own, and an option of the same name."""
OPTIONS = (*NUMBERS, "profile", "track", "track_scale", "faults")


@dataclass(frozen=True)
class EpisodeOptions:
    """Quantities that are fixed; the others are drawn."""

    numbers: dict[str, float]
    """Some of `NUMBERS`, within `LIMITS`."""
    track: str | None
    """Name of a track, or a path."""
    track_scale: float | None
    """Factor on its amplitudes."""
    faults: tuple[Fault, ...] | None
    """All faults of the episode."""


def checked_options(options: Mapping[str, Any] | None) -> EpisodeOptions:
    """Check options of an episode.

    Parameters
    ----------
    options : mapping or None
        Keys of `OPTIONS`: see `sayd_env.envs.draw.draw_episode`.

    Raises
    ------
    ConfigError
        An unknown option or a value that is not allowed.
    """
    given = {} if options is None else options
    if not isinstance(given, Mapping):
        raise ConfigError(f"options: found {shown(given)}; expected keys and values")
    for key in given:
        if key not in OPTIONS:
            known = ", ".join(sorted(OPTIONS))
            raise ConfigError(f"options: unknown key '{key}'{nearest(str(key), OPTIONS)}; allowed: {known}")
    numbers = {name: checked_number(name, given[name], "options: ") for name in NUMBERS if name in given}
    if "profile" in given:
        if "wear" in numbers:
            raise ConfigError("options: wear and profile say the same: give one of them")
        numbers["wear"] = _profile(given["profile"])
    return EpisodeOptions(
        numbers=numbers,
        track=_track(given["track"]) if "track" in given else None,
        track_scale=checked_number("track_scale", given["track_scale"], "options: ")
        if "track_scale" in given
        else None,
        faults=parse_faults(given["faults"], "options") if "faults" in given else None,
    )


def whole_number(name: str, value: Any, least: int = 0) -> int:
    """A whole number that is not below the least one.

    Raises
    ------
    ConfigError
        Anything else.
    """
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise ConfigError(f"{name}: found {shown(value)}; expected a whole number of {least} or more")
    return int(value)


def checked_number(name: str, value: Any, place: str = "") -> float:
    """A number within the `LIMITS` of a quantity.

    Parameters
    ----------
    name : str
        One of `LIMITS`.
    value
    place : str
        What a message says before the name.

    Raises
    ------
    ConfigError
        Anything else.
    """
    allowed = LIMITS[name]
    if not isinstance(value, bool) and isinstance(value, Real):
        number = float(value)
        if math.isfinite(number) and allowed.low <= number <= allowed.high:
            return number
    raise ConfigError(f"{place}{name}: found {shown(value)}; expected a number from {allowed}")


def _profile(value: Any) -> float:
    if not isinstance(value, str) or value not in PROFILES:
        close = nearest(value, PROFILES) if isinstance(value, str) else ""
        raise ConfigError(f"options: profile: found {shown(value)}{close}; expected {' or '.join(PROFILES)}")
    return PROFILES[value]


def _track(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ConfigError(f"options: track: found {shown(value)}; expected the name of a track or a path")
    return value
