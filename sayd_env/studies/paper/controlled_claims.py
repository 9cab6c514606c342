"""What the paper shows about the controlled vehicle, as measurements with a verdict (M1 to M9, S1 to S6, C1).

All runs are on worn wheels. Commands are those of the rear bogie, which the paper's figures show; times count
from the controller's first command, at the end of the run-in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter

import numpy as np

from sayd_env.config.assessment import AssessmentConfig, load_assessment
from sayd_env.config.reproduction import load_reproduction
from sayd_env.config.units import KMH, Array, Flags
from sayd_env.runs.controlled import REAR, ControlledRun, ControlledRuns
from sayd_env.runs.metrics import switchings
from sayd_env.runs.policies import PAPER
from sayd_env.stability import Limits
from sayd_env.studies.paper.claims import Claim, Seeds, Verdict, bootstrapped, by_median, by_seed, spread

MPPT1, MPPT2, ON_OFF, CONTINUOUS = PAPER
CLOSED, OPEN = 0.0, 1.0
"""The two starts of figures 12 and 14."""

PERCENT = 100.0
SCATTER = (2.0, 10.0)
"""Hz, between which row M2 has the dominant frequencies."""
FAST_SWITCH = 0.1
"""s, row S2."""
LOW_END, HIGH_END = 0.2, 0.8
"""Commands up to the first one are at the closed end of the valve's range, from the second on at the open."""
MOTION = ("M3", "M4", "M6", "M7", "S2", "S5")
"""Rows about the motion of the command."""
OCCUPIED = 0.1
"""An end is occupied if more than this share of the time is spent there."""


def required_runs(speeds: Sequence[float] | None = None) -> list[tuple[str, float, float]]:
    """Controller, speed (m/s) and initial current of every run that the rows need, for each seed.

    The grid of speeds (m/s) is by default that of the packaged study.
    """
    grid = load_reproduction().speeds("sayd") if speeds is None else speeds
    return [*runs_over_speed(PAPER, grid), (MPPT1, 400 / KMH, OPEN), (MPPT2, 300 / KMH, OPEN)]


def runs_over_speed(policies: Sequence[str], speeds: Sequence[float]) -> list[tuple[str, float, float]]:
    """Runs of policies at every speed (m/s), from closed valves."""
    return [(policy, speed, CLOSED) for policy in policies for speed in speeds]


def skyhook_runs(speeds: Sequence[float] | None = None) -> list[tuple[str, float, float]]:
    """Runs on which rows S1 to S6 rest: those of both skyhooks, and both MPPTs at 400 km/h (S3)."""
    return [
        (policy, speed, current)
        for policy, speed, current in required_runs(speeds)
        if current == CLOSED and (policy in (ON_OFF, CONTINUOUS) or round(speed * KMH) == 400)
    ]


def command_at(run: ControlledRun, time: float) -> float:
    """Rear command that holds from a time (s) on; the last one if the run is shorter."""
    step = round(time / run.control_period)
    return float(run.command[min(step, len(run.command) - 1), REAR])


command_after_5_s = partial(command_at, time=5.0)


