"""Readers of what is typed after an option: a `ValueError` says what was found and what is allowed.

The program's border puts the option's name in front of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

from sayd_env.config.explain import shown
from sayd_env.config.units import KMH

Numbers: TypeAlias = Sequence[float]
Names: TypeAlias = Sequence[str]
MAX_SPEEDS = 1000
SPEEDS = "300,350,400 or 320:445:25"


@dataclass(frozen=True)
class Number:
    """Reader of one finite number within bounds, the lower one excluded if it must be `above` it."""

    low: float
    high: float = math.inf
    unit: str = ""
    whole: bool = False
    above: bool = False

    def __call__(self, given: str | float) -> float:
        """Read it, or check a default."""
        text = str(given).strip()
        try:
            # Python would take digits of other scripts and 1_000, too.
            readable = text.isascii() and "_" not in text
            value = (int(text) if self.whole else float(text)) if readable else math.nan
        except ValueError:
            value = math.nan
        if not self.low <= value <= self.high or math.isinf(value) or (self.above and value == self.low):
            raise ValueError(f"{shown(text)[1:-1] or 'an empty place'}: expected {self}")
        return value

    def __str__(self) -> str:
        """What is allowed."""
        unit = f" {self.unit}" if self.unit else ""
        if self.above:
            most = "" if math.isinf(self.high) else f", at most {self.high:g}"
            return f"a finite number above {self.low:g}{unit}{most}"
        return f"a {'whole ' * self.whole}number from {self.low:g} to {self.high:.10g}{unit}"


def positive(unit: str = "", high: float = math.inf) -> Number:
    """Reader of a finite number above 0."""
    return Number(0, high, unit, above=True)


SPEED = positive("km/h")


def name(text: str) -> str:
    """Read a name; whether there is such is checked where it is used."""
    if not text.strip():
        raise ValueError("found an empty place; expected names, separated by commas")
    return text.strip()


@dataclass(frozen=True)
class ListOf:
    """Reader of what is separated by commas, each part by a reader of its own."""

    one: Callable[[str], Any]
    distinct: bool = False

    def __call__(self, text: str) -> tuple[Any, ...]:
        """Read them."""
        found = tuple(map(self.one, text.split(",")))
        if self.distinct and len(set(found)) < len(found):
            raise ValueError(f"{shown(text)}: duplicate number")
        return found


SPEED_LIST = ListOf(SPEED)


def speeds(text: str) -> Numbers:
    """Read speeds in km/h, give them in m/s.

    Parameters
    ----------
    text : str
        ``300,350,400`` or ``320:445:25`` (first, last, step; last included when a step meets it).

    Raises
    ------
    ValueError
        Not a number, not positive, not finite, not rising, empty, or more than `MAX_SPEEDS` values.
    """
    try:
        found = _grid(text) if ":" in text else SPEED_LIST(text)
        for before, after in pairwise(found):
            if after <= before:
                raise ValueError(f"{after:g} follows {before:g}; speeds must rise")
    except ValueError as error:
        raise ValueError(f"{error} (use {SPEEDS})") from None
    return tuple(value / KMH for value in found)


def _grid(text: str) -> Numbers:
    """Numbers from first to last by step."""
    parts = text.split(":")
    if len(parts) != 3:
        raise ValueError(f"{shown(text)}: expected first:last:step")
    first, last, step = map(SPEED, parts)
    if last < first:
        raise ValueError(f"{shown(text)}: the last speed {last:g} is below the first {first:g}")
    # Half a millionth of a step forgives the rounding of decimal steps such as 0.1.
    steps = (last - first) / step + 5e-7
    if steps >= MAX_SPEEDS:
        raise ValueError(f"{shown(text)}: gives {steps + 1:.4g} speeds; at most {MAX_SPEEDS} are allowed")
    return [first + index * step for index in range(math.floor(steps) + 1)]
