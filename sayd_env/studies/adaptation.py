"""What is there to adapt to? The best constant command of each condition, and what one for all costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.map import MapCondition, MapConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.envs.cost import charged
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.throttle import overlap
from sayd_env.report.columns import PERCENT, Column, Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot, heat_maps
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import CostParts, cost_parts
from sayd_env.runs.policies import constant_spec, for_policy
from sayd_env.runs.rollouts import Run, environment_of

DIGITS = 6
"""Digits behind the point of a command."""
CLOSED, OPEN = 0.0, 1.0
BRIGHTEST = 3.0
"""Ratio of J at which the colours of the picture end."""
WORDS = {
    "speed_kmh": "speed",
    "wheel": "wheels",
    "gauge": "gauge",
    "friction": "friction",
    "level": "track level",
}
"""How a table calls the quantities of a condition."""
Rule = Callable[[MapCondition], float]
"""Command in each condition."""


class BestConstant(NamedTuple):
    """Best constant command in one condition for one weight of the force."""

    force_weight: float
    """k_F at k_y = 1."""
    condition: MapCondition
    current: float
    """With the lowest J."""
    J: float
    J_single: float
    """J of the one command that is best for all conditions."""
    J_closed: float
    J_open: float


class Adaptation(NamedTuple):
    """What rules that know less than the condition cost beside the best command of each condition.

    Losses are geometric means over the conditions of J over the best J there, less 1.
    """

    force_weight: float
    """k_F at k_y = 1."""
    current: float
    """Best single command."""
    loss: float
    """Of this one command for all conditions."""
    loss_by_speed: float
    """Of the best command for each speed: what knowing the speed alone leaves."""
    loss_closed: float
    loss_open: float
    worst: float
    """Largest J of the single command over the best one in a condition."""


_CONDITION = ("speed_kmh", "wheel", "wear", "gauge", "friction", "level")
BEST = tuple(
    Column(name) for name in ("force_weight", *_CONDITION, "current", "J", "J_single", "J_closed", "J_open")
)
"""Of the table of best constant commands."""
ADAPTATION = (
    Column("force_weight", "k_F"),
    Column("current", "best for all", digits=2),
    Column("loss", "it costs", **PERCENT),
    Column("loss_by_speed", "best by speed", **PERCENT),
    Column("loss_closed", "closed", **PERCENT),
    Column("loss_open", "open", **PERCENT),
    Column("worst", "worst ratio", digits=1),
)
"""Of the table of what fixed commands cost."""


@dataclass(frozen=True)
class CommandCosts:
    """J of constant commands for one weight of the force."""

    by_condition: Mapping[MapCondition, Mapping[float, float]]
    """By command; means over the seeds."""

    def best(self, conditions: Sequence[MapCondition]) -> float:
        """Command with the lowest geometric mean of J among those that all of some conditions have tried."""
        return min(self.tried(conditions), key=lambda current: self._mean(conditions, current))

    def tried(self, conditions: Sequence[MapCondition]) -> list[float]:
        """Commands that all of some conditions have tried, rising."""
        return sorted(set.intersection(*(set(self.by_condition[each]) for each in conditions)))

    def ratio(self, condition: MapCondition, current: float) -> float:
        """J of a command over the lowest one in a condition."""
        costs = self.by_condition[condition]
        return costs[current] / min(costs.values())

    def loss(self, rule: Rule, conditions: Iterable[MapCondition]) -> float:
        """Geometric mean of this ratio for the commands of a rule, less 1."""
        return math.expm1(float(np.mean([math.log(self.ratio(each, rule(each))) for each in conditions])))

    def _mean(self, conditions: Sequence[MapCondition], current: float) -> float:
        return float(np.mean([math.log(self.by_condition[each][current]) for each in conditions]))


@dataclass(frozen=True)
class ConstantMap:
    """J of constant commands over conditions, and what it says."""

    config: MapConfig
    costs: Mapping[float, CommandCosts]
    """By k_F at k_y = 1."""
    conditions: tuple[MapCondition, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "conditions", self.config.conditions())

    def best(self, force_weight: float) -> list[BestConstant]:
        """Best constant command of each condition."""
        costs = self.costs[force_weight]
        single = costs.best(self.conditions)
        found = []
        for condition in self.conditions:
            tried = costs.by_condition[condition]
            current = costs.best([condition])
            others = (tried[each] for each in (single, CLOSED, OPEN))
            found.append(BestConstant(force_weight, condition, current, tried[current], *others))
        return found

    def adaptation(self, force_weight: float, chosen: Sequence[MapCondition] = ()) -> Adaptation:
        """What rules cost in some of the conditions, all by default; they are the best ones for all."""
        costs = self.costs[force_weight]
        single, counted = costs.best(self.conditions), chosen or self.conditions
        by_speed = {
            speed: costs.best([each for each in self.conditions if each.speed_kmh == speed])
            for speed in {each.speed_kmh for each in self.conditions}
        }
        return Adaptation(
            force_weight,
            single,
            loss=costs.loss(lambda _: single, counted),
            loss_by_speed=costs.loss(lambda condition: by_speed[condition.speed_kmh], counted),
            loss_closed=costs.loss(lambda _: CLOSED, counted),
            loss_open=costs.loss(lambda _: OPEN, counted),
            worst=max(costs.ratio(each, single) for each in counted),
        )

    def as_dict(self) -> dict[str, Any]:
        """Keys ``best_constant``, with the first weight of the force above the others, and ``adaptation``."""
        names = ("current", "J", "J_single", "J_closed", "J_open")
        entries = [
            {name: getattr(each[0], name) for name in names}
            | {"condition": self._named(each[0].condition)}
            | {"by_force_weight": {f"{e.force_weight:g}": {n: getattr(e, n) for n in names} for e in each}}
            for each in zip(*(self.best(weight) for weight in self.costs), strict=True)
        ]
        found = [self.adaptation(weight) for weight in self.costs]
        return {"best_constant": entries, "adaptation": json_rows(ADAPTATION, found)}

    def tables(self) -> dict[str, Table]:
        """Best commands by weight and condition, what fixed ones cost, and where the single one does."""
        best = [
            each._asdict() | self._named(each.condition)
            for weight in self.costs
            for each in self.best(weight)
        ]
        where = self._where()
        return {
            "best_constant": csv_table(BEST, best),
            "adaptation": csv_table(ADAPTATION, [self.adaptation(weight) for weight in self.costs]),
            "adaptation_by_condition": csv_table([Column(name) for name in where[0]], where),
        }

    def plots(self) -> dict[str, Plot]:
        """Heat maps over speed and wheels: the best command, and the ratio of the single one's J to its."""
        return {
            "map_best_constant": self._map(
                lambda best: (best.current, f"{best.current:.2f}"), "best constant command (-)", (0.0, 1.0)
            ),
            "map_single": self._map(
                lambda best: (min(best.J_single / best.J, BRIGHTEST), f"{best.J_single / best.J:.2f}"),
                "J of the single command / of the best one",
                (1.0, BRIGHTEST),
            ),
        }

    def worth(self) -> str:
        """What a fixed command costs, in words."""
        first = next(iter(self.costs))
        loss = 100.0 * self.adaptation(first).loss
        return (
            f"The best constant command for all {len(self.conditions)} conditions costs {loss:.0f} % more "
            f"than the best one of each (geometric mean of J, k_F {first:g})."
        )

    def listings(self) -> Iterator[Listing]:
        """What fixed commands cost, where the single one costs it, and the best commands."""
        title = f"constant commands in {len(self.conditions)} conditions: geometric mean of J over the best"
        yield Listing(title, ADAPTATION, [self.adaptation(weight) for weight in self.costs])
        columns = [Column("where", "where")]
        columns += [Column(f"loss_{w:g}", f"k_F {w:g}", **PERCENT) for w in self.costs]
        where = [row | {"where": _in_words(row["quantity"], row["value"])} for row in self._where()]
        yield Listing("what the best for all costs", columns, where, "quantity")
        speeds = [Column(f"{kmh:g}", f"{kmh:g} km/h", digits=2) for kmh in self.config.speeds_kmh]
        first = next(iter(self.costs))
        yield Listing(
            f"best constant command, k_F {first:g}, friction {self.config.friction[0]:g}",
            [Column("wheel", "wheels, gauge (mm)"), *speeds],
            [
                {"wheel": label} | {f"{best.condition.speed_kmh:g}": best.current for best in bests}
                for label, bests in self._rows(first)
            ],
        )

    def _named(self, condition: MapCondition) -> dict[str, Any]:
        wear = {wheel.name: wheel.wear for wheel in self.config.wheels}
        return condition._asdict() | {"wear": wear[condition.wheel]}

    def _where(self) -> list[dict[str, Any]]:
        """Loss of the single command by the value of each quantity that varies."""
        rows = []
        for name in WORDS:
            values = list(dict.fromkeys(getattr(each, name) for each in self.conditions))
            for value in values if len(values) > 1 else ():
                chosen = [each for each in self.conditions if getattr(each, name) == value]
                losses = {f"loss_{w:g}": self.adaptation(w, chosen).loss for w in self.costs}
                rows.append({"quantity": name, "value": "the study's" if value is None else value} | losses)
        return rows

    def _rows(self, force_weight: float) -> list[tuple[str, list[BestConstant]]]:
        """Best commands over speed of each wheel and gauge, with the first friction and level."""
        config = self.config
        found = {best.condition: best for best in self.best(force_weight)}
        return [
            (
                f"{wheel.name}, {1e3 * gauge:.0f}",
                [
                    found[MapCondition(kmh, wheel.name, gauge, config.friction[0], config.levels[0])]
                    for kmh in config.speeds_kmh
                ],
            )
            for wheel in config.wheels
            for gauge in config.gauges
        ]

    def _map(
        self, cell: Callable[[BestConstant], tuple[float, str]], values: str, span: tuple[float, float]
    ) -> Plot:
        rows = {weight: self._rows(weight) for weight in self.costs}
        first = next(iter(rows.values()))
        return partial(
            heat_maps,
            maps={f"k_F = {w:g}": [[cell(best) for best in bests] for _, bests in rows[w]] for w in rows},
            x=("speed (km/h)", [f"{kmh:g}" for kmh in self.config.speeds_kmh]),
            y=("wheels, gauge (mm)", [label for label, _ in first]),
            values=values,
            span=span,
        )


