"""How fast is the simulator here? Speed beside SciPy's integrators, cost of a step by part, starts, memory.

Everything is measured several times in turn, so that a disturbance of the machine meets all quantities alike;
reported are medians, least and greatest values. Factors over real time are of wall time; the cost of a step
and of its parts is processor time, which other work on the machine hardly touches.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from sayd_env.config import StudyError
from sayd_env.config.scenario import Scenario
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.parts import PARTS, repeat
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.physics.step import rates
from sayd_env.physics.track.realisation import TrackRealisation
from sayd_env.studies.output import Progress, silent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.studies.output import Plot, Table

Array = npt.NDArray[np.float64]

KMH = 3.6
VEHICLES_PER_THREAD = 4
"""Vehicles in the batch, for each thread."""
METHODS = ("RK45", "DOP853")
"""SciPy's integrators that compete; the fastest that is accurate enough is reported. LSODA and the implicit
ones take more than ten times as long: they build a dense Jacobian of nearly 300 columns by differences."""
TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Relative tolerances that are tried, the loosest first."""
TIGHT = ("DOP853", 1e-6)
"""Method and tolerance of the solution that all are compared with."""
SCALES = (1e-3, 1e-1, 1e4)
"""Absolute tolerances over relative ones: displacements (m, rad), velocities (1/s), damper forces (N)."""
SETTLING = 1.0
"""Time that a vehicle runs before the parts of its step are measured (s)."""

# What `sayd` does, in a process of its own, which tells its peak memory (kB) at the end where it can. The
# usage that a parent is told counts the parent's own memory, too, since a process begins as its copy.
_PROGRAM = "from sayd_env.cli import main; status = main()"
_PEAK = """
import sys
from pathlib import Path
about = Path("/proc/self/status")
if status == 0 and about.exists():
    print(about.read_text().partition("VmHWM:")[2].split()[0], file=sys.stderr)
sys.exit(status)
"""
_SHORT = ("--seeds", "1", "--json", "--set", "assessment.run_in=0", "--set", "assessment.length=1000")


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


FULL = Effort(9, 20.0, 100_000, 2.0, 2, 5)
QUICK = Effort(3, 4.0, 10_000, 0.25, 1, 2)


