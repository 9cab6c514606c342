"""What the user of an environment may fix of an episode: the options of `reset`, checked."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from sayd_env.config import ConfigError, nearest
from sayd_env.config.conditions import SAYABLE
from sayd_env.config.explain import shown
from sayd_env.config.fault import Fault, parse_faults
from sayd_env.config.limits import LIMITS
from sayd_env.config.line import LineConfig
from sayd_env.config.loader import is_path, packaged_names, validate
from sayd_env.config.units import Array

PROFILES = {"new": 0.0, "worn": 1.0}
"""Names of the two ends of wear, of the study's own wheel profile."""
NUMBERS = ("speed_kmh", "wear", "friction", "gauge", "payload", "initial_current")
"""Quantities of an episode that have a distribution of their own, and an option of the same name."""
LARGEST = 2**63 - 1
"""No whole number of a user's is larger."""
OPTIONS = (*NUMBERS, "profile", "track", "track_scale", "line", "faults")


@dataclass(frozen=True)
class EpisodeOptions:
    """Quantities that are fixed; the others are drawn."""

    numbers: dict[str, float]
    """Some of `NUMBERS`, within `LIMITS`."""
    profile: str | None
    """One of `PROFILES`, or name of a wheel profile, or a path."""
    track: str | None
    """Name of a track, or a path."""
    track_scale: float | None
    """Factor on its amplitudes."""
    line: str | LineConfig | None
    """Name of a line, or a path, or its content."""
    faults: tuple[Fault, ...] | None
    """All faults of the episode."""

    @property
    def sayable(self) -> tuple[str, ...]:
        """Those that a line may say itself."""
        fixed = self.numbers | {"track": self.track, "track_scale": self.track_scale}
        return tuple(name for name in SAYABLE if fixed.get(name) is not None)


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
            close = nearest(key, OPTIONS) if isinstance(key, str) else ""
            raise ConfigError(f"options: unknown key {shown(key)}{close}; allowed: {known}")
    numbers = {name: checked_number(name, given[name], "options: ") for name in NUMBERS if name in given}
    profile = _profile(given["profile"]) if "profile" in given else None
    if profile in PROFILES and "wear" in numbers:
        raise ConfigError(f"options: wear and profile '{profile}' set the same quantity: give one of them")
    if profile is not None:
        numbers.setdefault("wear", PROFILES.get(profile, 0.0))
    return EpisodeOptions(
        numbers=numbers,
        profile=profile,
        track=_track(given["track"]) if "track" in given else None,
        track_scale=checked_number("track_scale", given["track_scale"], "options: ")
        if "track_scale" in given
        else None,
        line=_line(given["line"]) if "line" in given else None,
        faults=parse_faults(given["faults"], "options") if "faults" in given else None,
    )


def whole_number(name: str, value: Any, least: int = 0, most: int = LARGEST) -> int:
    """A whole number between the least and the most that are allowed.

    Raises
    ------
    ConfigError
        Anything else.
    """
    found = int(value) if not isinstance(value, bool) and isinstance(value, Integral) else None
    if found is not None and least <= found <= most:
        return found
    open_above = most == LARGEST and (found is None or found < least)
    limits = f"of {least} or more" if open_above else f"from {least} to {most}"
    raise ConfigError(f"{name}: found {shown(value)}; expected a whole number {limits}")


def number(value: Any) -> float | None:
    """A finite number as a float; None for anything else."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        found = float(value)
    except OverflowError:  # a whole number or a fraction beyond all floats
        return None
    return found if math.isfinite(found) else None


def number_array(name: str, values: Any, shape: tuple[int, ...]) -> Array:
    """Values as numbers of float64, of whatever shape; `shape` is what a message asks for.

    Raises
    ------
    ConfigError
        Anything but real numbers.
    """
    try:
        found = np.asarray(values)
        if found.dtype.kind not in "biufO":  # NumPy would drop imaginary parts, and read texts and dates
            raise TypeError
        return np.asarray(found, dtype=np.float64)
    except Exception:  # objects of one's own raise what they like
        raise ConfigError(f"{name}: found {shown(values)}; expected numbers of shape {shape}") from None


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
    allowed, found = LIMITS[name], number(value)
    if found is not None and allowed.low <= found <= allowed.high:
        return found
    raise ConfigError(f"{place}{name}: found {shown(value)}; expected a number from {allowed}")


def _profile(value: Any) -> str:
    known = (*PROFILES, *packaged_names("profile"))
    if isinstance(value, str) and (value in known or is_path(value)):
        return value
    close = nearest(value, known) if isinstance(value, str) else ""
    raise ConfigError(
        f"options: profile: found {shown(value)}{close}; expected {', '.join(known)} or a path to a YAML file"
    )


def _track(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ConfigError(f"options: track: found {shown(value)}; expected the name of a track or a path")
    return value


def _line(value: Any) -> str | LineConfig:
    known = packaged_names("line")
    value = os.fspath(value) if isinstance(value, os.PathLike) else value
    if isinstance(value, Mapping):
        return validate(LineConfig, dict(value), "options: line")
    if isinstance(value, str) and (value in known or is_path(value) or value.endswith(".csv")):
        return value
    close = nearest(value, known) if isinstance(value, str) else ""
    raise ConfigError(
        f"options: line: found {shown(value)}{close}; expected {', '.join(known)}, a path to a YAML or CSV "
        "file, or a line's content"
    )
