"""The root of a simulation's configuration: which vehicle, dampers, wheels, rails and track, and how to run."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import Field

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.base import Model, quantity
from sayd_env.config.contact import ContactConfig
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.errors import ConfigError
from sayd_env.config.loader import apply_overrides, read_config, validate
from sayd_env.config.profile import RailProfileConfig, WheelProfileConfig
from sayd_env.config.track import TrackConfig, with_resolved_path
from sayd_env.config.vehicle import VehicleConfig

# Keys whose value may be the name of a packaged configuration, or a path, in place of the content.
REFERENCES = {
    "vehicle": "vehicle",
    "damper": "damper",
    "wheel": "profile",
    "rail": "profile",
    "track": "track",
    "assessment": "study",
}


class NumericsConfig(Model):
    """Time integration."""

    step: float = quantity("s", "Longest time step; a whole number of steps makes a sample", gt=0.0, le=1e-3)
    creep_step: float = quantity(
        "-", "Largest product of step and creep damping rate; shortens the step at low speed", gt=0.0, le=1.0
    )


class CostConfig(Model):
    """The paper's cost J of a bogie and second, eq. (27)."""

    acceleration_weight: float = quantity("-", "k_y, weight of the acceleration", ge=0.0)
    force_weight: float = quantity("-", "k_F, weight of the damper force", ge=0.0)
    force_reference: float = quantity("N", "F_max, reference of the damper force", gt=0.0)


class Scenario(Model):
    """Everything a run needs but its speed and its seed."""

    vehicle: VehicleConfig
    damper: PassiveDamperConfig
    wheel: WheelProfileConfig
    rail: RailProfileConfig
    track: TrackConfig
    contact: ContactConfig
    contact_damping: float = quantity("N s/m", "Normal damping of a wheel's contact at its static load", ge=0.0)
    wear: float = quantity("-", "Wear of the wheels' treads: 0 new, 1 worn", ge=0.0, le=1.0)
    friction: float = quantity("-", "Coefficient of friction of wheel and rail", gt=0.0, le=1.0)
    numerics: NumericsConfig
    cost: CostConfig
    assessment: AssessmentConfig
    description: str = Field("", description="What this scenario is")


def load_scenario(config: str | None = None, overrides: Iterable[str] = ()) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    config : str, optional
        A packaged study (``nominal``) or a path to a YAML file. A file needs only the keys in which it
        differs from ``nominal``; a section may be given by name, by path or by content.
    overrides : iterable of str
        ``key=value`` assignments, applied last, for example ``damper.series_stiffness=4e6``.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    base, source = read_config("study", "nominal")
    data = _resolved(base, source)
    if config is not None and config != "nominal":
        own, source = read_config("study", config)
        if not isinstance(own, dict):
            raise ConfigError(f"{source}: expected keys and values")
        data = _merged(data, _resolved(own, source))
    for item in overrides:  # one by one, so that a name can be followed by a key of its content
        data = _resolved(apply_overrides(data, [item]), source)
    return validate(Scenario, data, source)


def _resolved(data: Any, source: str) -> dict[str, Any]:
    """Replace names of packaged configurations by their content."""
    result = dict(data)
    for key, kind in REFERENCES.items():
        if isinstance(result.get(key), str):
            content, found = read_config(kind, result[key])
            if not isinstance(content, dict):
                raise ConfigError(f"{found}: expected keys and values")
            result[key] = with_resolved_path(content, Path(found).parent) if key == "track" else content
    return result


def _stands_alone(own: dict[str, Any], below: dict[str, Any]) -> bool:
    return "name" in own or ("type" in own and own["type"] != below.get("type"))


def _merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Overlay nested mappings; a section with a name, or of another type, replaces the base's as a whole."""
    result = dict(base)
    for key, value in own.items():
        below = base.get(key)
        if isinstance(value, dict) and isinstance(below, dict) and not _stands_alone(value, below):
            result[key] = _merged(below, value)
        else:
            result[key] = value
    return result
