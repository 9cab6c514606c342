"""Faults of valves, dampers and sensors: those that happen, and the classes of which they are drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from sayd_env.config.base import Model, quantity
from sayd_env.config.distribution import ChoiceDistribution, Distribution, FixedDistribution
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import shown
from sayd_env.config.loader import nearest, validate
from sayd_env.config.sensors import DAMPERS, KINDS, SIGNALS, SensorKind

MOST_FAULTS = 8
"""Most faults of an episode that is drawn: every damper can have one."""


def _damper(name: str) -> str:
    if name not in DAMPERS:
        raise ValueError(f"expected the name of a damper{nearest(name, DAMPERS)}: {', '.join(DAMPERS)}")
    return name


def _signal(name: str) -> str:
    if name not in SIGNALS:
        groups = ", ".join(dict.fromkeys(signal.partition(".")[0] for signal in SIGNALS))
        raise ValueError(
            f"expected the name of a signal{nearest(name, SIGNALS)}: one of {groups}, and its place, "
            "for example stroke.front.left.upper"
        )
    return name


DamperName = Annotated[str, AfterValidator(_damper)]
SignalName = Annotated[str, AfterValidator(_signal)]


class _Fault(Model):
    start_s: float = quantity("s", "Time after step 0 at which it happens", default=0.0, ge=0.0)


class _DamperFault(_Fault):
    damper: DamperName = Field(description="Damper, such as front.left.upper")


class _SensorFault(_Fault):
    signal: SignalName = Field(description="Signal, such as stroke.front.left.upper")


class ValveStuck(_DamperFault):
    """The valve stays at a given opening, whatever the command."""

    kind: Literal["valve_stuck"]
    current: float = quantity(
        "-", "Current at which the valve is stuck: 0 closed, 1 open, or between them", ge=0.0, le=1.0
    )


class PowerLost(_DamperFault):
    """The coil has no power: the valve goes to the fail-safe state of its hardware."""

    kind: Literal["power_lost"]


class DamperLost(_DamperFault):
    """The damper is torn off and has no force."""

    kind: Literal["damper_lost"]


class SensorDead(_SensorFault):
    """The sensor no longer follows its signal: it reads as if the signal were zero."""

    kind: Literal["sensor_dead"]


class SensorFrozen(_SensorFault):
    """The sensor repeats its last reading."""

    kind: Literal["sensor_frozen"]


class SensorBiased(_SensorFault):
    """A constant error is added to the readings."""

    kind: Literal["sensor_biased"]
    bias: float = quantity("unit of the signal", "Error, beside the sensor's own bias")


class SensorNoisy(_SensorFault):
    """The sensor's noise is replaced by a larger one."""

    kind: Literal["sensor_noisy"]
    noise: float = quantity("unit of the signal", "RMS of a sample's noise, in place of the sensor's", ge=0.0)


Fault = Annotated[
    ValveStuck | PowerLost | DamperLost | SensorDead | SensorFrozen | SensorBiased | SensorNoisy,
    Field(discriminator="kind"),
]


class _Faults(Model):
    faults: tuple[Fault, ...]


def parse_faults(raw: Any, source: str) -> tuple[Fault, ...]:
    """Read a list of faults, each given by keys and values.

    Parameters
    ----------
    raw : sequence of mappings
        For example ``{"kind": "valve_stuck", "damper": "front.left.upper", "current": 0.3, "start_s": 5.0}``
        or ``{"kind": "sensor_dead", "signal": "speed"}``.
    source : str
        What a message calls the place of the list.

    Raises
    ------
    ConfigError
        Not a list, or a fault that cannot be.
    """
    single = isinstance(raw, np.ndarray) and raw.ndim == 0
    if single or isinstance(raw, str | bytes) or not isinstance(raw, Sequence | np.ndarray):
        raise ConfigError(f"{source}: faults: found {shown(raw)}; expected a list of faults")
    return validate(_Faults, {"faults": [_plain(entry) for entry in raw]}, source).faults


