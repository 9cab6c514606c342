"""Policies along lines: what each section of a line costs, and what it asks of wheels and rails."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy.integrate import cumulative_trapezoid

from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.conditions import Line
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.line import LineConfig
from sayd_env.config.scenario import CostConfig, Scenario
from sayd_env.config.units import Array, Integers
from sayd_env.envs.cost import charged, squares, weighted
from sayd_env.envs.loop import (
    LOG_ACCELERATION,
    LOG_BODY,
    LOG_CURRENT,
    LOG_FILTERED,
    LOG_FORCE,
    LOG_HYDRAULIC,
    LOG_TRACK_SHIFT,
    PEAK_QUOTIENT,
    PEAK_TRACK_SHIFT,
)
from sayd_env.envs.rollout import Rollout
from sayd_env.envs.trace import WHEEL_VERTICAL
from sayd_env.envs.vehicle import model_limits
from sayd_env.measured.lines import load_line
from sayd_env.physics.plant import LANES
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.controlled import force_use, refuse_divergence
from sayd_env.runs.metrics import Row, band_passed, comfort_index, row_of
from sayd_env.runs.policies import PolicySpec, for_policy
from sayd_env.runs.rollouts import Run, environment_of, roll_out_runs
from sayd_env.stability import assess
from sayd_env.stability.signals import sliding_rms

_WHEEL_LOADS = range(WHEEL_VERTICAL, WHEEL_VERTICAL + LANES)

SECOND = 1.0
"""Time over which the damper force is averaged to tell what a curve needs (s): a step of the paper's MPPT."""


@dataclass(frozen=True)
class Trip:
    """A train on a line: where it is when."""

    line: Line
    speed: float
    """Where the line leaves it out, m/s."""

    @property
    def seconds(self) -> int:
        """Whole seconds to the line's end; in the last of them the line goes on as it ends."""
        time = self.line.time_at(self.line.length)
        exact = self.line.length / self.speed if time is None else float(time)
        return math.ceil(exact - 1e-6)

    def distance(self, t: npt.ArrayLike) -> Array:
        """Distances (m) at times from step 0 on (s); before it the train runs at its first speed."""
        t = np.asarray(t, dtype=np.float64)
        along = self.line.distance_at(np.maximum(t, 0.0))
        return self.speed * t if along is None else np.where(t < 0.0, self.speed * t, along)

    def speed_at(self, s: Array) -> Array:
        """Speeds (m/s) at distances (m)."""
        found = self.line.speed_at(s)
        return np.full(s.shape, self.speed) if found is None else found

    def sections(self, t: npt.ArrayLike) -> Integers:
        """Numbers of the sections in which the train is at times (s)."""
        ends = np.array([each.end for each in self.line.sections[:-1]])
        return np.searchsorted(ends, self.distance(t), side="right")


@dataclass(frozen=True)
class LineRecord:
    """One run along a line of s sections and n whole seconds; NaN for what there is not."""

    time: Array
    """(s,) of each section, run or not, s."""
    acceleration: Array
    """(s,) mean of (psi_y / y_lim)^2 in each section, unweighted, on-line filter."""
    force: Array
    """(s,) mean of (psi_F / F_max)^2."""
    curve_force: Array
    """(s,) part of it that belongs to means of the damper forces over whole seconds: no hunting."""
    lost: Array
    """(s,) share of the section's time that an early end has cut off."""
    quotient: Array
    """(s,) largest Y/Q of a wheel, mean over the averaging distance."""
    track_shift: Array
    """(s,) largest track shift force of a wheelset, mean over the same distance, N."""
    unloading: Array
    """(s,) largest share of its static load that a wheel has lost, mean over the same distance."""
    acceleration_rms: Array
    """(s,) largest sliding RMS of a frame's acceleration by EN 14363 on the section's straight part, m/s2."""
    track_shift_rms: Array
    """(s,) the same of the track shift force, N."""
    command: Array
    """(n, A) mean valve commands of each second."""
    cost_acceleration: Array
    """(n,) (psi_y / y_lim)^2 of each second."""
    cost_force: Array
    """(n,) (psi_F / F_max)^2."""
    peak_quotient: Array
    """(n,) largest mean Y/Q."""
    peak_track_shift: Array
    """(n,) largest mean track shift force, N."""
    position: Array
    """(w,) centres of the windows of the sliding RMS of the acceleration, m."""
    sliding_rms_acceleration: Array
    """(w,) largest sliding RMS of a frame's acceleration behind the on-line filter, m/s2."""
    ending: str | None = None
    """Why the run ended early; None if it did not."""

    def cost(self, environment: EnvironmentConfig, weights: CostConfig) -> Array:
        """(s,) J of each section, with the charge for what an early end has cut off."""
        return charged(environment, weights, self.acceleration, self.force, self.lost)

    def mean(self, values: Array) -> float:
        """Mean over the line of what a section has as a mean over its time."""
        return float(np.dot(np.where(self.time > 0.0, values, 0.0), self.time) / self.time.sum())


