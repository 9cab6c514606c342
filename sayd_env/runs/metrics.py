"""Runs of policies, judged: cost, limits of EN 14363, forces, valves, ride comfort."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import CostConfig, Scenario
from sayd_env.config.units import KMH, Array, Array32, Flags
from sayd_env.envs.cost import charged, weighted
from sayd_env.envs.loop import (
    BOGIES,
    LOG_ACCELERATION,
    LOG_BODY,
    LOG_CURRENT,
    LOG_HYDRAULIC,
    LOG_TRACK_SHIFT,
)
from sayd_env.envs.rollout import Rollout
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.runs.controlled import controlled_run_of, refuse_divergence
from sayd_env.runs.passive import assessed_part
from sayd_env.runs.policies import PASSIVE
from sayd_env.runs.rollouts import Run, roll_out_runs
from sayd_env.stability import assessed_span, averaged_spectra, band_pass, distance_run
from sayd_env.stability.comfort import BLOCK, mean_comfort

LOWER, UPPER = 0.25, 0.75
"""A valve switches when its command goes from the lower quarter of its range to the upper one, or back."""


@dataclass(frozen=True)
class Row:
    """One run; units stand in the names, ratios are to the limits of EN 14363.

    Where the run derails, what belongs to the whole assessed length is infinite.
    """

    policy: str
    speed_kmh: float
    wear: float
    friction: float
    seed: int
    J: float
    """Mean cost of the bogies, eq. (27), over the episode of the environment, with the on-line filter.

    Minus the mean reward per second, with the charge for a derailment.
    """
    J_acceleration: float
    """(psi_y / y_lim)^2 of this, unweighted."""
    J_force: float
    """(psi_F / F_max)^2 of this, unweighted."""
    J_run: float
    """J over the whole seconds of the assessed length, on-line filter."""
    J_offline: float
    """J over the assessed length, with the filter of the assessment, which no policy can move."""
    J_offline_acceleration: float
    """(psi_y / y_lim)^2 of this, unweighted."""
    J_offline_force: float
    """(psi_F / F_max)^2 of this, unweighted."""
    acceleration_ratio: float
    track_shift_ratio: float
    force_rms_n: float
    force_peak_n: float
    force_power_above_10_hz_n2: float
    """Power of the damper force above 10 Hz, mean over the dampers."""
    comfort: float
    """N_MV of EN 12299, the worst of the places above both bogies and mid-way."""
    valve_mean: float | None = None
    """Mean valve command; None for a passive damper."""
    valve_travel_per_km: float | None = None
    """Changes of the valve command added up over a kilometre, mean over the valves; 1: the whole range."""
    switching_per_s: float | None = None
    """Passages of the valve command between the outer quarters of its range, mean over the valves."""
    fallback_share: float | None = None
    """Share of the time in which the safe fallback intervened, mean over the bogies; None without one."""
    ending: str | None = None
    """Why the run ended early; None if it did not."""
    duration_s: float = math.nan
    """From step 0 to the end of the run."""

    def lost(self, seconds: float) -> float:
        """Share of so many seconds from step 0 on that an early end has cut off."""
        return 0.0 if self.ending is None else max(1.0 - self.duration_s / seconds, 0.0)

    def cost(self, environment: EnvironmentConfig, weights: CostConfig) -> float:
        """J over the episode of the environment that ran, on-line filter, with other weights."""
        lost = self.lost(environment.episode_s)
        return float(charged(environment, weights, self.J_acceleration, self.J_force, lost))


def judged(runs: list[Run]) -> list[Row]:
    """Make runs that are companions over run-in and assessed length, and judge them."""
    return [policy_row(run, rollout) for run, rollout in zip(runs, roll_out_runs(runs), strict=True)]


def rows(
    runs: Sequence[Run],
    context: RunContext,
    what: str = "",
    judge: Callable[[list[Run]], list[Row]] = judged,
) -> list[Row]:
    """Make runs, or take them from the cache, and judge them.

    Parameters
    ----------
    what : str
        Names the runs where progress is reported.
    judge : callable
        Makes and judges runs that are companions; `sayd_env.runs.along.judged_along` those along lines.

    Raises
    ------
    ConfigError
        A policy that does not fit.
    StudyError
        A run that diverged.
    """
    found = context.records(judge, runs, Row, what)
    return [replace(row, policy=run.policy.title) for run, row in zip(runs, found, strict=True)]


@dataclass(frozen=True)
class CostParts:
    """Cost of an episode whose weights are still open."""

    acceleration: float
    """Mean of (psi_y / y_lim)^2, on-line filter."""
    force: float
    """Mean of (psi_F / F_max)^2."""
    lost: float
    """Share of the episode that a derailment has cut off."""


def cost_parts(runs: list[Run]) -> list[CostParts]:
    """Make runs that are companions over the episode of their environment, and take the parts of their J.

    Raises
    ------
    StudyError
        A run that diverged.
    """
    found = []
    for run, rollout in zip(runs, roll_out_runs(runs, episode=True), strict=True):
        if rollout.ending is not None:
            refuse_divergence(rollout)
        cost = rollout.episode_cost(run.environment, run.scenario)
        share = len(rollout.terms) * rollout.control_period / run.environment.episode_s
        found.append(CostParts(cost.acceleration, cost.force, max(1.0 - share, 0.0)))
    return found


def policy_row(run: Run, rollout: Rollout) -> Row:
    """Judge a run from its rollout over run-in and assessed length, or less where it ended early.

    Raises
    ------
    StudyError
        The simulation diverged.
    ConfigError
        The environment's run-in is not the assessment's.
    """
    length, period = run.scenario.assessment.length or 0.0, rollout.control_period
    command = rollout.actions[: int(length / run.speed / period + 1e-6)]
    return row_of(run, rollout, _measured, command, run.speed * len(command) * period)


def row_of(
    run: Run,
    rollout: Rollout,
    measure: Callable[[Run, Rollout], dict[str, float]],
    command: Array32,
    distance: float,
) -> Row:
    """A run as a row.

    Parameters
    ----------
    measure : callable
        Gives the columns `OVER_THE_LENGTH`, which are infinite where the run ended early.
    command : ndarray, shape (steps, valves)
        The commands that count.
    distance : float
        Over which they were given, m.

    Raises
    ------
    StudyError
        The simulation diverged.
    """
    if rollout.ending is not None:
        refuse_divergence(rollout)
        over_the_length = dict.fromkeys(OVER_THE_LENGTH, math.inf)
    else:
        over_the_length = measure(run, rollout)
    cost = rollout.episode_cost(run.environment, run.scenario)
    return Row(
        policy=run.policy.title,
        speed_kmh=round(run.speed * KMH, 6),
        wear=run.scenario.wear,
        friction=run.scenario.friction,
        seed=rollout.episode.seed,
        J=cost.total,
        J_acceleration=cost.acceleration,
        J_force=cost.force,
        **over_the_length,
        **({} if run.policy.name == PASSIVE else _use(rollout, command, distance)),
        ending=rollout.ending,
        duration_s=len(rollout.terms) * rollout.control_period,
    )


def band_passed(
    acceleration: Array, rate: float, distance: Array, span: tuple[float, float], settings: AssessmentConfig
) -> Array:
    """Accelerations behind the off-line filter; each bogie has one f_0, of its spectra in a span.

    Parameters
    ----------
    acceleration : ndarray, shape (t, 4)
        Lateral accelerations of the bogie frames (m/s2).
    rate : float
        Hz.
    distance : ndarray, shape (t,)
        Of each sample (m).
    span : tuple of float
        Distances (m) between which the spectra are taken.

    Returns
    -------
    ndarray, shape (t, 4)

    Raises
    ------
    DataError
        A span shorter than one segment of the spectrum.
    """
    grid, spectra = averaged_spectra(acceleration, rate, distance, settings, span)
    width = len(spectra) // BOGIES
    pairs = spectra.reshape(BOGIES, width, -1).sum(axis=1)
    f0 = np.repeat(grid[np.argmax(pairs[:, 1:-1], axis=1) + 1], width)
    return band_pass(acceleration, rate, f0, settings)


def comfort_index(rollout: Rollout, scenario: Scenario, part: slice) -> float:
    """Worst mean comfort index of the three places on the floor over some samples.

    NaN below 5 s, and of vehicles without a floor.
    """
    rate = rollout.sample_rate
    if scenario.vehicle.floor_height is None or part.stop - part.start < BLOCK * rate:
        return math.nan
    places = (rollout.true[:, k : k + 3] for k in range(LOG_BODY, LOG_BODY + 9, 3))
    return max(mean_comfort(place, rate, part.start, part.stop) for place in places)


def switchings(command: Array32, lower: float = LOWER, upper: float = UPPER) -> float:
    """Passages of commands, shape (steps, valves), from one end of their range to the other, their mean.

    The ends lie up to `lower` and from `upper` on. What lies between them does not count, nor does a return
    to the end from which the command came: the number does not depend on how often a command is given.
    """
    ends = np.where(command >= upper, 1, np.where(command <= lower, -1, 0))
    visited = (column[column != 0] for column in ends.T)
    return float(np.mean([np.count_nonzero(np.diff(each)) for each in visited]))


def _measured(run: Run, rollout: Rollout) -> dict[str, float]:
    scenario, speed, rate = run.scenario, rollout.episode.speed, rollout.sample_rate
    settings, bounds = scenario.assessment, model_limits(VehicleModel(scenario))
    controlled = controlled_run_of("", rollout, settings)
    acceleration = rollout.true[:, LOG_ACCELERATION:LOG_TRACK_SHIFT]
    distance = distance_run(speed, rate, len(acceleration))
    part = assessed_part(len(acceleration), rate, speed, settings)
    span = assessed_span(distance, settings)
    filtered = band_passed(acceleration, rate, distance, span, settings)[part]
    force = rollout.true[part, LOG_HYDRAULIC:LOG_CURRENT]
    # Unweighted means over time, points or dampers, and bogies.
    offline = (
        float(np.mean((filtered / bounds.acceleration) ** 2)),
        float(np.mean((force / scenario.cost.force_reference) ** 2)),
    )
    return {
        "J_run": weighted(scenario.cost, *rollout.cost(math.floor((settings.length or 0.0) / speed))),
        "J_offline": weighted(scenario.cost, *offline),
        "J_offline_acceleration": offline[0],
        "J_offline_force": offline[1],
        "acceleration_ratio": float(controlled.acceleration.max() / bounds.acceleration),
        "track_shift_ratio": float(controlled.track_shift.max() / bounds.track_shift_force),
        "force_rms_n": controlled.force_rms,
        "force_peak_n": controlled.force_peak,
        "force_power_above_10_hz_n2": controlled.force_power_high,
        "comfort": comfort_index(rollout, scenario, part),
    }


RATIOS = ("acceleration_ratio", "track_shift_ratio")
"""Columns of ratios to the limits of EN 14363."""
OVER_THE_LENGTH = (
    *("J_run", "J_offline", "J_offline_acceleration", "J_offline_force"),
    *RATIOS,
    *("force_rms_n", "force_peak_n", "force_power_above_10_hz_n2", "comfort"),
)
"""Columns that belong to the whole assessed length."""


def _use(rollout: Rollout, command: Array32, distance: float) -> dict[str, Any]:
    """What commands of a rollout did over a distance (m); nothing where the run ended before step 0."""
    if not len(command):
        return {}
    travel = np.abs(np.diff(command, axis=0)).sum(axis=0, dtype=np.float64).mean()
    return {
        "valve_mean": float(command.mean(dtype=np.float64)),
        "valve_travel_per_km": float(travel / (distance * 1e-3)),
        "switching_per_s": switchings(command) / (len(command) * rollout.control_period),
        "fallback_share": _share(rollout.intervened, len(command)),
    }


def _share(intervened: Flags | None, periods: int) -> float | None:
    return None if intervened is None else float(intervened[:periods].mean())
