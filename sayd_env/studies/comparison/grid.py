"""Runs of a comparison: the same conditions for every policy, each run kept with the parts of its J."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError
from sayd_env.config.comparison import ComparedTrack, ComparisonConfig
from sayd_env.config.environment import EnvironmentConfig, charge_a_second, load_environment
from sayd_env.config.scenario import CostConfig, Scenario, load_scenario
from sayd_env.config.track import IrregularityConfig
from sayd_env.envs.rollout import Rollout
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.files import Progress, silent
from sayd_env.runs.cache import RunStore
from sayd_env.runs.kept import (
    CONSTANT,
    constant_command,
    identity,
    identity_of_constants,
    run_kept,
)
from sayd_env.runs.metrics import policy_row
from sayd_env.runs.passive import run_name
from sayd_env.runs.policies import PolicySpec, for_policy
from sayd_env.runs.rollouts import Group
from sayd_env.studies.evaluate import environment_of

Array = npt.NDArray[np.float64]
Filter = Literal["online", "offline"]
FILTERS: tuple[Filter, ...] = ("online", "offline")
KMH = 3.6


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


@dataclass(frozen=True)
class CompareRun:
    """What is kept of a run; NaN where there is nothing to measure, infinite where the run derailed."""

    acceleration: float
    """(psi_y / y_lim)^2 over the episode of the environment, on-line filter."""
    force: float
    """(psi_F / F_max)^2 of this."""
    lost: float
    """Share of the episode that a derailment has cut off."""
    offline_lost: float
    """Share of the assessed length that it has cut off."""
    offline_acceleration: float
    """(psi_y / y_lim)^2 over the assessed length, off-line filter."""
    offline_force: float
    """(psi_F / F_max)^2 of this."""
    acceleration_ratio: float
    """Largest over the limit of EN 14363."""
    track_shift_ratio: float
    """The same of the track shift force."""
    force_rms_n: float
    comfort: float
    valve_mean: float
    valve_travel_per_km: float
    switching_per_s: float


Runs = Mapping[str, Array]
"""Fields of `CompareRun` by name, over conditions and seeds: shape (C, S)."""


@dataclass(frozen=True)
class Arena:
    """The conditions of a comparison, and what they stand on.

    Attributes
    ----------
    config : ComparisonConfig
    environment : EnvironmentConfig
    scenario : Scenario
        The environment's study at the assessed length.
    conditions : tuple of Condition
    irregularities : tuple of IrregularityConfig
        Of each track.
    """

    config: ComparisonConfig
    environment: EnvironmentConfig
    scenario: Scenario
    conditions: tuple[Condition, ...]
    irregularities: tuple[IrregularityConfig, ...]

    @classmethod
    def of(cls, config: ComparisonConfig) -> Arena:
        """Arena of a comparison.

        Raises
        ------
        ConfigError
            An unknown environment or study, a length below one spectrum or the environment's episode, a speed
            outside the vehicle's range.
        """
        environment = load_environment(config.environment)
        _check_episode(config, environment)
        length = f"assessment.length={config.length!r}"
        scenario = load_scenario(environment.study, [length], option="length")
        model = VehicleModel(scenario)
        for kmh in config.speeds_kmh:
            model.check_speed(kmh / KMH)
        spans = product(config.tracks, config.speeds_kmh, config.wear, config.friction)
        conditions = tuple(Condition(*each) for each in spans)
        return cls(config, environment, scenario, conditions, tuple(t.irregularity for t in config.tracks))

    def groups(self, policy: PolicySpec) -> list[Group]:
        """Runs of a policy: one group for each condition."""
        fitted = for_policy(self.scenario, policy)
        environment = environment_of(fitted, self.environment)
        scenarios: dict[tuple[int, float, float], Scenario] = {}
        groups = []
        for condition in self.conditions:
            number = self.config.tracks.index(condition.track)
            key = (number, condition.wear, condition.friction)
            if key not in scenarios:
                track = fitted.track.model_copy(update={"irregularity": self.irregularities[number]})
                changes = {"track": track, "wear": condition.wear, "friction": condition.friction}
                scenarios[key] = fitted.model_copy(update=changes)
            groups.append(
                Group(
                    policy,
                    scenarios[key],
                    environment,
                    condition.speed_kmh / KMH,
                    self.config.seeds,
                    self.config.initial_current,
                )
            )
        return groups

    def costs(self, runs: Runs, variant: Variant) -> Array:
        """J of runs, charge for derailments included.

        A run that derailed has no assessed length: off line it counts with what it cost on line until then,
        and with the charge for the larger share that is missing, of the episode or of the length.

        Parameters
        ----------
        runs : mapping of ndarray
        variant : Variant
        """
        own = self.scenario.cost
        cost = own.model_copy(update={"force_weight": own.force_weight * variant.factor})
        charge = charge_a_second(self.environment, cost)
        online = _weighted(cost, runs["acceleration"], runs["force"])
        if variant.filter == "online":
            return online + charge * runs["lost"]
        offline = _weighted(cost, runs["offline_acceleration"], runs["offline_force"])
        charged = online + charge * np.maximum(runs["lost"], runs["offline_lost"])
        return np.where(np.isfinite(offline), offline, charged)


class Keeper:
    """Where finished runs are kept.

    Parameters
    ----------
    folder : Path, optional
        None keeps nothing.
    arena : Arena
    """

    def __init__(self, folder: Path | None, arena: Arena) -> None:
        self.folder, self.arena = folder, arena
        self._stores: dict[tuple[str, int], RunStore[CompareRun]] = {}

    def place(self, group: Group, seed: int) -> tuple[RunStore[CompareRun] | None, str]:
        """Store and name of a run; constant commands share a store, they stand in the names of the runs."""
        if self.folder is None:
            return None, ""
        command = constant_command(group.policy)
        title = group.policy.title if command is None else CONSTANT
        key = (title, self.arena.irregularities.index(group.scenario.track.irregularity))
        if key not in self._stores:
            scenario = group.scenario.model_copy(update={"wear": 0.0, "friction": 1.0})
            who = identity(group.policy) if command is None else identity_of_constants()
            self._stores[key] = RunStore(
                self.folder,
                f"compare-{title}-track-{key[1]}",
                CompareRun,
                scenario,
                group.config,
                who,
                group.initial_current,
            )
        current = "" if command is None else f"_V_{command:.9g}"
        where = f"wear_{group.scenario.wear:.9g}_friction_{group.scenario.friction:.9g}"
        return self._stores[key], f"{where}{current}_{run_name(group.speed, seed)}"

    def finish(self) -> int:
        """Forget what other inputs have left; return how many runs came from the disk."""
        for store in self._stores.values():
            store.forget_former()
        return sum(store.reused for store in self._stores.values())


def run_all(
    arena: Arena,
    policies: Sequence[PolicySpec],
    keeper: Keeper,
    *,
    workers: int | None = None,
    progress: Progress = silent,
) -> dict[str, Runs]:
    """Run policies in all conditions.

    Returns
    -------
    dict
        Runs by the policies' titles.

    Raises
    ------
    ConfigError
        A policy that does not fit, a folder that cannot be written to.
    StudyError
        A run that diverged.
    """
    groups = [(policy.title, group) for policy in policies for group in arena.groups(policy)]
    found = run_kept(
        [group for _, group in groups], compare_run, keeper.place, workers=workers, progress=progress
    )
    rows: dict[str, list[list[CompareRun]]] = {policy.title: [] for policy in policies}
    for (title, _), records in zip(groups, found, strict=True):
        rows[title].append(records)
    return {title: _arrays(records) for title, records in rows.items()}


def compare_run(group: Group, rollout: Rollout) -> CompareRun:
    """Judge a run.

    Raises
    ------
    StudyError
        The simulation diverged.
    """
    row = policy_row(group, rollout)
    return CompareRun(
        acceleration=row.J_acceleration,
        force=row.J_force,
        lost=_lost(rollout, group.config.episode_s),
        offline_lost=_lost(rollout, (group.scenario.assessment.length or 0.0) / group.speed),
        offline_acceleration=row.J_offline_acceleration,
        offline_force=row.J_offline_force,
        acceleration_ratio=row.acceleration_ratio,
        track_shift_ratio=row.track_shift_ratio,
        force_rms_n=row.force_rms_n,
        comfort=row.comfort,
        valve_mean=_number(row.valve_mean),
        valve_travel_per_km=_number(row.valve_travel_per_km),
        switching_per_s=_number(row.switching_per_s),
    )


def constant(current: float) -> PolicySpec:
    """The policy of one command for ever."""
    return PolicySpec(CONSTANT, {"current": current}, f"{CONSTANT}:{current:g}")


def variants(config: ComparisonConfig) -> tuple[Variant, ...]:
    """All ways in which J is taken."""
    return tuple(Variant(*each) for each in product(FILTERS, config.force_weights))


def _check_episode(config: ComparisonConfig, environment: EnvironmentConfig) -> None:
    """Refuse a length over which J on line would be taken over different times at different speeds."""
    fastest, episode = max(config.speeds_kmh), environment.episode_s
    if config.length < fastest / KMH * episode:
        raise ConfigError(
            f"length: {config.length:g} m are over before the {episode:g} s of an episode at {fastest:g} "
            f"km/h; expected {math.ceil(fastest / KMH * episode)} m or more"
        )


def _lost(rollout: Rollout, time: float) -> float:
    """Share of a time (s) from step 0 on that an early end has cut off."""
    if rollout.ending is None:
        return 0.0
    run = len(rollout.terms) * rollout.control_period
    return max(1.0 - run / time, 0.0)


def _arrays(records: Sequence[Sequence[CompareRun]]) -> Runs:
    return {
        field.name: np.array([[getattr(record, field.name) for record in line] for line in records])
        for field in fields(CompareRun)
    }


def _weighted(cost: CostConfig, acceleration: Array, force: Array) -> Array:
    return cost.acceleration_weight * acceleration + cost.force_weight * force


def _number(value: float | None) -> float:
    return math.nan if value is None else value
