"""Variables of a unit: what a simulation tool connects, reads and sets."""

from __future__ import annotations

import math
from dataclasses import dataclass

TIME, INPUT, OUTPUT, PARAMETER = "independent", "input", "output", "parameter"


@dataclass(frozen=True)
class Variable:
    """One variable; its value reference is its place in the list."""

    name: str
    unit: str
    """As in `UNITS`."""
    text: str
    causality: str
    """TIME, INPUT, OUTPUT or PARAMETER."""
    start: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    integer: bool = False
    """Whether it has whole values: a choice, a number of things."""


UNITS: dict[str, dict[str, float]] = {
    "1": {},
    "s": {"s": 1},
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s": {"rad": 1, "s": -1},
    "1/s": {"s": -1},
    "kg": {"kg": 1},
    "m2": {"m": 2},
    "m3": {"m": 3},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N/m": {"kg": 1, "s": -2},
    "N.s/m": {"kg": 1, "s": -1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "m3/(s.Pa)": {"kg": -1, "m": 4, "s": 1},
}
"""Exponents of the base units."""