def line_runs(
    policies: Iterable[PolicySpec],
    scenario: Scenario,
    line: str | LineConfig | Line,
    speeds: Sequence[float],
    seeds: Sequence[int],
    environment: EnvironmentConfig,
    *,
    initial_current: float = 0.0,
) -> Iterator[Run]:
    """Runs of every policy over the whole of a line, at every speed with every seed, in this order.

    Parameters
    ----------
    scenario : Scenario
        What the line leaves out is as this has it.
    speeds : sequence of float
        m/s; of a line with speeds of its own there must be one, which does not count.
    seeds : sequence of int
        Of the tracks.
    environment : EnvironmentConfig
        Sensors and clock.
    initial_current : float
        Valve command of the run-in.

    Raises
    ------
    ConfigError
        A line that cannot be, a policy that does not fit, a speed outside the vehicle's range.
    """
    trips = [Trip(resolved(line, scenario, speed), speed) for speed in speeds]
    for policy in policies:
        fitted = for_policy(scenario, policy)
        model, config = VehicleModel(fitted), environment_of(fitted, environment)
        for trip in trips:
            first = float(trip.speed_at(np.zeros(1))[0])
            for speed in (first, trip.line.slowest or first, trip.line.fastest or first):
                model.check_speed(speed)
            whole = config.model_copy(update={"episode_s": float(Trip(trip.line, first).seconds)})
            for seed in seeds:
                yield Run(policy, fitted, whole, first, seed, initial_current, trip.line)


def resolved(line: str | LineConfig | Line, scenario: Scenario, speed: float | None) -> Line:
    """A line in a scenario.

    Raises
    ------
    ConfigError, DataError
        As `load_line`.
    """
    if isinstance(line, Line):
        return line
    return load_line(line, speed=speed, gauge=scenario.track.gauge, friction=scenario.friction)


def along_lines(runs: list[Run]) -> list[LineRecord]:
    """Make runs along lines that are companions, and judge them.

    Raises
    ------
    ConfigError
        A policy that does not fit.
    StudyError
        A run that diverged.
    """
    rollouts = roll_out_runs(runs, episode=True, keep=_WHEEL_LOADS)
    return [_record(run, rollout) for run, rollout in zip(runs, rollouts, strict=True)]


def _record(run: Run, rollout: Rollout) -> LineRecord:
    """Judge a run along a line from its rollout; one that diverged is refused."""
    assert run.line is not None
    if rollout.ending is not None:
        refuse_divergence(rollout)
    trip = Trip(run.line, run.speed)
    period, settings = rollout.control_period, run.environment
    planned = round(settings.episode_s / period)
    place = trip.sections((np.arange(planned) + 0.5) * period)
    taken = place[: len(rollout.terms)]
    count = len(run.line.sections)
    periods = np.bincount(place, minlength=count)

    def mean(values: Array) -> Array:
        """By section over the time of all of it; values are rates of the periods that were run.

        NaN for a section so short that no period is its.
        """
        whole = np.full(count, np.nan)
        np.divide(np.bincount(taken, values, count), periods, out=whole, where=periods > 0)
        return whole

    def most(values: Array) -> Array:
        return np.array([values[taken == k].max(initial=-math.inf) for k in range(count)])

    acceleration, force = (each / period for each in squares(rollout.terms))
    curve = _second_means(rollout) / run.scenario.cost.force_reference**2
    unloading = _unloading(run, rollout, trip)
    rms = _sliding_rms(run, rollout, trip)
    second = round(SECOND / period)
    return LineRecord(
        time=np.asarray(periods * period, dtype=np.float64),
        acceleration=mean(acceleration),
        force=mean(force),
        curve_force=mean(curve),
        lost=1.0 - mean(np.ones(len(taken))),
        quotient=_known(most(rollout.terms[:, PEAK_QUOTIENT])),
        track_shift=_known(most(rollout.terms[:, PEAK_TRACK_SHIFT])),
        unloading=_known(most(unloading)),
        acceleration_rms=rms[0],
        track_shift_rms=rms[1],
        command=_of_seconds(rollout.actions.astype(np.float64), second).mean(axis=1),
        cost_acceleration=_of_seconds(acceleration, second).mean(axis=1),
        cost_force=_of_seconds(force, second).mean(axis=1),
        peak_quotient=_of_seconds(rollout.terms[:, PEAK_QUOTIENT], second).max(axis=1),
        peak_track_shift=_of_seconds(rollout.terms[:, PEAK_TRACK_SHIFT], second).max(axis=1),
        **_for_pictures(run, rollout, trip),
        ending=rollout.ending,
    )


