"""Runs of a comparison: the same conditions for every policy, each run kept with the parts of its J."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import cycle, islice, product
from typing import Literal, NamedTuple

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.comparison import ComparedLines, ComparedTrack, ComparedWheels, ComparisonConfig
from sayd_env.config.conditions import Line
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.reward import reported_costs
from sayd_env.config.scenario import CostConfig, Scenario, load_scenario
from sayd_env.config.track import IrregularityConfig
from sayd_env.config.units import KMH, Array
from sayd_env.envs.cost import charged
from sayd_env.envs.draw import draw_episode
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.along import Trip, judged_along
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import RATIOS, Row, rows
from sayd_env.runs.policies import PolicySpec, for_policy
from sayd_env.runs.rollouts import Run, environment_of

Filter = Literal["online", "offline"]
FILTERS: tuple[Filter, ...] = ("online", "offline")
STATIONARY, LINES, TOGETHER = "stationary", "lines", "together"
"""Parts of a comparison: straight track under conditions that do not change, lines, and both."""


class Condition(NamedTuple):
    """What scenarios have in common that differ in their seed alone; None: as the line has it."""

    wheels: ComparedWheels
    track: ComparedTrack | None = None
    speed_kmh: float | None = None
    friction: float | None = None
    line: int | None = None
    """Seed of the line; None: straight track, and nothing changes along it."""

    @property
    def text(self) -> str:
        """In words."""
        if self.line is not None:
            return f"line {self.line}, {self.wheels.name} wheels"
        assert self.track is not None  # of straight track
        scale = "" if self.track.scale is None else f" x {self.track.scale:g}"
        return (
            f"{self.speed_kmh:g} km/h, {self.wheels.name} wheels, friction {self.friction:g}, "
            f"{self.track.name}{scale}"
        )

    def as_dict(self) -> dict[str, object]:
        """Keys of a scenario in the result."""
        return {
            "line": self.line,
            "track": None if self.track is None else self.track.name,
            "track_scale": None if self.track is None else self.track.scale,
            "speed_kmh": self.speed_kmh,
            "wheels": self.wheels.name,
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

AVERAGED = ("force_rms_n", "comfort", "valve_mean", "valve_travel_per_km", "switching_per_s")
MEASURED = ("J_acceleration", "J_force", "J_offline_acceleration", "J_offline_force", *RATIOS, *AVERAGED)
"""Fields of a `Row` that a comparison reads."""
Runs = Mapping[str, Array]
"""`MEASURED` by name, over conditions and seeds: shape (C, S); NaN where nothing is measured, infinite
where the run derailed. ``lost`` is the share of the episode that a derailment has cut off, ``offline_lost``
that of the assessed length."""


@dataclass(frozen=True)
class DrawnLines:
    """Lines of a comparison, and what their episodes stand on."""

    environment: EnvironmentConfig
    """With the comparison's tracks."""
    lines: Mapping[int, Line]
    """By seed."""

    @classmethod
    def of(cls, config: ComparedLines) -> DrawnLines:
        """Draw the lines of a comparison.

        Raises
        ------
        ConfigError
            An environment that draws no lines, or a line that is not allowed.
        """
        environment = load_environment(config.environment)
        if environment.lines is None:
            raise ConfigError(f"lines.environment: '{config.environment}' draws no lines")
        lines = environment.lines.model_copy(update={"tracks": config.tracks})
        environment = environment.model_copy(update={"lines": lines})
        drawn = {seed: draw_episode(environment, seed, 0).line for seed in config.seeds}
        return cls(environment, {seed: line for seed, line in drawn.items() if isinstance(line, Line)})

    def check_length(self, seed: int, shortest: float) -> None:
        """Refuse a line of which an episode runs over less than a length (m).

        Raises
        ------
        ConfigError
            The line of the seed is one.
        """
        line, time = self.lines[seed], self.environment.episode_s
        found = float(Trip(line, _first_speed(line)).distance(time))
        if found < shortest:
            raise ConfigError(
                f"lines: the line of seed {seed} is {found:.0f} m long after {time:g} s; "
                f"expected {shortest:g} m or more, one segment of the spectrum"
            )


