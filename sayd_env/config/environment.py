"""What an environment is, as data: vehicle, sensors, clock, ending, and what an episode draws."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from sayd_env.config.base import Model, is_multiple, quantity
from sayd_env.config.distribution import Distribution
from sayd_env.config.errors import ConfigError
from sayd_env.config.explain import nearest
from sayd_env.config.fault import FaultsConfig
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.limits import within
from sayd_env.config.lines import LINES, LinesConfig
from sayd_env.config.profile import load_wheel
from sayd_env.config.scenario import CostConfig
from sayd_env.config.sensors import SAMPLE, SENSORS, SensorsConfig
from sayd_env.config.track import TrackClass

ENVIRONMENT = Kind(
    "env",
    parts={"sensors": SENSORS, "lines": LINES},
    names=("study", "line", "randomisation.tracks.*.name", "randomisation.profiles.*.name"),
    base="nominal",
    optional=("lines",),
)
PERIODS = tuple(n for n in range(1, 1001) if 1000 % n == 0)
"""Control periods that divide a second (ms)."""


LONGEST_HISTORY = 1000
"""Vectors in an observation."""


def whole_period(period: float) -> float:
    """A control period that is a whole number of milliseconds and divides a second.

    Raises
    ------
    ValueError
        It is another one.
    """
    if not (is_multiple(period, SAMPLE) and 1000 % round(period / SAMPLE) == 0):
        raise ValueError(
            "expected a whole number of milliseconds that divides a second: "
            f"{', '.join(map(str, PERIODS))} ms"
        )
    return period


TOLERANT = ("vehicle", "track", "contact_damping", "sayd", "passive")
"""First parts of keys that tolerances may scale: sections of a scenario, or one of its kinds of damper."""


class ProfileClass(Model):
    """A wheel profile that an episode may have."""

    name: str | None = Field(
        None,
        min_length=1,
        description="Name of a wheel profile, or a path to its YAML file; null: the study's",
    )
    weight: float = quantity("-", "Relative frequency", default=1.0, ge=0.0, le=1e9)
    shift: float | None = quantity(
        "m",
        "Outward shift of the curve in place of the profile's own; null: its own",
        default=None,
        ge=-0.01,
        le=0.01,
    )

    @model_validator(mode="after")
    def _known(self) -> ProfileClass:
        if self.name is not None:
            try:
                load_wheel(self.name)
            except ConfigError as error:
                raise ValueError(f"name: {error}") from None
        return self


class ToleranceConfig(Model):
    """Numbers of the scenario that a factor scales together."""

    keys: tuple[str, ...] = Field(
        min_length=1,
        description="Dotted keys of the scenario; sayd. and passive. name the damper, where it is of "
        "this type. Lists are scaled as a whole, curves in their ordinates",
    )
    factor: Distribution = Field(description="The factor (-)")

    @field_validator("keys")
    @classmethod
    def _begins_well(cls, keys: tuple[str, ...]) -> tuple[str, ...]:
        for key in keys:
            first = key.partition(".")[0]
            if first not in TOLERANT:
                raise ValueError(
                    f"key '{key}' begins with '{first}'{nearest(first, TOLERANT)}; allowed are "
                    f"{', '.join(TOLERANT)}"
                )
        return keys

    @field_validator("factor")
    @classmethod
    def _moderate(cls, distribution: Distribution) -> Distribution:
        return within(distribution, "factor")


OF_THE_SCENARIO = ("wear", "profiles", "gauge", "friction", "tracks")
"""What an episode has from its scenario unless it draws it."""


def fixed_by(keys: Iterable[str]) -> set[str]:
    """Those of `OF_THE_SCENARIO` that assignments to keys of a scenario set."""
    found = set()
    for key in keys:
        first = key.partition(".")[0]
        if key in ("wear", "friction"):
            found.add(key)
        if first == "wheel":
            found.add("profiles")
        if key in ("track", "track.gauge"):
            found.add("gauge")
        if key == "track" or key.startswith("track.irregularity"):
            found.add("tracks")
    return found


def _covers(assigned: str, key: str) -> bool:
    """Whether an assignment settles the number of a tolerance. A part that is named keeps its tolerances."""
    if "." not in assigned:
        return False
    return f"{key}.".startswith(f"{assigned}.") or f"{assigned}.".startswith(f"{key}.")


class RandomisationConfig(Model):
    """The distributions of what an episode draws."""

    speed_kmh: Distribution = Field(description="Speed (km/h)")
    wear: Distribution | None = Field(description="Wear of the treads, 0 new, 1 worn (-); null: the study's")
    friction: Distribution | None = Field(description="Coefficient of friction (-); null: the study's")
    gauge: Distribution | None = Field(None, description="Track gauge (m); null: the study's")
    payload: Distribution = Field(
        description="Change of the carbody's mass and inertia, as a share of it (-)"
    )
    initial_current: Distribution = Field(description="Valve command during the run-in (-)")
    sensor_bias: Distribution = Field(description="Error of each sensor, as a share of its bias_spread (-)")
    sensor_noise: Distribution = Field(description="Factor on the noise of each sensor (-)")
    tracks: tuple[TrackClass, ...] = Field((), description="Classes of track; none: the study's track")
    profiles: tuple[ProfileClass, ...] = Field(
        (), description="Wheel profiles; none: the study's. One that does not wear is new whatever `wear` is"
    )
    tolerances: dict[str, ToleranceConfig] = Field({}, description="Groups of numbers that vary together")

    @field_validator(
        *("speed_kmh", "wear", "friction", "gauge", "payload", "initial_current"),
        *("sensor_bias", "sensor_noise"),
    )
    @classmethod
    def _allowed(cls, distribution: Distribution | None, info: ValidationInfo) -> Distribution | None:
        return None if distribution is None else within(distribution, str(info.field_name))

    @field_validator("tracks", "profiles")
    @classmethod
    def _some_weight(cls, classes: tuple[Any, ...]) -> tuple[Any, ...]:
        if classes and sum(each.weight for each in classes) == 0.0:
            raise ValueError("at least one weight must be positive")
        return classes

    @field_validator("tolerances")
    @classmethod
    def _once(cls, groups: dict[str, ToleranceConfig]) -> dict[str, ToleranceConfig]:
        owner: dict[str, str] = {}
        for name, group in groups.items():
            for key in group.keys:
                if key in owner:
                    raise ValueError(f"key '{key}' is in two groups, '{owner[key]}' and '{name}'")
                owner[key] = name
        return groups

    def without_keys(self, keys: Iterable[str], damper: str) -> RandomisationConfig:
        """The same without what assignments to keys of a scenario set, whose damper is of this type."""
        own = [
            f"{damper}.{key.removeprefix('damper.')}" if key.startswith("damper.") else key for key in keys
        ]
        left = {
            name: group.model_copy(update={"keys": kept})
            for name, group in self.tolerances.items()
            if (kept := tuple(key for key in group.keys if not any(_covers(each, key) for each in own)))
        }
        return self.without(fixed_by(own)).model_copy(update={"tolerances": left})

    def without(self, names: Iterable[str] = OF_THE_SCENARIO) -> RandomisationConfig:
        """The same, but some of `OF_THE_SCENARIO` are not drawn."""
        return self.model_copy(
            update={name: () if name in ("profiles", "tracks") else None for name in names}
        )


class DerailmentConfig(Model):
    """When a run is about to derail (a wheel that leaves the contact table has derailed)."""

    quotient: float = quantity("-", "Y/Q of a wheel, sliding mean, at which a run ends", gt=0.0, le=5.0)
    safe_quotient: float = quantity("-", "Limit of the same for safety", gt=0.0, le=5.0)
    averaging: float = quantity(
        "m", "Distance of the sliding means of Y/Q and of the track shift force", gt=0.0, le=100.0
    )


class EnvironmentConfig(Model):
    """An environment: everything but the seed."""

    description: str = ""
    study: str = Field(min_length=1, description="Scenario: name of a packaged study, or a path")
    damper: Literal["sayd", "passive"] = Field(description="Kind of the vehicle's yaw dampers")
    sensors: SensorsConfig
    control_period: float = quantity("s", "Time for which a command holds", gt=0.0, le=1.0)
    episode_s: float = quantity("s", "Time at which an episode is truncated", gt=0.0, le=86400.0)
    run_in: float = quantity("m", "Distance before step 0, with the initial current", ge=0.0, le=10e3)
    valves: Literal["bogie", "damper", "vehicle"] = Field(description="Which valves a command goes to")
    observation: Literal["signals", "history", "features"] = Field(description="What an observation is")
    history: int = quantity("-", "Vectors in an observation of type 'history'", ge=1, le=LONGEST_HISTORY)
    derailment: DerailmentConfig
    termination_cost: float = quantity(
        "-", "J_term, charged for each remaining second, at the weights k_y = 1 and k_F = 0.5", ge=0.0
    )
    randomisation: RandomisationConfig
    line: str | None = Field(
        None, min_length=1, description="Line of every episode: a name or a path; null: straight, or drawn"
    )
    lines: LinesConfig | None = Field(
        None, description="What the lines of episodes are drawn from; null: none"
    )
    faults: FaultsConfig | None = Field(None, description="Faults; null: none")

    @field_validator("control_period")
    @classmethod
    def _divides_a_second(cls, period: float) -> float:
        return whole_period(period)

    @model_validator(mode="after")
    def _one_line(self) -> EnvironmentConfig:
        if self.line is not None and self.lines is not None:
            raise ValueError("line and lines exclude each other: set one of them to null")
        return self

    @model_validator(mode="after")
    def _whole_periods(self) -> EnvironmentConfig:
        if not is_multiple(self.episode_s, self.control_period):
            raise ValueError(
                f"episode_s ({self.episode_s:g} s) must be a multiple of control_period "
                f"({self.control_period:g} s)"
            )
        return self


def charge_a_second(config: EnvironmentConfig, cost: CostConfig) -> float:
    """J_term at a cost's own weights: no smaller a share of J than at those of its configuration."""
    return config.termination_cost * max(cost.acceleration_weight, 2.0 * cost.force_weight)


def load_environment(name: str = "nominal", overrides: Iterable[str] = ()) -> EnvironmentConfig:
    """Read an environment.

    Parameters
    ----------
    name : str
        A packaged environment (``nominal``, ``randomized``, ``faults``) or a path to a YAML file. A file
        needs only the keys in which it differs from its ``base`` (``nominal`` unless it names another, or
        null); a distribution or a list replaces the base's as a whole. Paths in it are relative to it.
    overrides : iterable of str
        ``key=value`` assignments, applied last, for example ``control_period=0.02`` or ``sensors=realistic``.

    Raises
    ------
    ConfigError
        A file, key or value that cannot be used; the message names it and what is allowed.
    """
    return read_layered(EnvironmentConfig, ENVIRONMENT, name, overrides)
