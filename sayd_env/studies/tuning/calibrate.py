"""What the paper leaves open, found within sourced ranges from its statements.

First the vehicle from rows P1 to P10, and so that semi-active dampers can hold it at 400 km/h; then damper,
valve and controllers from rows M1 to M9 and S1 to S5. In each stage a search by response surfaces looks over
the whole ranges with few tracks and short runs; others go on from its best place with more of them, in boxes
that become smaller. Residuals are those of `sayd_env.studies.tuning.targets`; crossings are extrapolated
beyond the grid of speeds, so that a search can start anywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from sayd_env.config import StudyError
from sayd_env.config.calibration import CalibrationConfig, Parameter, Search, Stage
from sayd_env.config.control import load_controller
from sayd_env.config.damper import load_sayd
from sayd_env.config.environment import load_environment
from sayd_env.config.reproduction import load_reproduction
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.units import KMH, Array
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, legend_below, panels
from sayd_env.runs.context import Progress, RunContext
from sayd_env.runs.controlled import ControlledRun, ControlledRuns, assessed_controlled
from sayd_env.runs.passive import Assessed, PassiveRun, assessed, assessed_or_derailed, gathered
from sayd_env.runs.policies import PAPER, PolicySpec
from sayd_env.runs.rollouts import Run, environment_of
from sayd_env.studies.paper.controlled_claims import (
    CLOSED,
    MPPT1,
    MPPT2,
    ControlledMeasures,
    required_runs,
)
from sayd_env.studies.paper.reproduce import row_policies
from sayd_env.studies.tuning.parts import part_files
from sayd_env.studies.tuning.search import as_yaml, best_of, draw_costs
from sayd_env.studies.tuning.targets import (
    FREQUENCY,
    MPPT1_400,
    MPPT2_300,
    NEW,
    ROWS_OF_CONTROLLERS,
    ROWS_OF_VEHICLE,
    ROWS_WITH_CONTROL,
    WORN,
    WORN_FORCE,
    Measures,
    Residuals,
    controlled_residuals,
    passive_residuals,
    valve_positions,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

PRIOR = 0.02
"""Weight of a parameter's distance from the middle of its range: settles what the rows do not."""
KNEE = 3.0
"""Residual from which on it counts by its logarithm."""
LOST = 50.0
"""Residual of numbers with which a run does not stay finite, or derails."""
SMOOTHING = 0.1
"""Of the response surfaces: what differs less than places do is taken for chance."""
KEPT = 0.75
"""Share of the trials that surfaces drawn from them pass."""
PLACES = 4
"""So many are tried at a time."""
CONTROL = "control."
HELD = (0.05, 0.3)
"""Fixed commands with which a vehicle shows whether semi-active dampers can hold it at 400 km/h.

The first is about where MPPT1 rests there (figure 12)."""
WORST = 50.0
"""m/s2, acceleration with which a derailed run counts."""

Place = tuple[float, ...]
"""In the unit cube of a stage's ranges."""
Outcome = tuple[Residuals, Measures]


@dataclass(frozen=True)
class Trial:
    """One set of numbers and what came out."""

    stage: str
    place: Place
    residuals: Residuals
    measures: Measures

    @property
    def cost(self) -> float:
        """Sum of the squared residuals, large ones counted by their logarithm."""
        return float(np.sum(np.square(damped(self))))


def damped(trial: Trial) -> Array:
    """Residuals whose large values grow as logarithms, so that no lost row outweighs all others."""
    return np.asarray(KNEE * np.arcsinh(np.array(list(trial.residuals.values())) / KNEE))


