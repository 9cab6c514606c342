"""What becomes of a policy beyond its training? Disturbances, another vehicle, and each single fault."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.distribution import FixedDistribution
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.fault import DamperLost, Fault, PowerLost, ValveStuck
from sayd_env.config.palette import SHADE, policy_style
from sayd_env.config.robustness import (
    Axis,
    DisturbedQuantity,
    OperatingCondition,
    RobustnessConfig,
    single_faults,
)
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.track import read_irregularity
from sayd_env.config.units import KMH, Array
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import LIMITED, PERCENT, Column, Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot, label, legend_below, limit_line, log_axis, name_rows, panels
from sayd_env.report.html import Grid, Page, Picture, Section, Text, Verdict
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import Row, rows
from sayd_env.runs.policies import PASSIVE, PolicySpec, constant_spec, for_policy
from sayd_env.runs.rollouts import Run, environment_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

TITLE = "Robustness: policies beyond their training"
UNDISTURBED, FAULT = "none", "fault"
"""Axes of the runs without a disturbance, and of the single faults."""
_OF_SENSORS = ("sensor_noise",)
"""Quantities of axes that no wheel feels: a policy that reads no sensor runs as without them."""
_OF_VALVES = ("delay", "lag")
"""Those that passive dampers do not have."""


@dataclass(frozen=True)
class Disturbance:
    """What is different from the conditions of the training."""

    axis: str
    """`UNDISTURBED`, `FAULT`, or the name of an axis."""
    quantity: str | None = None
    value: float = math.nan
    fault: Fault | None = None
    title: str = "none"
    """How tables call it."""

    @property
    def named(self) -> dict[str, Any]:
        """Columns that say what it is."""
        return {"axis": self.axis, "disturbance": self.title}

    def felt_by(self, policy: PolicySpec) -> bool:
        """Whether it can change a run of a policy at all: one that reads no sensor does not feel theirs."""
        if self.fault is not None:
            if isinstance(self.fault, DamperLost):
                return True
            of_damper = isinstance(self.fault, ValveStuck | PowerLost)
            return policy.name != PASSIVE if of_damper else not policy.open_loop
        if self.quantity in _OF_SENSORS:
            return not policy.open_loop
        return self.quantity is not None and not (self.quantity in _OF_VALVES and policy.name == PASSIVE)

    def scenario(self, scenario: Scenario) -> Scenario:
        """The scenario with it."""
        if self.quantity in ("wear", "friction"):
            return scenario.model_copy(update={self.quantity: self.value})
        damper = scenario.damper
        if self.quantity not in _OF_VALVES or not isinstance(damper, SaydDamperConfig):
            return scenario
        valve = damper.valve
        if self.quantity == "delay":
            changed = {"delay": valve.delay + self.value}
        else:
            changed = {"natural_frequency": valve.natural_frequency / self.value}
        slower = damper.model_copy(update={"valve": valve.model_copy(update=changed)})
        return scenario.model_copy(update={"damper": slower})

    def environment(self, environment: EnvironmentConfig) -> EnvironmentConfig:
        """The environment with it."""
        if self.quantity not in ("sensor_noise", "payload"):
            return environment
        fixed = {self.quantity: FixedDistribution(distribution="fixed", value=self.value)}
        drawn = environment.randomisation.model_copy(update=fixed)
        return environment.model_copy(update={"randomisation": drawn})


class Outcome(NamedTuple):
    """A policy with one disturbance, over all conditions; ratios are of J, means over the seeds."""

    policy: str
    axis: str
    disturbance: str
    J: float
    """Mean over the conditions."""
    to_passive: float
    """Largest ratio to the passive vehicle's with the same disturbance."""
    to_best_constant: float
    """Largest ratio to that of the best constant command with the same disturbance."""
    largest_acceleration_ratio: float
    """Largest RMS of a bogie frame's acceleration over the limit of EN 14363; infinite after a derailment."""
    derailed: int
    valve_mean: float | None
    fallback_share: float | None
    """Share of the time in which the safe fallback intervened."""
    holds: bool
    """Whether it does what is asked, see `Asked`."""