def judged_along(runs: list[Run]) -> list[Row]:
    """Make runs along lines that are companions over their episode, and judge each as a whole."""
    rollouts = roll_out_runs(runs, episode=True)
    return [whole_row(run, rollout) for run, rollout in zip(runs, rollouts, strict=True)]


def whole_row(run: Run, rollout: Rollout) -> Row:
    """Judge a run along a line as a whole.

    J off line is the mean over time of that of the sections, each with the dominant frequency of its own. The
    ratios are the largest ones of straight parts as long as a segment of the spectrum; 0 without any.

    Raises
    ------
    StudyError
        The simulation diverged.
    """
    assert run.line is not None
    distance = float(Trip(run.line, run.speed).distance(len(rollout.terms) * rollout.control_period))
    return row_of(run, rollout, _over_the_line, rollout.actions, distance)


def _over_the_line(run: Run, rollout: Rollout) -> dict[str, float]:
    assert run.line is not None
    scenario, trip = run.scenario, Trip(run.line, run.speed)
    bounds = model_limits(VehicleModel(scenario))
    force = rollout.true[rollout.run_in :, LOG_HYDRAULIC:LOG_CURRENT]
    on_bogie = rollout.true[rollout.run_in :, LOG_FORCE:LOG_HYDRAULIC]
    offline = (
        offline_along(rollout, trip, scenario.assessment) / bounds.acceleration**2,
        float(np.mean((force / scenario.cost.force_reference) ** 2)),
    )
    acceleration, shift = (float(np.nan_to_num(rms).max()) for rms in _sliding_rms(run, rollout, trip))
    rms, peak, power = force_use(on_bogie, rollout.sample_rate)
    return {
        "J_run": weighted(scenario.cost, *rollout.cost()),
        "J_offline": weighted(scenario.cost, *offline),
        "J_offline_acceleration": offline[0],
        "J_offline_force": offline[1],
        "acceleration_ratio": acceleration / bounds.acceleration,
        "track_shift_ratio": shift / bounds.track_shift_force,
        "force_rms_n": rms,
        "force_peak_n": peak,
        "force_power_above_10_hz_n2": power,
        "comfort": comfort_index(rollout, scenario, slice(rollout.run_in, len(rollout.true))),
    }


def offline_along(rollout: Rollout, trip: Trip, settings: AssessmentConfig) -> float:
    """Mean square of the bogie frames' accelerations behind the off-line filter along a line, (m/s2)^2.

    The filter follows the dominant frequency from section to section; what lies around one starts it. A
    section too short for a spectrum, as the last one of a run can be, counts with the one before.
    """
    signals, rate = rollout.true[:, LOG_ACCELERATION:LOG_TRACK_SHIFT], rollout.sample_rate
    distance, around = trip.distance(rollout.times), round(settings.filter_padding * rate)
    total = 0.0
    for first, last in _parts(trip, float(distance[rollout.run_in]), float(distance[-1]), settings):
        a, b = np.searchsorted(distance, (first, last))
        b = len(distance) if last >= float(distance[-1]) else b
        part = slice(max(a - around, 0), b + around)
        filtered = band_passed(signals[part], rate, distance[part], (first, last), settings)
        total += float(np.sum(filtered[a - part.start : b - part.start] ** 2))
    return float(total / ((len(signals) - rollout.run_in) * signals.shape[1]))


def _parts(trip: Trip, first: float, last: float, settings: AssessmentConfig) -> list[tuple[float, float]]:
    """Sections between two distances (m), those shorter than a segment of the spectrum put together."""
    inner = [each.end for each in trip.line.sections[:-1] if first < each.end < last]
    edges = [first]
    for edge in inner:
        if edge - edges[-1] >= settings.segment_length and last - edge >= settings.segment_length:
            edges.append(edge)
    return list(pairwise((*edges, last)))


