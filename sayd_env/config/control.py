"""Schemas of the controllers and of the on-line filter that they and the reward share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from sayd_env.config.base import Model, Number, Part, Provenance, Share, quantity
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import Origin, nearest, shown
from sayd_env.config.layers import Kind, layered, read_layered
from sayd_env.config.loader import is_path, validate
from sayd_env.config.reward import MeanName

CONTROL = Kind("control", names=("study",))


class OnlineConfig(Model):
    """The on-line band-pass filter: how it finds and follows the dominant frequency f_0 while running.

    Band, filter order, range of f_0 and the distance behind it are those of the assessment.
    """

    start_frequency: float = quantity("Hz", "f_0 until the distance of one spectrum has been run", gt=0.0)
    frequency_step: float = quantity("Hz", "step of the grid of f_0", ge=1e-3)
    block: float = quantity("s", "the spectrum is that of the means over this time, or of samples", gt=0.0)
    settling: float = quantity(
        "s", "kept signal that a filter with a new band runs over first", gt=0.0, le=60.0
    )


def load_online(name: str = "online", overrides: Iterable[str] = ()) -> OnlineConfig:
    """Read the settings of the on-line filter.

    Parameters
    ----------
    name : str
        A packaged configuration (``online``) or a path to a YAML file.
    overrides : iterable of str
        ``key=value`` assignments.

    Raises
    ------
    ConfigError
        The file, a key or a value cannot be used.
    """
    return read_layered(OnlineConfig, CONTROL, name, overrides)


class PassiveControlConfig(Model):
    """Passive dampers: nothing to control, no parameters."""


class ConstantConfig(Part):
    """A constant valve command."""

    current: float = quantity("-", "Valve command V of every damper: 0 closed, 1 open", ge=0.0, le=1.0)


class BogieCostConfig(Part):
    """What a controller measures on its bogie of J, eq. (27)."""

    k_y: float = quantity("-", "k_y of eq. (27), weight of the acceleration", ge=0.0)
    k_F: float = quantity("-", "k_F of eq. (27), weight of the force; 0: no pressure is read", ge=0.0)
    accelerometer: Literal["leading", "trailing"] = Field(
        description="Wheelset above which the bogie frame's lateral acceleration is measured"
    )
    damper: Literal["left.upper", "left.lower", "right.upper", "right.lower"] = Field(
        description="The bogie's damper whose pressures are measured"
    )
    slowest: float = quantity(
        "m/s", "Speed below which the spectrum behind f_0 covers less than its distance", ge=1.0
    )


class ExtremumConfig(BogieCostConfig):
    """Range and start of the command of a controller that seeks the smallest J."""

    v_min: float = quantity("-", "V_min, smallest valve command", ge=0.0, le=1.0)
    initial: float | None = quantity(
        "-", "Valve command of the first second; null: the fed-back current at the start", ge=0.0, le=1.0
    )


class MpptConfig(ExtremumConfig):
    """The paper's MPPT, eq. (27) to (31)."""

    k_J: float = quantity("-", "k_J of eq. (29), gain on the relative rise of J", ge=0.0, le=1.0)
    delta_v_down: float = quantity("-", "Delta V of eq. (30), closing step", ge=0.0, le=1.0)
    delta_v_up: float = quantity("-", "Delta V of eq. (31), opening step", ge=0.0, le=1.0)
    threshold_max: float = quantity("m/s2", "RMS above which eq. (30) closes the valve", gt=0.0)
    threshold_min: float = quantity("m/s2", "RMS below which eq. (31) opens the valve; 0: never", ge=0.0)

    @model_validator(mode="after")
    def _thresholds_in_order(self) -> Self:
        if self.threshold_min > self.threshold_max:
            raise ValueError(
                f"threshold_min {self.threshold_min:g} m/s2 must not exceed "
                f"threshold_max {self.threshold_max:g} m/s2"
            )
        return self


class PerturbObserveConfig(ExtremumConfig):
    """Perturb and observe: step the command, observe J, reverse where it rises."""

    step: float = quantity("-", "Change of the valve command in a second", gt=0.0, le=1.0)
    first_move: Literal["close", "open"] = Field(description="Direction of the first change")


