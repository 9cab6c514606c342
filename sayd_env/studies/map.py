"""Where is the vehicle stable? Critical speed over wear and friction, and the best constant current."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.throttle import overlap
from sayd_env.report.columns import Column, Table, csv_table, print_table
from sayd_env.report.figures import Plot, heat_maps
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import Row, rows
from sayd_env.runs.policies import PAPER, PASSIVE, PolicySpec, constant_spec, for_policy
from sayd_env.runs.rollouts import conditions, policy_runs
from sayd_env.stability import Crossing, critical_speed

if TYPE_CHECKING:
    from rich.console import Console

POLICIES = (PASSIVE, *PAPER)
DERAILED = 10.0
"""Ratio to a limit with which a derailed run counts, so that a crossing can be interpolated."""
RATIO = {"acceleration": "acceleration_ratio", "track_shift_force": "track_shift_ratio"}
"""Column of each criterion."""
CRITERIA = tuple(RATIO)
LEAST_SEEDS = 5
"""Track realisations that a median needs."""
DIGITS = 6
"""Digits behind the point of a constant current."""


@dataclass(frozen=True)
class MapGrid:
    """What the maps span."""

    wear: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)
    friction: tuple[float, ...] = (0.2, 0.3, 0.4, 0.5)
    speeds: tuple[float, ...] = tuple(v / KMH for v in range(280, 441, 40))
    """On which the crossing is looked for, m/s; the middle of the interval that holds it is run, too."""
    condition_speeds: tuple[float, ...] = (300 / KMH, 400 / KMH)
    """For which the best constant current is looked for, m/s."""
    openings: tuple[float, ...] = (0.05, 0.1, 0.15, 0.25, 0.4, 1.0)
    """Constant currents tried everywhere besides 0, as shares of the valve's travel beyond its overlap.

    Dense where the valve is nearly closed, for there the damper's force changes most.
    """
    refinements: int = 1
    """How often the steps between the currents are halved around the best one."""


QUICK = MapGrid(
    wear=(0.0, 1.0),
    friction=(0.3, 0.5),
    speeds=tuple(v / KMH for v in (300, 360, 420)),
    condition_speeds=(350 / KMH,),
    openings=(0.1, 0.4, 1.0),
    refinements=1,
)
"""For a look at what comes out, within a minute or two."""


@dataclass(frozen=True)
class Cell:
    """Critical speed of one policy for one wear and friction."""

    policy: str
    wear: float
    friction: float
    by_criterion: Mapping[str, tuple[float | None, Crossing]]
    """Critical speed (km/h) by each criterion, and how the quantity runs over the grid."""
    ratios: Mapping[str, Mapping[float, tuple[float, ...]]] = field(default_factory=dict)
    """Ratio of each seed to the limit, by criterion and speed (km/h)."""

    @property
    def lowest(self) -> tuple[float | None, Crossing]:
        """The lower one of both, km/h."""
        found = [each for each in self.by_criterion.values() if each[1] is not Crossing.NOT_REACHED]
        below_first = [-math.inf if kmh is None else kmh for kmh, _ in found]
        return found[int(np.argmin(below_first))] if found else (None, Crossing.NOT_REACHED)

    @property
    def status(self) -> str:
        """How the quantities run over the grid."""
        return self.lowest[1].name.lower()


class BestConstant(NamedTuple):
    """Best constant current for one condition."""

    speed_kmh: float
    wear: float
    friction: float
    current: float
    """With the lowest J by the on-line filter."""
    J: float
    current_offline: float
    """With the lowest J by the off-line filter."""
    J_offline: float
    J_closed: float
    """J of a closed valve."""
    J_open: float
    """J of an open valve."""


BEST = (
    Column("speed_kmh", "km/h", digits=0),
    Column("wear", "wear"),
    Column("friction", "friction"),
    Column("current", "current"),
    Column("J", "J", digits=4),
    Column("current_offline", "off line"),
    Column("J_offline", "J off-line", digits=4),
    Column("J_closed", "J closed", digits=4),
    Column("J_open", "J open", digits=4),
)
"""Of the table of best constant currents."""
Value = TypeVar("Value")


@dataclass(frozen=True)
class MapResult:
    """Maps over wear and friction."""

    scenario: Scenario
    grid: MapGrid
    seeds: tuple[int, ...]
    cells: list[Cell]
    best: list[BestConstant]

    @property
    def policies(self) -> tuple[str, ...]:
        """Policies of the maps of critical speeds."""
        return tuple(dict.fromkeys(cell.policy for cell in self.cells))

    def cell(self, policy: str, wear: float, friction: float) -> Cell:
        """Critical speed of one policy for one wear and friction."""
        key = (policy, wear, friction)
        return next(c for c in self.cells if (c.policy, c.wear, c.friction) == key)

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd map --json``; tables are lists over wear of lists over friction."""

        def table(read: Callable[[Cell], Any]) -> dict[str, list[list[Any]]]:
            return {p: self._over_grid(lambda *place, p=p: read(self.cell(p, *place))) for p in self.policies}

        return {
            "critical_speed_kmh": table(lambda cell: cell.lowest[0]),
            "status": table(lambda cell: cell.status),
            "by_criterion": {
                name: table(lambda cell, name=name: cell.by_criterion[name][0])  # type: ignore[misc]
                for name in CRITERIA
            },
            "wear": list(self.grid.wear),
            "friction": list(self.grid.friction),
            "speeds_kmh": [v * KMH for v in self.grid.speeds],
            "best_constant": [_best_dict(entry) for entry in self.best],
            "seeds": list(self.seeds),
        }

    def tables(self) -> dict[str, Table]:
        """Critical speeds and best currents, one line for each condition."""
        critical = [
            {"policy": cell.policy, "wear": cell.wear, "friction": cell.friction}
            | {"critical_speed_kmh": cell.lowest[0], "status": cell.status}
            | {f"by_{name}_kmh": cell.by_criterion[name][0] for name in CRITERIA}
            for cell in self.cells
        ]
        names = ("policy", "wear", "friction", "critical_speed_kmh", "status")
        columns = [Column(name) for name in (*names, *(f"by_{name}_kmh" for name in CRITERIA))]
        tables = {"critical_speed": csv_table(columns, critical)}
        return tables | ({"best_constant": csv_table(BEST, self.best)} if self.best else {})

    def plots(self) -> dict[str, Plot]:
        """Heat maps of the critical speed by policy, and of the best constant current by speed."""
        plots = {"map_critical_speed": self._critical_map()}
        return plots | ({"map_best_constant": self._best_map()} if self.best else {})

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the critical speeds of all policies, then the best currents."""
        count = len(self.seeds)
        seeds = f"{count} seed{'s' if count > 1 else ''}"
        places = [("wear", "wear"), ("friction", "friction"), *((name, name) for name in self.policies)]
        rows = [
            {"wear": wear, "friction": mu}
            | {name: self._verdict(*self.cell(name, wear, mu).lowest) for name in self.policies}
            for wear, mu in product(self.grid.wear, self.grid.friction)
        ]
        title = f"critical speed (km/h), either limit: medians of {seeds}"
        print_table(console, title, [Column(*place) for place in places], rows, wide=wide)
        if self.best:
            title = "best constant current, by J on line and off line"
            print_table(console, title, BEST, self.best, wide=wide)
        if count < LEAST_SEEDS:
            console.print(f"medians of fewer than {LEAST_SEEDS} seeds: a look, not a verdict")

    def _verdict(self, kmh: float | None, crossing: Crossing) -> str:
        if crossing is Crossing.NOT_REACHED:
            return f"> {self.grid.speeds[-1] * KMH:.0f}"
        return f"< {self.grid.speeds[0] * KMH:.0f}" if kmh is None else f"{kmh:.0f}"

    def _critical_map(self) -> Plot:
        ends = self.grid.speeds[0] * KMH, self.grid.speeds[-1] * KMH

        def cell(policy: str, wear: float, mu: float) -> tuple[float, str]:
            kmh, crossing = self.cell(policy, wear, mu).lowest
            shown = ends[crossing is Crossing.NOT_REACHED] if kmh is None else kmh
            return shown, self._verdict(kmh, crossing)

        return self._map({policy: policy for policy in self.policies}, cell, "critical speed (km/h)", ends)

    def _best_map(self) -> Plot:
        found = {entry[:3]: entry for entry in self.best}

        def cell(speed: float, wear: float, mu: float) -> tuple[float, str]:
            best = found[speed, wear, mu]
            return best.current, f"{best.current:.2g}\nJ {best.J:.3f}"

        speeds = sorted({entry.speed_kmh for entry in self.best})
        titles = {f"{speed:.0f} km/h": speed for speed in speeds}
        return self._map(titles, cell, "best constant current", (0.0, 1.0))

    def _over_grid(self, read: Callable[[float, float], Value]) -> list[list[Value]]:
        return [[read(wear, mu) for mu in self.grid.friction] for wear in self.grid.wear]

    def _map(
        self,
        titles: Mapping[str, Any],
        cell: Callable[[Any, float, float], tuple[float, str]],
        values: str,
        span: tuple[float, float],
    ) -> Plot:
        """Heat maps side by side of what `cell` reads for what each title stands for."""
        return partial(
            heat_maps,
            maps={title: self._over_grid(partial(cell, which)) for title, which in titles.items()},
            x=("friction", [f"{mu:g}" for mu in self.grid.friction]),
            y=("wear", [f"{wear:g}" for wear in self.grid.wear]),
            values=values,
            span=span,
        )


def stability_map(
    scenario: Scenario,
    policies: Sequence[PolicySpec],
    seeds: Sequence[int] = range(2),
    *,
    grid: MapGrid | None = None,
    best_constant: bool = True,
    environment: EnvironmentConfig | None = None,
    context: RunContext | None = None,
) -> MapResult:
    """Map critical speeds over wear and friction, and the best constant current for each condition.

    Parameters
    ----------
    scenario : Scenario
        The configuration; wear and friction are those of the grid.
    policies : sequence of PolicySpec
        Policies whose critical speeds are mapped.
    seeds : sequence of int
        Track seeds; medians over them are judged.
    grid : MapGrid, optional
    best_constant : bool
        Whether the best constant current is looked for, too.
    environment : EnvironmentConfig, optional
        ``nominal`` by default.
    context : RunContext, optional

    Raises
    ------
    ConfigError
        A policy that does not fit, a value outside its range.
    StudyError
        A run that diverged.
    """
    study = _Study(scenario, tuple(seeds), environment or load_environment(), context or RunContext())
    chosen = grid or MapGrid()
    if len(chosen.speeds) < 2 and policies:
        raise ConfigError("--speeds: a critical speed needs at least two speeds")
    asked = (*(chosen.speeds if policies else ()), *(chosen.condition_speeds if best_constant else ()))
    model = VehicleModel(scenario)
    for speed in asked:
        model.check_speed(speed)  # refused before any work
    cells = study.critical(policies, chosen) if policies else []
    best = study.best_constant(chosen) if best_constant else []
    return MapResult(scenario, chosen, tuple(seeds), cells, best)


Place = tuple[float, float, float]
"""Speed (m/s), wear, friction."""


@dataclass
class _Study:
    """Runs of the maps: each once, whoever asks for it."""

    scenario: Scenario
    seeds: tuple[int, ...]
    environment: EnvironmentConfig
    context: RunContext
    found: dict[tuple[str, float, float], dict[float, list[Row]]] = field(default_factory=dict)
    """By policy, wear and friction; by speed (m/s)."""

    def critical(self, policies: Sequence[PolicySpec], grid: MapGrid) -> list[Cell]:
        """Critical speeds on the grid and, where a limit is crossed, on it with the interval halved."""
        places = list(product(policies, grid.wear, grid.friction))
        self._run(((spec, w, mu, v) for (spec, w, mu), v in product(places, grid.speeds)), "grid of speeds")
        middles = [
            (spec, w, mu, middle)
            for spec, w, mu in places
            for column in RATIO.values()
            if (middle := _middle(self.found[spec.title, w, mu], grid.speeds, column)) is not None
        ]
        self._run(middles, "around the crossings")
        return [self._cell(spec.title, w, mu) for spec, w, mu in places]

    def _cell(self, policy: str, wear: float, friction: float) -> Cell:
        runs = self.found[policy, wear, friction]
        speeds = sorted(runs)
        ratios = {
            name: {round(v * KMH, DIGITS): tuple(getattr(run, column) for run in runs[v]) for v in speeds}
            for name, column in RATIO.items()
        }
        crossings = {name: _crossing(runs, speeds, column) for name, column in RATIO.items()}
        return Cell(policy, wear, friction, crossings, ratios)

    def best_constant(self, grid: MapGrid) -> list[BestConstant]:
        """Best constant currents: a grid, then halfway to the neighbours of the best one, and again."""
        closed = self._overlap()
        nodes = {0.0, *(round(closed + (1.0 - closed) * share, DIGITS) for share in grid.openings)}
        places = list(product(grid.condition_speeds, grid.wear, grid.friction))
        tried = {place: set(nodes) for place in places}
        self._run_currents(tried)
        for _ in range(grid.refinements):
            for place, currents in tried.items():
                best = {self._lowest(name, place, currents)[0] for name in ("J", "J_offline")}
                currents |= {new for current in best for new in halfway(current, currents, closed)}
            self._run_currents(tried)
        return [self._best(place, tried[place]) for place in places]

    def _overlap(self) -> float:
        """Current up to which the valve stays closed."""
        damper = for_policy(self.scenario, constant_spec(0.0)).damper
        assert isinstance(damper, SaydDamperConfig)  # `for_policy` sees to it
        return overlap(damper.throttle)

    def _best(self, place: Place, currents: set[float]) -> BestConstant:
        on_line, off_line = (self._lowest(name, place, currents) for name in ("J", "J_offline"))
        ends = [self._cost("J", place, current) for current in (min(currents), max(currents))]
        speed, wear, friction = place
        return BestConstant(round(speed * KMH, 6), wear, friction, *on_line, *off_line, *ends)

    def _lowest(self, name: str, place: Place, currents: Iterable[float]) -> tuple[float, float]:
        cost, current = min((self._cost(name, place, current), current) for current in currents)
        return current, cost

    def _cost(self, name: str, place: Place, current: float) -> float:
        speed, wear, friction = place
        return _median(name, self.found[constant_spec(current).title, wear, friction][speed])

    def _run_currents(self, tried: Mapping[Place, Iterable[float]]) -> None:
        cases = [
            (constant_spec(current), wear, mu, speed)
            for (speed, wear, mu), currents in tried.items()
            for current in sorted(currents)
        ]
        self._run(cases, "constant currents")

    def _run(self, cases: Iterable[tuple[PolicySpec, float, float, float]], what: str) -> None:
        """Run what has not been run before."""
        asked: dict[tuple[str, float, float], tuple[PolicySpec, dict[float, None]]] = {}
        for spec, wear, mu, speed in cases:
            if speed not in self.found.get((spec.title, wear, mu), {}):
                asked.setdefault((spec.title, wear, mu), (spec, {}))[1][speed] = None
        runs = [
            run
            for (_, wear, mu), (spec, speeds) in asked.items()
            for run in policy_runs(
                [spec], conditions(self.scenario, [wear], [mu]), list(speeds), self.seeds, self.environment
            )
        ]
        for run, row in zip(runs, rows(runs, self.context, what), strict=True):
            place = run.policy.title, run.scenario.wear, run.scenario.friction
            self.found.setdefault(place, {}).setdefault(run.speed, []).append(row)


def _median(name: str, runs: Sequence[Row]) -> float:
    return float(np.median([getattr(run, name) for run in runs]))


def _crossing(
    runs: Mapping[float, Sequence[Row]], speeds: Sequence[float], column: str
) -> tuple[float | None, Crossing]:
    """Critical speed (km/h) from the medians of a ratio at some of the speeds."""
    ratios = [min(_median(column, runs[speed]), DERAILED) for speed in speeds]
    found = critical_speed(np.array(speeds), np.array(ratios), 1.0)
    return None if found.speed is None else found.speed * KMH, found.crossing


def _middle(runs: Mapping[float, Sequence[Row]], speeds: Sequence[float], column: str) -> float | None:
    """Middle of the interval of the grid in which a ratio passes 1, m/s."""
    kmh, _ = _crossing(runs, speeds, column)
    if kmh is None:
        return None
    i = min(int(np.searchsorted(speeds, kmh / KMH)), len(speeds) - 1)
    return round(0.5 * (speeds[i - 1] + speeds[i]) * KMH, 6) / KMH


def halfway(current: float, currents: Iterable[float], closed: float) -> list[float]:
    """Currents halfway between one and its neighbours; up to `closed` all act as one."""
    ends = sorted({max(each, closed) for each in currents})
    place = ends.index(max(current, closed))
    around = ends[max(place - 1, 0) : place + 2]
    return [round(0.5 * (low + high), DIGITS) for low, high in pairwise(around)]


def _best_dict(entry: BestConstant) -> dict[str, Any]:
    content = entry._asdict()
    names = ("speed_kmh", "wear", "friction")
    return {"condition": {name: content.pop(name) for name in names}, **content}