OUTCOMES = (
    Column("policy", "policy"),
    Column("axis"),
    Column("disturbance", "disturbance"),
    Column("J", "J", digits=4),
    Column("to_passive", "/ passive", digits=2),
    Column("to_best_constant", "/ constant", digits=2),
    Column("largest_acceleration_ratio", "acc.", **LIMITED),
    Column("derailed"),
    Column("valve_mean", "mean V", digits=2, wide=True),
    Column("fallback_share", "fallback", wide=True, **PERCENT),
    Column("holds", "met", bad=lambda holds: not holds),
)
_VERDICTS = (
    Column("policy", "policy"),
    Column("faults_met", "faults met"),
    Column("faults", "of"),
    Column("worst_fault", "worst fault"),
    Column("others_met", "others met"),
    Column("others", "of"),
    Column("worst_other", "worst of them", wide=True),
    Column("derailed", "derailed", limit=0.0),
)
_PICTURES = (
    (
        "robustness_axes",
        "J over each quantity",
        (
            "Largest J over the passive vehicle's with the same disturbance. Below the dashed line the "
            "policy is better than passive dampers in every condition. Shaded: values of the runs without a "
            "disturbance, over which their J is drawn as a level line.",
        ),
    ),
    (
        "robustness_faults",
        "J with each fault",
        (
            "The same with each single fault; the dashed line is what is asked, unless the best constant "
            "command is no better.",
        ),
    ),
)
_RUNS = ("J", "acceleration_ratio", "valve_mean", "fallback_share", "ending")


