"""Schema of the safe fallback: when a monitor of the sensors closes the valves, and when it lets go again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

from pydantic import model_validator

from sayd_env.config.base import Model, quantity
from sayd_env.config.control import CONTROL
from sayd_env.config.explain import Origin
from sayd_env.config.layers import layered
from sayd_env.config.loader import validate


class TwinConfig(Model):
    """When two sensors of the same quantity on one bogie contradict each other."""

    floor: float = quantity(
        "unit of the signal", "RMS of the livelier one below which the pair is not judged", gt=0.0
    )
    ratio: float = quantity("-", "Ratio of their RMS values above which they contradict", gt=1.0)
    offset: float = quantity(
        "unit of the signal", "Difference of their means above which they contradict", gt=0.0
    )


class SafeConfig(Model):
    """Thresholds and times of the fallback."""

    command: float = quantity("-", "Valve command of the fallback", ge=0.0, le=1.0)
    smoothing: float = quantity("s", "Time constant of the sliding mean squares and means", gt=0.0, le=60.0)
    trip: float = quantity(
        "-", "Hunting indicator, as a share of the limit of EN 14363, above which valves close", gt=0.0
    )
    release: float = quantity("-", "Indicator below which the bogie counts as calm", gt=0.0)
    hold: float = quantity("s", "Calm time before the policy gets its valves back", ge=0.0, le=3600.0)
    longest_hold: float = quantity("s", "Most that repeated trips make of it", ge=0.0, le=3600.0)
    reopening: float = quantity("s", "Time over which the policy's command comes back", ge=0.0, le=3600.0)
    slowest: float = quantity("m/s", "Reading of the speed below which the valves are closed", ge=1.0)
    confirmation: float = quantity(
        "s", "Time for which a pair must contradict without a break", ge=0.0, le=60.0
    )
    lateral_acceleration: TwinConfig
    longitudinal_acceleration: TwinConfig
    pressure: TwinConfig
    stroke: TwinConfig

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.release >= self.trip:
            raise ValueError(f"release {self.release:g} must be below trip {self.trip:g}: hysteresis")
        if self.longest_hold < self.hold:
            raise ValueError(f"longest_hold {self.longest_hold:g} s must not be below hold {self.hold:g} s")
        return self


def load_safe(changes: Mapping[str, Any] | None = None) -> SafeConfig:
    """Read configs/control/safe.yaml.

    Parameters
    ----------
    changes : mapping, optional
        Values that replace those of the file.

    Raises
    ------
    ConfigError
        An unknown key, or a value that cannot be used.
    """
    given, draft = dict(changes or {}), layered(CONTROL, "safe")
    origins = (*draft.origins, *(Origin((key,), "safe fallback") for key in given))
    return validate(SafeConfig, draft.data | given, draft.source, origins)
