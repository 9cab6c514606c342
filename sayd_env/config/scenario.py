"""The root of a simulation's configuration: vehicle, dampers, wheels, rails, track, and how to run."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import Field

from sayd_env.config.assessment import ASSESSMENT, AssessmentConfig
from sayd_env.config.base import Model, Part, quantity
from sayd_env.config.contact import ContactConfig
from sayd_env.config.damper import DAMPER, DamperConfig
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.limits import WORN_OUT
from sayd_env.config.profile import RAIL, WHEEL, RailProfileConfig, WheelProfileConfig
from sayd_env.config.track import TRACK, TrackConfig
from sayd_env.config.vehicle import VEHICLE, VehicleConfig

STUDY = Kind(
    "study",
    parts={
        "vehicle": VEHICLE,
        "damper": DAMPER,
        "wheel": WHEEL,
        "rail": RAIL,
        "track": TRACK,
        "assessment": ASSESSMENT,
    },
    base="nominal",
    mark="vehicle",
)


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


class Scenario(Part):
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
    wear: float = quantity(
        "-", "Wear of the wheels' treads: 0 new, 1 worn, beyond it more of the same", ge=0.0, le=WORN_OUT
    )
    friction: float = quantity("-", "Coefficient of friction of wheel and rail", gt=0.0, le=1.0)
    numerics: NumericsConfig
    cost: CostConfig
    assessment: AssessmentConfig
    description: str = Field("", description="What this scenario is")

    def content(self) -> dict[str, Any]:
        """What a file of its own holds; measured files stay where they are and are found from any folder."""
        found: dict[str, Any] = _found_from_anywhere(self.model_dump(mode="json"))
        return found


def _found_from_anywhere(value: Any, key: str = "") -> Any:
    if isinstance(value, dict):
        return {name: _found_from_anywhere(each, name) for name, each in value.items()}
    if isinstance(value, list):
        return [_found_from_anywhere(each) for each in value]
    return str(Path(value).resolve()) if key in ("file", "path") and isinstance(value, str) else value


def load_scenario(
    config: str | None = None, overrides: Iterable[str] = (), option: str = "--set"
) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    config : str, optional
        A packaged scenario (``nominal``) or a path to a YAML file. A file needs only the keys in which it
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
    return read_layered(Scenario, STUDY, "nominal" if config is None else config, overrides, option)
