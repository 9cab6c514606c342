"""Many assessed runs: a vehicle over speeds and track seeds, in parallel, with progress."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.physics.simulator import RUN_OUT, Simulator, Telemetry, VehicleModel, threads
from sayd_env.stability import assess
from sayd_env.runs.cache import RunStore
from sayd_env.report.files import Progress, silent

Array = npt.NDArray[np.float64]
T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True)
class Run:
    """One assessed run: maxima over the 5 km, one value for each of the w wheelsets."""

    speed: float
    """m/s."""
    seed: int
    frequency: Array
    """(w,) dominant frequency of the bogie-frame acceleration, Hz."""
    frequency_force: Array
    """(w,) dominant frequency of the track shift force, Hz."""
    acceleration: Array
    """(w,) maximum sliding RMS of the bogie-frame acceleration, m/s2."""
    track_shift: Array
    """(w,) maximum sliding RMS of the track shift force, N."""


@dataclass(frozen=True)
class Sweep:
    """Assessed runs on a grid: arrays of shape (speeds, seeds, w)."""

    speeds: Array
    """m/s, rising."""
    seeds: tuple[int, ...]
    frequency: Array
    frequency_force: Array
    acceleration: Array
    track_shift: Array


def simulate(model: VehicleModel, speed: float, seed: int) -> Telemetry:
    """Signals of one run over run-in and assessed length, and a little beyond."""
    simulator, assessment = Simulator(model, speed, seed), model.scenario.assessment
    assert assessment.length is not None  # the simulator's track has refused it
    return simulator.run(assessment.run_in + assessment.length + RUN_OUT)


def assessed_run(model: VehicleModel, speed: float, seed: int) -> Run:
    """Simulate and assess one run."""
    signals = simulate(model, speed, seed)
    return run_from(signals.acceleration, signals.track_shift, speed, seed, model.scenario.assessment)


def run_from(
    acceleration: Array, track_shift: Array, speed: float, seed: int, settings: AssessmentConfig
) -> Run:
    """Assess the signals of a run, both of shape (t, w) and run-in included."""
    result = assess(np.hstack([acceleration, track_shift]), settings.sample_rate, speed, settings)
    w = acceleration.shape[1]
    f, peak = result.dominant_frequency, result.maximum
    return Run(speed, seed, f[:w], f[w:], peak[:w], peak[w:])


def sweep(
    model: VehicleModel,
    speeds: Sequence[float],
    seeds: Sequence[int],
    *,
    workers: int | None = None,
    progress: Progress = silent,
    store: RunStore[Run] | None = None,
) -> Sweep:
    """Assess a vehicle at every speed on every track realisation.

    Parameters
    ----------
    model : VehicleModel
        The vehicle.
    speeds : sequence of float
        Speeds, m/s.
    seeds : sequence of int
        Track seeds.
    workers : int, optional
        Threads; all cores by default. The result does not depend on it.
    progress : Progress
        Told after each run.
    store : RunStore, optional
        Where finished runs are kept, and looked for first.
    """
    for speed in speeds:
        model.check_speed(speed)  # refused before any work
    model.table  # noqa: B018 - made once, before the threads ask for it
    cases = [(speed, seed) for seed in seeds for speed in speeds]

    def run(case: tuple[float, int]) -> Run:
        if store is None:
            return assessed_run(model, *case)
        return store.remembered(run_name(*case), lambda: assessed_run(model, *case))

    runs = parallel(run, cases, workers, progress)
    return gathered(runs, speeds, seeds)


def run_name(speed: float, seed: int) -> str:
    """Name of a run in a store, from its speed (m/s) and its seed."""
    return f"{speed * 3.6:.9g}_kmh_seed_{seed}"


def gathered(runs: Sequence[Run], speeds: Sequence[float], seeds: Sequence[int]) -> Sweep:
    """Put runs on a grid: all speeds (m/s, rising) of the first seed, then those of the next."""
    shape = (len(seeds), len(speeds), -1)

    def grid(name: str) -> Array:
        return np.array([getattr(run, name) for run in runs]).reshape(shape).swapaxes(0, 1)

    return Sweep(
        speeds=np.array(speeds, dtype=float),
        seeds=tuple(seeds),
        frequency=grid("frequency"),
        frequency_force=grid("frequency_force"),
        acceleration=grid("acceleration"),
        track_shift=grid("track_shift"),
    )


def runs_table(grid: Sweep, wheelsets: Sequence[str]) -> tuple[Sequence[str], list[list[Any]]]:
    """Every run of a sweep as a table, one line for each wheelset."""
    header = (
        "speed_kmh",
        "seed",
        "wheelset",
        "dominant_frequency_hz",
        "dominant_frequency_force_hz",
        "acceleration_rms",
        "track_shift_rms_kn",
    )
    columns = (
        (grid.frequency, 1.0),
        (grid.frequency_force, 1.0),
        (grid.acceleration, 1.0),
        (grid.track_shift, 1e-3),
    )
    rows = [
        [v * 3.6, seed, name, *(values[i, j, k] * scale for values, scale in columns)]
        for i, v in enumerate(grid.speeds)
        for j, seed in enumerate(grid.seeds)
        for k, name in enumerate(wheelsets)
    ]
    return header, rows


def parallel(
    work: Callable[[U], T], cases: Iterable[U], workers: int | None = None, progress: Progress = silent
) -> list[T]:
    """Results of `work` for all cases, in their order, computed in threads; the first error ends it all."""
    todo = list(cases)
    # Not `concurrent.futures.wait`: interrupted while it holds the futures' locks, it keeps them for ever.
    outcomes: SimpleQueue[tuple[int, T | None, BaseException | None]] = SimpleQueue()

    def run(i: int) -> None:
        try:
            outcomes.put((i, work(todo[i]), None))
        except BaseException as error:  # the thread that waits raises it
            outcomes.put((i, None, error))

    results: dict[int, Any] = {}
    with threads(workers) as pool:
        try:
            for i in range(len(todo)):
                pool.submit(run, i)
            for i, result, error in _completed(outcomes, len(todo)):
                if error is not None:
                    raise error
                results[i] = result
                progress(len(results), len(todo))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [results[i] for i in range(len(todo))]


def _completed(outcomes: SimpleQueue[T], count: int) -> Iterator[T]:
    # A short timeout lets Ctrl-C through while all threads are in compiled code.
    while count:
        try:
            outcome = outcomes.get(timeout=0.2)
        except Empty:
            continue
        count -= 1
        yield outcome
