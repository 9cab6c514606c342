"""How fast is all this here? Simulator beside SciPy, cost of a step, environments, training, starts, runs.

Everything is measured several times in turn, so that a disturbance of the machine meets all quantities alike;
reported are medians, least and greatest values. Factors over real time and rates of control steps are of wall
time; the cost of a step and of its parts is processor time, which other work on the machine hardly touches.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from sayd_env.config.palette import SKY
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.parts import PARTS, SAYD_PARTS
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, log_axis, name_rows, panels
from sayd_env.runs.context import Progress, silent
from sayd_env.runs.executors import PROCESSES, THREADS, ExecutorChoice, KeptExecutor
from sayd_env.studies.bench import environment
from sayd_env.studies.bench.environment import ID, RATES, TIMES, YARDSTICK, measure_environments
from sayd_env.studies.bench.executors import measure_executors
from sayd_env.studies.bench.spread import Effort, Measurement, in_turn, quantities
from sayd_env.studies.bench.start import measure_starts
from sayd_env.studies.bench.training import TrainingRates, measure_training
from sayd_env.studies.bench.vehicle import (
    FirstOrder,
    PartTimer,
    Reference,
    match_accuracy,
    realtime_factor,
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
STEP = {name: f"step: {name}" for name in (*PARTS, "integration")} | {
    "total": "step: total, passive",
    "valves": "step: valves",
    "hydraulics": "step: hydraulics",
    "total_sayd": "step: total, 8 SAYDs",
}
"""Parts of the step and what they are called."""
NO_TRAINING = "no training beside them: torch and Stable-Baselines3 are not installed"

FULL = Effort()
QUICK = Effort(3, 4.0, 10_000, 0.25, 1, 2, 1, 0.25, 500, 1, 1000, uncapped=False)
COLUMNS = (
    Column("quantity", "quantity"),
    Column("unit", "unit"),
    Column("median", "median"),
    Column("minimum", "min"),
    Column("maximum", "max"),
    Column("count", "count", wide=True),
)


@dataclass(frozen=True)
class BenchResult:
    """All figures of one machine."""

    scenario: Scenario
    speed: float
    """m/s"""
    step: float
    """s"""
    batch: dict[str, int]
    """Vehicles of the simulator's batch, environments of the batch environment, and threads of both."""
    measured: dict[str, dict[str, Measurement]]
    """Quantities by group and name, the keys of the JSON document. What could not be measured is left out."""
    training: TrainingRates | None
    """None where torch and Stable-Baselines3 are not installed."""
    memory: dict[str, float] | None
    """Peak memory of a first and a later start (MB); None where the system does not tell."""
    reference: Reference
    machine: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd bench --json``; null is what could not be measured."""
        medians: dict[str, dict[str, float | None]] = {
            group: {name: quantity.spread.median for name, quantity in each.items()}
            for group, each in self.measured.items()
        }
        wanted = {"realtime_factor": FACTORS, "control_steps_per_second": RATES | TIMES}
        return {
            **medians,
            **{group: dict.fromkeys(names) | medians[group] for group, names in wanted.items()},
            "training": None if self.training is None else self.training.as_dict(),
            "memory_mb": None if self.memory is None else self.memory["later"],
            "memory_first_start_mb": None if self.memory is None else self.memory["first"],
            "speed_kmh": self.speed * KMH,
            "step_size_s": self.step,
            "batch": self.batch,
            "scipy": asdict(self.reference),
            "machine": self.machine,
            "spread": {
                group: {name: asdict(quantity.spread) for name, quantity in each.items()}
                for group, each in self._groups().items()
            },
        }

    def tables(self) -> dict[str, Table]:
        """All measured quantities."""
        return {"bench": csv_table(COLUMNS, self._rows())}

    def plots(self) -> dict[str, Plot]:
        """Bars of factors over real time, of the parts of a step, and of rates."""
        return {"bench": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print all measured quantities."""
        machine = self.machine
        title = f"{machine['processor']}, {machine['cores']} cores, {machine['date']}"
        Listing(title, COLUMNS, self._rows(), "group").print(console, wide)
        for note in self._notes():
            console.print(note)

    def _groups(self) -> dict[str, dict[str, Measurement]]:
        """All quantities, those of the trainings among them."""
        return self.measured | {"training": {} if self.training is None else self.training.rates}

    def _rows(self) -> list[dict[str, Any]]:
        """Values by `COLUMNS`."""
        return [
            {"group": group, "quantity": quantity.label, "unit": quantity.unit, **asdict(quantity.spread)}
            for group, each in self._groups().items()
            for quantity in each.values()
        ]

    def _notes(self) -> list[str]:
        r, costs = self.reference, self.measured["step_us"]
        notes = [
            f"{self.scenario.vehicle.name} at {self.speed * KMH:.0f} km/h, step {self.step * 1e3:g} ms "
            f"(error {r.step_error:.1e}); scipy: {r.method}, rtol {r.tolerance:g} (error {r.error:.1e}), "
            f"{r.evaluations / r.span:.0f} evaluations of {r.call_us:.1f} us for each second"
        ]
        if "total_sayd" in costs:
            valves, rest, total = (costs[k].spread.median for k in ("valves", "hydraulics", "total_sayd"))
            notes.append(
                f"hydraulics and valves take {(valves + rest) / total:.0%} of a step with eight SAYDs"
            )
        notes.append(
            f"environments: {ID} by gymnasium.utils.performance; batch of {self.batch['environments']} on "
            f"{self.batch['threads']} threads"
        )
        if "ant_v5" not in self.measured["control_steps_per_second"]:
            notes.append(f"no {YARDSTICK} beside them: mujoco is not installed")
        notes.append(NO_TRAINING if self.training is None else self.training.note())
        if self.memory is not None:
            notes.append(
                f"peak memory {self.memory['later']:.0f} MB, compiling {self.memory['first']:.0f} MB"
            )
        return notes

    def _draw(self, figure: Figure) -> None:
        titles = {
            "realtime_factor": "simulated over wall time",
            "step_us": f"processor time of a step of {self.step * 1e3:g} ms (us)",
            "control_steps_per_second": "control steps per second",
            "training": "control steps per second in training",
            "runs_per_second": "runs per second",
        }
        shown = {group: [q for k, q in self._groups()[group].items() if k not in TIMES] for group in titles}
        shown = {group: each for group, each in shown.items() if each}
        axes = panels(figure, len(shown), size=(10.0, 2.6))
        for panel, (group, each) in zip(axes, shown.items(), strict=True):
            _bars(panel, each, titles[group])
        log_axis(axes[0], "x")
        figure.suptitle(f"{self.machine['processor']}, {self.machine['cores']} cores", fontsize="small")


