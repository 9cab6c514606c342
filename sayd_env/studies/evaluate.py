"""How do policies run the vehicle? Cost, EN 14363 ratios, forces, valves and comfort, side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.palette import policy_style
from sayd_env.config.reward import REPORTED, reported_costs
from sayd_env.config.scenario import CostConfig, Scenario
from sayd_env.config.units import Array
from sayd_env.report.columns import DERAILED, LIMITED, PERCENT, Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, label, legend_below, limit_line, log_axis, panels
from sayd_env.report.html import Grid, Page, Picture, Section
from sayd_env.runs.context import RunContext, refuse_empty
from sayd_env.runs.metrics import RATIOS, Row, rows
from sayd_env.runs.policies import PolicySpec
from sayd_env.runs.rollouts import conditions, own_policy, policy_runs
from sayd_env.studies.standing import Standing, verdict

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

COSTS = (
    *("J", "J_acceleration", "J_force", "J_run"),
    *("J_offline", "J_offline_acceleration", "J_offline_force"),
)
FORCES = ("force_rms_n", "force_peak_n", "force_power_above_10_hz_n2")
VALVES = ("valve_mean", "valve_travel_per_km", "switching_per_s", "fallback_share")
AVERAGED = (*COSTS, *RATIOS, *FORCES, "comfort", *VALVES)
"""Columns of a row that a summary averages."""


class GridPoint(NamedTuple):
    """What the runs of one line of the table have in common, beside the policy."""

    wear: float
    friction: float
    speed_kmh: float


_REPORTED = tuple(Column(column, f"J {name}", digits=4, best=True) for column, name in REPORTED.items())
"""J by other weights than the evaluation's; those that it has are left out."""
_WHO = (
    Column("policy", "policy"),
    Column("wear", "wear", wide=True),
    Column("friction", "friction", wide=True),
    Column("speed_kmh", "km/h"),
)
_COST_COLUMNS = (
    Column("J", "J", digits=4, best=True),
    *_REPORTED,
    Column("J_acceleration", "acceleration", digits=4, best=True, wide=True),
    Column("J_force", "force", digits=4, best=True, wide=True),
    Column("J_offline", "J off-line", digits=4, best=True, infinite=DERAILED),
    Column("acceleration_ratio", "acc. / limit", best=True, **LIMITED),
    Column("track_shift_ratio", "shift / limit", best=True, **LIMITED),
    Column("comfort", "N_MV", digits=2, best=True, wide=True, infinite=DERAILED),
)
_DAMPER_COLUMNS = (
    Column("force_rms_n", "force RMS", "kN", 1e-3, 2, best=True, infinite=DERAILED),
    Column("force_peak_n", "peak", "kN", 1e-3, 1, best=True, infinite=DERAILED),
    Column(
        "force_power_above_10_hz_n2", "above 10 Hz", "kN²", 1e-6, 3, best=True, wide=True, infinite=DERAILED
    ),
    Column("valve_mean", "mean V", digits=2),
    Column("valve_travel_per_km", "travel", "1/km", digits=1),
    Column("switching_per_s", "switching", "1/s", digits=1),
    Column("fallback_share", "fallback", wide=True, **PERCENT),
)
_POLICY_COLUMNS = (
    Column("policy", "policy"),
    Column("J", "J", digits=4, best=True),
    *_REPORTED,
    Column("J_offline", "J off-line", digits=4, best=True, infinite=DERAILED),
    Column("largest_ratio", "largest ratio", best=True, **LIMITED),
    Column("force_rms_n", "force", "kN", 1e-3, 2, best=True, wide=True, infinite=DERAILED),
    Column("comfort", "N_MV", digits=2, best=True, wide=True, infinite=DERAILED),
    Column("derailed", "derailed", limit=0.0),
    Column("runs", "runs"),
)
_MEDIANS = tuple(Column(name) for name in ("policy", *GridPoint._fields, *AVERAGED, "derailed"))
_BY_NAME = {column.name: column for column in (*_COST_COLUMNS, *_DAMPER_COLUMNS)}
_PANELS = {
    "J": "J, on-line filter",
    "acceleration_ratio": "acceleration, RMS over limit",
    "J_acceleration": "acceleration's part of J, unweighted",
    "track_shift_ratio": "track shift force, RMS over limit",
    "J_force": "force's part of J, unweighted",
    "force_rms_n": "yaw damper force, RMS (kN)",
    "J_offline": "J, off-line filter",
    "comfort": "comfort index N_MV",
}
"""Of the pictures: what is drawn, and how its axis is called."""
_PICTURE_WORDS = "Lines: medians over the seeds; points: the seeds. Dashed: limits of EN 14363."


