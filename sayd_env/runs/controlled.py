"""Assessed runs of a controlled vehicle: what the paper's figures 11 to 18 show of them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import decimate, welch

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array, Array32
from sayd_env.envs.loop import LOG_ACCELERATION, LOG_FORCE, LOG_HYDRAULIC, LOG_TRACK_SHIFT
from sayd_env.envs.rollout import Rollout
from sayd_env.runs.context import RunContext
from sayd_env.runs.passive import (
    Assessed,
    Sweep,
    assessed_part,
    assessed_run,
    beyond_limits,
    gathered,
    runs_table,
)
from sayd_env.runs.policies import PolicySpec, for_policy, policy_spec
from sayd_env.runs.rollouts import Run, environment_of, roll_out_runs

IMPOSSIBLE = 1e5
"""Acceleration of a bogie frame that no wheel on a rail causes, m/s2: the integration diverged."""
HIGH_FREQUENCY = 10.0
"""Hz; above it lies what the paper calls the high-frequency part of the damper force."""
FRONT, REAR = 0, 1
"""Columns of the bogies' commands."""

_REAR_DAMPER = 4  # the rear bogie's first damper, in the order of `Multibody.yaw_dampers`
_TRACE_RATE, _TRACE_TIME = 200.0, 40.0  # Hz and s: enough for figures 12, 14, 16 and 18
_SPECTRUM_SEGMENT = 2.0  # s, so that 10 Hz is the twentieth line and leakage across it is small


@dataclass(frozen=True)
class ControlledRun(Assessed):
    """One assessed run with controlled dampers, of d dampers and b bogies; forces are over its 5 km."""

    policy: str
    """Name of the controller."""
    initial_current: float
    """Valve current of the run-in, 0 to 1, and the controller's first command where it keeps one."""
    force_rms: float
    """RMS of the damper force over time and dampers, N."""
    force_peak: float
    """Largest absolute force of any damper, N."""
    force_power_high: float
    """Power of the damper force above 10 Hz, mean over the dampers, N^2."""
    command: Array32
    """(steps, b) commanded valve opening of each bogie, 0 to 1, from the end of the run-in on."""
    control_period: float
    """How long a command holds, s."""
    force_trace: Array32
    """(n,) force of one damper of the rear bogie, N: the first 40 s behind the run-in."""
    trace_period: float
    """Time between two values of the trace, s."""


def controlled_runs(
    scenario: Scenario,
    environment: EnvironmentConfig,
    seeds: Sequence[int],
    required: Iterable[tuple[str, float, float]],
    context: RunContext,
    policies: Mapping[str, PolicySpec] | None = None,
) -> ControlledRuns:
    """Make and assess the runs that the rows of a claim need, or take them from the cache.

    Parameters
    ----------
    scenario : Scenario
        The packaged semi-active dampers replace passive ones; others stay.
    environment : EnvironmentConfig
        Sensors and clock.
    seeds : sequence of int
        Track seeds; each of the following is run with all of them.
    required : iterable
        Names of policies with their speed (m/s) and initial current.
    policies : mapping, optional
        What some of the names stand for; the packaged policies by default.

    Raises
    ------
    ConfigError, StudyError
        See `policy_spec`, `roll_out_runs` and `controlled_run_of`.
    """
    runs: list[Run] = []
    for name, speed, current in required:
        policy = replace((policies or {}).get(name) or policy_spec(name), label=name)
        fitted = for_policy(scenario, policy)
        config = environment_of(fitted, environment)
        runs += [Run(policy, fitted, config, speed, seed, current) for seed in seeds]
    found = context.records(assessed_or_derailed, runs, ControlledRun)
    return ControlledRuns(
        replace(record, policy=run.policy.title) for run, record in zip(runs, found, strict=True)
    )


def assessed_controlled(runs: list[Run]) -> list[ControlledRun]:
    """Make runs that are companions, and assess them."""
    return [
        controlled_run_of(run.policy.title, rollout, run.scenario.assessment)
        for run, rollout in zip(runs, roll_out_runs(runs), strict=True)
    ]


def assessed_or_derailed(runs: list[Run]) -> list[ControlledRun]:
    """Make runs that are companions, and assess them.

    Where the vehicle derails, what belongs to the whole length is infinite, and it has no frequency.
    """
    return [
        controlled_run_of(run.policy.title, rollout, run.scenario.assessment)
        if rollout.ending is None
        else _derailed(run.policy.title, rollout)
        for run, rollout in zip(runs, roll_out_runs(runs), strict=True)
    ]