@dataclass(frozen=True)
class ScenarioGrid:
    """The conditions of a comparison, and what they stand on."""

    config: ComparisonConfig
    environment: EnvironmentConfig
    scenario: Scenario
    """The environment's study at the assessed length."""
    conditions: tuple[Condition, ...]
    """Straight track first, then the lines."""
    irregularities: tuple[IrregularityConfig, ...]
    """Of each track."""
    drawn: DrawnLines | None = None

    @classmethod
    def of(cls, config: ComparisonConfig) -> ScenarioGrid:
        """Conditions of a comparison.

        Raises
        ------
        ConfigError
            An unknown environment or study, a length below one spectrum or the environment's episode, a speed
            outside the vehicle's range, or an environment that draws no lines.
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
        spans = product(config.wheels, config.tracks, config.speeds_kmh, config.friction)
        conditions = [Condition(*each) for each in spans]
        drawn = None if config.lines is None else DrawnLines.of(config.lines)
        if drawn is not None:
            model, wheels = VehicleModel(scenario), cycle(config.wheels)
            for seed, line in drawn.lines.items():
                for speed in (line.slowest, line.fastest):
                    model.check_speed(_first_speed(line) if speed is None else speed)
                drawn.check_length(seed, scenario.assessment.segment_length)
            conditions += [Condition(next(wheels), line=seed) for seed in drawn.lines]
        tracks = tuple(track.irregularity for track in config.tracks)
        return cls(config, environment, scenario, tuple(conditions), tracks, drawn)

    @property
    def parts(self) -> Mapping[str, slice]:
        """Conditions of straight track and those of lines, by name; one alone has no parts."""
        straight = sum(each.line is None for each in self.conditions)
        if straight == len(self.conditions):
            return {}
        return {STATIONARY: slice(0, straight), LINES: slice(straight, None)}

    def runs(self, policy: PolicySpec) -> tuple[list[Run], list[Run]]:
        """Runs of a policy on straight track and along lines: condition by condition, seed by seed."""
        fitted = for_policy(self.scenario, policy)
        environment = environment_of(fitted, self.environment)
        along = environment if self.drawn is None else environment_of(fitted, self.drawn.environment)
        on_wheels = {each.name: each.under(fitted) for each in self.config.wheels}

        @cache
        def scenario(wheels: str, number: int, friction: float) -> Scenario:
            base = on_wheels[wheels]
            track = base.track.model_copy(update={"irregularity": self.irregularities[number]})
            return base.model_copy(update={"track": track, "friction": friction})

        straight: list[Run] = []
        lines: list[Run] = []
        for each in self.conditions:
            for seed in self.config.seeds:
                name, rest = each.wheels.name, (seed, self.config.initial_current)
                if each.line is not None:
                    assert self.drawn is not None  # the line is one of it
                    line = self.drawn.lines[each.line]
                    lines.append(Run(policy, on_wheels[name], along, _first_speed(line), *rest, line))
                    continue
                assert each.track is not None  # of straight track
                assert each.speed_kmh is not None
                assert each.friction is not None
                place = self.config.tracks.index(each.track)
                made = scenario(name, place, each.friction)
                straight.append(Run(policy, made, environment, each.speed_kmh / KMH, *rest))
        return straight, lines

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
    straight, lines = ([run for runs in each for run in runs[k]] for k in (0, 1))
    total, before = len(straight) + len(lines), float(len(straight))
    on_straight = iter(rows(straight, context.part(0.0, total, what), what))
    along = context.part(before, total, f"{what}, lines")
    on_lines = iter(rows(lines, along, what, judged_along) if lines else ())
    return {
        policy.title: _arrays(grid, [*islice(on_straight, len(one)), *islice(on_lines, len(other))])
        for policy, (one, other) in zip(policies, each, strict=True)
    }


def _first_speed(line: Line) -> float:
    """Speed (m/s) with which a drawn line begins; one without is refused."""
    found = line.speed_at(0.0)
    if found is None:
        raise ConfigError("lines.environment: its lines leave the speed out; expected some with speed_kmh")
    return float(found)


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
    episode = grid.environment.episode_s
    along = episode if grid.drawn is None else grid.drawn.environment.episode_s
    straight = sum(each.line is None for each in grid.conditions) * len(grid.config.seeds)
    one, other = found[:straight], found[straight:]
    whole = [row.lost(along) for row in other]
    return {
        **{name: table(getattr(row, name) for row in found) for name in MEASURED},
        "lost": table([*(row.lost(episode) for row in one), *whole]),
        "offline_lost": table([*(row.lost(length / row.speed_kmh * KMH) for row in one), *whole]),
    }
