"""The root of a simulation's configuration: vehicle, dampers, wheels, rails, track, and how to run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import Field

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.base import Model, quantity
from sayd_env.config.contact import ContactConfig
from sayd_env.config.damper import DamperConfig, with_resolved_table
from sayd_env.config.errors import ConfigError
from sayd_env.config.loader import apply_overrides, packaged_names, read_config, validate
from sayd_env.config.profile import RailProfileConfig, WheelProfileConfig, with_resolved_files
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
    damper: DamperConfig
    wheel: WheelProfileConfig
    rail: RailProfileConfig
    track: TrackConfig
    contact: ContactConfig
    contact_damping: float = quantity(
        "N s/m", "Normal damping of a wheel's contact at its static load", ge=0.0
    )
    wear: float = quantity("-", "Wear of the wheels' treads: 0 new, 1 worn", ge=0.0, le=1.0)
    friction: float = quantity("-", "Coefficient of friction of wheel and rail", gt=0.0, le=1.0)
    numerics: NumericsConfig
    cost: CostConfig
    assessment: AssessmentConfig
    description: str = Field("", description="What this scenario is")
    provenance: dict[str, Any] = Field({}, description="Where calibrated numbers come from")


def load_scenario(config: str | None = None, overrides: Iterable[str] = ()) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    config : str, optional
        A packaged study (``nominal``) or a path to a YAML file. A file needs only the keys in which it
        differs from its ``base`` (``nominal`` unless it names another); a section may be given by name, by
        path or by content, and single numbers under ``set``, as key: value with dotted keys.
    overrides : iterable of str
        ``key=value`` assignments, applied last, for example ``damper.series_stiffness=4e6``.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    name = "nominal" if config is None else config
    data = _study(name, ())
    for item in overrides:  # one by one, so that a name can be followed by a key of its content
        data = _resolved(apply_overrides(data, [item]), item)
    return validate(Scenario, data, f"configs/study/{name}.yaml" if name in packaged_names("study") else name)


def _study(name: str, users: tuple[str, ...]) -> dict[str, Any]:
    """Content of a study on top of the study that its `base` names, its own `set` assignments last."""
    own, source = read_config("study", name)
    if not isinstance(own, dict):
        raise ConfigError(f"{source}: expected keys and values")
    own = dict(own)
    base, assignments = own.pop("base", "nominal"), own.pop("set", {})
    if base in users or base == name:
        raise ConfigError(f"{source}: base: '{base}' stands on this file itself")
    if not isinstance(assignments, dict):
        raise ConfigError(
            f"{source}: set: expected keys and values, for example damper.series_stiffness: 4.0e6"
        )
    below = {} if base is None else _study(str(base), (*users, name))
    data = _merged(below, _resolved(own, source))
    return _resolved(apply_overrides(data, [f"{k}={json.dumps(v)}" for k, v in assignments.items()]), source)


def _resolved(data: Any, source: str) -> dict[str, Any]:
    """Replace names of packaged configurations by their content."""
    result = dict(data)
    for key, kind in REFERENCES.items():
        if isinstance(result.get(key), str):
            content, found = read_config(kind, result[key])
            if not isinstance(content, dict):
                raise ConfigError(f"{found}: expected keys and values")
            result[key] = _beside(key, content, Path(found).parent)
    return result


def _beside(key: str, content: dict[str, Any], folder: Path) -> Any:
    """Content whose data files are looked for beside the YAML file that names them."""
    if key == "damper":
        return with_resolved_table(content, folder)
    if key == "track":
        return with_resolved_path(content, folder)
    return with_resolved_files(content, folder) if key in ("wheel", "rail") else content


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