class SkyhookConfig(Part):
    """On-off and continuous skyhook, eq. (32) to (38), with the estimator that they share."""

    closed: float = quantity("-", "Valve command for c_max", ge=0.0, le=1.0)
    open: float = quantity("-", "Valve command for c_min", ge=0.0, le=1.0)
    corner: float = quantity("Hz", "Corner of the high-pass that keeps the velocity from drifting", gt=0.0)
    rate_corner: float | None = quantity(
        "Hz", "Corner of the low-pass on the stroke rate; null: none", gt=0.0
    )
    dead_band: float = quantity(
        "m/s", "Velocity below which bogie or stroke count as standing and the command stays", ge=0.0
    )

    @model_validator(mode="after")
    def _limits_in_order(self) -> Self:
        if self.closed >= self.open:
            raise ValueError(f"closed {self.closed:g} must be below open {self.open:g}")
        return self


class _OverSpeed(Model):
    """A table over speed."""

    speeds_kmh: tuple[Number, ...] = Field(
        min_length=1,
        description="Rising speeds of the table (km/h); beyond its ends the outer values stay",
    )
    commands: tuple[Share, ...] = Field(description="Valve command V at each of them (-)")

    def _columns(self) -> dict[str, tuple[float, ...]]:
        return {"commands": self.commands}

    @model_validator(mode="after")
    def _one_for_each_speed(self) -> Self:
        if any(a >= b for a, b in pairwise(self.speeds_kmh)):
            raise ValueError("speeds_kmh must rise")
        for name, values in self._columns().items():
            if len(values) != len(self.speeds_kmh):
                raise ValueError(f"{name}: found {len(values)} values for {len(self.speeds_kmh)} speeds")
        return self


class SpeedScheduleConfig(Part, _OverSpeed):
    """A valve command over speed, linear between the speeds of a table."""


class HuntingScheduleConfig(BogieCostConfig, _OverSpeed):
    """A valve command over speed, corrected by what a bogie's hunting weighs beside its dampers' force."""

    balances: tuple[Number, ...] = Field(
        description="Wanted logarithm of (k_y psi_y^2 / y_lim^2) / (k_F psi_F^2 / F_max^2) at each speed (-)"
    )
    gain: float = quantity(
        "-", "Closing of the valve in a second for a balance too high by 1", ge=0.0, le=1.0
    )
    v_min: float = quantity("-", "Smallest valve command", ge=0.0, le=1.0)
    v_max: float = quantity("-", "Largest valve command", ge=0.0, le=1.0)

    def _columns(self) -> dict[str, tuple[float, ...]]:
        return {**super()._columns(), "balances": self.balances}

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.v_min >= self.v_max:
            raise ValueError(f"v_min {self.v_min:g} must be below v_max {self.v_max:g}")
        if self.k_y == 0.0 or self.k_F == 0.0:
            raise ValueError("k_y and k_F must be positive: the command follows the ratio of their parts")
        return self


class LqgConfig(Part):
    """LQG on the linearised vehicle, clipped to what the dampers can do."""

    study: str = Field(min_length=1, description="Vehicle that is linearised: a packaged study, or a path")
    speeds_kmh: tuple[Annotated[Number, Field(gt=0.0)], ...] = Field(
        min_length=1,
        description="Rising speeds of the designs (km/h), between which wanted forces are blended",
    )
    stroke_speed: float = quantity("m/s", "RMS of the stroke rate at which dampers are linearised", gt=0.0)
    shifts: tuple[Annotated[Number, Field(gt=0.0)], ...] = Field(
        min_length=1,
        description="RMS of the wheelsets' shift at which contact is linearised (m): the first with a stable "
        "vehicle",
    )
    corner: float = quantity("Hz", "From which the irregularities' density falls with f^2", gt=0.0)
    states: int = quantity("-", "States of the reduced vehicle", ge=2, le=200)
    force_weight: float = quantity("-", "k_F of the cost that the regulator minimises, at k_y = 1", ge=0.0)
    force_penalty: float = quantity("-", "Weight of the force added to a closed damper's, over F_max", gt=0.0)
    noise: float = quantity("-", "Errors of the sensors, over the RMS of what they read", gt=0.0)
    widest: float = quantity("-", "Largest valve command", gt=0.0, le=1.0)

    @model_validator(mode="after")
    def _rising(self) -> Self:
        if any(a >= b for a, b in pairwise(self.speeds_kmh)):
            raise ValueError("speeds_kmh must rise")
        return self


class TunedProvenance(Provenance):
    """Where the gains of a tuned controller come from."""

    command: str = Field(min_length=1, description="Command that found them")
    scenarios: str = Field(min_length=1, description="Scenarios on which they were assessed")
    evaluations: int = quantity("-", "Sets of gains that were tried", ge=1)
    simulated_s: float | None = quantity("s", "Time that they were simulated", default=None, gt=0.0)
    mean: MeanName = Field("arithmetic", description="Which mean of J was small")
    J_before: float = quantity("-", "Mean J of the controller that was tuned", gt=0.0)
    J_after: float = quantity("-", "Mean J with these gains", gt=0.0)
    commit: str | None = Field(description="State of the software, git; null: unknown")


