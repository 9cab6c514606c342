"""What quantities may be: of an episode, for its options and its draws alike, and of a recorded train."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from sayd_env.config.distribution import Distribution

WORN_OUT = 1.2
"""Largest wear of a tread: 1 is the worn wheel that a profile describes, beyond it the hollow grows on by the
same law. A fifth shows what a controller does with wheels that are turned too late; no profile says more."""


class AllowedRange(NamedTuple):
    """Values that a quantity may have."""

    low: float
    high: float
    unit: str

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g} {self.unit}".removesuffix(" -")


LIMITS: Mapping[str, AllowedRange] = MappingProxyType(
    {
        "speed_kmh": AllowedRange(30.0, 500.0, "km/h"),
        "wear": AllowedRange(0.0, WORN_OUT, "-"),
        "gauge": AllowedRange(0.9, 1.7, "m"),
        "friction": AllowedRange(0.05, 1.0, "-"),
        "payload": AllowedRange(-0.5, 0.5, "-"),
        "initial_current": AllowedRange(0.0, 1.0, "-"),
        "track_scale": AllowedRange(0.0, 5.0, "-"),
        "sensor_bias": AllowedRange(-10.0, 10.0, "-"),
        "sensor_noise": AllowedRange(0.0, 100.0, "-"),
        "factor": AllowedRange(0.1, 10.0, "-"),
    }
)
"""For options of an episode and for what it draws alike. (The vehicle's speeds may reach less far.)"""


BOGIE_MASS, AXLE_LOAD = AllowedRange(500.0, 50e3, "kg"), AllowedRange(30e3, 500e3, "N")
"""Of the train whose run was recorded. What lies beyond is in another unit as a rule."""


def within(distribution: Distribution, name: str) -> Distribution:
    """Return a distribution of a quantity of `LIMITS`.

    Raises
    ------
    ValueError
        The distribution reaches beyond what is allowed.
    """
    (low, high), allowed = distribution.bounds, LIMITS[name]
    if low < allowed.low or high > allowed.high:
        raise ValueError(f"the distribution reaches from {low:g} to {high:g}; allowed are {allowed}")
    return distribution