def _in_words(quantity: str, value: str | float) -> str:
    """A value of a condition with its name and unit."""
    factor, unit = {"speed_kmh": (1.0, " km/h"), "gauge": (1e3, " mm")}.get(quantity, (1.0, ""))
    shown = value if isinstance(value, str) else f"{factor * value:g}{unit}"
    return f"{WORDS[quantity]} {shown}"


def constant_map(
    scenario: Scenario, config: MapConfig, environment: EnvironmentConfig, context: RunContext
) -> ConstantMap:
    """Find the best constant commands: a grid, then halfway to the neighbours of the best ones, and again.

    The best ones are those of each condition, of all conditions of a speed and of all together, for each
    weight of the force. One run of a command serves all weights.

    Parameters
    ----------
    scenario : Scenario
        The study, with passive or semi-active dampers.
    environment : EnvironmentConfig
        Control period, derailment and its charge.

    Raises
    ------
    ConfigError
        A condition that cannot be.
    StudyError
        A run that diverged.
    """
    study = _Study(for_policy(scenario, constant_spec(CLOSED)), config, environment, context)
    conditions = config.conditions()
    speeds = dict.fromkeys(each.speed_kmh for each in conditions)
    groups = [
        *([each] for each in conditions),
        *([each for each in conditions if each.speed_kmh == speed] for speed in speeds),
        list(conditions),
    ]
    tried = {each: spread_out(config.openings, study.closed) for each in conditions}
    costs = study.costs(tried)
    for _ in range(config.refinements):
        for each in costs.values():
            for group in groups:
                new = halfway(each.best(group), each.tried(group), study.closed)
                for condition in group:
                    tried[condition].update(new)
        costs = study.costs(tried)
    return ConstantMap(config, costs)


