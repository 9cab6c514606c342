"""Interfaces and observations made by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sayd_env.config.assessment import load_assessment
from sayd_env.config.control import load_online
from sayd_env.config.damper import load_sayd
from sayd_env.config.units import Array32
from sayd_env.envs.interface import BOGIES, DAMPERS, POINTS, Interface, Signal

Observe = Callable[..., Array32]

PLACES = {
    "lateral_acceleration": POINTS,
    "longitudinal_acceleration": ("left", "right"),
    "pressure_a": DAMPERS,
    "pressure_b": DAMPERS,
    "stroke": DAMPERS,
    "current": DAMPERS,
    "acceleration_rms": POINTS,
    "force_rms": DAMPERS,
    "command": DAMPERS,
}
QUANTITIES = {
    "signals": (
        "lateral_acceleration",
        "longitudinal_acceleration",
        "pressure_a",
        "pressure_b",
        "stroke",
        "current",
        "speed",
    ),
    "features": ("acceleration_rms", "force_rms", "dominant_frequency", "current", "command", "speed"),
}


def names(observation: str) -> list[str]:
    found = []
    for quantity in QUANTITIES["features" if observation == "features" else "signals"]:
        if quantity == "speed":
            found.append(quantity)
        elif quantity == "dominant_frequency":
            found += [f"{quantity}.{bogie}" for bogie in BOGIES]
        else:
            found += [f"{quantity}.{bogie}.{place}" for bogie in BOGIES for place in PLACES[quantity]]
    return found


@pytest.fixture(scope="session")
def interface() -> Callable[..., Interface]:
    """A function that makes an interface, with changes of single fields."""
    base = Interface(
        observation="signals",
        signals=(),
        history=1,
        valves="bogie",
        control_period=0.01,
        damper=load_sayd("sayd"),
        acceleration_limit=5.44,
        force_reference=12e3,
        online=load_online(),
        assessment=load_assessment(),
    )

    def make(**changes: Any) -> Interface:
        observation = changes.get("observation", "signals")
        signals = tuple(Signal(name, "", -1e9, 1e9) for name in names(observation))
        if observation == "history":
            changes.setdefault("history", 4)
        return replace(base, signals=signals, **changes)

    return make


@pytest.fixture(scope="session")
def observe() -> Observe:
    """A function that makes an observation: a value for every signal whose name begins with a key."""

    def make(interface: Interface, readings: dict[str, float]) -> Array32:
        row = np.zeros(len(interface.signals), dtype=np.float32)
        for column, signal in enumerate(interface.signals):
            for start, value in readings.items():
                if signal.name == start or signal.name.startswith(start + "."):
                    row[column] = value
        if interface.observation == "history":
            return np.tile(row, (interface.history, 1))
        return row

    return make