@dataclass(frozen=True)
class Spread:
    """Several measurements of one quantity."""

    median: float
    minimum: float
    maximum: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Summarise measurements."""
        return cls(float(np.median(values)), min(values), max(values), len(values))


@dataclass(frozen=True)
class Reference:
    """SciPy's integrator of equal accuracy."""

    method: str
    tolerance: float
    """Relative tolerance."""
    error: float
    """Relative RMS difference of the bogie frames' lateral displacement from a tight solution."""
    step_error: float
    """The same of our own time step."""
    evaluations: int
    """Evaluations of the right-hand side over the span."""
    call_us: float
    """Time of one evaluation, called from Python (us)."""
    span: float
    """Simulated time (s)."""


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
    """Vehicles in the batch."""
    realtime: dict[str, Spread]
    """Simulated seconds per wall second; a batch counts the seconds of all its vehicles."""
    step_us: dict[str, Spread]
    """Processor time of a step by part (us)."""
    startup: dict[str, Spread]
    """Wall time of a first and a later start (s)."""
    memory: dict[str, float] | None
    """Peak memory of these processes (MB); None where the system does not tell."""
    reference: Reference
    machine: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd bench --json``; null is what this version does not have."""
        realtime = {name: spread.median for name, spread in self.realtime.items()}
        return {
            "realtime_factor": {
                "passive_single": realtime["passive_single"],
                "sayd_single": None,
                "passive_batch": realtime["passive_batch"],
                "sayd_batch": None,
                "scipy_reference": realtime["scipy_reference"],
                "passive_single_processor_time": realtime["passive_single_processor_time"],
            },
            "step_us": {name: spread.median for name, spread in self.step_us.items()},
            "control_steps_per_second": {"single": None, "batch": None, "overhead_us": None},
            "startup_s": {name: spread.median for name, spread in self.startup.items()},
            "memory_mb": None if self.memory is None else self.memory["later"],
            "memory_first_start_mb": None if self.memory is None else self.memory["first"],
            "speed_kmh": self.speed * KMH,
            "step_size_s": self.step,
            "batch": {"vehicles": self.vehicles, "threads": self.threads},
            "scipy": asdict(self.reference),
            "machine": self.machine,
            "spread": {
                "realtime_factor": {name: asdict(s) for name, s in self.realtime.items()},
                "step_us": {name: asdict(s) for name, s in self.step_us.items()},
                "startup_s": {name: asdict(s) for name, s in self.startup.items()},
            },
        }

    def tables(self) -> dict[str, Table]:
        """All measured quantities."""
        header = ("quantity", "unit", "median", "minimum", "maximum", "count")
        return {"bench": (header, [(name, unit, *asdict(s).values()) for name, unit, s in self._rows()])}

    def plots(self) -> dict[str, Plot]:
        """Bars of the factors over real time and of the parts of a step."""
        return {"bench": self._draw}

    def summary(self, console: Console) -> None:
        """Print all measured quantities."""
        from rich.table import Table as RichTable  # noqa: PLC0415 - only who prints pays for it

        machine = self.machine
        grid = RichTable(title=f"{machine['processor']}, {machine['cores']} cores, {machine['date']}")
        for name in ("quantity", "unit", "median", "min", "max"):
            grid.add_column(name, justify="left" if name in {"quantity", "unit"} else "right")
        for name, unit, s in self._rows():
            grid.add_row(name, unit, _figure(s.median), _figure(s.minimum), _figure(s.maximum))
        console.print(grid)
        r = self.reference
        console.print(
            f"{self.scenario.vehicle.name} at {self.speed * KMH:.0f} km/h, step {self.step * 1e3:g} ms "
            f"(error {r.step_error:.1e}); scipy: {r.method}, rtol {r.tolerance:g} (error {r.error:.1e}), "
            f"{r.evaluations / r.span:.0f} evaluations of {r.call_us:.1f} us for each second"
        )
        if self.memory is not None:
            console.print(
                f"peak memory {self.memory['later']:.0f} MB, compiling {self.memory['first']:.0f} MB"
            )

    def _rows(self) -> list[tuple[str, str, Spread]]:
        return [
            *((_LABELS[name], "x real time", s) for name, s in self.realtime.items()),
            *((f"step: {name}", "us", s) for name, s in self.step_us.items()),
            *((f"{name} start", "s", s) for name, s in self.startup.items()),
        ]

    def _draw(self, figure: Figure) -> None:
        figure.set_size_inches(10.0, 4.0)
        factors, parts = figure.subplots(1, 2)
        _bars(factors, {_LABELS[name]: s for name, s in self.realtime.items()}, "simulated over wall time")
        factors.set_xscale("log")
        _bars(parts, self.step_us, f"processor time of a step of {self.step * 1e3:g} ms (us)")
        figure.suptitle(f"{self.machine['processor']}, {self.machine['cores']} cores", fontsize="small")


_LABELS = {
    "passive_single": "one vehicle, one core",
    "passive_single_processor_time": "the same, processor time",
    "passive_batch": "batch, all cores",
    "scipy_reference": "scipy, equal accuracy",
}


def _figure(x: float) -> str:
    return f"{x:.3g}" if x < 100.0 else f"{x:.0f}"


def _bars(axes: Axes, spreads: dict[str, Spread], label: str) -> None:
    names, medians = list(spreads), np.array([s.median for s in spreads.values()])
    low = medians - [s.minimum for s in spreads.values()]
    high = np.array([s.maximum for s in spreads.values()]) - medians
    bars = axes.barh(names, medians, xerr=(low, high), capsize=3)
    axes.bar_label(bars, fmt="%.3g", padding=8)
    axes.invert_yaxis()
    axes.margins(x=0.2)
    axes.set_xlabel(label)


def bench(
    scenario: Scenario,
    speed: float = 350.0 / KMH,
    *,
    quick: bool = False,
    workers: int | None = None,
    progress: Progress = silent,
) -> BenchResult:
    """Measure speed, cost by part, starts and memory.

    Parameters
    ----------
    scenario : Scenario
        The configuration.
    speed : float
        Speed of the measured vehicles, m/s.
    quick : bool
        Few and short measurements: figures that show a trend, in a fraction of the time.
    workers : int, optional
        Threads of the batch; all cores by default.
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
    model = VehicleModel(scenario)
    step = model.step(speed)[0]
    threads = workers or numba.get_num_threads()
    steps = _Steps(progress, effort)

    startup, memory = _starts(scenario, speed, effort, steps)
    reference = match_accuracy(model, speed, effort.reference_span)
    steps.did("scipy's tolerance")

    tracks = [model.realisation(seed) for seed in range(VEHICLES_PER_THREAD * threads)]
    parts = PartTimer(Simulator(model, speed, track=tracks[0]), effort.evaluations)
    probes: dict[str, Callable[[], float]] = {
        "passive_single": lambda: single_factor(model, speed, tracks[0], effort.span),
        "passive_single_processor_time": lambda: single_factor(
            model, speed, tracks[0], effort.span, time.thread_time
        ),
        "passive_batch": lambda: batch_factor(model, speed, tracks, effort.span, threads),
        "scipy_reference": lambda: (
            reference.span
            / FirstOrder(model, speed, reference.span).solve(reference.method, reference.tolerance)[1]
        ),
        **{name: lambda k=k: parts.microseconds(k) for k, name in enumerate(PARTS)},  # type: ignore[misc]
    }
    measured = _in_turn(probes, effort.repetitions, steps)
    realtime = {name: Spread.of(measured[name]) for name in _LABELS}
    return BenchResult(
        scenario=scenario,
        speed=speed,
        step=step,
        threads=threads,
        vehicles=len(tracks),
        realtime=realtime,
        step_us=_cost_by_part(measured, step),
        startup=startup,
        memory=memory,
        reference=reference,
        machine=machine(),
    )