@dataclass(frozen=True)
class CalibrationResult:
    """All evaluations, in the order in which they were made, and what each number does."""

    config: CalibrationConfig
    trials: dict[str, list[Trial]]
    """By stage, ``passive`` and ``semi_active``."""
    sensitivity: list[dict[str, Any]]

    def best(self, stage: str) -> Trial:
        """Best evaluation of the last search of a stage."""
        return best_of(self.trials[stage], self.trials[stage][-1].stage)

    def values(self, stage: str) -> dict[str, float]:
        """Calibrated value of each parameter of a stage, in its unit."""
        return self._stages()[stage].values(self.best(stage).place)

    def files(self, command: str, commit: str) -> dict[str, str]:
        """Parts with the calibrated numbers, as `configs/` holds them, by their paths there.

        Parameters
        ----------
        command, commit : str
            How to repeat it.
        """
        about = {
            "command": command,
            "commit": commit,
            "track_seeds": f"{self.config.first_seed} to {self.config.first_seed + self._seeds() - 1}",
            "evaluations": sum(len(trials) for trials in self.trials.values()),
        }
        found: dict[str, str] = {}
        for name in self.trials:
            cost = {"cost": f"{self.best(name).cost:.3g}"}
            found |= part_files(self.config, name, self.values(name), about | cost)
        return found

    def as_dict(self) -> dict[str, Any]:
        """Of each stage the parameters, the assignments that set them, and residuals at the best point."""
        return {
            name: {
                "parameters": self.values(name),
                "set": stage.assignments(self.values(name)),
                "cost": self.best(name).cost,
                "residuals": self.best(name).residuals,
                "measures": self.best(name).measures,
                "evaluations": len(self.trials[name]),
            }
            for name, stage in self._stages().items()
        } | {"sensitivity": self.sensitivity}

    def tables(self) -> dict[str, Table]:
        """Every evaluation of each stage, and the sensitivities."""
        return {
            **{f"evaluations_{name}": self._evaluations(name) for name in self.trials},
            "sensitivity": csv_table(SENSITIVITY, self.sensitivity),
        }

    def plots(self) -> dict[str, Plot]:
        """Cost over the search."""
        return {"cost": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print calibrated values, what is left of each row's residual, and the sensitivities."""
        for name, stage in self._stages().items():
            values, best = self.values(name), self.best(name)
            rows = [p.model_dump() | {"value": values[p.name]} for p in stage.parameters]
            title = f"{name.replace('_', '-')}: cost {best.cost:.3f} ({best.stage})"
            Listing(title, PARAMETERS, rows).print(console, wide)
            left = {k: round(v, 2) for k, v in best.residuals.items() if abs(v) > 0.005}
            console.print(f"residuals left: {left or 'none'}")
        title = f"what follows where one number moves by {self.config.sensitivity.share:.0%} of its range"
        Listing(title, SENSITIVITY, self.sensitivity).print(console, wide)

    def _stages(self) -> dict[str, Stage]:
        return {name: getattr(self.config, name) for name in self.trials}

    def _seeds(self) -> int:
        return max(search.seeds for stage in self._stages().values() for search in stage.searches)

    def _evaluations(self, name: str) -> Table:
        trials, stage = self.trials[name], self._stages()[name]
        rows = sorted({row for trial in trials for row in trial.residuals})
        parameters = [p.name for p in stage.parameters]
        lines = [
            [t.stage, t.cost, *stage.values(t.place).values(), *map(t.residuals.get, rows)] for t in trials
        ]
        return ("stage", "cost", *parameters, *rows), lines

    def _draw(self, figure: Figure) -> None:
        each = panels(figure, len(self.trials), size=(8.0, 4.5))
        for axes, (name, trials) in zip(each, self.trials.items(), strict=True):
            draw_costs(axes, trials)
            axes.set(ylabel="cost", title=name.replace("_", "-"), yscale="symlog")
            axes.yaxis.set_major_formatter("{x:g}")
        legend_below(figure, *each)


PARAMETERS = (
    Column("name", "parameter"),
    Column("value", "value"),
    Column("unit", "unit"),
    Column("low", "from"),
    Column("high", "to"),
    Column("source", "source", wide=True),
)
"""Of the printed tables of calibrated numbers."""
QUANTITIES = {
    NEW: Column(NEW, "new km/h", digits=0),
    WORN: Column(WORN, "worn km/h", digits=0),
    WORN_FORCE: Column(WORN_FORCE, "worn, force km/h", digits=0),
    FREQUENCY: Column(FREQUENCY, "Hz", digits=2),
    MPPT1_400: Column(MPPT1_400, "MPPT1 %", digits=1),
    MPPT2_300: Column(MPPT2_300, "MPPT2 %", digits=1),
}
"""What the table of sensitivities shows."""
SENSITIVITY = (
    Column("name", "parameter"),
    Column("value", "value"),
    Column("unit", "unit"),
    *QUANTITIES.values(),
)
"""Of the table of what each number does."""
RESTING = ((MPPT1, 400 / KMH, CLOSED), (MPPT2, 300 / KMH, CLOSED))
"""Runs whose valves come to rest in figures 12 and 14."""


def calibrate(
    config: CalibrationConfig, *, seed: int = 0, context: RunContext | None = None
) -> CalibrationResult:
    """Search for the numbers that meet most rows: first the passive vehicle, then dampers and controllers.

    Parameters
    ----------
    seed : int
        Where the searches begin: 0 in the middle of every range, others at a random place; of their random
        draws as well, not of the tracks.

    Raises
    ------
    ConfigError
        A file of a controller that no row is about; a damper that is not semi-active; a key, or an end of a
        range, that cannot be used.
    StudyError
        No numbers gave a finite run.
    """
    context = context or RunContext()
    row_policies(config.controllers)
    for end in (0.0, 0.5, 1.0):  # hours before a run would need them
        vehicle = config.passive.values([end] * len(config.passive.parameters))
        _SemiActive(config, vehicle, context).check(end)
    stages = config.passive, config.semi_active
    planned = sum(search.evaluations for stage in stages for search in stage.searches)
    progress = _Evaluations(context.progress, planned + sum(_of_sensitivity(config)))
    runs = replace(context, progress=progress.within)
    passive = _Passive(config, runs)
    found = {"passive": _searched("passive", config.passive, passive.outcomes, seed, progress)}
    best = best_of(found["passive"], found["passive"][-1].stage)
    semi_active = _SemiActive(config, config.passive.values(best.place), runs)
    found["semi_active"] = _searched("semi_active", config.semi_active, semi_active.outcomes, seed, progress)
    result = CalibrationResult(config, found, [])
    return replace(result, sensitivity=_sensitivity(passive, semi_active, result, progress))


@dataclass
class _Evaluations:
    """Reports progress: evaluations that were made of those that can be."""

    progress: Progress
    total: int
    """Evaluations without those of further starts, which `more` adds."""
    done: int = 0
    under_way: int = 0
    words: str = ""
    shown: int = 0
    """Evaluations that were reported: runs that are made once more do not count again."""

    def begin(self, what: str, count: int) -> None:
        """Report the evaluations that follow."""
        self.words, self.under_way = what, count
        self.within(0.0, 1.0)

    def within(self, done: float, total: float, what: str = "") -> None:
        """Report how many of their runs are made."""
        del what  # of single runs
        reached = self.done + math.floor(self.under_way * done / total)
        self.shown = max(self.shown, min(reached, self.total))
        self.progress(self.shown, self.total, self.words)

    def end(self, outcome: str = "") -> None:
        """Report that they are made, and what came of them."""
        self.done, self.under_way = self.done + self.under_way, 0
        self.words += outcome
        self.within(0.0, 1.0)

    def more(self, searches: Iterable[Search]) -> None:
        """Count searches that were not foreseen."""
        self.total += sum(search.evaluations for search in searches)


Evaluate = Callable[[Sequence[Place], int, float], list[Outcome]]
"""Places, number of seeds and assessed distance (m) -> what comes out at each."""


def _searched(name: str, stage: Stage, evaluate: Evaluate, seed: int, progress: _Evaluations) -> list[Trial]:
    """Search the ranges of a stage from one start or more, then on from the best of their ends."""
    trials: list[Trial] = []
    *wide, last = stage.searches

    def searched(search: Search, place: Array, start: int) -> Trial:
        what = f"{name}, {search.name}" + (f" {start + 1}" if start else "")

        def tried(places: Iterable[Array]) -> list[Trial]:
            keys = [tuple(round(float(u), 6) for u in np.clip(place, 0.0, 1.0)) for place in places]
            progress.begin(what, len(keys))
            outcomes = evaluate(keys, search.seeds, search.length)
            new = [Trial(what, key, *outcome) for key, outcome in zip(keys, outcomes, strict=True)]
            trials.extend(new)
            progress.end(f", best cost {best_of(trials, what).cost:.2f}")
            return new

        best = _search(search, place, lambda row: _columns(stage, row), tried, _random(seed, start))
        if LOST in best.residuals.values():
            raise StudyError(f"calibration, {name}: no numbers within the ranges gave a finite run")
        return best

    ends: list[Trial] = []
    for start in range(stage.starts if wide else 0):
        if start > 0:
            progress.more(wide)
        place = _start(seed, start, len(stage.parameters))
        for search in wide:
            end = searched(search, place, start)
            place = np.array(end.place)
        ends.append(end)
        if end.cost <= stage.good_cost:
            break
    place = np.array(best_of(ends).place) if ends else _start(seed, 0, len(stage.parameters))
    searched(last, place, 0)
    return trials


def _random(seed: int, start: int) -> int | tuple[int, int]:
    """Seed of the random draws of one start."""
    return (seed, start) if start else seed


def _start(seed: int, start: int, count: int) -> Array:
    """Where a search begins: in the middle of every range, or at a random place."""
    if seed == start == 0:
        return np.full(count, 0.5)
    return np.random.default_rng(_random(seed, start)).random(count)


def _columns(stage: Stage, row: str) -> tuple[int, ...]:
    """Parameters on which a row depends: all but those of controllers that do not run in it."""
    others = [f"{CONTROL}{name}." for name, rows in ROWS_OF_CONTROLLERS.items() if row not in rows]
    return tuple(
        i
        for i, parameter in enumerate(stage.parameters)
        if not next(iter(parameter.keys)).startswith(tuple(others))
    )


def _search(
    search: Search,
    start: Array,
    columns: Callable[[str], tuple[int, ...]],
    tried: Callable[[Iterable[Array]], list[Trial]],
    seed: int | tuple[int, int],
) -> Trial:
    """Search a box around a place by response surfaces; returns the best trial in it.

    Radial basis functions smooth each residual over the places tried so far, in the parameters on which it
    depends. Where their sum of squares is least, the next places are tried: each by surfaces through other
    trials, drawn from all, so that the places spread where the surfaces are uncertain.
    """
    random = np.random.default_rng(seed)
    low, high = np.maximum(start - search.radius, 0.0), np.minimum(start + search.radius, 1.0)
    cube = qmc.LatinHypercube(len(start), rng=seed).random(search.samples - 1)
    made = tried([start, *qmc.scale(cube, low, high)])
    while len(made) < search.evaluations:
        count = min(PLACES, search.evaluations - len(made))
        made += tried([_least(made, columns, low, high, random, drawn=i > 0) for i in range(count)])
    return best_of(made)


def _least(
    made: Sequence[Trial],
    columns: Callable[[str], tuple[int, ...]],
    low: Array,
    high: Array,
    random: np.random.Generator,
    *,
    drawn: bool,
) -> Array:
    """Where response surfaces through all trials, or through some drawn from them, have the least cost."""
    kept = max(len(low) + 2, round(KEPT * len(made))) if drawn else len(made)
    chosen = random.permutation(len(made))[:kept]
    trials = {made[i].place: damped(made[i]) for i in chosen}
    places, residuals = np.array(list(trials)), np.array(list(trials.values()))
    rows: dict[tuple[int, ...], list[int]] = {}
    for i, row in enumerate(made[0].residuals):
        rows.setdefault(columns(row), []).append(i)
    surfaces = {
        own: RBFInterpolator(
            places[:, own], residuals[:, found], kernel="linear", smoothing=SMOOTHING, degree=1
        )
        for own, found in rows.items()
    }

    def cost(at: Array) -> Array:
        squares = [np.sum(np.square(surface(at.T[:, own])), axis=1) for own, surface in surfaces.items()]
        return np.asarray(np.sum(squares, axis=0) + PRIOR * np.sum(np.square(at.T - 0.5), axis=1))

    found = differential_evolution(
        cost,
        list(zip(low, high, strict=True)),
        rng=random,
        vectorized=True,
        updating="deferred",
        maxiter=200,
        polish=False,
    )
    return np.asarray(found.x)


@dataclass
class _Passive:
    """The vehicle with passive yaw dampers at places of its ranges."""

    config: CalibrationConfig
    context: RunContext

    def outcomes(self, places: Sequence[Place], seeds: int, length: float) -> list[Outcome]:
        """Residuals of rows P1 to P10, and of what M1, M5 and S1 need, at each place."""
        stage = self.config.passive
        values = [stage.values(place) for place in places]
        lost: Outcome = dict.fromkeys(ROWS_OF_VEHICLE, LOST), {}
        return _each(values, lambda part: self._measured(part, seeds, length), lost)

    def _measured(self, values: Sequence[Mapping[str, float]], seeds: int, length: float) -> list[Outcome]:
        tracks = range(self.config.first_seed, self.config.first_seed + seeds)
        grids, scenarios, runs = load_reproduction(), [], []
        for each in values:
            for wear, speeds in ((0.0, grids.speeds("new")), (1.0, grids.speeds("worn"))):
                scenario = vehicle_of(self.config, each, length, [f"wear={wear}"])
                scenarios.append((scenario, speeds))
                runs += [PassiveRun(scenario, speed, track) for track in tracks for speed in speeds]
        whole = len(runs) + len(values) * len(HELD) * len(tracks)
        records = iter(self.context.part(0, whole).records(assessed, runs, Assessed))
        sweeps = [
            gathered([next(records) for _ in range(len(tracks) * len(speeds))], speeds, tracks)
            for _, speeds in scenarios
        ]
        limits = [model_limits(VehicleModel(scenario)) for scenario, _ in scenarios[::2]]
        held, frequency = self._held(values, tracks, length, self.context.part(len(runs), whole))
        return [
            passive_residuals(new, worn, own, accelerations / own.acceleration, frequencies)
            for new, worn, own, accelerations, frequencies in zip(
                sweeps[::2], sweeps[1::2], limits, held, frequency, strict=True
            )
        ]

    def _held(
        self, values: Sequence[Mapping[str, float]], tracks: Sequence[int], length: float, context: RunContext
    ) -> tuple[Array, Array]:
        """Smallest a_max (m/s2) of `HELD` at 400 km/h on worn wheels, shape (values, tracks).

        And dominant frequencies (Hz) with the first of them, shape (values, tracks, points).
        """
        runs = []
        for each in values:
            for command in HELD:
                damper = [_semi_active_damper(self.config), f"damper.current={command}"]
                scenario = vehicle_of(self.config, each, length, ["wear=1.0", *damper])
                runs += [PassiveRun(scenario, 400 / KMH, track) for track in tracks]
        records = context.records(assessed_or_derailed, runs, Assessed)
        shape = (len(values), len(HELD), len(tracks))
        largest = np.array([min(record.acceleration.max(), WORST) for record in records])
        frequency = np.array([record.frequency for record in records]).reshape(*shape, -1)
        return largest.reshape(shape).min(axis=1), frequency[:, 0]


@dataclass
class _SemiActive:
    """The calibrated vehicle with semi-active dampers and their controllers, on worn wheels."""

    config: CalibrationConfig
    vehicle: Mapping[str, float]
    """Values of the parameters of the passive stage."""
    context: RunContext

    def outcomes(self, places: Sequence[Place], seeds: int, length: float) -> list[Outcome]:
        """Residuals of rows M1 to M9 and S1 to S5 at each place."""
        values = [self.config.semi_active.values(place) for place in places]
        pairs = [(self.vehicle, each) for each in values]
        return _each(
            pairs,
            lambda part: [
                controlled_residuals(m) for m in self.measured(part, required_runs(), seeds, length)
            ],
            lost=(dict.fromkeys(ROWS_WITH_CONTROL, LOST), {}),
        )

    def measured(
        self,
        pairs: Sequence[tuple[Mapping[str, float], Mapping[str, float]]],
        required: Sequence[tuple[str, float, float]],
        seeds: int,
        length: float,
    ) -> list[ControlledMeasures]:
        """Measures of each pair of values, those of the passive and those of the semi-active stage."""
        tracks = range(self.config.first_seed, self.config.first_seed + seeds)
        runs: list[Run] = []
        for vehicle, own in pairs:
            numbers = self.config.semi_active.assignments(own)
            scenario = self._scenario(vehicle, numbers, length)
            environment = environment_of(scenario, load_environment())
            policies = {name: self._policy(name, numbers) for name, _, _ in required}
            runs += [
                Run(policies[name], scenario, environment, speed, track, current)
                for name, speed, current in required
                for track in tracks
            ]
        records = self.context.records(assessed_controlled, runs, ControlledRun)
        count = len(required) * len(tracks)
        return [
            ControlledMeasures(
                ControlledRuns(records[i : i + count]),
                model_limits(VehicleModel(runs[i].scenario)),
                required,
                runs[i].scenario.assessment,
            )
            for i in range(0, len(records), count)
        ]

    def check(self, place: float) -> None:
        """Read what runs need where all numbers stand at one place of their ranges.

        Raises
        ------
        ConfigError
            A damper that is not semi-active, a key or a number that cannot be used.
        """
        stage = self.config.semi_active
        numbers = stage.assignments(stage.values([place] * len(stage.parameters)))
        load_sayd(self.config.semi_active_damper)
        self._scenario(self.vehicle, numbers, stage.searches[0].length)
        for name in PAPER:
            self._policy(name, numbers)

    def _scenario(
        self, vehicle: Mapping[str, float], numbers: Mapping[str, float], length: float
    ) -> Scenario:
        more = ["wear=1.0", _semi_active_damper(self.config)]
        more += [f"{key}={number!r}" for key, number in numbers.items() if not key.startswith(CONTROL)]
        return vehicle_of(self.config, vehicle, length, more)

    def _policy(self, name: str, numbers: Mapping[str, float]) -> PolicySpec:
        files = (name, "skyhook") if name.startswith("skyhook") else (name,)
        own = {
            parameter: number
            for file in files
            for key, number in numbers.items()
            if (parameter := key.removeprefix(f"{CONTROL}{file}.")) != key
        }
        file = self.config.controller_files.get(name, name)
        return PolicySpec(name, load_controller(file, own).model_dump())


def _semi_active_damper(config: CalibrationConfig) -> str:
    return f"damper={as_yaml(config.semi_active_damper)}"


def vehicle_of(
    config: CalibrationConfig, values: Mapping[str, float], length: float, more: Sequence[str]
) -> Scenario:
    """The base scenario with values of the passive stage and, over them, further assignments."""
    keys = [f"{key}={number!r}" for key, number in config.passive.assignments(values).items()]
    return load_scenario(config.base, [*keys, f"assessment.length={length!r}", *more])


def _each(
    values: Sequence[Any], measured: Callable[[Sequence[Any]], list[Outcome]], lost: Outcome
) -> list[Outcome]:
    """What comes out of all values at once; one by one where a run of any of them fails."""
    try:
        return measured(values)
    except StudyError:
        if len(values) == 1:
            return [lost]
        return [_each([each], measured, lost)[0] for each in values]


def _of_sensitivity(config: CalibrationConfig) -> tuple[int, int]:
    """Evaluations of the passive vehicle and of the one with controllers that its table needs."""
    passive, semi_active = (2 * len(stage.parameters) for stage in (config.passive, config.semi_active))
    return 1 + passive, 1 + passive + semi_active


def _sensitivity(
    passive: _Passive, semi_active: _SemiActive, result: CalibrationResult, progress: _Evaluations
) -> list[dict[str, Any]]:
    """The calibrated numbers, then each of them moved by a share of its range up and down: what follows.

    The valves' positions follow the vehicle's numbers as well as their own; the passive vehicle's critical
    speeds follow its own alone.
    """
    config, settings = result.config, result.config.sensitivity
    of_vehicle, of_all = _of_sensitivity(config)
    calibrated = {name: np.array(result.best(name).place) for name in result.trials}
    lines: list[tuple[Parameter | None, dict[str, Array]]] = [(None, calibrated)]
    for name, place in calibrated.items():
        for i, parameter in enumerate(getattr(config, name).parameters):
            for change in (settings.share, -settings.share):
                moved = place + change * np.eye(len(place))[i]
                lines.append((parameter, calibrated | {name: np.clip(moved, 0.0, 1.0)}))
    vehicles = [tuple(places["passive"]) for _, places in lines[:of_vehicle]]
    progress.begin("sensitivity of the critical speeds", of_vehicle)
    outcomes = passive.outcomes(vehicles, settings.seeds, settings.length)
    progress.end()
    progress.begin("sensitivity of the valves' positions", of_all)
    pairs = [
        (
            config.passive.values(places["passive"].tolist()),
            config.semi_active.values(places["semi_active"].tolist()),
        )
        for _, places in lines
    ]
    resting = [run for run in required_runs() if run in RESTING]
    valves = _each(
        pairs,
        lambda part: [
            ({}, valve_positions(m))
            for m in semi_active.measured(part, resting, settings.seeds, settings.length)
        ],
        ({}, {}),
    )
    progress.end()
    measures = [m for _, m in outcomes] + [{}] * (len(lines) - of_vehicle)
    return [
        {
            "name": parameter.name if parameter else "as calibrated",
            "value": (own | vehicle)[parameter.name] if parameter else None,
            "unit": parameter.unit if parameter else "",
            **dict.fromkeys(QUANTITIES),
            **{key: value for key, value in found.items() if key in QUANTITIES},
            **positions,
        }
        for (parameter, _), (vehicle, own), found, (_, positions) in zip(
            lines, pairs, measures, valves, strict=True
        )
    ]