@dataclass(frozen=True)
class RobustnessResult:
    """Runs of policies, of the passive vehicle and of constant commands with every disturbance."""

    config: RobustnessConfig
    disturbances: tuple[Disturbance, ...]
    policies: tuple[str, ...]
    """Those that are judged."""
    bounding: tuple[str, ...]
    """Constant commands."""
    runs: Mapping[tuple[str, str], Sequence[Row]] = field(repr=False)
    """By title of policy and disturbance: condition by condition, seed by seed."""

    def costs(self, policy: str, disturbance: str) -> Array:
        """J of each condition, mean over the seeds."""
        found = np.array([row.J for row in self.runs[policy, disturbance]])
        return np.asarray(found.reshape(len(self.config.conditions), -1).mean(axis=1))

    def best_constant(self, disturbance: str) -> Array:
        """J of the best constant command of each condition."""
        return np.asarray(np.min([self.costs(each, disturbance) for each in self.bounding], axis=0))

    @cached_property
    def outcomes(self) -> list[Outcome]:
        """Of each policy with each disturbance."""
        return [self._outcome(policy, each) for policy in self.policies for each in self.disturbances]

    @cached_property
    def verdicts(self) -> list[dict[str, Any]]:
        """How often each policy does what is asked, and where it is farthest from it."""
        return [self._verdict(policy) for policy in self.policies]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd robustness --json``."""
        return {
            "outcomes": json_rows(OUTCOMES, self.outcomes),
            "verdicts": json_rows(_VERDICTS, self.verdicts),
            "conditions": [each.text for each in self.config.conditions],
            "faults": [
                each.named | {"fault": each.fault.model_dump(mode="json")}
                for each in self.disturbances
                if each.fault is not None
            ],
            "asked": self.config.asked.model_dump(mode="json"),
        }

    def tables(self) -> dict[str, Table]:
        """Outcomes, what is met, and every run."""
        columns = ["policy", "axis", "disturbance", "condition", "seed", *_RUNS]
        every = [
            {"policy": policy, **each.named, "condition": condition.text, "seed": row.seed}
            | {name: getattr(row, name) for name in _RUNS}
            for policy in dict.fromkeys((PASSIVE, *self.bounding, *self.policies))
            for each in self.disturbances
            for condition, row in zip(self._conditions(), self.runs[policy, each.title], strict=True)
        ]
        return {
            "outcomes": csv_table(OUTCOMES, self.outcomes),
            "verdicts": csv_table(_VERDICTS, self.verdicts),
            "runs": csv_table([Column(name) for name in columns], every),
        }

    def plots(self) -> dict[str, Plot]:
        """J over each quantity, and with each fault, over the passive vehicle's."""
        found: dict[str, Plot] = {"robustness_faults": self._draw_faults}
        if self.config.axes:
            found["robustness_axes"] = self._draw_axes
        return found

    def page(self) -> Page:
        """What is asked and met, the pictures, and all outcomes."""
        conditions = "; ".join(each.text for each in self.config.conditions)
        words = (
            f"Every policy, the passive vehicle and constant commands meet the same conditions "
            f"({conditions}; {len(self.config.seeds)} seeds each) with one thing changed at a time. "
            f"{self._asked}"
        )
        verdicts, *missed = self._listings()
        # A policy's faults are its longest story.
        tables = [
            Grid.of(verdicts, lambda _: "robustness_faults"),
            *(Grid.of(each, _picture_of) for each in missed),
        ]
        met = {row["policy"]: row["faults_met"] + row["others_met"] for row in self.verdicts}
        each_of = len(self.disturbances)
        names = sorted(met, key=lambda policy: -met[policy])
        verdict = Verdict(
            [f"{name}: {met[name]} of {each_of} outcomes are as asked." for name in names],
            all(each.holds for each in self.outcomes),
        )
        everything = Listing("all outcomes", OUTCOMES, self.outcomes, "policy")
        pictures = [Picture(*each) for each in _PICTURES if each[0] in self.plots()]
        sections = [
            Section("What is asked, and met", [Text(words), *tables]),
            Section("Pictures", pictures),
            Section("All outcomes", [Grid.of(everything, _picture_of)]),
        ]
        return Page(TITLE, verdict, sections)

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print what each policy meets, and what it misses."""
        verdicts, *missed = self._listings()
        verdicts.print(console, wide)
        console.print(self._asked)
        for listing in missed:
            listing.print(console, wide)

    @property
    def _asked(self) -> str:
        asked = self.config.asked
        return (
            "Asked: with a single fault no derailment, and in every condition a J of at most "
            f"{asked.to_passive:g} times the passive vehicle's or {asked.to_best_constant:g} times that of "
            "the best constant command, both with the same fault; with anything else no derailment, and a J "
            f"above the passive vehicle's by no more than {100 * asked.worse_than_passive:g} %."
        )

    def _listings(self) -> Iterator[Listing]:
        count = f"{len(self.config.conditions)} conditions x {len(self.config.seeds)} seeds"
        yield Listing(f"{count}: what is asked, and met", _VERDICTS, self.verdicts)
        missed = [each for each in self.outcomes if not each.holds]
        if missed:
            yield Listing("missed: largest ratios of J", OUTCOMES, missed, "policy")

    def _conditions(self) -> list[OperatingCondition]:
        return [each for each in self.config.conditions for _ in self.config.seeds]

    def _outcome(self, policy: str, disturbance: Disturbance) -> Outcome:
        found = self.runs[policy, disturbance.title]
        costs = self.costs(policy, disturbance.title)
        passive = costs / self.costs(PASSIVE, disturbance.title)
        constant = costs / self.best_constant(disturbance.title)
        derailed, asked = sum(row.ending is not None for row in found), self.config.asked
        if disturbance.fault is None:
            met = passive <= 1.0 + asked.worse_than_passive
        else:
            met = (passive <= asked.to_passive) | (constant <= asked.to_best_constant)
        return Outcome(
            policy,
            disturbance.axis,
            disturbance.title,
            float(costs.mean()),
            float(passive.max()),
            float(constant.max()),
            max(row.acceleration_ratio for row in found),
            derailed,
            _mean(row.valve_mean for row in found),
            _mean(row.fallback_share for row in found),
            bool(met.all()) and derailed == 0,
        )

    def _verdict(self, policy: str) -> dict[str, Any]:
        own = [each for each in self.outcomes if each.policy == policy]
        faults = [each for each in own if each.axis == FAULT]
        others = [each for each in own if each.axis != FAULT]

        def worst(among: list[Outcome]) -> str | None:
            found = max(among, key=lambda each: (each.derailed, each.to_passive), default=None)
            return None if found is None else found.disturbance

        return {
            "policy": policy,
            "faults_met": sum(each.holds for each in faults),
            "faults": len(faults),
            "worst_fault": worst(faults),
            "others_met": sum(each.holds for each in others),
            "others": len(others),
            "worst_other": worst(others),
            "derailed": sum(each.derailed for each in own),
        }

    def _draw_axes(self, figure: Figure) -> None:
        """The largest ratio to the passive vehicle over each quantity."""
        axes = panels(figure, len(self.config.axes), 2, (5.0, 3.2), sharey=True)
        environment = load_environment(self.config.environment)
        for panel, axis in zip(axes, self.config.axes, strict=True):
            usual = _undisturbed(axis.quantity, self.config.conditions, environment)
            if usual[0] < usual[1]:
                panel.axvspan(*usual, color=SHADE, zorder=0.5, label="undisturbed")
            for policy in self.policies:
                self._draw_over(panel, axis, policy, usual)
            panel.set_xticks(sorted({*axis.values, *usual}))
            panel.xaxis.set_major_formatter("{x:g}")
            panel.set_xlabel(f"{axis.name} ({_UNITS[axis.quantity]})")
            limit_line(panel, 1.0, "passive")
            log_axis(panel, "y")
        for panel in axes[::2]:
            panel.set_ylabel("J / passive, worst condition")
        legend_below(figure, *axes)

    def _draw_over(self, panel: Axes, axis: Axis, policy: str, usual: tuple[float, float]) -> None:
        """Draw a policy over the values of an axis, and level over those without a disturbance."""
        found = {each.disturbance: each.to_passive for each in self.outcomes if each.policy == policy}
        points = {value: found[disturbance_of(axis, value).title] for value in axis.values}
        own = found[UNDISTURBED]
        style = policy_style(policy).drawn | _OPEN
        if any(usual[0] <= value <= usual[1] for value in points):  # no place of its own
            panel.plot(usual, [own, own], **style | {"marker": "", "linewidth": 1.0})
        else:
            points |= dict.fromkeys(usual, own)
        places = sorted(points)
        marked = [place for place, x in enumerate(places) if x in axis.values or usual[0] == usual[1]]
        values = [points[x] for x in places]
        panel.plot(places, values, markevery=marked, label=label(policy), **style)

    def _draw_faults(self, figure: Figure) -> None:
        """The largest ratio to the passive vehicle with each fault."""
        titles = [each.title for each in self.disturbances if each.fault is not None]
        figure.set_size_inches(9.0, 0.26 * len(titles) + 1.8)
        axes = figure.subplots()
        axes.grid(alpha=0.3)
        for policy in self.policies:
            found = {e.disturbance: e.to_passive for e in self.outcomes if e.policy == policy}
            values = [found[title] for title in titles]
            style = policy_style(policy).drawn | _OPEN | {"linestyle": "none"}
            axes.plot(values, range(len(titles)), label=label(policy), **style)
        name_rows(axes, titles)
        axes.set_xlabel("J / passive with the same fault, worst condition")
        most = self.config.asked.to_passive
        limit_line(axes, most, f"asked: at most {most:g}", vertical=True)
        log_axis(axes, "x")
        legend_below(figure, axes, columns=3)


_OPEN: dict[str, Any] = {"markerfacecolor": "none", "markeredgewidth": 1.3}
"""Markers through which those of equal values are seen."""
_UNITS: Mapping[DisturbedQuantity, str] = {
    "sensor_noise": "factor",
    "delay": "s",
    "lag": "factor on the time constant",
    "wear": "-",
    "friction": "-",
    "payload": "share of the carbody's mass",
}


def _undisturbed(
    quantity: DisturbedQuantity, conditions: Iterable[OperatingCondition], environment: EnvironmentConfig
) -> tuple[float, float]:
    """Least and largest value of a quantity in the runs without a disturbance."""
    match quantity:
        case "delay":
            return 0.0, 0.0
        case "lag":
            return 1.0, 1.0
        case "wear" | "friction":
            own = [getattr(each, quantity) for each in conditions]
            return min(own), max(own)
        case _:
            low, high = getattr(environment.randomisation, quantity).bounds
            return low, high


def _picture_of(outcome: Outcome) -> str | None:
    """The figure in which an outcome is seen; the one without a disturbance begins each axis."""
    return "robustness_faults" if outcome.axis == FAULT else "robustness_axes"


def disturbance_of(axis: Axis, value: float) -> Disturbance:
    """One value of an axis."""
    return Disturbance(axis.name, axis.quantity, value, title=f"{axis.name} {value:g}")


def robustness(
    config: RobustnessConfig, policies: Sequence[PolicySpec], *, context: RunContext | None = None
) -> RobustnessResult:
    """Run policies with each disturbance and each single fault, in the same conditions.

    Parameters
    ----------
    policies : sequence of PolicySpec
        Beside the passive vehicle and constant commands, with which they are compared.

    Raises
    ------
    ConfigError
        A policy that does not fit, a speed outside the vehicle's range, an environment without faults.
    StudyError
        A run that diverged.
    """
    study, context = _Study(config), context or RunContext()
    bounding = [constant_spec(current) for current in config.constants]
    judged = tuple(each.title for each in policies)
    wanted = {each.title: each for each in (PolicySpec(PASSIVE), *bounding, *policies)}
    runs: list[Run] = []
    spans: dict[tuple[str, str], slice] = {}
    for title, policy in wanted.items():
        for each in study.disturbances:
            if each.axis == UNDISTURBED or each.felt_by(policy):
                new = study.runs(policy, each)
                spans[title, each.title] = slice(len(runs), len(runs) + len(new))
                runs += new
            else:
                spans[title, each.title] = spans[title, UNDISTURBED]
    found = rows(runs, context, "policies and disturbances")
    return RobustnessResult(
        config,
        study.disturbances,
        judged,
        tuple(each.title for each in bounding),
        {key: found[span] for key, span in spans.items()},
    )


class _Study:
    """The runs of a policy with a disturbance."""

    def __init__(self, config: RobustnessConfig) -> None:
        self._config = config
        environment = load_environment(config.environment)
        self._environment = environment.model_copy(update={"episode_s": config.episode_s})
        fastest = max(each.speed_kmh for each in config.conditions)
        length = math.ceil(fastest / KMH * config.episode_s)
        scenario = load_scenario(environment.study, [f"assessment.length={float(length)!r}"])
        if config.track is not None:
            track = scenario.track.model_copy(update={"irregularity": read_irregularity(config.track)})
            scenario = scenario.model_copy(update={"track": track})
        self._scenario = scenario
        model = VehicleModel(scenario)
        for each in config.conditions:
            model.check_speed(each.speed_kmh / KMH)  # refused before any work
        faults = load_environment(config.faults).faults
        if faults is None:
            raise ConfigError(f"faults: environment '{config.faults}' has none")
        single = single_faults(faults.kinds, config.places, environment.sensors, config.onset)
        self.disturbances = (
            Disturbance(UNDISTURBED),
            *(disturbance_of(axis, value) for axis in config.axes for value in axis.values),
            *(Disturbance(FAULT, fault=fault, title=name) for name, fault in single.items()),
        )
        self._shared: dict[tuple[Any, ...], tuple[Scenario, EnvironmentConfig]] = {}

    def runs(self, policy: PolicySpec, disturbance: Disturbance) -> list[Run]:
        """Condition by condition, seed by seed."""
        faults = () if disturbance.fault is None else (disturbance.fault,)
        return [
            Run(
                policy,
                *self._where(policy, condition, disturbance),
                condition.speed_kmh / KMH,
                seed,
                faults=faults,
            )
            for condition in self._config.conditions
            for seed in self._config.seeds
        ]

    def _where(
        self, policy: PolicySpec, condition: OperatingCondition, disturbance: Disturbance
    ) -> tuple[Scenario, EnvironmentConfig]:
        """Scenario and environment: the same objects for all runs that can go side by side."""
        changed = disturbance if disturbance.fault is None else Disturbance(UNDISTURBED)
        passive = policy.name == PASSIVE
        key = (passive, condition.wear, condition.friction, changed.title)
        if key not in self._shared:
            own = {"wear": condition.wear, "friction": condition.friction}
            fitted = for_policy(self._scenario.model_copy(update=own), policy)
            environment = environment_of(fitted, self._environment)
            self._shared[key] = changed.scenario(fitted), changed.environment(environment)
        return self._shared[key]


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