def controlled_run_of(policy: str, rollout: Rollout, settings: AssessmentConfig) -> ControlledRun:
    """Assess a rollout whose policy commands each bogie, over run-in and at least the assessed length.

    Raises
    ------
    StudyError
        The run ended early.
    ConfigError
        The environment's run-in is not the assessment's.
    DataError
        Signals that are too short or not finite.
    """
    episode, rate, period = rollout.episode, rollout.sample_rate, rollout.control_period
    if rollout.ending is not None:
        where = f"at {episode.speed * KMH:g} km/h, seed {episode.seed}"
        raise StudyError(f"the run of '{policy}' {where}, ended: {rollout.ending}")
    late = rollout.run_in / rate - settings.run_in / episode.speed
    if not -1.5 / rate < late < period + 1.5 / rate:  # a whole number of periods
        raise ConfigError(
            f"assessment.run_in: found {settings.run_in:g} m, while the environment runs in for "
            f"{rollout.run_in / rate * episode.speed:.0f} m; expected the same"
        )
    signals = rollout.true
    acceleration = signals[:, LOG_ACCELERATION:LOG_TRACK_SHIFT]
    track_shift = signals[:, LOG_TRACK_SHIFT:LOG_FORCE]
    assessed = assessed_run(acceleration, track_shift, episode.speed, episode.seed, settings)
    part = assessed_part(len(signals), rate, episode.speed, settings)
    force = signals[part, LOG_FORCE:LOG_HYDRAULIC]
    rms, peak, power = force_use(force, rate)
    trace, trace_period = _trace(signals[part.start :, LOG_FORCE + _REAR_DAMPER], rate)
    return ControlledRun(
        **vars(assessed),
        policy=policy,
        initial_current=episode.initial_current,
        force_rms=rms,
        force_peak=peak,
        force_power_high=power,
        command=rollout.actions[: int(len(force) / rate / period + 1e-6)],
        control_period=period,
        force_trace=trace,
        trace_period=trace_period,
    )


def force_use(force: Array, rate: float) -> tuple[float, float, float]:
    """RMS (N), peak (N) and power above 10 Hz (N^2) of dampers' forces, shape (samples, dampers)."""
    return float(np.sqrt(np.mean(force**2))), float(np.max(np.abs(force))), high_frequency_power(force, rate)


def refuse_divergence(rollout: Rollout) -> None:
    """Refuse a run that ended because the simulation diverged: this is no derailment.

    Raises
    ------
    StudyError
        It did.
    """
    fiercest = np.max(np.abs(rollout.true[:, LOG_ACCELERATION:LOG_TRACK_SHIFT]))
    if str(rollout.ending).startswith("non-finite") or not fiercest < IMPOSSIBLE:
        raise StudyError(
            f"the run of seed {rollout.episode.seed} at {rollout.episode.speed * KMH:g} km/h diverged"
        )


def _derailed(policy: str, rollout: Rollout) -> ControlledRun:
    """Make the record of a run that a derailment ended: beyond every limit; a divergence is refused."""
    refuse_divergence(rollout)
    episode = rollout.episode
    at_rest = np.full((1, rollout.actions.shape[1]), episode.initial_current, dtype=np.float32)
    return ControlledRun(
        **vars(beyond_limits(episode.speed, episode.seed, LOG_TRACK_SHIFT - LOG_ACCELERATION)),
        policy=policy,
        initial_current=episode.initial_current,
        force_rms=np.inf,
        force_peak=np.inf,
        force_power_high=np.inf,
        command=rollout.actions if len(rollout.actions) else at_rest,
        control_period=rollout.control_period,
        force_trace=np.zeros(0, dtype=np.float32),
        trace_period=1.0 / _TRACE_RATE,
    )


def high_frequency_power(force: Array, sample_rate: float) -> float:
    """Power of forces, shape (t, d) in N, above 10 Hz by Welch's (1967) averaged spectra (N^2).

    Mean over the dampers; the sampling rate is in Hz.
    """
    segment = min(round(_SPECTRUM_SEGMENT * sample_rate), len(force))
    frequency, density = welch(force, fs=sample_rate, nperseg=segment, axis=0)
    power = density[frequency > HIGH_FREQUENCY].sum(axis=0) * frequency[1]
    return float(np.mean(power))