def _known(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def _of_seconds(values: Array, second: int) -> Array:
    """Values of whole seconds, shape (n, periods, ...)."""
    whole = len(values) // second
    return values[: whole * second].reshape(whole, second, *values.shape[1:])


def _second_means(rollout: Rollout) -> Array:
    """Mean over the dampers of the square of each force's mean over a second (N^2), for each control period.

    Hunting, of 1 Hz and more, has no mean over a second to speak of; what a curve asks for has.
    """
    forces = rollout.true[rollout.run_in :, LOG_HYDRAULIC:LOG_CURRENT]
    rate, periods = round(SECOND * rollout.sample_rate), len(rollout.terms)
    starts = np.arange(0, len(forces), rate)
    lengths = np.minimum(rate, len(forces) - starts)
    if not len(starts):
        return np.zeros(0)
    means = np.add.reduceat(forces, starts, axis=0) / lengths[:, None]
    of_second = np.mean(means**2, axis=1)
    return np.asarray(np.repeat(of_second, round(SECOND / rollout.control_period))[:periods])


def _unloading(run: Run, rollout: Rollout, trip: Trip) -> Array:
    """Largest share of its static load that a wheel has lost, mean over some distance, by period."""
    length = run.environment.derailment.averaging
    static = np.repeat(VehicleModel(run.scenario).multibody.wheel_load, 2)
    distance = trip.distance(rollout.times[rollout.run_in :])
    loads = rollout.traced[rollout.run_in :] / static
    if not len(loads):
        return np.zeros(0)
    total = cumulative_trapezoid(loads, distance, axis=0, initial=0.0)
    back = np.maximum(distance - length, distance[0])
    before = np.stack([np.interp(back, distance, column) for column in total.T], axis=1)
    with np.errstate(invalid="ignore"):
        means = (total - before) / (distance - back)[:, None]
    lost = np.where(np.arange(len(means))[:, None] > 0, 1.0 - means, 1.0 - loads)
    # Where a run has ended, what it went on to may not be a number.
    return np.asarray(np.fmax.reduce(lost.reshape(len(rollout.terms), -1), axis=1))


def _sliding_rms(run: Run, rollout: Rollout, trip: Trip) -> tuple[Array, Array]:
    """Maxima by EN 14363 on the straight parts of the sections: acceleration (m/s2), track shift force (N).

    NaN where there is no straight part as long as a segment of the spectrum; infinite where the run ended.
    What lies around a part starts its filter.
    """
    settings, signals = run.scenario.assessment, rollout.true[:, LOG_ACCELERATION:LOG_FORCE]
    distance, rate = trip.distance(rollout.times), rollout.sample_rate
    around = round(settings.filter_padding * rate)
    found = np.full((2, len(trip.line.sections)), np.nan)
    shortest = max(settings.segment_length, settings.window_length)
    reached = float(distance[-1])
    for k, section in enumerate(trip.line.sections):
        start = section.straight_from
        if start is None or section.end - start < shortest or start > reached:
            continue
        if rollout.ending is not None and reached < section.end:
            found[:, k] = math.inf
            continue
        # Where the episode's time ends; distances differ by rounding.
        if min(section.end, reached) - start < shortest * (1.0 - 1e-6):
            continue
        first, last = np.searchsorted(distance, (start, section.end))
        part = slice(max(int(first) - around, 0), int(last) + around)
        s = distance[part]
        # The distance that the assessment adds up from speeds is shorter by rounding than what the line says.
        length = min(section.end, float(s[-1])) - start - 1e-6 * (float(s[-1]) - float(s[0]))
        own = settings.model_copy(update={"run_in": start - float(s[0]), "length": length})
        peak = assess(signals[part], rate, trip.speed_at(s), own).maximum
        found[:, k] = peak[: len(peak) // 2].max(), peak[len(peak) // 2 :].max()
    return found[0], found[1]


def _for_pictures(run: Run, rollout: Rollout, trip: Trip) -> Mapping[str, Array]:
    """Sliding RMS of the acceleration behind the on-line filter, for pictures."""
    settings = run.scenario.assessment
    s = trip.distance(rollout.times[rollout.run_in :])
    filtered = rollout.true[rollout.run_in :, LOG_FILTERED:LOG_BODY]
    if len(s) < 2 or s[-1] - s[0] < settings.window_length:
        return {"position": np.zeros(0), "sliding_rms_acceleration": np.zeros(0)}
    position, rms = sliding_rms(filtered, rollout.sample_rate, s, settings)
    return {"position": position, "sliding_rms_acceleration": rms.max(axis=1)}