class _Steps:
    """Progress of a bench: counts what is done."""

    def __init__(self, progress: Progress, effort: Effort) -> None:
        self.progress, self.done = progress, 0
        self.total = effort.first_starts + effort.later_starts + 1 + effort.repetitions

    def did(self, what: str) -> None:
        self.done += 1
        self.progress(self.done, self.total, what)


def _in_turn(
    probes: dict[str, Callable[[], float]], repetitions: int, steps: _Steps
) -> dict[str, list[float]]:
    """Measure all in turn, several times, after a round that nobody counts: it compiles and fills caches."""
    measured: dict[str, list[float]] = {name: [] for name in probes}
    for probe in probes.values():
        probe()
    for _ in range(repetitions):
        for name, probe in probes.items():
            measured[name].append(probe())
        steps.did("speed")
    return measured


def _cost_by_part(measured: dict[str, list[float]], step: float) -> dict[str, Spread]:
    """Cost of the parts, of a whole step of the running vehicle, and of integration: what is left of it."""
    total = 1e6 * step / np.array(measured["passive_single_processor_time"])
    rest = total - np.sum([measured[name] for name in PARTS], axis=0)
    parts = {name: Spread.of(measured[name]) for name in PARTS}
    return {**parts, "integration": Spread.of(rest.tolist()), "total": Spread.of(total.tolist())}