def _trace(force: Array, sample_rate: float) -> tuple[Array32, float]:
    """Thinned start of a force, and the time between its values."""
    start = force[: round(_TRACE_TIME * sample_rate)]
    step = max(round(sample_rate / _TRACE_RATE), 1)
    thinned = decimate(start, step, ftype="fir") if step > 1 else start
    return np.asarray(thinned, dtype=np.float32), step / sample_rate


class ControlledRuns:
    """Runs of several controllers over speeds and seeds, in any order; every controller on the same seeds.

    Raises
    ------
    ValueError
        No run at all, or one run twice; in methods: a run that is missing.
    """

    def __init__(self, runs: Iterable[ControlledRun]) -> None:
        self.runs = tuple(runs)
        """All runs."""
        self._runs = {
            (run.policy, run.initial_current, round(run.speed * KMH, 6), run.seed): run for run in self.runs
        }
        if not self.runs or len(self._runs) < len(self.runs):
            raise ValueError("the same run twice" if self.runs else "no runs")
        self.seeds = tuple(sorted({run.seed for run in self.runs}))
        self.variants = tuple(dict.fromkeys((run.policy, run.initial_current) for run in self.runs))
        """Controllers with their initial currents, in the order of the runs."""

    @property
    def speeds(self) -> list[float]:
        """All speeds, m/s, rising."""
        return sorted({run.speed for run in self.runs})

    def at(self, policy: str, kmh: float, initial_current: float = 0.0) -> tuple[ControlledRun, ...]:
        """Runs of a controller at a speed (km/h), one for each seed."""
        keys = [(policy, initial_current, round(kmh, 6), seed) for seed in self.seeds]
        for key in keys:
            if key not in self._runs:
                raise ValueError(
                    f"no run of '{policy}' at {kmh:g} km/h, V(0) = {initial_current:g}, seed {key[-1]}"
                )
        return tuple(self._runs[key] for key in keys)

    def in_place_of(self, policies: Collection[str], stand_in: str) -> ControlledRuns:
        """The same, but for runs from closed valves of some policies: those of another one stand for them."""
        replaced = {run.policy for run in self.runs if run.policy in policies}
        kept = [run for run in self.runs if run.policy not in policies or run.initial_current != 0.0]
        others = [run for run in self.runs if run.policy == stand_in and run.initial_current == 0.0]
        return ControlledRuns([*kept, *(replace(run, policy=name) for name in replaced for run in others)])

    def sweep(self, policy: str, initial_current: float = 0.0) -> Sweep:
        """Assessed quantities of a controller over its speeds."""
        variant = policy, initial_current
        speeds = sorted({r.speed for r in self.runs if (r.policy, r.initial_current) == variant})
        columns = [self.at(policy, speed * KMH, initial_current) for speed in speeds]
        return gathered([run for row in zip(*columns, strict=True) for run in row], speeds, self.seeds)

    def tables(self, wheelsets: Sequence[str]) -> dict[str, tuple[Sequence[str], list[list[Any]]]]:
        """Every run: assessed quantities of each wheelset, and what the dampers did."""
        sweeps = {variant: runs_table(self.sweep(*variant), wheelsets) for variant in self.variants}
        header, _ = sweeps[self.variants[0]]
        assessed = [[*variant, *row] for variant, (_, rows) in sweeps.items() for row in rows]
        dampers = [_damper_row(run) for run in self.runs]
        return {
            "runs_controlled": (("policy", "initial_current", *header), assessed),
            "dampers_controlled": (list(dampers[0]), [list(row.values()) for row in dampers]),
        }


def _damper_row(run: ControlledRun) -> dict[str, Any]:
    commands = run.command.mean(axis=0, dtype=np.float64)
    return {
        "policy": run.policy,
        "initial_current": run.initial_current,
        "speed_kmh": run.speed * KMH,
        "seed": run.seed,
        "force_rms_n": run.force_rms,
        "force_peak_n": run.force_peak,
        "force_power_above_10_hz_n2": run.force_power_high,
        "command_front_mean": commands[FRONT],
        "command_rear_mean": commands[REAR],
    }
