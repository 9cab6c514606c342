"""What a policy may know of an environment: its signals, its valves, its clock and its hardware."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy.typing as npt

from sayd_env.config import ConfigError, nearest
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.control import OnlineConfig
from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig
from sayd_env.config.explain import shown
from sayd_env.config.units import Array, Array32, Integers
from sayd_env.envs.options import number_array

BOGIES = ("front", "rear")
POINTS = ("leading", "trailing")
DAMPERS = ("left.upper", "left.lower", "right.upper", "right.lower")
"""Yaw dampers of a bogie, in the order that holds everywhere."""

ACTIONS = {"bogie": 2, "damper": 8, "vehicle": 1}
"""Number of valve commands of each layout."""

OBSERVED = {
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
"""First part of the names that an observation holds; a history holds signals."""


@dataclass(frozen=True)
class Signal:
    """One number of an observation."""

    name: str
    """Quantity and place, for example ``stroke.front.left.upper``."""
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class Interface:
    """What a policy may know of an environment."""

    observation: str
    """``signals``, ``history`` or ``features``."""
    signals: tuple[Signal, ...]
    """The numbers of one vector, in order."""
    history: int
    """Rows of a ``history``, else 1."""
    valves: str
    """``bogie``, ``damper`` or ``vehicle``: what has a valve command of its own."""
    control_period: float
    """Time from one action to the next, s."""
    damper: PassiveDamperConfig | SaydDamperConfig
    acceleration_limit: float
    """Limit of the bogie frame's lateral acceleration, eq. (26), m/s2."""
    force_reference: float
    """F_max of eq. (27), N."""
    online: OnlineConfig
    assessment: AssessmentConfig
    scaled: bool = False
    """Whether the environment's observations and actions are a learner's, not in SI units."""

    @property
    def actions(self) -> int:
        """Number of valve commands."""
        return ACTIONS[self.valves]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one observation."""
        width = len(self.signals)
        return (self.history, width) if self.observation == "history" else (width,)

    def rows(self, observation: npt.ArrayLike, source: str) -> tuple[Array, bool]:
        """Observations of N vehicles, shape (N, *shape), and whether it was that of a single one.

        Raises
        ------
        ConfigError
            Another shape, or no numbers; the message begins with the source.
        """
        shape = self.shape
        values = number_array(f"{source}: observation", observation, shape)
        single = values.ndim == len(shape)
        if values.ndim > len(shape) + 1 or values.shape[-len(shape) :] != shape:
            raise ConfigError(
                f"{source}: found an observation of shape {values.shape}; expected {shape}, or "
                f"(N, {', '.join(map(str, shape))}) of N vehicles"
            )
        return (values[None] if single else values), single

    @property
    def keywords(self) -> dict[str, Any]:
        """Keywords with which `gymnasium.make` gives an environment of this interface."""
        rows = {"history": self.history} if self.observation == "history" else {}
        common = {"observation": self.observation, "valves": self.valves, "damper": self.damper.type}
        return {**common, **rows, "control_period": self.control_period}

    def check(self, source: str, needs: Mapping[str, Any], signals: Sequence[str] = ()) -> None:
        """Refuse to let a policy act that needs another environment.

        Parameters
        ----------
        source : str
            Names the policy in the message.
        needs : mapping
            `keywords` that it needs.
        signals : sequence of str
            The numbers of a vector, in order, that it needs; empty for any.

        Raises
        ------
        ConfigError
            The environment is another one.
        """
        if self.scaled:
            raise ConfigError(
                f"{source}: the policy needs observations in SI units and gives valve commands; make the "
                "environment without scaled=True"
            )
        mine = self.keywords
        for name, needed in needs.items():
            if mine.get(name) != needed:
                keywords = ", ".join(f"{key}={value!r}" for key, value in needs.items())
                raise ConfigError(
                    f"{source}: the policy needs {name}={needed!r}, the environment has {mine.get(name)!r}; "
                    f"make it with {keywords}"
                )
        names = [signal.name for signal in self.signals]
        for i, (needed, found) in enumerate(zip_longest(signals, names, fillvalue="nothing")):
            if signals and needed != found:
                raise ConfigError(
                    f"{source}: the policy has learned from other signals: number {i} was {needed}, here it "
                    f"is {found}"
                )

    def index(self, name: str) -> int:
        """Position of a signal in an observation's vector.

        Raises
        ------
        ConfigError
            The observation has no such signal; the message says which one has.
        """
        names = [signal.name for signal in self.signals]
        if name in names:
            return names.index(name)
        quantity = name.partition(".")[0]
        holders = [kind for kind, quantities in OBSERVED.items() if quantity in quantities]
        mine = "features" if self.observation == "features" else "signals"
        if holders and mine not in holders:
            hint = "'signals' or 'history'" if holders == ["signals"] else "'features'"
            raise ConfigError(f"observation '{self.observation}' has no signal {shown(name)}; {hint} has it")
        raise ConfigError(
            f"observation '{self.observation}' has no signal {shown(name)}{nearest(name, names)}; "
            f"its quantities: {', '.join(sorted({other.partition('.')[0] for other in names}))}"
        )


@dataclass(frozen=True, eq=False)
class RunIn:
    """What vehicles observed on their way to step 0, T control periods; all arrive there together."""

    observations: Array32
    """(T, count, numbers of a vector), the last ones those of the reset."""
    begins: Integers
    """(count,) period with which each vehicle's run-in begins; what is before it is not its own."""
