"""How fast is all this here? Simulator beside SciPy, cost of a step by part, environments, training, starts.

Everything is measured several times in turn, so that a disturbance of the machine meets all quantities alike;
reported are medians, least and greatest values. Factors over real time and rates of control steps are of wall
time; the cost of a step and of its parts is processor time, which other work on the machine hardly touches.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from sayd_env.config.palette import SKY
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.physics.parts import PARTS, SAYD_PARTS
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.report.columns import Column, Table, csv_table, print_table
from sayd_env.report.figures import Plot, log_axis, name_rows, panels
from sayd_env.runs.context import Progress, silent
from sayd_env.studies.bench.environment import (
    ID,
    RATES,
    YARDSTICK,
    ControlSteps,
    EnvironmentEffort,
    measure_environments,
)
from sayd_env.studies.bench.machine import machine
from sayd_env.studies.bench.spread import Spread, in_turn
from sayd_env.studies.bench.start import measure_starts
from sayd_env.studies.bench.training import TrainingEffort, TrainingRates, measure_training
from sayd_env.studies.bench.vehicle import (
    FirstOrder,
    PartTimer,
    Reference,
    SaydTimer,
    batch_factor,
    match_accuracy,
    single_factor,
    with_dampers,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

VEHICLES_PER_THREAD = 4
"""Vehicles in the simulator's batch, for each thread."""
FACTORS = {
    "passive_single": "passive, one vehicle, one core",
    "sayd_single": "8 SAYDs, one vehicle, one core",
    "passive_single_processor_time": "passive, one vehicle, processor time",
    "sayd_single_processor_time": "8 SAYDs, one vehicle, processor time",
    "passive_batch": "passive, batch, all cores",
    "sayd_batch": "8 SAYDs, batch, all cores",
    "scipy_reference": "scipy, passive, equal accuracy",
}
"""Factors over real time and what they are called."""
NO_TRAINING = "no training beside them: torch and Stable-Baselines3 are not installed"


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    repetitions: int
    span: float
    """Simulated time of a vehicle in one repetition (s)."""
    evaluations: int
    """Evaluations of a part of the step in one repetition."""
    reference_span: float
    """Simulated time of SciPy's integration (s)."""
    first_starts: int
    later_starts: int
    environments: EnvironmentEffort
    training: TrainingEffort


FULL = Effort(9, 20.0, 100_000, 2.0, 2, 5, EnvironmentEffort(5, 0.5, 1500), TrainingEffort(3, 1500))
QUICK = Effort(3, 4.0, 10_000, 0.25, 1, 2, EnvironmentEffort(1, 0.25, 500), TrainingEffort(1, 1000, False))


