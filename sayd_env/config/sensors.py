"""Sensors of the train: their signals, ranges and errors.

The reading of a sensor: the true value through a first-order low-pass, plus bias and noise, cut to the range,
rounded to the resolution, held for the sampling time. Samples are 1 ms apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import product
from types import MappingProxyType
from typing import Literal, get_args

from pydantic import field_validator, model_validator

from sayd_env.config.base import Model, is_multiple, quantity
from sayd_env.config.layers import Kind, read_layered

SENSORS = Kind("sensors")
SAMPLE = 1.0e-3
"""Time between two samples of a sensor (s)."""

SensorKind = Literal[
    "lateral_acceleration", "longitudinal_acceleration", "pressure", "stroke", "current", "speed"
]
KINDS: tuple[SensorKind, ...] = get_args(SensorKind)
UNITS: Mapping[SensorKind, str] = MappingProxyType(
    {
        "lateral_acceleration": "m/s2",
        "longitudinal_acceleration": "m/s2",
        "pressure": "Pa",
        "stroke": "m",
        "current": "-",
        "speed": "m/s",
    }
)

POINTS = tuple(".".join(place) for place in product(("front", "rear"), ("leading", "trailing")))
"""Points of the bogie frames above the wheelsets, mid-width."""
MOUNTS = tuple(".".join(place) for place in product(("front", "rear"), ("left", "right")))
"""Sides of the bogie frames at which yaw dampers are mounted."""
DAMPERS = tuple(".".join(place) for place in product(MOUNTS, ("upper", "lower")))
"""The eight yaw dampers, in the order of the vehicle's model."""


def _signals() -> dict[str, SensorKind]:
    groups: tuple[tuple[str, SensorKind, tuple[str, ...]], ...] = (
        ("lateral_acceleration", "lateral_acceleration", POINTS),
        ("longitudinal_acceleration", "longitudinal_acceleration", MOUNTS),
        ("pressure_a", "pressure", DAMPERS),
        ("pressure_b", "pressure", DAMPERS),
        ("stroke", "stroke", DAMPERS),
        ("current", "current", DAMPERS),
    )
    named = {f"{name}.{place}": kind for name, kind, places in groups for place in places}
    return named | {"speed": "speed"}


SIGNALS: Mapping[str, SensorKind] = MappingProxyType(_signals())
"""Names of the 41 signals in the order of the observation, and the kind of sensor that each comes from."""


class SensorConfig(Model):
    """One kind of sensor, in the unit of its signal."""

    low: float = quantity("unit of the signal", "Lower end of the range")
    high: float = quantity("unit of the signal", "Upper end of the range")
    noise: float = quantity("unit of the signal", "RMS of the noise of one sample of 1 ms", ge=0.0)
    bias: float = quantity("unit of the signal", "Error that all sensors of the kind have in common")
    bias_spread: float = quantity(
        "unit of the signal", "Half width of the error that is drawn for each sensor", ge=0.0
    )
    bandwidth: float | None = quantity("Hz", "Corner of the first-order low-pass; null: none", gt=0.0)
    resolution: float = quantity("unit of the signal", "Step of the readings; 0: none", ge=0.0)
    sampling: float = quantity(
        "s", "Time between two readings, a whole number of milliseconds", gt=0.0, le=1.0
    )

    @field_validator("sampling")
    @classmethod
    def _whole_samples(cls, time: float) -> float:
        if not is_multiple(time, SAMPLE):
            raise ValueError("expected a multiple of 0.001 s")
        return time

    @model_validator(mode="after")
    def _range(self) -> SensorConfig:
        if self.low >= self.high:
            raise ValueError(f"low ({self.low:g}) must be below high ({self.high:g})")
        if self.resolution > self.high - self.low:
            raise ValueError(f"resolution ({self.resolution:g}) must not exceed the range")
        return self


class SensorsConfig(Model):
    """The sensors of a train, one section for each kind."""

    name: str
    description: str = ""
    lateral_acceleration: SensorConfig
    longitudinal_acceleration: SensorConfig
    pressure: SensorConfig
    stroke: SensorConfig
    current: SensorConfig
    speed: SensorConfig

    def of(self, signal: str) -> SensorConfig:
        """Return the sensor of a signal, one of `SIGNALS`."""
        sensor: SensorConfig = getattr(self, SIGNALS[signal])
        return sensor


def load_sensors(name: str = "ideal", overrides: Iterable[str] = ()) -> SensorsConfig:
    """Read a set of sensors.

    Parameters
    ----------
    name : str
        A packaged set (``ideal``, ``realistic``) or a path to a YAML file.
    overrides : iterable of str
        ``key=value`` assignments, for example ``pressure.noise=0``.

    Raises
    ------
    ConfigError
        The file, a key or a value cannot be used.
    """
    return read_layered(SensorsConfig, SENSORS, name, overrides)
