"""Assessed runs of a vehicle by itself: over speeds and track seeds."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.simulator import RUN_OUT, Simulator, VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.stability import assess


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
class Sweep:
    """Assessed runs on a grid: arrays of shape (speeds, seeds, w)."""

    speeds: Array
    """m/s, rising."""
    seeds: tuple[int, ...]
    frequency: Array
    frequency_force: Array
    acceleration: Array
    track_shift: Array


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
        """Runs that end together run side by side."""
        return id(self.scenario), self.speed


def sweep(
    scenario: Scenario,
    speeds: Sequence[float],
    seeds: Sequence[int],
    context: RunContext | None = None,
    what: str = "",
) -> Sweep:
    """Assess a vehicle at every speed on every track realisation.

    Parameters
    ----------
    scenario : Scenario
    speeds : sequence of float
        Speeds, m/s, rising.
    seeds : sequence of int
        Track seeds.
    context : RunContext, optional
    what : str
        Names the runs where progress is reported.

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
    settings = runs[0].scenario.assessment
    return [
        assessed_run(*signals, run.speed, run.seed, settings)
        for run, signals in zip(runs, simulated(runs), strict=True)
    ]


def simulated(runs: Sequence[PassiveRun]) -> list[tuple[Array, Array]]:
    """Make runs that are companions, over run-in and assessed length and a little beyond.

    Returns
    -------
    list of tuple of ndarray, shape (t, w)
        Lateral acceleration of the bogie frame (m/s2) and track shift force (N) at each wheelset.
    """
    settings, speed = runs[0].scenario.assessment, runs[0].speed
    assert settings.length is not None  # the simulator's track refuses it
    model = VehicleModel(runs[0].scenario)
    batch = BatchSimulator([Simulator(model, speed, run.seed) for run in runs], num_threads=1)
    distance = settings.run_in + settings.length + RUN_OUT
    signals = batch.advance(math.ceil(distance / speed * settings.sample_rate))
    w = len(model.multibody.wheelset_x)
    return [(each[:, :w], each[:, w : 2 * w]) for each in signals]


def assessed_run(
    acceleration: Array, track_shift: Array, speed: float, seed: int, settings: AssessmentConfig
) -> Assessed:
    """Assess the signals of a run, both of shape (t, w) and run-in included."""
    result = assess(np.hstack([acceleration, track_shift]), settings.sample_rate, speed, settings)
    w = acceleration.shape[1]
    f, peak = result.dominant_frequency, result.maximum
    return Assessed(speed, seed, f[:w], f[w:], peak[:w], peak[w:])


def gathered(runs: Sequence[Assessed], speeds: Sequence[float], seeds: Sequence[int]) -> Sweep:
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
        [v * KMH, seed, name, *(values[i, j, k] * scale for values, scale in columns)]
        for i, v in enumerate(grid.speeds)
        for j, seed in enumerate(grid.seeds)
        for k, name in enumerate(wheelsets)
    ]
    return header, rows