def _bars(axes: Axes, shown: Sequence[Measurement], title: str) -> None:
    spreads = [quantity.spread for quantity in shown]
    medians = np.array([s.median for s in spreads])
    low, high = medians - [s.minimum for s in spreads], np.array([s.maximum for s in spreads]) - medians
    bars = axes.barh(range(len(medians)), medians, xerr=(low, high), capsize=3, color=SKY)
    axes.bar_label(bars, fmt=COLUMNS[2].words, padding=8)
    name_rows(axes, [quantity.label for quantity in shown])
    axes.margins(x=0.2)
    axes.set_xlabel(title)


def bench(
    scenario: Scenario,
    speed: float = 350.0 / KMH,
    *,
    quick: bool = False,
    workers: int | None = None,
    executors: Sequence[str] = (),
    progress: Progress = silent,
) -> BenchResult:
    """Measure speed, cost by part, environments, training, starts, memory and runs by executor.

    Parameters
    ----------
    scenario : Scenario
        The configuration of the simulator, measured with passive and with semi-active yaw dampers; those
        that it does not have are the packaged ones. The environment is always ``SAYD/Nominal-v1``.
    speed : float
        Speed of the measured vehicles, m/s.
    quick : bool
        Few and short measurements: figures that show a trend, in a fraction of the time.
    workers : int, optional
        Threads of the batches and workers of the executors; all cores by default.
    executors : sequence of str
        Executors beside threads and processes, as `ExecutorChoice.parse` reads them.
    progress : Progress
        Called after each measurement.

    Raises
    ------
    ConfigError
        A configuration that cannot be used, an executor that is not there.
    StudyError
        A run that diverged, a program that does not start.
    """
    effort = QUICK if quick else FULL
    names = dict.fromkeys((THREADS, PROCESSES, *executors))
    choices = [ExecutorChoice.parse(name, None if "://" in name else workers) for name in names]
    models = dict(zip(("passive", "sayd"), map(VehicleModel, with_dampers(scenario)), strict=True))
    step = models["passive"].step(speed)[0]
    threads = workers or numba.get_num_threads()
    done = 0

    def did(what: str) -> None:
        nonlocal done
        done += 1
        progress(done, effort.total, what)

    for choice in choices:
        if choice.address:  # nobody there? Said before the work
            with KeptExecutor(choice) as kept:
                kept.get(1)
    starts, memory = measure_starts(scenario, speed, effort, did)
    reference = match_accuracy(models["passive"], speed, effort.reference_span)
    did("scipy's tolerance")
    if not models["sayd"].multibody.yaw_dampers:
        del models["sayd"]
    probes = [_probe(kind, model, speed, effort, threads) for kind, model in models.items()]
    probes.append(partial(_scipy_factor, models["passive"], speed, reference))
    measured = in_turn(probes, effort.repetitions, lambda: did("speed"))
    control = measure_environments(effort, threads, lambda: did("environments"))
    training = measure_training(effort, threads, lambda: did("training"))
    runs = measure_executors(choices, effort, lambda: did("runs"))
    return BenchResult(
        scenario=scenario,
        speed=speed,
        step=step,
        batch={
            "vehicles": VEHICLES_PER_THREAD * threads,
            "environments": environment.BATCH,
            "threads": threads,
        },
        measured={
            "realtime_factor": quantities(measured, FACTORS, "x real time"),
            "step_us": quantities(_cost_by_part(measured, step), STEP, "us"),
            **control,
            "startup_s": starts,
            **runs,
        },
        training=training,
        memory=memory,
        reference=reference,
        machine=machine(),
    )


