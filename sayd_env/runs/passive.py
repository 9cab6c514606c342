"""Assessed runs of a vehicle by itself: over speeds and track seeds."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.errors import Diverged, StudyError
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array, Integers
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.simulator import RUN_OUT, Simulator, VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.stability import (
    CriticalSpeed,
    Crossing,
    Limits,
    assess,
    assessed_span,
    critical_speed,
    distance_run,
    grid_sensitivity,
    thinned_grids,
)

Selection: TypeAlias = slice | Integers
"""Of seeds by their places, with repetitions in a bootstrap."""
ALL = slice(None)
FAR = 100.0
"""Between speeds, a derailment counts as this many times the limit."""


@dataclass(frozen=True)
class Assessed:
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
class Criterion:
    """Highest value of the wheelsets in each run, and its limit of EN 14363; any selection of seeds."""

    speeds: Array
    """(n,) m/s, rising."""
    values: Array
    """(n, seeds)."""
    limit: float

    @property
    def ratios(self) -> Array:
        """(n, seeds) values over the limit."""
        return self.values / self.limit

    def medians(self, seeds: Selection = ALL) -> Array:
        """(n,) medians over seeds."""
        return np.asarray(np.median(self.values[:, seeds], axis=1))

    def critical_speed(self, seeds: Selection = ALL) -> CriticalSpeed:
        """Where the medians cross the limit (m/s)."""
        return critical_speed(self.speeds, np.minimum(self.medians(seeds), FAR * self.limit), self.limit)

    def kmh(self, seeds: Selection = ALL) -> float:
        """The same in km/h; NaN if they do not."""
        found = self.critical_speed(seeds).speed
        return math.nan if found is None else found * KMH

    def extrapolated_kmh(self) -> float:
        """The same, where the first or the last segment of the medians goes on beyond the grid.

        It goes on with the limit in 200 km/h at least, so that there is a finite value.
        """
        v, peak = self.speeds * KMH, self.medians()
        above = np.flatnonzero(peak > self.limit)
        i = len(v) - 1 if above.size == 0 else max(1, int(above[0]))
        slope = (peak[i] - peak[i - 1]) / (v[i] - v[i - 1])
        if above.size > 0 and above[0] > 0:
            return float(v[i] + (self.limit - peak[i]) / slope)
        end = i if above.size == 0 else 0
        return float(v[end] + (self.limit - peak[end]) / max(slope, self.limit / 200.0))

    def over_seeds_kmh(self) -> tuple[float, float]:
        """10 % and 90 % quantile of single seeds; infinite where they lie beyond the grid."""
        beyond = {Crossing.BELOW_GRID: -math.inf, Crossing.NOT_REACHED: math.inf}
        single = [self.critical_speed(np.array([j])) for j in range(self.values.shape[1])]
        speeds = [beyond[found.crossing] if found.speed is None else found.speed * KMH for found in single]
        low, high = np.quantile(speeds, (0.1, 0.9), method="nearest")
        return float(low), float(high)

    def over_seeds_text(self) -> str:
        """The same in words: ``355 to above 400``."""
        first, last = self.speeds[[0, -1]] * KMH
        beyond = {-math.inf: f"below {first:.0f}", math.inf: f"above {last:.0f}"}
        return " to ".join(beyond.get(v, f"{v:.0f}") for v in self.over_seeds_kmh())

    def sensitive(self, tolerance: float) -> bool:
        """Whether the critical speed moves by more than a tolerance (m/s) on a thinner grid of speeds."""
        values = np.minimum(self.medians(), FAR * self.limit)
        thinner = thinned_grids(self.speeds, values, self.limit)
        return grid_sensitivity(self.critical_speed(), thinner, tolerance).sensitive


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

    def criteria(self, limits: Limits) -> dict[str, Criterion]:
        """What EN 14363 limits, by name."""
        acceleration, force = (values.max(axis=-1) for values in (self.acceleration, self.track_shift))
        return {
            "acceleration": Criterion(self.speeds, acceleration, limits.acceleration),
            "track_shift_force": Criterion(self.speeds, force, limits.track_shift_force),
        }


@dataclass(frozen=True, eq=False)
class PassiveRun:
    """One run of a vehicle whose dampers need no controller."""

    scenario: Scenario
    speed: float
    """m/s."""
    seed: int

    def inputs(self) -> Sequence[Any]:
        """What the run depends on."""
        return self.scenario, (round(self.speed, 9), self.seed)

    def companions(self) -> Hashable:
        """Vehicles of one structure run side by side, whatever their numbers, speeds and tracks."""
        return self.scenario.vehicle.structure, self.scenario.assessment.sample_rate

    def duration(self) -> float:
        """As long as its speed is low."""
        return 1.0 / self.speed


def sweep(
    scenario: Scenario,
    speeds: Sequence[float],
    seeds: Sequence[int],
    context: RunContext | None = None,
    what: str = "",
) -> Sweep:
    """Assess a vehicle at every speed (m/s, rising) on the track of every seed.

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range.
    StudyError
        A run that diverged.
    """
    model = VehicleModel(scenario)
    for speed in speeds:
        model.check_speed(speed)  # refused before any work
    runs = [PassiveRun(scenario, speed, seed) for seed in seeds for speed in speeds]
    return gathered((context or RunContext()).records(assessed, runs, Assessed, what), speeds, seeds)


def assessed(runs: list[PassiveRun]) -> list[Assessed]:
    """Make runs that are companions, and assess them."""
    return [
        assessed_run(*signals, run.speed, run.seed, run.scenario.assessment)
        for run, signals in zip(runs, simulated(runs), strict=True)
    ]


def assessed_or_derailed(runs: list[PassiveRun]) -> list[Assessed]:
    """Make runs that are companions, and assess them; one that ends early is beyond every limit."""
    try:
        return assessed(runs)
    except Diverged:
        if len(runs) > 1:
            return [record for run in runs for record in assessed_or_derailed([run])]
        (run,) = runs
        wheelsets = len(VehicleModel(run.scenario).multibody.wheelset_x)
        return [beyond_limits(run.speed, run.seed, wheelsets)]


def beyond_limits(speed: float, seed: int, wheelsets: int) -> Assessed:
    """The record of a run at a speed (m/s) that ended early: beyond every limit, with no frequency."""
    none, beyond = np.full(wheelsets, np.nan), np.full(wheelsets, np.inf)
    return Assessed(speed, seed, none, none, beyond, beyond)


def simulated(runs: Sequence[PassiveRun]) -> list[tuple[Array, Array]]:
    """Make runs that are companions, over run-in and assessed length and a little beyond.

    Returns
    -------
    list of tuple of ndarray, shape (t, w)
        Lateral acceleration of the bogie frame (m/s2) and track shift force (N) at each wheelset.

    Raises
    ------
    Diverged
        Numbers of a run did not stay finite.
    """
    models = {id(run.scenario): VehicleModel(run.scenario) for run in runs}
    batch = BatchSimulator(
        [Simulator(models[id(run.scenario)], run.speed, run.seed) for run in runs], num_threads=1
    )
    samples = [_samples(run) for run in runs]
    try:
        signals = batch.advance(samples)
    except StudyError as error:
        raise Diverged(str(error)) from None
    w = len(models[id(runs[0].scenario)].multibody.wheelset_x)
    return [(own[:n, :w], own[:n, w : 2 * w]) for own, n in zip(signals, samples, strict=True)]


def _samples(run: PassiveRun) -> int:
    settings = run.scenario.assessment
    assert settings.length is not None  # the simulator's track refuses it
    distance = settings.run_in + settings.length + RUN_OUT
    return math.ceil(distance / run.speed * settings.sample_rate)


def assessed_run(
    acceleration: Array, track_shift: Array, speed: float, seed: int, settings: AssessmentConfig
) -> Assessed:
    """Assess the signals of a run (m/s2, N), both of shape (t, w) and run-in included.

    Raises
    ------
    DataError
        Signals too short for the assessment.
    """
    result = assess(np.hstack([acceleration, track_shift]), settings.sample_rate, speed, settings)
    w = acceleration.shape[1]
    f, peak = result.dominant_frequency, result.maximum
    return Assessed(speed, seed, f[:w], f[w:], peak[:w], peak[w:])


def assessed_part(samples: int, rate: float, speed: float, settings: AssessmentConfig) -> slice:
    """Samples of the assessed length among those of a run at constant speed (m/s), rate in Hz."""
    distance = distance_run(speed, rate, samples)
    first, last = np.searchsorted(distance, np.array(assessed_span(distance, settings)) - 1e-9)
    return slice(int(first), int(last))


def gathered(runs: Sequence[Assessed], speeds: Sequence[float], seeds: Sequence[int]) -> Sweep:
    """Put runs on a grid: all speeds (m/s, rising) of the first seed, then those of the next."""
    shape = (len(seeds), len(speeds), -1)
    grids = {
        name: np.array([getattr(run, name) for run in runs]).reshape(shape).swapaxes(0, 1)
        for name in ("frequency", "frequency_force", "acceleration", "track_shift")
    }
    return Sweep(np.array(speeds, dtype=float), tuple(seeds), **grids)


def runs_table(grid: Sweep, wheelsets: Sequence[str]) -> tuple[Sequence[str], list[list[Any]]]:
    """Every run of a sweep as a table, one line for each wheelset."""
    columns = {
        "dominant_frequency_hz": grid.frequency,
        "dominant_frequency_force_hz": grid.frequency_force,
        "acceleration_rms": grid.acceleration,
        "track_shift_rms_kn": grid.track_shift * 1e-3,
    }
    rows = [
        [v * KMH, seed, name, *(values[i, j, k] for values in columns.values())]
        for i, v in enumerate(grid.speeds)
        for j, seed in enumerate(grid.seeds)
        for k, name in enumerate(wheelsets)
    ]
    return ("speed_kmh", "seed", "wheelset", *columns), rows
