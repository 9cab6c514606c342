"""How do policies run the vehicle? Cost, EN 14363 ratios, forces, valves and comfort, side by side."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.scenario import Scenario
from sayd_env.envs.keywords import REWARDS
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import Row, rows
from sayd_env.runs.policies import PolicySpec
from sayd_env.runs.rollouts import conditions, own_policy, policy_runs

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

COSTS = (
    *("J", "J_acceleration", "J_force", "J_run"),
    *("J_offline", "J_offline_acceleration", "J_offline_force"),
)
RATIOS = ("acceleration_ratio", "track_shift_ratio")
FORCES = ("force_rms_n", "force_peak_n", "force_power_above_10_hz_n2")
VALVES = ("valve_mean", "valve_travel_per_km", "switching_per_s")
AVERAGED = (*COSTS, *RATIOS, *FORCES, "comfort", *VALVES)
"""Columns of a row that a summary averages."""


class Condition(NamedTuple):
    """What the runs of one line of the table have in common, beside the policy."""

    wear: float
    friction: float
    speed_kmh: float


class _Column(NamedTuple):
    """A column of the printed table."""

    name: str
    header: str
    scale: float = 1.0
    digits: int = 2
    best: bool = True
    """The lowest value stands out."""
    limit: float = math.inf


_COST_COLUMNS = (
    _Column("J", "J", digits=4),
    _Column("J_acceleration", "acceleration", digits=4),
    _Column("J_force", "force", digits=4),
    _Column("J_offline", "J off-line", digits=4),
    _Column("acceleration_ratio", "acc. / limit", limit=1.0),
    _Column("track_shift_ratio", "shift / limit", limit=1.0),
    _Column("comfort", "N_MV"),
)
_DAMPER_COLUMNS = (
    _Column("force_rms_n", "force RMS (kN)", 1e-3),
    _Column("force_peak_n", "peak (kN)", 1e-3, 1),
    _Column("force_power_above_10_hz_n2", "above 10 Hz (kN²)", 1e-6, 3),
    _Column("valve_mean", "mean V", best=False),
    _Column("valve_travel_per_km", "travel (1/km)", digits=1, best=False),
    _Column("switching_per_s", "switching (1/s)", digits=1, best=False),
)


@dataclass(frozen=True)
class EvaluateResult:
    """All runs of an evaluation."""

    scenario: Scenario
    rows: list[Row]

    @property
    def policies(self) -> tuple[str, ...]:
        """Policies in the order in which they were asked for."""
        return tuple(dict.fromkeys(row.policy for row in self.rows))

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """Conditions in the order of wear, friction and speed."""
        return tuple(sorted({_condition(row) for row in self.rows}))

    def runs(self, policy: str, condition: Condition | None = None) -> list[Row]:
        """Runs of a policy, of one condition or of all."""
        return [
            row
            for row in self.rows
            if row.policy == policy and (condition is None or _condition(row) == condition)
        ]

    def medians(self, policy: str, condition: Condition) -> dict[str, float]:
        """Medians over the seeds; NaN for what a policy does not have."""
        return _over(np.median, self.runs(policy, condition))

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd evaluate --json``."""
        return {
            "rows": [asdict(row) for row in self.rows],
            "summary": {policy: self._summary(policy) for policy in self.policies},
        }

    def tables(self) -> dict[str, tuple[Sequence[str], list[list[Any]]]]:
        """All runs, and the medians over the seeds that the printed table shows."""
        runs = [list(asdict(row).values()) for row in self.rows]
        medians = [
            [policy, *condition, *self.medians(policy, condition).values(), self._derailed(policy, condition)]
            for condition in self.conditions
            for policy in self.policies
        ]
        header = ("policy", *Condition._fields, *AVERAGED, "derailed")
        return {"runs": ([f.name for f in fields(Row)], runs), "medians": (header, medians)}

    def plots(self) -> dict[str, Callable[[Figure], None]]:
        """Cost, ratios, force and comfort over speed by policy, one picture for each wear and friction."""
        pairs = list(dict.fromkeys((c.wear, c.friction) for c in self.conditions))
        if len(pairs) == 1:
            return {"evaluate": lambda figure: self._draw(figure, *pairs[0])}
        return {
            f"evaluate_wear_{wear:g}_friction_{friction:g}": (
                lambda figure, pair=(wear, friction): self._draw(figure, *pair)  # type: ignore[misc]
            )
            for wear, friction in pairs
        }

    def summary(self, console: Console) -> None:
        """Print the medians over the seeds of each condition and policy, then each policy as a whole."""
        seeds = len({row.seed for row in self.rows})
        about = f"{self.scenario.vehicle.name}, medians of {seeds} seeds"
        console.print(self._table(f"{about}: cost (its terms unweighted), limits, comfort", _COST_COLUMNS))
        console.print(self._table(f"{about}: dampers and valves", _DAMPER_COLUMNS))
        console.print(self._policies_table())
        self._name_derailments(console)

    def _table(self, title: str, columns: Sequence[_Column]) -> Any:
        from rich.table import Table  # noqa: PLC0415 - only who prints pays for it

        table = Table(title=title)
        varied = [
            name for name in ("wear", "friction") if len({getattr(c, name) for c in self.conditions}) > 1
        ]
        for name in ("policy", "km/h", *varied, *(column.header for column in columns)):
            table.add_column(name, justify="left" if name == "policy" else "right", no_wrap=name == "policy")
        for condition in self.conditions:
            medians = {policy: self.medians(policy, condition) for policy in self.policies}
            for policy in self.policies:
                where = [f"{condition.speed_kmh:g}", *(f"{getattr(condition, name):g}" for name in varied)]
                cells = [_cell(column, policy, medians) for column in columns]
                table.add_row(policy, *where, *cells, end_section=policy == self.policies[-1])
        return table

    def _policies_table(self) -> Any:
        from rich.table import Table  # noqa: PLC0415 - only who prints pays for it

        table = Table(title=f"all {len(self.conditions)} conditions: means over the runs")
        for name in ("policy", "J", "J off-line", "largest ratio", "force (kN)", "N_MV", "derailed"):
            table.add_column(name, justify="left" if name == "policy" else "right")
        summaries = {policy: self._summary(policy) for policy in self.policies}
        columns = (
            _Column("J", "", digits=4),
            _Column("J_offline", "", digits=4),
            _Column("largest_ratio", "", limit=1.0),
            _Column("force_rms_n", "", 1e-3),
            _Column("comfort", ""),
        )
        for policy in self.policies:
            cells = [_cell(column, policy, summaries) for column in columns]
            count = len(self.runs(policy))
            table.add_row(policy, *cells, f"{summaries[policy]['derailed']:.0f} of {count}")
        return table

    def _name_derailments(self, console: Console) -> None:
        for policy in self.policies:
            for condition in self.conditions:
                if lost := self._derailed(policy, condition):
                    console.print(
                        f"[bold red]derailed[/]: {policy} at {condition.speed_kmh:g} km/h, wear "
                        f"{condition.wear:g}, friction {condition.friction:g}: {lost} of "
                        f"{len(self.runs(policy, condition))} runs; they count with infinite ratios and with "
                        "the environment's charge in J"
                    )

    def _derailed(self, policy: str, condition: Condition | None = None) -> int:
        return sum(row.ending is not None for row in self.runs(policy, condition))

    def _summary(self, policy: str) -> dict[str, float]:
        """Means over all runs; the largest median of either ratio; how many runs derailed."""
        largest = max(
            max(m[name] for name in RATIOS) for m in (self.medians(policy, c) for c in self.conditions)
        )
        means = _over(np.mean, self.runs(policy))
        return means | {"largest_ratio": largest, "derailed": float(self._derailed(policy))}

    def _draw(self, figure: Figure, wear: float, friction: float) -> None:
        panels = (
            ("J", 1.0, "J, on-line filter"),
            ("acceleration_ratio", 1.0, "acceleration, RMS over limit"),
            ("J_acceleration", 1.0, "acceleration's part of J, unweighted"),
            ("track_shift_ratio", 1.0, "track shift force, RMS over limit"),
            ("J_force", 1.0, "force's part of J, unweighted"),
            ("force_rms_n", 1e-3, "yaw damper force, RMS (kN)"),
            ("J_offline", 1.0, "J, off-line filter"),
            ("comfort", 1.0, "comfort index N_MV"),
        )
        figure.set_size_inches(10.0, 12.0)
        figure.suptitle(
            f"{self.scenario.vehicle.name}, wear {wear:g}, friction {friction:g}: medians and seeds"
        )
        axes = figure.subplots(4, 2, sharex=True).ravel()
        for axis, (name, scale, label) in zip(axes, panels, strict=True):
            for policy in self.policies:
                self._draw_policy(axis, policy, (wear, friction), name, scale)
            if name in RATIOS:
                axis.axhline(1.0, color="k", linestyle="--", linewidth=1.0)
            if name in COSTS:  # a hunting vehicle costs a hundred times as much
                axis.set_yscale("log")
            else:
                axis.set_ylim(bottom=0.0)
            axis.set_ylabel(label)
            axis.grid(alpha=0.3)
        for axis in axes[-2:]:
            axis.set_xlabel("speed (km/h)")
        axes[0].legend(fontsize="small")

    def _draw_policy(
        self, axis: Axes, policy: str, pair: tuple[float, float], name: str, scale: float
    ) -> None:
        """Draw medians over speed with the seeds behind them; infinite values leave gaps."""
        chosen = [c for c in self.conditions if (c.wear, c.friction) == pair]
        speeds = [c.speed_kmh for c in chosen]
        values = np.array([scale * self.medians(policy, c)[name] for c in chosen])
        (line,) = axis.plot(speeds, np.where(np.isfinite(values), values, np.nan), "o-", label=policy)
        runs = [(c.speed_kmh, scale * getattr(row, name)) for c in chosen for row in self.runs(policy, c)]
        finite = [(speed, value) for speed, value in runs if math.isfinite(value)]
        axis.plot(*zip(*finite, strict=True), ".", color=line.get_color(), markersize=2) if finite else None


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
    scenario : Scenario
        The configuration.
    speeds : sequence of float
        Speeds, m/s.
    seeds : sequence of int
        Track seeds, the same for every policy and condition.
    policies : sequence of PolicySpec
        By default what the scenario's dampers do by themselves: passive ones, or semi-active ones at the
        constant current of their configuration.
    wear, friction : sequence of float
        In place of the scenario's.
    environment : EnvironmentConfig
        Sensors, control period, length of an episode, charge for a derailment; ``nominal`` by default.
    initial_current : float
        Valve command of the run-in.
    context : RunContext, optional

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, a profile that cannot be used, a policy that does not fit.
    StudyError
        A run that diverged.
    """
    specs = tuple(policies) or (own_policy(scenario),)
    runs = list(
        policy_runs(
            specs,
            conditions(scenario, wear, friction),
            speeds,
            seeds,
            environment or load_environment(),
            initial_current=initial_current,
        )
    )
    return EvaluateResult(scenario, rows(runs, context or RunContext()))


def with_reward(scenario: Scenario, reward: str) -> Scenario:
    """Scenario whose cost has the weights of a named reward, as the keyword ``reward`` of the environment.

    Raises
    ------
    ConfigError
        An unknown name.
    """
    if reward not in REWARDS:
        raise ConfigError(f"--reward {reward}: expected {' or '.join(REWARDS)}")
    weights = REWARDS[reward]
    if weights is None:
        return scenario
    cost = scenario.cost.model_copy(update={"acceleration_weight": weights[0], "force_weight": weights[1]})
    return scenario.model_copy(update={"cost": cost})


def _condition(row: Row) -> Condition:
    return Condition(row.wear, row.friction, row.speed_kmh)


def _over(statistic: Callable[[Any], Any], rows: Sequence[Row]) -> dict[str, float]:
    values = {name: [getattr(row, name) for row in rows] for name in AVERAGED}
    return {name: math.nan if None in column else float(statistic(column)) for name, column in values.items()}


def _cell(column: _Column, policy: str, found: dict[str, dict[str, float]]) -> str:
    """Value of a policy; the best one in bold, one beyond its limit in red, an infinite one in words."""
    value = found[policy][column.name]
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "[bold red]derailed[/]"
    text = f"{column.scale * value:.{column.digits}f}"
    others = [each[column.name] for each in found.values() if not math.isnan(each[column.name])]
    bold = column.best and len(found) > 1 and value == min(others)
    style = " ".join(word for word, on in (("bold", bold), ("red", value > column.limit)) if on)
    return f"[{style}]{text}[/]" if style else text