def settled_command(run: ControlledRun) -> float:
    """Mean of the rear command over the last half of the run."""
    return float(run.command[len(run.command) // 2 :, REAR].mean(dtype=np.float64))


def largest_distance(one: ControlledRun, other: ControlledRun, after: float) -> float:
    """Largest difference of two runs' rear commands at equal times from a time (s) on; NaN if none left."""
    start = round(after / one.control_period)
    gap = np.abs(one.command[start:, REAR] - other.command[start:, REAR])
    return float(gap.max()) if gap.size else float("nan")


def commands_from(run: ControlledRun, after: float) -> Array:
    """Rear commands from a time (s) on; NaN if the run ends before."""
    command = run.command[round(after / run.control_period) :, REAR].astype(np.float64)
    return command if command.size else np.array([np.nan])


def dwell_times(run: ControlledRun) -> Array:
    """Times between successive changes of the rear command (s).

    The first and the last stay, of which the run shows only a part, are left out.
    """
    changes = np.flatnonzero(np.diff(run.command[:, REAR]))
    return np.asarray(np.diff(changes) * run.control_period)


def end_shares(run: ControlledRun) -> tuple[float, float]:
    """Shares of the time that the rear command spends at the closed (<= 0.2) and the open end (>= 0.8)."""
    command = run.command[:, REAR]
    return float(np.mean(command <= LOW_END)), float(np.mean(command >= HIGH_END))


def swings_per_second(run: ControlledRun) -> float:
    """Passages of the rear command from one end of the valve's range to the other, in either direction."""
    return switchings(run.command[:, [REAR]], LOW_END, HIGH_END) / (len(run.command) * run.control_period)


class ControlledMeasures:
    """The quantities behind rows M1 to M9, S1 to S6 and C1, for each seed or any selection of seeds.

    Parameters
    ----------
    runs : ControlledRuns
        All that are required, on the same seeds.
    required : sequence
        `required_runs`, or `skyhook_runs` where the rows in question need no others.
    assessment : AssessmentConfig, optional
        That of the runs: where dominant frequencies are searched. The packaged one by default.

    Raises
    ------
    ValueError
        A run is missing.
    """

    def __init__(
        self,
        runs: ControlledRuns,
        limits: Limits,
        required: Sequence[tuple[str, float, float]],
        assessment: AssessmentConfig | None = None,
    ) -> None:
        for policy, speed, current in required:
            runs.at(policy, speed * KMH, current)  # refused here, not in the middle of the table
        self.runs, self.count = runs, len(runs.seeds)
        closed = dict.fromkeys(policy for policy, _, current in required if current == CLOSED)
        self.sweeps = {policy: runs.sweep(policy, CLOSED) for policy in closed}
        self.criteria = {policy: sweep.criteria(limits) for policy, sweep in self.sweeps.items()}
        self.assessment = assessment or load_assessment()

    def scatter(self) -> tuple[Array, Array, Array]:
        """Dominant frequencies of MPPT1 over speeds and points, for each seed (M2).

        Returns
        -------
        width : ndarray, shape (seeds,)
            Highest minus lowest, Hz.
        within : ndarray, shape (seeds,)
            Share of the values between 2 and 10 Hz.
        edge : ndarray, shape (seeds,)
            Share of the values at an end of the searched range, where there is no peak.
        """
        frequency, settings = self.sweeps[MPPT1].frequency, self.assessment
        low, high = SCATTER
        margin = 0.5 * settings.frequency_step
        inner = between(frequency, low, high)
        edge = (frequency < settings.frequency_min + margin) | (frequency > settings.frequency_max - margin)
        return np.ptp(frequency, axis=(0, 2)), inner.mean(axis=(0, 2)), edge.mean(axis=(0, 2))

    def acceleration(self, policy: str) -> Array:
        """Largest a_max over its limit, for each seed."""
        return np.asarray(self.criteria[policy]["acceleration"].ratios.max(axis=0))

    def ratios(self, policy: str) -> Array:
        """The larger of both ratios to the limits, shape (speeds, seeds)."""
        acceleration, force = self.criteria[policy].values()
        return np.maximum(acceleration.ratios, force.ratios)

    def each(
        self, measure: Callable[[ControlledRun], float], policy: str, kmh: float, initial: float = CLOSED
    ) -> Array:
        """A number from each seed's run."""
        return np.array([measure(run) for run in self.runs.at(policy, kmh, initial)])

    def ratio(self, name: str, one: tuple[str, float], other: tuple[str, float]) -> Array:
        """A force quantity of one controller and speed (km/h) over that of another, for each seed."""
        with np.errstate(invalid="ignore"):  # both may be infinite
            return np.asarray(self.each(attrgetter(name), *one) / self.each(attrgetter(name), *other))


def controlled_claims(
    runs: ControlledRuns, limits: Limits, assessment: AssessmentConfig | None = None
) -> list[Claim]:
    """Judge rows M1 to M9, S1 to S6 and C1 from `required_runs`; parameters as of `ControlledMeasures`.

    Raises
    ------
    ValueError
        A run is missing.
    """
    m = ControlledMeasures(runs, limits, required_runs(runs.speeds), assessment)
    return [claim for rows in CONTROLLER_ROWS.values() for claim in rows(m)] + [bounded_row(m)]


def skyhook_claims(runs: ControlledRuns, limits: Limits) -> list[Claim]:
    """Judge rows S1 to S6 alone, from `skyhook_runs`; otherwise as `controlled_claims`."""
    m = ControlledMeasures(runs, limits, skyhook_runs(runs.speeds))
    return [*_on_off_rows(m), *_continuous_rows(m)]


def fixed_verdicts(
    runs: ControlledRuns, limits: Limits, command: str, assessment: AssessmentConfig | None = None
) -> dict[str, Verdict]:
    """What a policy of one command does in the rows, in the place of the controller that each is about.

    Where a row compares two controllers, the other one stays. Rows about the motion of the command do not
    apply: their verdict says where it stays.

    Parameters
    ----------
    runs : ControlledRuns
        With `required_runs` and those of the command over speed.
    limits, assessment
        As of `ControlledMeasures`.
    command : str
        Name of the policy.
    """

    def measures(policies: Sequence[str]) -> ControlledMeasures:
        stood_in = runs.in_place_of(policies, command)
        return ControlledMeasures(stood_in, limits, required_runs(runs.speeds), assessment)

    claims = [claim for policy, rows in CONTROLLER_ROWS.items() for claim in rows(measures([policy]))]
    found = {claim.id: claim.verdict for claim in [*claims, bounded_row(measures(PAPER))]}
    level = next(run.command[0, REAR] for run in runs.runs if run.policy == command)
    return found | dict.fromkeys(MOTION, Verdict(f"stays at {PERCENT * level:.0f} %"))


def bounded_row(m: ControlledMeasures) -> Claim:
    """Row C1."""
    largest = np.asarray(np.max([m.ratios(policy).max(axis=0) for policy in PAPER], axis=0))
    return by_seed(
        "C1",
        "all four controllers: no limit exceeded up to 400 km/h",
        largest <= 1.0,
        f"largest ratio {spread(largest)}",
    )


def _mppt1_rows(m: ControlledMeasures) -> list[Claim]:
    calm, settled = m.acceleration(MPPT1), PERCENT * m.each(settled_command, MPPT1, 400)
    return [
        by_seed("M1", "MPPT1, 300 to 400 km/h: a_max < 0.5 of the limit", calm < 0.5, spread(calm)),
        _scatter_row(m),
        by_seed(
            "M3",
            "MPPT1, 400 km/h, V(0) = 0 %: settles at 3 to 13 %",
            between(settled, 3.0, 13.0),
            spread(settled, "%", 1),
        ),
        _open_start_row(m, "M4", MPPT1, 400, "< 20 %", lambda v: v < 20.0, after=10.0, as_in="M3"),
    ]


def _mppt2_rows(m: ControlledMeasures) -> list[Claim]:
    calm, settled = m.acceleration(MPPT2), PERCENT * m.each(settled_command, MPPT2, 300)
    at_5 = PERCENT * m.each(command_after_5_s, MPPT2, 300)
    restless = PERCENT * m.each(lambda run: float(commands_from(run, 15.0).std()), MPPT2, 300)
    slow, fast = (MPPT2, 300.0), (MPPT1, 400.0)
    quieter, smoother = m.ratio("force_rms", slow, fast), m.ratio("force_power_high", slow, fast)
    force = m.ratio("force_rms", slow, (MPPT1, 300.0))
    return [
        by_seed("M5", "MPPT2, 300 to 400 km/h: a_max < 0.5 of the limit", calm < 0.5, spread(calm)),
        by_seed(
            "M6",
            "MPPT2, 300 km/h, V(0) = 0 %: 20 to 30 % after 5 s, settles at 30 to 40 %, "
            "deviates by less than 10 points from 15 s on",
            between(at_5, 20.0, 30.0) & between(settled, 30.0, 40.0) & (restless < 10.0),
            f"5 s: {spread(at_5, '%', 1)}; settled: {spread(settled, '%', 1)}; "
            f"standard deviation {spread(restless, 'points', 1)}",
        ),
        _open_start_row(
            m, "M7", MPPT2, 300, "<= 35 %", lambda v: between(v, 0.0, 35.0), after=15.0, as_in="M6"
        ),
        by_seed(
            "M8",
            "MPPT2 at 300 km/h against MPPT1 at 400 km/h: lower RMS force and lower power above 10 Hz",
            (quieter < 1.0) & (smoother < 1.0),
            f"RMS force {spread(quieter)} times, power {spread(smoother)} times",
        ),
        by_seed(
            "M9",
            "MPPT2 against MPPT1, both at 300 km/h: lower RMS force",
            force < 1.0,
            f"RMS force {spread(force)} times",
        ),
    ]


def _scatter_row(m: ControlledMeasures) -> Claim:
    width, within, edge = m.scatter()

    def median(values: Array) -> Callable[[Seeds], float]:
        return lambda seeds: float(np.median(values[seeds]))

    return by_median(
        "M2",
        "MPPT1: dominant frequencies scatter over more than 2 Hz, 80 % of them within 2 to 10 Hz, "
        "none at the edge of the search",
        m.count,
        lambda seeds: (
            median(width)(seeds) > 2.0 and median(within)(seeds) >= 0.8 - 1e-9 and median(edge)(seeds) == 0.0
        ),
        f"{bootstrapped(median(width), m.count, 'Hz')}; within {spread(PERCENT * within, '%', 0)}; "
        f"at the edge {spread(PERCENT * edge, '%', 0)}",
    )


def _open_start_row(
    m: ControlledMeasures,
    id_: str,
    policy: str,
    kmh: float,
    low: str,
    is_low: Callable[[Array], Flags],
    *,
    after: float,
    as_in: str,
) -> Claim:
    """Rows M4 and M7: from a fully open valve, down within 5 s and then to the level of the closed start.

    The level is judged, as rows M3 and M6 measure it; the moments at which the commands step differ.
    """
    at_5 = PERCENT * m.each(command_after_5_s, policy, kmh, OPEN)
    opened = m.each(lambda run: float(commands_from(run, after).mean()), policy, kmh, OPEN)
    level = PERCENT * np.abs(opened - m.each(settled_command, policy, kmh))
    pairs = zip(m.runs.at(policy, kmh, OPEN), m.runs.at(policy, kmh, CLOSED), strict=True)
    apart = PERCENT * np.array([largest_distance(one, other, after) for one, other in pairs])
    return by_seed(
        id_,
        f"{policy.upper()}, {kmh:g} km/h, V(0) = 100 %: {low} after 5 s, "
        f"from {after:g} s on within 5 points of {as_in}",
        is_low(at_5) & between(level, 0.0, 5.0),
        f"5 s: {spread(at_5, '%', 1)}; level {spread(level, 'points', 1)} off "
        f"(commands at any moment {spread(apart, 'points', 1)})",
    )


def _on_off_rows(m: ControlledMeasures) -> list[Claim]:
    calm = m.ratios(ON_OFF).max(axis=0)
    on_off, *mppt = (m.each(attrgetter("force_peak"), policy, 400) for policy in (ON_OFF, MPPT1, MPPT2))
    with np.errstate(invalid="ignore"):
        peak = on_off / np.maximum(*mppt)
    return [
        by_seed("S1", "on-off skyhook, 300 to 400 km/h: both ratios < 0.5", calm < 0.5, spread(calm)),
        _switching_row(m),
        by_seed(
            "S3",
            "on-off skyhook against both MPPTs, 400 km/h: higher peak force",
            peak > 1.0,
            f"{spread(peak)} times",
        ),
    ]


def _continuous_rows(m: ControlledMeasures) -> list[Claim]:
    everything = np.arange(m.count)
    high = m.ratio("force_power_high", (CONTINUOUS, 400), (ON_OFF, 400))
    a_max, a_max_on_off = (m.criteria[policy]["acceleration"].values for policy in (CONTINUOUS, ON_OFF))
    with np.errstate(invalid="ignore"):
        higher = a_max / a_max_on_off - 1.0

    def largest(seeds: Seeds) -> float:
        """Largest of both ratios over the speeds, medians over seeds."""
        return float(np.median(m.ratios(CONTINUOUS)[:, seeds], axis=1).max())

    def excess(seeds: Seeds) -> Array:
        """Median of each seed's own rise at each speed: both controllers run on the same tracks."""
        return np.asarray(np.median(higher[:, seeds], axis=1))

    def slightly_higher(seeds: Seeds) -> bool:
        rise = excess(seeds)
        return bool(largest(seeds) < 0.6 and np.all((rise >= 0.0) & (rise <= 0.4)))

    rise = PERCENT * excess(everything)
    low_end, high_end = np.array([end_shares(run) for run in m.runs.at(CONTINUOUS, 400)]).T
    swings = m.each(swings_per_second, CONTINUOUS, 400)
    return [
        by_median(
            "S4",
            "continuous skyhook: both ratios < 0.6, a_max 0 to 40 % above on-off's at every speed",
            m.count,
            slightly_higher,
            f"ratio {largest(everything):.2f}; a_max {np.min(rise):+.0f} to {np.max(rise):+.0f} %",
        ),
        by_seed(
            "S5",
            "continuous skyhook, 400 km/h: at both ends (<= 20 %, >= 80 %) for over 10 % of the time each, "
            "more than 5 swings/s",
            (low_end > OCCUPIED) & (high_end > OCCUPIED) & (swings > 5.0),
            f"{spread(PERCENT * low_end, '%', 0)} and {spread(PERCENT * high_end, '%', 0)} of the time, "
            f"{spread(swings, 'swings/s', 1)}",
        ),
        by_seed(
            "S6",
            "continuous against on-off skyhook, 400 km/h: higher force power above 10 Hz",
            high > 1.0,
            f"{spread(high)} times",
        ),
    ]


def _switching_row(m: ControlledMeasures) -> Claim:
    runs = m.runs.at(ON_OFF, 400)
    two_valued = np.array([bool(np.isin(run.command, (0.0, 1.0)).all()) for run in runs])
    # A command that never switches dwells until the end.
    dwells = [dwell if dwell.size else np.array([np.inf]) for dwell in map(dwell_times, runs)]
    short, median = (np.array([np.quantile(d, q, method="higher") for d in dwells]) for q in (0.1, 0.5))
    return by_seed(
        "S2",
        "on-off skyhook, 400 km/h: commands 0 or 1 only, 10th percentile of dwell < 0.1 s",
        two_valued & (short < FAST_SWITCH - 1e-9),
        f"10th percentile {spread(short, 's')}, median {spread(median, 's')}"
        + ("" if two_valued.all() else ", other commands than 0 and 1"),
    )


CONTROLLER_ROWS: dict[str, Callable[[ControlledMeasures], list[Claim]]] = {
    MPPT1: _mppt1_rows,
    MPPT2: _mppt2_rows,
    ON_OFF: _on_off_rows,
    CONTINUOUS: _continuous_rows,
}
"""What judges the rows that are about a controller."""


def between(values: Array, low: float, high: float) -> Flags:
    """Which values lie between two bounds, both included, up to the rounding of single precision."""
    return np.asarray((values >= low - 1e-5) & (values <= high + 1e-5))