def _plain(entry: Any) -> Any:
    """Entry with Python's numbers instead of NumPy's, which a strict schema does not accept."""
    if not isinstance(entry, dict):
        return entry
    return {key: value.item() if isinstance(value, np.generic) else value for key, value in entry.items()}


class _FaultClass(Model):
    weight: float = quantity("-", "Relative frequency", default=1.0, ge=0.0, le=1e9)


class ValveStuckClass(_FaultClass):
    """A valve of any damper that sticks at a drawn opening."""

    kind: Literal["valve_stuck"]
    current: Distribution = Field(description="Current at which it is stuck (-)")

    @field_validator("current")
    @classmethod
    def _opening(cls, distribution: Distribution) -> Distribution:
        low, high = distribution.bounds
        if low < 0.0 or high > 1.0:
            raise ValueError(f"the distribution reaches from {low:g} to {high:g}; allowed are 0 to 1")
        return distribution


class DamperFaultClass(_FaultClass):
    """A fault of any damper without a magnitude."""

    kind: Literal["power_lost", "damper_lost"]


class SensorFaultClass(_FaultClass):
    """A fault of any sensor of some kinds without a magnitude."""

    kind: Literal["sensor_dead", "sensor_frozen"]
    sensors: tuple[SensorKind, ...] = Field(KINDS, min_length=1, description="Kinds of sensors")


class SensorErrorClass(_FaultClass):
    """An error of any sensor of some kinds: biased to either side, or noisy."""

    kind: Literal["sensor_biased", "sensor_noisy"]
    sensors: tuple[SensorKind, ...] = Field(KINDS, min_length=1, description="Kinds of sensors")
    share: Distribution = Field(description="Size of the error, as a share of half the sensor's range (-)")

    @field_validator("share")
    @classmethod
    def _positive(cls, distribution: Distribution) -> Distribution:
        low, high = distribution.bounds
        if low < 0.0 or high > 1.0:
            raise ValueError(f"the distribution reaches from {low:g} to {high:g}; allowed are 0 to 1")
        return distribution


FaultClass = Annotated[
    ValveStuckClass | DamperFaultClass | SensorFaultClass | SensorErrorClass, Field(discriminator="kind")
]


class FaultsConfig(Model):
    """How many faults an episode has, when, and which."""

    count: Annotated[FixedDistribution | ChoiceDistribution, Field(discriminator="distribution")] = Field(
        description="Number of faults (-)"
    )
    onset: Distribution = Field(description="Time after step 0 at which a fault happens (s)")
    kinds: tuple[FaultClass, ...] = Field(min_length=1, description="The faults, with their weights")

    @field_validator("count")
    @classmethod
    def _countable(
        cls, distribution: FixedDistribution | ChoiceDistribution
    ) -> FixedDistribution | ChoiceDistribution:
        values = (
            distribution.values if isinstance(distribution, ChoiceDistribution) else (distribution.value,)
        )
        wrong = [value for value in values if value not in range(MOST_FAULTS + 1)]
        if wrong:
            raise ValueError(
                f"the distribution has {wrong[0]:g}; allowed are whole numbers from 0 to {MOST_FAULTS}"
            )
        return distribution

    @field_validator("onset")
    @classmethod
    def _after_the_start(cls, distribution: Distribution) -> Distribution:
        if distribution.bounds[0] < 0.0:
            raise ValueError(
                f"the distribution reaches down to {distribution.bounds[0]:g} s; allowed are 0 s and more"
            )
        return distribution

    @field_validator("kinds")
    @classmethod
    def _some_weight(cls, kinds: tuple[FaultClass, ...]) -> tuple[FaultClass, ...]:
        if sum(each.weight for each in kinds) == 0.0:
            raise ValueError("at least one weight must be positive")
        return kinds
