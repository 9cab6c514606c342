"""Where is the vehicle stable? Critical speed over wear and friction, and the best constant commands."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any, TypeVar

import numpy as np
from rich.console import Console

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.map import MapConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, heat_maps
from sayd_env.report.html import Grid, Page, Picture, Section, Text, Verdict
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import Row, rows
from sayd_env.runs.policies import PAPER, PASSIVE, PolicySpec, for_policy
from sayd_env.runs.rollouts import conditions, policy_runs
from sayd_env.stability import Crossing, critical_speed
from sayd_env.studies.adaptation import ConstantMap, constant_map

POLICIES = (PASSIVE, *PAPER)
DERAILED = 10.0
"""Ratio to a limit with which a derailed run counts, so that a crossing can be interpolated."""
RATIO = {"acceleration": "acceleration_ratio", "track_shift_force": "track_shift_ratio"}
"""Column of each criterion."""
CRITERIA = tuple(RATIO)
_CONSTANT_MAPS = {
    "map_best_constant": "Best constant command over speed, wheels and gauge, by weight of the force",
    "map_single": "What the best single command costs beside the best one of each condition",
}
LEAST_SEEDS = 5
"""Track realisations that a median needs."""
_FEW = f"medians of fewer than {LEAST_SEEDS} seeds: a look, not a verdict"
DIGITS = 6
"""Digits behind the point of a speed in km/h."""


@dataclass(frozen=True)
class MapGrid:
    """What the maps span."""

    wear: tuple[float, ...] = (0.0, 0.25, 0.5, 0.75, 1.0)
    friction: tuple[float, ...] = (0.2, 0.3, 0.4, 0.5)
    speeds: tuple[float, ...] = tuple(v / KMH for v in range(280, 441, 40))
    """On which the crossing is looked for, m/s; the middle of the interval that holds it is run, too."""


QUICK = MapGrid(
    wear=(0.0, 1.0),
    friction=(0.3, 0.5),
    speeds=tuple(v / KMH for v in (300, 360, 420)),
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


def rank(kmh: float | None, crossing: Crossing) -> float:
    """Place of a critical speed (km/h) among others; infinite beyond the grid of speeds."""
    if kmh is not None:
        return kmh
    return -math.inf if crossing is Crossing.BELOW_GRID else math.inf


Value = TypeVar("Value")


@dataclass(frozen=True)
class MapResult:
    """Maps over wear and friction."""

    scenario: Scenario
    grid: MapGrid
    seeds: tuple[int, ...]
    cells: list[Cell]
    constants: ConstantMap | None = None

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
            "seeds": list(self.seeds),
        } | ({"best_constant": [], "adaptation": []} if self.constants is None else self.constants.as_dict())

    def tables(self) -> dict[str, Table]:
        """Critical speeds and best commands, one line for each condition."""
        critical = [
            {"policy": cell.policy, "wear": cell.wear, "friction": cell.friction}
            | {"critical_speed_kmh": cell.lowest[0], "status": cell.status}
            | {f"by_{name}_kmh": cell.by_criterion[name][0] for name in CRITERIA}
            for cell in self.cells
        ]
        names = ("policy", "wear", "friction", "critical_speed_kmh", "status")
        columns = [Column(name) for name in (*names, *(f"by_{name}_kmh" for name in CRITERIA))]
        tables = {"critical_speed": csv_table(columns, critical)}
        return tables | ({} if self.constants is None else self.constants.tables())

    def plots(self) -> dict[str, Plot]:
        """Heat maps of the critical speed by policy, and of the best constant commands."""
        plots = {"map_critical_speed": self._critical_map()}
        return plots | ({} if self.constants is None else self.constants.plots())

    def page(self) -> Page:
        """Critical speeds and best commands, as maps and as tables."""
        table, *constants = self._listings()
        note = [Text(_FEW)] if len(self.seeds) < LEAST_SEEDS else []
        picture = Picture(
            "map_critical_speed", "Critical speed over wear and friction, a map for each policy"
        )
        sections = [Section("Critical speed", [picture, Grid.of(table, lambda _: picture.name), *note])]
        if self.constants is not None:
            pictures = [Picture(name, words) for name, words in _CONSTANT_MAPS.items()]
            tables = [Grid.of(each, lambda _: pictures[0].name) for each in constants]
            sections.append(Section("Best constant command", [*pictures, *tables]))
        return Page("Where the vehicle is stable", self._judged(), sections)

    def _judged(self) -> Verdict:
        """Critical speed of each policy where it is lowest and highest, and what a fixed command costs."""
        words = []
        for policy in self.policies:
            lowest = [cell.lowest for cell in self.cells if cell.policy == policy]
            ends = sorted(lowest, key=lambda found: rank(*found))
            low, high = self._verdict(*ends[0]), self._verdict(*ends[-1])
            words.append(
                f"{policy}: critical speed " + (low if low == high else f"from {low} to {high}") + " km/h."
            )
        if self.constants is not None:
            words.append(self.constants.worth())
        return Verdict(words)

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the critical speeds of all policies, then the best commands."""
        for listing in self._listings():
            listing.print(console, wide)
        if len(self.seeds) < LEAST_SEEDS:
            console.print(_FEW)

    def _listings(self) -> Iterator[Listing]:
        count = len(self.seeds)
        seeds = f"{count} seed{'s' if count > 1 else ''}"
        places = [("wear", "wear"), ("friction", "friction"), *((name, name) for name in self.policies)]
        rows = [
            {"wear": wear, "friction": mu}
            | {name: self._verdict(*self.cell(name, wear, mu).lowest) for name in self.policies}
            for wear, mu in product(self.grid.wear, self.grid.friction)
        ]
        title = f"critical speed (km/h), either limit: medians of {seeds}"
        yield Listing(title, [Column(*place) for place in places], rows)
        if self.constants is not None:
            yield from self.constants.listings()

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

        return partial(
            heat_maps,
            maps={policy: self._over_grid(partial(cell, policy)) for policy in self.policies},
            x=("friction", [f"{mu:g}" for mu in self.grid.friction]),
            y=("wear", [f"{wear:g}" for wear in self.grid.wear]),
            values="critical speed (km/h)",
            span=ends,
        )

    def _over_grid(self, read: Callable[[float, float], Value]) -> list[list[Value]]:
        return [[read(wear, mu) for mu in self.grid.friction] for wear in self.grid.wear]