class _Study:
    """Runs of constant commands: each once, whoever asks for it."""

    def __init__(
        self, scenario: Scenario, config: MapConfig, environment: EnvironmentConfig, context: RunContext
    ) -> None:
        assert isinstance(scenario.damper, SaydDamperConfig)  # `for_policy` sees to it
        self.closed = overlap(scenario.damper.throttle)
        self._config, self._context, self._cost = config, context, scenario.cost
        shorter = environment.model_copy(update={"episode_s": config.episode_s})
        self._environment = environment_of(scenario, shorter)
        model = VehicleModel(scenario)
        for kmh in config.speeds_kmh:
            model.check_speed(kmh / KMH)  # refused before any work
        self._scenarios: dict[MapCondition, Scenario] = {}
        for condition in config.conditions():
            anywhere = condition._replace(speed_kmh=0.0)
            if anywhere not in self._scenarios:  # one for all speeds: they run side by side
                self._scenarios[anywhere] = config.scenario(scenario, condition)
        self._parts: dict[MapCondition, dict[float, list[CostParts]]] = {}

    def costs(self, tried: Mapping[MapCondition, Iterable[float]]) -> dict[float, CommandCosts]:
        """J of commands by weight of the force, condition and command."""
        self._run(tried)
        return {weight: CommandCosts(self._weighted(weight)) for weight in self._config.force_weights}

    def _weighted(self, weight: float) -> dict[MapCondition, dict[float, float]]:
        cost = self._cost.model_copy(update={"acceleration_weight": 1.0, "force_weight": weight})

        def mean(runs: Sequence[CostParts]) -> float:
            acceleration, force, lost = np.array([(run.acceleration, run.force, run.lost) for run in runs]).T
            return float(np.mean(charged(self._environment, cost, acceleration, force, lost)))

        return {
            condition: {current: mean(runs) for current, runs in sorted(of_command.items())}
            for condition, of_command in self._parts.items()
        }

    def _run(self, tried: Mapping[MapCondition, Iterable[float]]) -> None:
        """Run what has not been run before."""
        new = [
            (condition, current)
            for condition, currents in tried.items()
            for current in sorted(currents)
            if current not in self._parts.get(condition, {})
        ]
        specs = {current: constant_spec(current) for _, current in new}
        runs = [
            Run(
                specs[current],
                self._scenarios[condition._replace(speed_kmh=0.0)],
                self._environment,
                condition.speed_kmh / KMH,
                seed,
            )
            for condition, current in new
            for seed in self._config.seeds
        ]
        found = iter(self._context.records(cost_parts, runs, CostParts, "constant commands"))
        for condition, current in new:
            parts = [next(found) for _ in self._config.seeds]
            self._parts.setdefault(condition, {})[current] = parts


def spread_out(openings: Iterable[float], closed: float) -> set[float]:
    """Both ends, and commands at shares of the way from `closed`, up to which all act as one, to open."""
    return {CLOSED, OPEN, *(round(closed + (1.0 - closed) * share, DIGITS) for share in openings)}


def halfway(current: float, currents: Iterable[float], closed: float) -> list[float]:
    """Commands halfway between one and its neighbours; up to `closed` all act as one."""
    ends = sorted({max(each, closed) for each in currents})
    place = ends.index(max(current, closed))
    around = ends[max(place - 1, 0) : place + 2]
    return [round(0.5 * (low + high), DIGITS) for low, high in pairwise(around)]