def single_factor(
    model: VehicleModel,
    speed: float,
    track: TrackRealisation,
    span: float,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Simulated seconds of one vehicle on one core over the seconds of a clock: by default wall time."""
    simulator = Simulator(model, speed, track=track)
    samples = _samples(model, span)
    begin = clock()
    simulator.advance(samples)
    return span / (clock() - begin)


def batch_factor(
    model: VehicleModel, speed: float, tracks: Sequence[TrackRealisation], span: float, threads: int
) -> float:
    """Simulated seconds of all vehicles of a batch, one on each track, over wall seconds."""
    batch = BatchSimulator([Simulator(model, speed, track=track) for track in tracks], threads)
    samples = _samples(model, span)
    begin = time.perf_counter()
    batch.advance(samples)
    return len(tracks) * span / (time.perf_counter() - begin)


def _samples(model: VehicleModel, span: float) -> int:
    return round(span * model.scenario.assessment.sample_rate)


class PartTimer:
    """Times the parts of the step of a vehicle that has run for a while.

    Parameters
    ----------
    simulator : Simulator
        The vehicle; it runs on for a while here.
    evaluations : int
        Evaluations in one measurement.
    """

    def __init__(self, simulator: Simulator, evaluations: int) -> None:
        self.simulator = simulator
        self.evaluations = evaluations
        states = [self._moved(SETTLING), self._moved(0.05)]
        self.q, self.v = (np.array([s[k] for s in states]) for k in range(2))

    def _moved(self, span: float) -> tuple[Array, Array]:
        self.simulator.advance(_samples(self.simulator.model, span))
        return self.simulator.state.q.copy(), self.simulator.state.v.copy()

    def microseconds(self, part: int) -> float:
        """Processor time of one evaluation of a part, an index in `PARTS` (us)."""
        s = self.simulator
        s.work.f[:] = 0.0  # it sums up whatever a part adds
        begin = time.thread_time()
        repeat(part, self.evaluations, s.plant, s.state, s.work, self.q, self.v)
        return 1e6 * (time.thread_time() - begin) / self.evaluations


class FirstOrder:
    """The vehicle as a system of first order for SciPy, from rest, over a span (s)."""

    def __init__(self, model: VehicleModel, speed: float, span: float) -> None:
        self.simulator = Simulator(model, speed, seed=0)
        self.n, self.m = model.multibody.n, len(model.dampers)
        self.start = float(self.simulator.state.clock[1])
        rate = model.scenario.assessment.sample_rate
        self.times = np.arange(1, _samples(model, span) + 1) / rate
        self.evaluations = 0

    def __call__(self, t: float, s: Array) -> Array:
        """Time derivative of displacements, velocities and damper forces."""
        n, run = self.n, self.simulator
        self.evaluations += 1
        out = np.empty(len(s))
        rates(run.plant, self.start + run.speed * t, s[:n], s[n : 2 * n], s[2 * n :], run.work, out)
        return out

    def solve(self, method: str, tolerance: float) -> tuple[Array, float]:
        """Lateral displacements of the bogie frames above the wheelsets, (t, w), and the wall time (s).

        Raises
        ------
        StudyError
            The integrator gave up.
        """
        scales = np.repeat(SCALES, [self.n, self.n, self.m])
        initial, span = np.zeros(len(scales)), (0.0, self.times[-1])
        begin = time.perf_counter()
        solution = solve_ivp(
            self, span, initial, method, t_eval=self.times, rtol=tolerance, atol=tolerance * scales
        )
        elapsed = time.perf_counter() - begin
        if not solution.success:
            raise StudyError(f"scipy's {method} at rtol {tolerance:g}: {solution.message}")
        return solution.y[: self.n].T @ self.simulator.plant.measure.T, elapsed


def match_accuracy(model: VehicleModel, speed: float, span: float) -> Reference:
    """Find SciPy's fastest integration that is at least as accurate as our time step.

    Accuracy is the RMS difference of the bogie frames' lateral displacement above the wheelsets from a tight
    solution, over its RMS. Of each method the loosest tolerance that is as good as our step competes.

    Raises
    ------
    StudyError
        No method is as accurate at any tolerance that is tried.
    """
    exact, _ = FirstOrder(model, speed, span).solve(*TIGHT)
    own = Simulator(model, speed, seed=0).advance(_samples(model, span), motion=True).motion
    system = FirstOrder(model, speed, span)
    step_error = _difference(own @ system.simulator.plant.measure.T, exact)
    candidates: list[tuple[float, Reference]] = []
    for method in METHODS:
        for tolerance in TOLERANCES:
            system = FirstOrder(model, speed, span)
            motion, elapsed = system.solve(method, tolerance)
            error = _difference(motion, exact)
            if error <= step_error:
                count = system.evaluations
                call = 1e6 * _call_time(system)
                candidates.append(
                    (elapsed, Reference(method, tolerance, error, step_error, count, call, span))
                )
                break
    if not candidates:
        raise StudyError(f"no scipy integrator came as near as {step_error:.1e} to the tight solution")
    return min(candidates, key=lambda c: c[0])[1]


def _difference(motion: Array, exact: Array) -> float:
    return float(np.sqrt(np.mean((motion - exact) ** 2) / np.mean(exact**2)))


def _call_time(system: FirstOrder, calls: int = 1000) -> float:
    state = np.repeat(1e-2 * np.array(SCALES), [system.n, system.n, system.m])
    begin = time.perf_counter()
    for _ in range(calls):
        system(0.0, state)
    return (time.perf_counter() - begin) / calls


def _starts(
    scenario: Scenario, speed: float, effort: Effort, steps: _Steps
) -> tuple[dict[str, Spread], dict[str, float] | None]:
    """Time and memory of a short ``sayd evaluate``, with nothing compiled yet and with everything."""
    results: dict[str, list[tuple[float, float]]] = {"first": [], "later": []}
    with tempfile.TemporaryDirectory(prefix="sayd-bench-") as folder:
        config = Path(folder) / "scenario.yaml"
        config.write_text(json.dumps(scenario.model_dump(mode="json")))
        command = [sys.executable, "-c", _PROGRAM + _PEAK, "evaluate", "--config", str(config), *_SHORT]
        command += ["--speeds", f"{speed * KMH:.6g}"]
        for k in range(effort.first_starts):
            results["first"].append(_timed(command, Path(folder) / f"cache-{k}"))
            steps.did("first start")
        for _ in range(effort.later_starts):
            results["later"].append(_timed(command, Path(folder) / "cache-0"))
            steps.did("later start")
    startup = {name: Spread.of([seconds for seconds, _ in pairs]) for name, pairs in results.items()}
    memory = {name: float(np.median([peak for _, peak in pairs])) for name, pairs in results.items()}
    return startup, memory if all(np.isfinite(list(memory.values()))) else None


def _timed(command: list[str], cache: Path) -> tuple[float, float]:
    """Wall time (s) and peak memory (MB, NaN if unknown) of a process."""
    environment = os.environ | {"SAYD_CACHE_DIR": str(cache)}
    begin = time.perf_counter()
    process = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    elapsed = time.perf_counter() - begin
    last = (process.stderr.strip().splitlines() or ["no message"])[-1]
    if process.returncode != 0:
        raise StudyError(f"a start of sayd failed: {last}")
    return elapsed, 1.024e-3 * float(last) if last.isdecimal() else float("nan")


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