@dataclass(frozen=True)
class BenchResult:
    """All figures of one machine."""

    scenario: Scenario
    speed: float
    """m/s"""
    step: float
    """s"""
    threads: int
    vehicles: int
    """Vehicles in the simulator's batch."""
    realtime: dict[str, Spread]
    """Simulated seconds per wall second, by `FACTORS`; a batch counts the seconds of all its vehicles. A
    vehicle without yaw dampers has none with SAYDs."""
    step_us: dict[str, Spread]
    """Processor time of a step by part (us)."""
    control: ControlSteps
    training: TrainingRates | None
    """None where torch and Stable-Baselines3 are not installed."""
    startup: dict[str, Spread]
    """Wall time of a first and a later start (s)."""
    memory: dict[str, float] | None
    """Peak memory of these processes (MB); None where the system does not tell."""
    reference: Reference
    machine: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd bench --json``; null is what could not be measured."""
        return {
            "realtime_factor": {
                name: self.realtime[name].median if name in self.realtime else None for name in FACTORS
            },
            "step_us": {name: spread.median for name, spread in self.step_us.items()},
            "control_steps_per_second": self.control.as_dict(),
            "reset_s": {name: spread.median for name, spread in self.control.reset_s.items()},
            "training": None if self.training is None else self.training.as_dict(),
            "startup_s": {name: spread.median for name, spread in self.startup.items()},
            "memory_mb": None if self.memory is None else self.memory["later"],
            "memory_first_start_mb": None if self.memory is None else self.memory["first"],
            "speed_kmh": self.speed * KMH,
            "step_size_s": self.step,
            "batch": {
                "vehicles": self.vehicles,
                "environments": self.control.vehicles,
                "threads": self.threads,
            },
            "scipy": asdict(self.reference),
            "machine": self.machine,
            "spread": {
                "realtime_factor": _each(self.realtime),
                "step_us": _each(self.step_us),
                "control_steps_per_second": _each(self.control.spreads()),
                "reset_s": _each(self.control.reset_s),
                "training": {} if self.training is None else _each(self.training.rates),
                "startup_s": _each(self.startup),
            },
        }

    def tables(self) -> dict[str, Table]:
        """All measured quantities."""
        return {"bench": csv_table(COLUMNS, self._rows())}

    def _rows(self) -> list[dict[str, Any]]:
        """Values by `COLUMNS`."""
        return [
            {"group": number, "quantity": name, "unit": unit, **asdict(spread)}
            for number, group in enumerate(self._groups())
            for name, unit, spread in group
        ]

    def plots(self) -> dict[str, Plot]:
        """Bars of the factors over real time, of the parts of a step and of the environments' rates."""
        return {"bench": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print all measured quantities."""
        machine = self.machine
        title = f"{machine['processor']}, {machine['cores']} cores, {machine['date']}"
        print_table(console, title, COLUMNS, self._rows(), wide=wide, section="group")
        for note in self._notes():
            console.print(note)

    def _notes(self) -> list[str]:
        r, share = self.reference, self._sayds_share()
        notes = [
            f"{self.scenario.vehicle.name} at {self.speed * KMH:.0f} km/h, step {self.step * 1e3:g} ms "
            f"(error {r.step_error:.1e}); scipy: {r.method}, rtol {r.tolerance:g} (error {r.error:.1e}), "
            f"{r.evaluations / r.span:.0f} evaluations of {r.call_us:.1f} us for each second"
        ]
        if share is not None:
            notes.append(f"hydraulics and valves take {share:.0%} of a step with eight SAYDs")
        notes.append(
            f"environments: {ID} by gymnasium.utils.performance; batch of {self.control.vehicles} on "
            f"{self.threads} threads"
        )
        if "ant_v5" not in self.control.rates:
            notes.append(f"no {YARDSTICK} beside them: mujoco is not installed")
        notes.append(NO_TRAINING if self.training is None else self.training.note())
        if self.memory is not None:
            notes.append(
                f"peak memory {self.memory['later']:.0f} MB, compiling {self.memory['first']:.0f} MB"
            )
        return notes

    def _sayds_share(self) -> float | None:
        costs = self.step_us
        if "total_sayd" not in costs:
            return None
        return (costs["valves"].median + costs["hydraulics"].median) / costs["total_sayd"].median

    def _groups(self) -> list[list[tuple[str, str, Spread]]]:
        control, training = self.control, self.training
        return [
            [(FACTORS[name], "x real time", s) for name, s in self.realtime.items()],
            [(_step_label(name), "us", s) for name, s in self.step_us.items()],
            [
                *((RATES[name], "steps/s", s) for name, s in control.rates.items()),
                ("step minus compiled call", "us", control.overhead_us),
                ("compiled call", "us", control.compiled_us),
                ("reset of one environment", "s", control.reset_s["single"]),
                (f"reset of {control.vehicles} at once", "s", control.reset_s["batch"]),
            ],
            []
            if training is None
            else [(training.label(k), "steps/s", s) for k, s in training.rates.items()],
            [(f"{name} start", "s", s) for name, s in self.startup.items()],
        ]

    def _draw(self, figure: Figure) -> None:
        training = self.training
        rates = {} if training is None else {training.label(name): s for name, s in training.rates.items()}
        shown = {
            "simulated over wall time": {FACTORS[name]: s for name, s in self.realtime.items()},
            f"processor time of a step of {self.step * 1e3:g} ms (us)": {
                _step_label(name): s for name, s in self.step_us.items()
            },
            "control steps per second": {RATES[name]: s for name, s in self.control.rates.items()},
            "control steps per second in training": rates,
        }
        axes = panels(figure, sum(bool(spreads) for spreads in shown.values()), size=(10.0, 2.6))
        for panel, (title, spreads) in zip(axes, filter(itemgetter(1), shown.items()), strict=True):
            _bars(panel, spreads, title)
        log_axis(axes[0], "x")
        figure.suptitle(f"{self.machine['processor']}, {self.machine['cores']} cores", fontsize="small")


COLUMNS = (
    Column("quantity", "quantity"),
    Column("unit", "unit"),
    Column("median", "median"),
    Column("minimum", "min"),
    Column("maximum", "max"),
    Column("count", "count", wide=True),
)


def _each(spreads: dict[str, Spread]) -> dict[str, Any]:
    return {name: asdict(spread) for name, spread in spreads.items()}


def _step_label(part: str) -> str:
    return {"total": "step: total, passive", "total_sayd": "step: total, 8 SAYDs"}.get(part, f"step: {part}")


def _bars(axes: Axes, spreads: dict[str, Spread], title: str) -> None:
    medians = np.array([s.median for s in spreads.values()])
    low = medians - [s.minimum for s in spreads.values()]
    high = np.array([s.maximum for s in spreads.values()]) - medians
    bars = axes.barh(range(len(medians)), medians, xerr=(low, high), capsize=3, color=SKY)
    axes.bar_label(bars, fmt=COLUMNS[2].words, padding=8)
    name_rows(axes, spreads)
    axes.margins(x=0.2)
    axes.set_xlabel(title)


def bench(
    scenario: Scenario,
    speed: float = 350.0 / KMH,
    *,
    quick: bool = False,
    workers: int | None = None,
    progress: Progress = silent,
) -> BenchResult:
    """Measure speed, cost by part, environments, training, starts and memory.

    Parameters
    ----------
    scenario : Scenario
        The configuration of the simulator, measured with passive and with semi-active yaw dampers; those
        that it does not have are the packaged ones. The environment is always ``SAYD/Nominal-v0``.
    speed : float
        Speed of the measured vehicles, m/s.
    quick : bool
        Few and short measurements: figures that show a trend, in a fraction of the time.
    workers : int, optional
        Threads of the batches; all cores by default.
    progress : Progress
        Told after each measurement.

    Raises
    ------
    ConfigError
        A configuration that cannot be used.
    StudyError
        A run that diverged, a program that does not start.
    """
    effort = QUICK if quick else FULL
    passive, semi = (VehicleModel(each) for each in with_dampers(scenario))
    step = passive.step(speed)[0]
    threads = workers or numba.get_num_threads()
    steps = _Steps(progress, effort)

    startup, memory = measure_starts(scenario, speed, effort.first_starts, effort.later_starts, steps.did)
    reference = match_accuracy(passive, speed, effort.reference_span)
    steps.did("scipy's tolerance")

    vehicles = VEHICLES_PER_THREAD * threads
    probes = _passive_probes(passive, speed, effort, threads, reference)
    if semi.multibody.yaw_dampers:
        probes |= _sayd_probes(semi, speed, effort, threads)
    measured = in_turn(probes, effort.repetitions, lambda: steps.did("speed"))
    return BenchResult(
        scenario=scenario,
        speed=speed,
        step=step,
        threads=threads,
        vehicles=vehicles,
        realtime={name: Spread.of(measured[name]) for name in FACTORS if name in measured},
        step_us=_cost_by_part(measured, step),
        control=measure_environments(effort.environments, threads, lambda: steps.did("environments")),
        training=measure_training(effort.training, threads, lambda: steps.did("training")),
        startup=startup,
        memory=memory,
        reference=reference,
        machine=machine(),
    )


class _Steps:
    """Progress of a bench: counts what is done."""

    def __init__(self, progress: Progress, effort: Effort) -> None:
        self.progress, self.done = progress, 0
        runs = effort.repetitions + effort.environments.repetitions + effort.training.repetitions
        self.total = effort.first_starts + effort.later_starts + 1 + runs

    def did(self, what: str) -> None:
        self.done += 1
        self.progress(self.done, self.total, what)


def _passive_probes(
    model: VehicleModel, speed: float, effort: Effort, threads: int, reference: Reference
) -> dict[str, Callable[[], float]]:
    """What is measured of the vehicle with passive dampers."""
    parts = PartTimer(Simulator(model, speed, seed=0), effort.evaluations)
    return {
        **_speed_probes("passive", model, speed, effort, threads),
        "scipy_reference": lambda: (
            reference.span
            / FirstOrder(model, speed, reference.span).solve(reference.method, reference.tolerance)[1]
        ),
        **{name: lambda k=k: parts.microseconds(k) for k, name in enumerate(PARTS)},  # type: ignore[misc]
    }


def _sayd_probes(
    model: VehicleModel, speed: float, effort: Effort, threads: int
) -> dict[str, Callable[[], float]]:
    """What is measured of the vehicle with semi-active dampers."""
    parts = SaydTimer(Simulator(model, speed, seed=0), effort.evaluations)
    return {
        **_speed_probes("sayd", model, speed, effort, threads),
        **{name: lambda k=k: parts.microseconds(k) for k, name in enumerate(SAYD_PARTS)},  # type: ignore[misc]
    }


def _speed_probes(
    kind: str, model: VehicleModel, speed: float, effort: Effort, threads: int
) -> dict[str, Callable[[], float]]:
    """Factors over real time of one vehicle and of a batch."""
    tracks = [model.realisation(seed) for seed in range(VEHICLES_PER_THREAD * threads)]
    span = effort.span
    return {
        f"{kind}_single": lambda: single_factor(model, speed, tracks[0], span),
        f"{kind}_single_processor_time": lambda: single_factor(
            model, speed, tracks[0], span, time.thread_time
        ),
        f"{kind}_batch": lambda: batch_factor(model, speed, tracks, span, threads),
    }


def _cost_by_part(measured: dict[str, list[float]], step: float) -> dict[str, Spread]:
    """Cost of the parts, of a whole step of the running vehicle, and of integration: what is left of it.

    Behind them what eight semi-active dampers add: valves, hydraulics, and the whole step with them.
    """
    total = 1e6 * step / np.array(measured["passive_single_processor_time"])
    rest = total - np.sum([measured[name] for name in PARTS], axis=0)
    costs = {name: np.array(measured[name]) for name in PARTS}
    costs |= {"integration": rest, "total": total}
    if "sayd_single_processor_time" in measured:
        valves, dampers = (np.array(measured[name]) for name in SAYD_PARTS)
        whole = 1e6 * step / np.array(measured["sayd_single_processor_time"])
        costs |= {"valves": valves, "hydraulics": dampers - valves, "total_sayd": whole}
    return {name: Spread.of(values.tolist()) for name, values in costs.items()}