@dataclass(frozen=True)
class EvaluateResult:
    """All runs of an evaluation."""

    scenario: Scenario
    rows: list[Row]
    environment: EnvironmentConfig = field(default_factory=load_environment)

    @cached_property
    def reported(self) -> dict[str, CostConfig]:
        """Other weights by which J is given, too, by column."""
        return reported_costs(self.scenario.cost)

    def by_weights(self, run: Row) -> dict[str, float]:
        """J of a run by these weights."""
        return {column: run.cost(self.environment, cost) for column, cost in self.reported.items()}

    @cached_property
    def policies(self) -> tuple[str, ...]:
        """Policies in the order in which they were asked for."""
        return tuple(dict.fromkeys(row.policy for row in self.rows))

    @cached_property
    def conditions(self) -> tuple[GridPoint, ...]:
        """Conditions in the order of wear, friction and speed."""
        return tuple(sorted({_condition(row) for row in self.rows}))

    def runs(self, policy: str, condition: GridPoint | None = None) -> list[Row]:
        """Runs of a policy, of one condition or of all."""
        chosen = [row for row in self.rows if row.policy == policy]
        return chosen if condition is None else [row for row in chosen if _condition(row) == condition]

    @cached_property
    def medians(self) -> list[dict[str, Any]]:
        """Medians over the seeds of each condition and policy, by `_MEDIANS`; NaN for what there is not."""
        return [
            {"policy": policy, "condition": condition, **condition._asdict()}
            | self._over(np.median, runs)
            | {"derailed": _derailed(runs), "runs": len(runs)}
            for condition in self.conditions
            for policy in self.policies
            if (runs := self.runs(policy, condition))
        ]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd evaluate --json``."""
        return {
            "rows": [asdict(row) | self.by_weights(row) for row in self.rows],
            "summary": {policy: self._summary(policy) for policy in self.policies},
        }

    def tables(self) -> dict[str, Table]:
        """All runs, and the medians over the seeds that the printed table shows."""
        runs = [Column(name) for name in (*(each.name for each in fields(Row)), *self.reported)]
        medians = [*_MEDIANS, *map(Column, self.reported)]
        return {
            "runs": csv_table(runs, self.as_dict()["rows"]),
            "medians": csv_table(medians, self.medians),
        }

    def plots(self) -> dict[str, Plot]:
        """Cost, ratios, force and comfort over speed by policy, one picture for each wear and friction."""
        return {
            self._figure(wear, friction): partial(self._draw, wear=wear, friction=friction)
            for wear, friction in self._pairs
        }

    def page(self) -> Page:
        """Which policy is best, tables of all conditions, and the pictures."""
        first = self._pairs[0]  # a policy over all conditions is seen from the first figure on
        costs, dampers, policies = (
            Grid.of(each, lambda row: self._figure(row.get("wear", first[0]), row.get("friction", first[1])))
            for each in self._listings()
        )
        standings = [
            Standing(name, found["J"], found["largest_ratio"], int(found["derailed"]))
            for name in self.policies
            for found in (self._summary(name),)
        ]
        where = f"{len(self.conditions)} condition{'s' * (len(self.conditions) > 1)}"
        pictures = [
            Picture(
                self._figure(*pair),
                f"Policies over speed at wear {pair[0]:g} and friction {pair[1]:.3g}",
                [_PICTURE_WORDS],
            )
            for pair in self._pairs
        ]
        return Page(
            f"Policies beside each other: {self.scenario.vehicle.name}",
            verdict(standings, where),
            [
                Section("Policies over all conditions", [policies]),
                Section("Over speed", pictures),
                Section("Conditions", [costs, dampers]),
            ],
        )

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the medians over the seeds of each condition and policy, then each policy as a whole."""
        for listing in self._listings():
            listing.print(console, wide)
        for row in self.medians:
            if row["derailed"]:
                console.print(
                    f"{DERAILED}: {row['policy']} at {row['speed_kmh']:g} km/h, wear {row['wear']:g}, "
                    f"friction {row['friction']:.3g}: {row['derailed']} of {row['runs']} runs; they count "
                    "with infinite ratios and with the environment's charge in J",
                    markup=False,
                    style="red",
                )

    def _listings(self) -> Iterator[Listing]:
        """Costs and limits, dampers and valves, policies as a whole."""
        seeds = len({row.seed for row in self.rows})
        about = f"{self.scenario.vehicle.name}, medians of {seeds} seed{'s' * (seeds > 1)}"
        for title, columns in (
            ("cost (its terms unweighted), limits, comfort", _COST_COLUMNS),
            ("dampers and valves", _DAMPER_COLUMNS),
        ):
            found = [*self._who(), *(column for column in columns if self._has(column))]
            yield Listing(f"{about}: {title}", found, self.medians, "condition")
        policies = [
            {"policy": policy, "runs": len(self.runs(policy)), **self._summary(policy)}
            for policy in self.policies
        ]
        where = f"all {len(self.conditions)} conditions" if len(self.conditions) > 1 else "the condition"
        title = f"{where}: means over the runs"
        yield Listing(title, [column for column in _POLICY_COLUMNS if self._has(column)], policies)

    @cached_property
    def _pairs(self) -> list[tuple[float, float]]:
        """Wear and friction of the pictures."""
        return list(dict.fromkeys((c.wear, c.friction) for c in self.conditions))

    def _figure(self, wear: float, friction: float) -> str:
        one = len(self._pairs) == 1
        return "evaluate" if one else f"evaluate_wear_{wear:g}_friction_{friction:g}"

    def overview(self) -> tuple[Sequence[Column], list[dict[str, Any]]]:
        """Medians over the seeds, as one of many results is shown."""
        every = (*self._who(), *_COST_COLUMNS, *_DAMPER_COLUMNS[:2])
        return [column for column in every if self._has(column)], self.medians

    def _who(self) -> list[Column]:
        """Columns that say which runs a row is of."""
        varied = {name for name in ("wear", "friction") if len({row[name] for row in self.medians}) > 1}
        return [column if column.name not in varied else replace(column, wide=False) for column in _WHO]

    def _summary(self, policy: str) -> dict[str, float]:
        """Means over all runs; the largest median of either ratio; how many runs derailed."""
        largest = max(row[name] for row in self.medians if row["policy"] == policy for name in RATIOS)
        runs = self.runs(policy)
        return self._over(np.mean, runs) | {"largest_ratio": largest, "derailed": float(_derailed(runs))}

    def _has(self, column: Column) -> bool:
        return column.name not in REPORTED or column.name in self.reported

    def _over(self, statistic: Callable[[Any], Any], runs: Sequence[Row]) -> dict[str, float]:
        """A statistic of all columns; NaN for what there is not."""
        values = {name: [getattr(run, name) for run in runs] for name in AVERAGED}
        values |= {name: [self.by_weights(run)[name] for run in runs] for name in self.reported}
        return {name: math.nan if None in each else float(statistic(each)) for name, each in values.items()}

    def _draw(self, figure: Figure, wear: float, friction: float) -> None:
        figure.suptitle(
            f"{self.scenario.vehicle.name}, wear {wear:g}, friction {friction:.3g}: medians and seeds"
        )
        axes = panels(figure, len(_PANELS), 2, (5.0, 2.9), sharex=True)
        for axis, (name, title) in zip(axes, _PANELS.items(), strict=True):
            column = _BY_NAME[name]
            for policy in self.policies:
                self._draw_policy(axis, policy, (wear, friction), column)
            axis.set_ylabel(title)
            if column.name in COSTS:  # a hunting vehicle costs a hundred times as much
                log_axis(axis)
                continue
            if column.name in RATIOS:
                limit_line(axis, 1.0)
            axis.set_ylim(bottom=0.0)
        for axis in axes[-2:]:
            axis.set_xlabel("speed (km/h)")
        legend_below(figure, axes[0])

    def _draw_policy(self, axis: Axes, policy: str, pair: tuple[float, float], column: Column) -> None:
        """Draw medians over speed with the seeds behind them; infinite values leave gaps."""
        style = policy_style(policy)
        medians = [r for r in self.medians if (r["policy"], r["wear"], r["friction"]) == (policy, *pair)]
        values = [column.scale * row[column.name] for row in medians]
        speeds = [row["speed_kmh"] for row in medians]
        axis.plot(speeds, _finite(values), markersize=5, label=label(policy), **style.drawn)
        runs = [run for run in self.runs(policy) if (run.wear, run.friction) == pair]
        found = [math.nan if (value := column.of(run)) is None else column.scale * value for run in runs]
        axis.plot([run.speed_kmh for run in runs], _finite(found), ".", color=style.colour, markersize=2)