class TunedConstantConfig(ConstantConfig):
    """The best constant valve command for all conditions."""

    provenance: TunedProvenance


class TunedMpptConfig(MpptConfig):
    """MPPT with the gains of the smallest J."""

    provenance: TunedProvenance


class TunedSpeedScheduleConfig(SpeedScheduleConfig):
    """The best table over speed."""

    provenance: TunedProvenance


class TunedHuntingScheduleConfig(HuntingScheduleConfig):
    """The best table over speed with its best correction."""

    provenance: TunedProvenance


class TunedLqgConfig(LqgConfig):
    """LQG with the weights of the smallest J."""

    provenance: TunedProvenance


ControllerConfig = (
    PassiveControlConfig
    | ConstantConfig
    | MpptConfig
    | PerturbObserveConfig
    | SkyhookConfig
    | SpeedScheduleConfig
    | HuntingScheduleConfig
    | LqgConfig
)

CONTROLLERS: dict[str, type[ControllerConfig]] = {
    "passive": PassiveControlConfig,
    "constant": ConstantConfig,
    "mppt1": MpptConfig,
    "mppt2": MpptConfig,
    "perturb-and-observe": PerturbObserveConfig,
    "skyhook-onoff": SkyhookConfig,
    "skyhook-continuous": SkyhookConfig,
    "mppt2-tuned": TunedMpptConfig,
    "constant-tuned": TunedConstantConfig,
    "speed-schedule": SpeedScheduleConfig,
    "speed-schedule-tuned": TunedSpeedScheduleConfig,
    "hunting-schedule": HuntingScheduleConfig,
    "hunting-schedule-tuned": TunedHuntingScheduleConfig,
    "lqg": LqgConfig,
    "lqg-tuned": TunedLqgConfig,
    "mppt1-estimate": MpptConfig,
    "mppt2-estimate": MpptConfig,
}
"""Schema of each controller's parameters."""


def controller_of(name_or_path: str) -> str:
    """Name of a controller: that of a file of parameters is the file's without its ending.

    Raises
    ------
    ConfigError
        There is no such controller.
    """
    name = Path(name_or_path).stem if is_path(name_or_path) else name_or_path
    if name not in CONTROLLERS:
        hint = "" if name == name_or_path else f"{name_or_path}: a file is named after its controller; "
        raise ConfigError(
            f"{hint}unknown controller {shown(name)}{nearest(str(name), CONTROLLERS)}; "
            f"available: {', '.join(CONTROLLERS)}"
        )
    return name


def load_controller(name: str, parameters: Mapping[str, Any] | None = None) -> ControllerConfig:
    """Read the parameters of a controller from configs/control, or from a user's file.

    Parameters
    ----------
    name : str
        One of `CONTROLLERS`, or the path of a YAML file that is named after one: ``own/mppt2.yaml``.
    parameters : mapping, optional
        Values that replace those of the file; ``commands.2`` is the third one of a list.

    Raises
    ------
    ConfigError
        Unknown name or parameter, or a value that cannot be used.
    """
    controller = controller_of(name)
    given = dict(parameters or {})
    if controller == "passive":
        if given or controller != name:
            raise ConfigError(f"controller 'passive': has no parameters, found {', '.join(given) or name}")
        return PassiveControlConfig()
    draft = layered(CONTROL, name)
    origins = (*draft.origins, *(Origin((key,), f"controller '{controller}'") for key in given))
    return validate(CONTROLLERS[controller], _replaced(draft.data, given), draft.source, origins)


def gains_of(config: ControllerConfig) -> dict[str, Any]:
    """Parameters of a controller by name, those of lists one by one: ``commands.2``."""
    found: dict[str, Any] = {}
    for name, value in config.model_dump().items():
        found |= {f"{name}.{k}": each for k, each in enumerate(value)} if isinstance(value, tuple) else {}
        found[name] = value
    return found


def _replaced(data: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Data of a file with other values; those of a list are replaced in it."""
    found = dict(data)
    for name, value in given.items():
        key, dot, place = name.partition(".")
        values = found.get(key)
        if not dot or not isinstance(values, list | tuple) or not place.isdecimal():
            found[name] = value
        elif int(place) >= len(values):
            raise ConfigError(f"'{name}': the list '{key}' has {len(values)} values")
        else:
            found[key] = [*values[: int(place)], value, *values[int(place) + 1 :]]
    return found
