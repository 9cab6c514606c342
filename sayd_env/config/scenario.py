"""The root of a simulation's configuration: vehicle, dampers, wheels, rails, track, and how to run."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import Field

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.base import Model, quantity
from sayd_env.config.contact import ContactConfig
from sayd_env.config.damper import DamperConfig, with_resolved_table
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import Origin, shown
from sayd_env.config.loader import (
    apply_overrides,
    assigned,
    beside,
    is_path,
    packaged_names,
    parse_yaml,
    read_config,
    section,
    validate,
)
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


PROFILE_KINDS = ("wheel", "rail")


class NumericsConfig(Model):
    """Time integration."""

    step: float = quantity("s", "Longest time step; a whole number of steps makes a sample", ge=1e-6, le=1e-3)
    creep_step: float = quantity(
        "-", "Largest product of step and creep damping rate; shortens the step at low speed", ge=0.01, le=1.0
    )


class CostConfig(Model):
    """The paper's cost J of a bogie and second, eq. (27)."""

    acceleration_weight: float = quantity("-", "k_y, weight of the acceleration", ge=0.0)
    force_weight: float = quantity("-", "k_F, weight of the damper force", ge=0.0)
    force_reference: float = quantity("N", "F_max, reference of the damper force", gt=0.0)


class Scenario(Model):
    """Everything that a run needs except its speed and seed."""

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


def load_scenario(
    config: str | None = None, overrides: Iterable[str] = (), option: str = "--set"
) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    config : str, optional
        A packaged study (``nominal``) or a path to a YAML file. A file needs only the keys in which it
        differs from its ``base`` (``nominal`` unless it names another); a section may be given by name, by
        path (relative to that file) or by content, and single numbers under ``set``, as key: value with
        dotted keys.
    overrides : iterable of str
        ``key=value`` assignments, applied last, for example ``damper.series_stiffness=4e6``.
    option : str
        What a message calls the place of the assignments.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    name = "nominal" if config is None else config
    source = f"configs/study/{name}.yaml" if name in packaged_names("study") else name
    draft = _study(name, ())
    for item in overrides:  # one by one, so that a name can be followed by a key of its content
        draft = _with_assignment(draft, item, option)
    return validate(Scenario, draft.data, source, draft.origins)


class _Draft(NamedTuple):
    """Raw content of a scenario, and which of its parts come from where."""

    data: dict[str, Any]
    origins: tuple[Origin, ...] = ()


def _study(name: str, users: tuple[str, ...]) -> _Draft:
    """Content of a study layered over its `base`, its own `set` assignments last."""
    content, source = read_config("study", name)
    own = dict(section(content, source))
    base, assignments = own.pop("base", "nominal"), own.pop("set", None)
    if base is not None and not isinstance(base, str):
        found = shown(base)
        raise ConfigError(f"{source}: base: found {found}; expected the name of a study, a path or null")
    folder = Path(source).parent
    base = None if base is None else beside(base, folder)
    users = (*users, _identity(name))
    if base is not None and _identity(base) in users:
        raise ConfigError(f"{source}: base: '{base}' refers back to this file")
    if assignments is not None and not isinstance(assignments, dict):
        raise ConfigError(
            f"{source}: set: expected keys and values, for example damper.series_stiffness: 4.0e6"
        )
    below = _Draft({}) if base is None else _study(base, users)
    own = {key: _placed(key, value, folder) for key, value in own.items()}
    top = _resolved(_Draft(own, tuple(Origin(path, source) for path in _paths(own))), source)
    draft = _Draft(_merged(below.data, top.data), below.origins + top.origins)
    for key, value in (assignments or {}).items():
        draft = _with_assignment(draft, f"{key}={json.dumps(value, default=str)}", f"{source}: set:")
    return draft


def _paths(node: dict[str, Any], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Paths of the values that a section sets."""
    found = []
    for key, value in node.items():
        path = (*above, key)
        # A section with a name or a type replaces the base's: what it lacks is not taken from there.
        if not isinstance(value, dict) or not value or "name" in value or "type" in value:
            found.append(path)
        if isinstance(value, dict):
            found += _paths(value, path)
    return found


def _with_assignment(draft: _Draft, item: str, option: str) -> _Draft:
    changed = apply_overrides(draft.data, [item], option)
    key, _, text = (part.strip() for part in item.partition("="))
    if key in REFERENCES and isinstance(changed[key], int | float):
        changed[key] = text  # a name such as 60e1, which YAML reads as a number
    origin = assigned(draft.data, item, option.removesuffix(":"))
    return _resolved(_Draft(changed, (*draft.origins, origin)), option.removesuffix(":"))


def _resolved(draft: _Draft, source: str) -> _Draft:
    """Replace names of packaged configurations, and paths, by their content."""
    data, origins = dict(draft.data), draft.origins
    for key, kind in REFERENCES.items():
        named = data.get(key)
        if isinstance(named, str):
            content, found = read_config(kind, named)
            fitting = _of_kind(key, section(content, found), found)
            data[key] = _with_data_files(key, fitting, Path(found).parent)
            origins = (*origins, Origin((key,), found, own=True))
        elif key in data and not isinstance(named, dict):
            raise ConfigError(f"{source}: {key}: found {shown(named)}; {_expected(key, kind, named)}")
    return _Draft(data, origins)


def _expected(key: str, kind: str, found: Any) -> str:
    names = packaged_names(kind)
    number = isinstance(found, int | float)
    same = [name for name in names if number and parse_yaml(name, key) == found]
    quoted = f"; did you mean '{same[0]}', in quotes?" if same else ""
    return f"expected the name of a {kind} ({', '.join(names)}), a path or keys and values{quoted}"


def _of_kind(key: str, content: dict[str, Any], source: str) -> dict[str, Any]:
    """Refuse a rail where a wheel is expected, and vice versa."""
    kind = content.get("kind")
    if key in PROFILE_KINDS and kind in PROFILE_KINDS and kind != key:
        fitting = [n for n in packaged_names("profile") if read_config("profile", n)[0].get("kind") == key]
        raise ConfigError(f"{source}: is a {kind} profile; as {key} are available: {', '.join(fitting)}")
    return content


def _identity(name_or_path: str) -> str:
    return str(Path(name_or_path).resolve()) if is_path(name_or_path) else name_or_path


def _placed(key: str, value: Any, folder: Path) -> Any:
    """Value of a study's key, its paths relative to the folder of its file resolved."""
    if key in REFERENCES and isinstance(value, str):
        return beside(value, folder)
    return _with_data_files(key, value, folder) if isinstance(value, dict) else value


def _with_data_files(key: str, content: dict[str, Any], folder: Path) -> Any:
    """Content with data files relative to the YAML file that names them."""
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