def _finite(values: Sequence[float]) -> Array:
    """The same with NaN, which is not drawn, in place of what is infinite."""
    return np.where(np.isfinite(values), values, np.nan)


def evaluate(
    scenario: Scenario,
    speeds: Sequence[float],
    seeds: Sequence[int] = range(10),
    *,
    policies: Sequence[PolicySpec] = (),
    wear: Sequence[float] = (),
    friction: Sequence[float] = (),
    environment: EnvironmentConfig | None = None,
    initial_current: float = 0.0,
    context: RunContext | None = None,
) -> EvaluateResult:
    """Run policies over speeds, wear, friction and seeds, all of them on the same tracks.

    Parameters
    ----------
    speeds : sequence of float
        m/s.
    seeds : sequence of int
        Track seeds.
    policies : sequence of PolicySpec
        By default what the scenario's dampers do by themselves: passive ones, or semi-active ones at the
        constant current of their configuration.
    wear, friction : sequence of float
        In place of the scenario's.
    environment : EnvironmentConfig
        Sensors, control period, length of an episode, charge for a derailment; ``nominal`` by default.
    initial_current : float
        Valve command of the run-in.

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, a profile that cannot be used, a policy that does not fit; no
        speed or no seed.
    StudyError
        A run that diverged.
    """
    refuse_empty(speeds=speeds, seeds=seeds)
    specs = tuple(policies) or (own_policy(scenario),)
    chosen, setup = conditions(scenario, wear, friction), environment or load_environment()
    runs = list(policy_runs(specs, chosen, speeds, seeds, setup, initial_current=initial_current))
    return EvaluateResult(scenario, rows(runs, context or RunContext()), setup)


def _condition(row: Row) -> GridPoint:
    return GridPoint(row.wear, row.friction, row.speed_kmh)


def _derailed(runs: Sequence[Row]) -> int:
    return sum(row.ending is not None for row in runs)