def _probe(
    kind: str, model: VehicleModel, speed: float, effort: Effort, threads: int
) -> Callable[[], dict[str, float]]:
    """What measures the vehicle with one kind of dampers: factors over real time, cost of parts."""
    tracks = [model.realisation(seed) for seed in range(VEHICLES_PER_THREAD * threads)]
    sayds = kind == "sayd"
    parts = PartTimer(Simulator(model, speed, seed=0), effort.evaluations, sayds=sayds)

    def single(clock: Callable[[], float]) -> float:
        return realtime_factor(Simulator(model, speed, track=tracks[0]), effort.span, clock=clock)

    def measure() -> dict[str, float]:
        vehicles = BatchSimulator([Simulator(model, speed, track=track) for track in tracks], threads)
        return {
            f"{kind}_single": single(time.perf_counter),
            f"{kind}_single_processor_time": single(time.thread_time),
            f"{kind}_batch": realtime_factor(vehicles, effort.span, len(tracks)),
            **{name: parts.microseconds(k) for k, name in enumerate(SAYD_PARTS if sayds else PARTS)},
        }

    return measure


def _scipy_factor(model: VehicleModel, speed: float, reference: Reference) -> dict[str, float]:
    """Simulated over wall time of SciPy's integration."""
    system = FirstOrder(model, speed, reference.span)
    seconds = system.solve(reference.method, reference.tolerance)[1]
    return {"scipy_reference": reference.span / seconds}


def _cost_by_part(measured: dict[str, list[float]], step: float) -> dict[str, list[float]]:
    """Cost of the parts, of a whole step of the running vehicle, and of integration: what is left of it.

    Besides what eight semi-active dampers add: valves, hydraulics, and the whole step with them.
    """
    whole = {
        kind: 1e6 * step / np.array(measured[f"{kind}_single_processor_time"])
        for kind in ("passive", "sayd")
        if f"{kind}_single_processor_time" in measured
    }
    parts = {name: np.array(measured[name]) for name in PARTS}
    costs = parts | {"integration": whole["passive"] - sum(parts.values()), "total": whole["passive"]}
    if "sayd" in whole:
        valves, dampers = (np.array(measured[name]) for name in SAYD_PARTS)
        costs |= {"valves": valves, "hydraulics": dampers - valves, "total_sayd": whole["sayd"]}
    return {name: values.tolist() for name, values in costs.items()}


def machine() -> dict[str, Any]:
    """Processor, cores that this process may use, system and date."""
    return {
        "processor": _processor(),
        "cores": numba.config.NUMBA_NUM_THREADS,  # type: ignore[attr-defined] # made at run time
        "system": f"{platform.system()} {platform.machine()}",
        "date": datetime.now(UTC).date().isoformat(),
    }


def _processor() -> str:
    """Name of the processor: Linux tells it in a file alone."""
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