def stability_map(
    scenario: Scenario,
    policies: Sequence[PolicySpec],
    seeds: Sequence[int] = range(2),
    *,
    grid: MapGrid | None = None,
    constants: MapConfig | None = None,
    environment: EnvironmentConfig | None = None,
    context: RunContext | None = None,
) -> MapResult:
    """Map critical speeds over wear and friction, and the best constant command over other conditions.

    Parameters
    ----------
    scenario : Scenario
        The configuration; wear and friction are those of the grid.
    policies : sequence of PolicySpec
        Policies whose critical speeds are mapped.
    seeds : sequence of int
        Track seeds; medians over them are judged.
    constants : MapConfig, optional
        Conditions for which the best constant command is looked for.
    environment : EnvironmentConfig, optional
        ``nominal`` by default.

    Raises
    ------
    ConfigError
        A policy that does not fit, a value outside its range.
    StudyError
        A run that diverged.
    """
    context, setup, chosen = context or RunContext(), environment or load_environment(), grid or MapGrid()
    if len(chosen.speeds) < 2:
        raise ConfigError("--speeds: a critical speed needs at least two speeds")
    model = VehicleModel(scenario)
    for speed in chosen.speeds:  # refused before any work, as policies are
        model.check_speed(speed)
    for policy in policies:
        for_policy(scenario, policy)
    best = None if constants is None else constant_map(scenario, constants, setup, context)
    cells = _Study(scenario, tuple(seeds), setup, context).critical(policies, chosen)
    return MapResult(scenario, chosen, tuple(seeds), cells, best)


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
