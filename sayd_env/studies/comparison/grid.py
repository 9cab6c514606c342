"""Runs of a comparison: the same conditions for every policy, each run kept with the parts of its J."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import islice, product
from typing import Literal, NamedTuple

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.comparison import ComparedTrack, ComparisonConfig
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.reward import reported_costs
from sayd_env.config.scenario import CostConfig, Scenario, load_scenario
from sayd_env.config.track import IrregularityConfig
from sayd_env.config.units import KMH, Array
from sayd_env.envs.cost import charged
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import Row, rows
from sayd_env.runs.policies import PolicySpec, for_policy
from sayd_env.runs.rollouts import Run, environment_of

Filter = Literal["online", "offline"]
FILTERS: tuple[Filter, ...] = ("online", "offline")


class Condition(NamedTuple):
    """What scenarios have in common that differ in their seed alone."""

    track: ComparedTrack
    speed_kmh: float
    wear: float
    friction: float

    @property
    def text(self) -> str:
        """In words."""
        scale = "" if self.track.scale is None else f" x {self.track.scale:g}"
        return (
            f"{self.speed_kmh:g} km/h, wear {self.wear:g}, friction {self.friction:g}, "
            f"{self.track.name}{scale}"
        )

    def as_dict(self) -> dict[str, object]:
        """Keys of a scenario in the result."""
        return {
            "track": self.track.name,
            "track_scale": self.track.scale,
            "speed_kmh": self.speed_kmh,
            "wear": self.wear,
            "friction": self.friction,
        }


class Variant(NamedTuple):
    """How J is taken."""

    filter: Filter
    factor: float
    """On k_F."""


OWN = Variant("online", 1.0)
"""The environment's J, in MPPT2's weighting."""
OFFLINE = Variant("offline", 1.0)

RATIOS = ("acceleration_ratio", "track_shift_ratio")
AVERAGED = ("force_rms_n", "comfort", "valve_mean", "valve_travel_per_km", "switching_per_s")
MEASURED = ("J_acceleration", "J_force", "J_offline_acceleration", "J_offline_force", *RATIOS, *AVERAGED)
"""Fields of a `Row` that a comparison reads."""
Runs = Mapping[str, Array]
"""`MEASURED` by name, over conditions and seeds: shape (C, S); NaN where nothing is measured, infinite
where the run derailed. ``lost`` is the share of the episode that a derailment has cut off, ``offline_lost``
that of the assessed length."""


@dataclass(frozen=True)
class ScenarioGrid:
    """The conditions of a comparison, and what they stand on."""

    config: ComparisonConfig
    environment: EnvironmentConfig
    scenario: Scenario
    """The environment's study at the assessed length."""
    conditions: tuple[Condition, ...]
    irregularities: tuple[IrregularityConfig, ...]
    """Of each track."""

    @classmethod
    def of(cls, config: ComparisonConfig) -> ScenarioGrid:
        """Conditions of a comparison.

        Raises
        ------
        ConfigError
            An unknown environment or study, a length below one spectrum or the environment's episode, a speed
            outside the vehicle's range.
        """
        environment = load_environment(config.environment)
        fastest, episode = max(config.speeds_kmh) / KMH, environment.episode_s
        if config.length < fastest * episode:  # J on line would be taken over less time at higher speeds
            raise ConfigError(
                f"length: {config.length:g} m are over before the {episode:g} s of an episode at "
                f"{fastest * KMH:g} km/h; expected {math.ceil(fastest * episode)} m or more"
            )
        length = f"assessment.length={config.length!r}"
        scenario = checked_scenario(environment.study, length, "length", config.speeds_kmh)
        spans = product(config.tracks, config.speeds_kmh, config.wear, config.friction)
        conditions = tuple(Condition(*each) for each in spans)
        return cls(config, environment, scenario, conditions, tuple(t.irregularity for t in config.tracks))

    def runs(self, policy: PolicySpec) -> list[Run]:
        """Runs of a policy: condition by condition, seed by seed."""
        fitted = for_policy(self.scenario, policy)
        environment = environment_of(fitted, self.environment)

        @cache
        def scenario(number: int, wear: float, friction: float) -> Scenario:
            track = fitted.track.model_copy(update={"irregularity": self.irregularities[number]})
            return fitted.model_copy(update={"track": track, "wear": wear, "friction": friction})

        return [
            Run(
                policy,
                scenario(self.config.tracks.index(each.track), each.wear, each.friction),
                environment,
                each.speed_kmh / KMH,
                seed,
                self.config.initial_current,
            )
            for each in self.conditions
            for seed in self.config.seeds
        ]

    def costs(self, runs: Runs, variant: Variant) -> Array:
        """J of runs, charge for derailments included.

        A run that derailed has no assessed length: off line it counts with what it cost on line until then,
        and with the charge for the larger share that is missing, of the episode or of the length.
        """
        own = self.scenario.cost
        cost = own.model_copy(update={"force_weight": own.force_weight * variant.factor})
        online = partial(charged, self.environment, cost, runs["J_acceleration"], runs["J_force"])
        if variant.filter == "online":
            return online(runs["lost"])
        offline = runs["J_offline_acceleration"], runs["J_offline_force"]
        return np.where(
            np.isfinite(offline[0]),
            charged(self.environment, cost, *offline, 0.0),
            online(np.maximum(runs["lost"], runs["offline_lost"])),
        )

    @property
    def reported(self) -> dict[str, float]:
        """Factor on k_F that stands for each of the `REPORTED` weights but the study's own, by column."""

        def ratio(cost: CostConfig) -> float:
            return cost.force_weight / cost.acceleration_weight

        own = self.scenario.cost
        return {column: ratio(cost) / ratio(own) for column, cost in reported_costs(own).items()}

    @property
    def factors(self) -> tuple[float, ...]:
        """Factors on k_F for which J is taken."""
        return tuple(dict.fromkeys((*self.config.force_weights, *self.reported.values())))


def run_all(
    grid: ScenarioGrid, policies: Sequence[PolicySpec], context: RunContext, what: str
) -> dict[str, Runs]:
    """Run policies in all conditions, by title; `what` names them where progress is reported.

    Raises
    ------
    ConfigError
        A policy that does not fit.
    StudyError
        A run that diverged.
    """
    each = [grid.runs(policy) for policy in policies]
    found = iter(rows([run for runs in each for run in runs], context, what))
    return {
        policy.title: _arrays(grid, list(islice(found, len(runs))))
        for policy, runs in zip(policies, each, strict=True)
    }


def checked_scenario(study: str, assignment: str, option: str, speeds_kmh: Iterable[float]) -> Scenario:
    """A study with one assignment, which stands behind an option, and whose vehicle allows the speeds."""
    scenario = load_scenario(study, [assignment], option=option)
    model = VehicleModel(scenario)
    for kmh in speeds_kmh:
        model.check_speed(kmh / KMH)
    return scenario


def _arrays(grid: ScenarioGrid, found: Sequence[Row]) -> Runs:
    shape = (len(grid.conditions), len(grid.config.seeds))

    def table(values: Iterable[float | None]) -> Array:
        return np.array([math.nan if value is None else value for value in values]).reshape(shape)

    length = grid.scenario.assessment.length or 0.0
    return {
        **{name: table(getattr(row, name) for row in found) for name in MEASURED},
        "lost": table(row.lost(grid.environment.episode_s) for row in found),
        "offline_lost": table(row.lost(length / row.speed_kmh * KMH) for row in found),
    }
