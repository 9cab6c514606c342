"""What the paper shows about the controlled vehicle, as measurements with a verdict (M1 to M9, S1 to S6, C1).

All runs are on worn wheels. Commands are those of the rear bogie, which the paper's figures show; times count
from the controller's first command, at the end of the run-in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from sayd_env.config.units import KMH, Array
from sayd_env.runs.controlled import REAR, SAYD_SPEEDS, ControlledRun, ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.paper.claims import Claim, Flags, Seeds, by_median, by_seed, by_selection, spread

MPPT1, MPPT2 = "mppt1", "mppt2"
ON_OFF, CONTINUOUS = "skyhook-onoff", "skyhook-continuous"
POLICIES = (MPPT1, MPPT2, ON_OFF, CONTINUOUS)
"""The paper's controllers."""
CLOSED, OPEN = 0.0, 1.0
"""The two starts of figures 12 and 14."""

PERCENT = 100.0
FAST_SWITCH = 0.1
"""s, row S2."""
LOW_END, HIGH_END = 0.2, 0.8
"""Commands up to the first one are at the closed end of the valve's range, from the second on at the open."""
OCCUPIED = 0.1
"""An end is occupied if more than this share of the time is spent there."""


def required_runs() -> list[tuple[str, float, float]]:
    """Controller, speed (m/s) and initial current of every run that the rows need, for each seed."""
    closed = [(policy, speed, CLOSED) for policy in POLICIES for speed in SAYD_SPEEDS]
    return [*closed, (MPPT1, 400 / KMH, OPEN), (MPPT2, 300 / KMH, OPEN)]


def skyhook_runs() -> list[tuple[str, float, float]]:
    """Runs on which rows S1 to S6 rest: those of both skyhooks, and both MPPTs at 400 km/h (S3)."""
    return [
        (policy, speed, current)
        for policy, speed, current in required_runs()
        if current == CLOSED and (policy in (ON_OFF, CONTINUOUS) or round(speed * KMH) == 400)
    ]


def command_at(run: ControlledRun, time: float) -> float:
    """Rear command that holds from a time (s) on; the last one if the run is shorter."""
    step = round(time / run.control_period)
    return float(run.command[min(step, len(run.command) - 1), REAR])


def settled_command(run: ControlledRun) -> float:
    """Mean of the rear command over the last half of the run."""
    return float(run.command[len(run.command) // 2 :, REAR].mean(dtype=np.float64))


def largest_distance(one: ControlledRun, other: ControlledRun, after: float) -> float:
    """Largest difference of two runs' rear commands at equal times from a time (s) on; NaN if none left."""
    start = round(after / one.control_period)
    gap = np.abs(one.command[start:, REAR] - other.command[start:, REAR])
    return float(gap.max()) if gap.size else float("nan")


def mean_command(run: ControlledRun, after: float) -> float:
    """Mean of the rear command from a time (s) on; NaN if the run ends before."""
    command = run.command[round(after / run.control_period) :, REAR]
    return float(command.mean(dtype=np.float64)) if command.size else float("nan")


def dwell_times(run: ControlledRun) -> Array:
    """Times between successive changes of the rear command (s).

    The first and the last stay, of which the run shows only a part, are left out.
    """
    changes = np.flatnonzero(np.diff(run.command[:, REAR]))
    return np.asarray(np.diff(changes) * run.control_period)


def end_shares(run: ControlledRun) -> tuple[float, float]:
    """Share of the time that the rear command spends at each end of the valve's range.

    Returns
    -------
    tuple of float
        Share of the steps with a command <= 0.2, and with one >= 0.8.
    """
    command = run.command[:, REAR]
    return float(np.mean(command <= LOW_END)), float(np.mean(command >= HIGH_END))


def swings_per_second(run: ControlledRun) -> float:
    """Passages of the rear command from one end of the valve's range to the other, in either direction.

    Between two passages the command has been at the other end (<= 0.2 or >= 0.8); what it does between the
    ends, and its returns to the end from which it came, do not count.
    """
    command = run.command[:, REAR]
    ends = np.where(command >= HIGH_END, 1, np.where(command <= LOW_END, -1, 0))
    visited = ends[ends != 0]
    return float(np.count_nonzero(np.diff(visited)) / (len(command) * run.control_period))


class ControlledMeasures:
    """The quantities behind rows M1 to M9, S1 to S6 and C1, for each seed or any selection of seeds.

    Parameters
    ----------
    runs : ControlledRuns
        All of `required_runs`, on the same seeds.
    limits : Limits
        Limits of EN 14363.
    required : sequence, optional
        The runs that are there, of which the rows in question need no others: `skyhook_runs`.

    Raises
    ------
    ValueError
        A run is missing.
    """

    def __init__(
        self,
        runs: ControlledRuns,
        limits: Limits,
        required: Sequence[tuple[str, float, float]] | None = None,
    ) -> None:
        needed = required_runs() if required is None else required
        self.runs, self.limits = runs, limits
        self.count = len(runs.seeds)
        self.all = np.arange(self.count)
        closed = dict.fromkeys(policy for policy, _, current in needed if current == CLOSED)
        self.sweeps = {policy: runs.sweep(policy, CLOSED) for policy in closed}
        for policy, speed, current in needed:
            runs.at(policy, speed * KMH, current)  # refused here, not in the middle of the table

    def acceleration_ratios(self, policy: str) -> Array:
        """a_max over its limit, shape (speeds, seeds)."""
        return np.asarray(self.sweeps[policy].acceleration.max(axis=-1) / self.limits.acceleration)

    def ratios(self, policy: str) -> Array:
        """The larger of both ratios to the limits, shape (speeds, seeds)."""
        force = self.sweeps[policy].track_shift.max(axis=-1) / self.limits.track_shift_force
        return np.asarray(np.maximum(self.acceleration_ratios(policy), force))

    def frequency_range(self, policy: str) -> Array:
        """Range of the dominant frequency over speeds and measuring points, for each seed, Hz (M2)."""
        return np.asarray(np.ptp(self.sweeps[policy].frequency, axis=(0, 2)))

    def commands_at(self, policy: str, kmh: float, initial: float, time: float) -> Array:
        """Rear command at a time (s), for each seed (M4, M6, M7)."""
        return np.array([command_at(run, time) for run in self.runs.at(policy, kmh, initial)])

    def settled(self, policy: str, kmh: float) -> Array:
        """Mean rear command of the last half, for each seed (M3, M6)."""
        return np.array([settled_command(run) for run in self.runs.at(policy, kmh)])

    def level_distance(self, policy: str, kmh: float, after: float) -> Array:
        """How far the level behind an open start is from the settled command of a closed one (M4, M7).

        The mean command from a time (s) on against that of rows M3 and M6, on the same track, for each seed.
        """
        opened = np.array([mean_command(run, after) for run in self.runs.at(policy, kmh, OPEN)])
        return np.abs(opened - self.settled(policy, kmh))

    def start_distance(self, policy: str, kmh: float, after: float) -> Array:
        """How far the commands from an open and from a closed start are apart after a time, at any moment.

        The largest difference at equal times on the same track, for each seed.
        """
        pairs = zip(self.runs.at(policy, kmh, OPEN), self.runs.at(policy, kmh, CLOSED), strict=True)
        return np.array([largest_distance(one, other, after) for one, other in pairs])

    def ratio(self, name: str, one: tuple[str, float], other: tuple[str, float]) -> Array:
        """A force quantity of one controller and speed (km/h) over that of another, for each seed."""
        return self._scalars(name, *one) / self._scalars(name, *other)

    def peak_over_mppt(self) -> Array:
        """Peak force of on-off skyhook over the higher one of both MPPTs at 400 km/h, for each seed (S3)."""
        mppt = [self._scalars("force_peak", policy, 400) for policy in (MPPT1, MPPT2)]
        return self._scalars("force_peak", ON_OFF, 400) / np.maximum(*mppt)

    def largest_median_ratio(self, policy: str, seeds: Seeds) -> float:
        """Largest of both ratios over the speeds, medians over a selection of seeds (S4)."""
        return float(np.median(self.ratios(policy)[:, seeds], axis=1).max())

    def excess(self, seeds: Seeds) -> Array:
        """Relative rise of a_max from on-off to continuous skyhook at each speed (S4).

        Both controllers run on the same tracks: the median of each seed's own rise.
        """
        continuous, on_off = (self.sweeps[p].acceleration.max(axis=-1) for p in (CONTINUOUS, ON_OFF))
        return np.asarray(np.median((continuous / on_off - 1.0)[:, seeds], axis=1))

    def slightly_higher(self, seeds: Seeds) -> bool:
        """Whether row S4 passes."""
        excess = self.excess(seeds)
        stable = self.largest_median_ratio(CONTINUOUS, seeds) < 0.6
        return bool(stable and np.all((excess >= 0.0) & (excess <= 0.4)))

    def largest_ratio(self) -> Array:
        """Largest ratio to a limit of all controllers and speeds, for each seed (C1)."""
        return np.asarray(np.max([self.ratios(policy).max(axis=0) for policy in POLICIES], axis=0))

    def _scalars(self, name: str, policy: str, kmh: float) -> Array:
        return np.array([getattr(run, name) for run in self.runs.at(policy, kmh)])


def controlled_claims(runs: ControlledRuns, limits: Limits) -> list[Claim]:
    """Judge rows M1 to M9, S1 to S6 and C1.

    Parameters
    ----------
    runs : ControlledRuns
        All of `required_runs`, on the same seeds.
    limits : Limits
        Limits of EN 14363.

    Raises
    ------
    ValueError
        A run is missing.
    """
    m = ControlledMeasures(runs, limits)
    return [*_mppt_rows(m), *_skyhook_rows(m), _critical_speed_row(m)]


def skyhook_claims(runs: ControlledRuns, limits: Limits) -> list[Claim]:
    """Judge rows S1 to S6 alone, from `skyhook_runs`; otherwise as `controlled_claims`."""
    return _skyhook_rows(ControlledMeasures(runs, limits, skyhook_runs()))


def _mppt_rows(m: ControlledMeasures) -> list[Claim]:
    stable = [m.acceleration_ratios(policy).max(axis=0) for policy in (MPPT1, MPPT2)]
    scatter = m.frequency_range(MPPT1)
    force = m.ratio("force_rms", (MPPT2, 300), (MPPT1, 300))
    return [
        by_seed("M1", "MPPT1, 300 to 400 km/h: a_max < 0.5 of the limit", stable[0] < 0.5, spread(stable[0])),
        by_median(
            "M2",
            "MPPT1: dominant frequency scatters over more than 2 Hz",
            "Hz",
            m.count,
            lambda seeds: float(np.median(scatter[seeds])),
            lambda width: width > 2.0,
        ),
        _settling_row(m),
        _open_start_row(m, "M4", MPPT1, 400, "< 20 %", lambda v: v < 20.0, after=10.0, as_in="M3"),
        by_seed("M5", "MPPT2, 300 to 400 km/h: a_max < 0.5 of the limit", stable[1] < 0.5, spread(stable[1])),
        _opening_row(m),
        _open_start_row(
            m, "M7", MPPT2, 300, "<= 35 %", lambda v: _between(v, 0.0, 35.0), after=15.0, as_in="M6"
        ),
        _quieter_row(m),
        by_seed(
            "M9",
            "MPPT2 against MPPT1, both at 300 km/h: lower RMS force",
            force < 1.0,
            f"RMS force {spread(force)} times",
        ),
    ]


def _settling_row(m: ControlledMeasures) -> Claim:
    settled = PERCENT * m.settled(MPPT1, 400)
    return by_seed(
        "M3",
        "MPPT1, 400 km/h, V(0) = 0 %: settles at 3 to 13 %",
        _between(settled, 3.0, 13.0),
        spread(settled, "%", 1),
    )


def _opening_row(m: ControlledMeasures) -> Claim:
    at_5, settled = PERCENT * m.commands_at(MPPT2, 300, CLOSED, 5.0), PERCENT * m.settled(MPPT2, 300)
    return by_seed(
        "M6",
        "MPPT2, 300 km/h, V(0) = 0 %: 20 to 30 % after 5 s, settles at 30 to 40 %",
        _between(at_5, 20.0, 30.0) & _between(settled, 30.0, 40.0),
        f"5 s: {spread(at_5, '%', 1)}; settled: {spread(settled, '%', 1)}",
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
    at_5 = PERCENT * m.commands_at(policy, kmh, OPEN, 5.0)
    level = PERCENT * m.level_distance(policy, kmh, after)
    apart = PERCENT * m.start_distance(policy, kmh, after)
    return by_seed(
        id_,
        f"{policy.upper()}, {kmh:g} km/h, V(0) = 100 %: {low} after 5 s, "
        f"from {after:g} s on within 5 points of {as_in}",
        is_low(at_5) & _between(level, 0.0, 5.0),
        f"5 s: {spread(at_5, '%', 1)}; level {spread(level, 'points', 1)} off "
        f"(commands at any moment {spread(apart, 'points', 1)})",
    )


def _quieter_row(m: ControlledMeasures) -> Claim:
    pair = (MPPT2, 300.0), (MPPT1, 400.0)
    force, power = m.ratio("force_rms", *pair), m.ratio("force_power_high", *pair)
    return by_seed(
        "M8",
        "MPPT2 at 300 km/h against MPPT1 at 400 km/h: lower RMS force and lower power above 10 Hz",
        (force < 1.0) & (power < 1.0),
        f"RMS force {spread(force)} times, power {spread(power)} times",
    )


def _skyhook_rows(m: ControlledMeasures) -> list[Claim]:
    calm, peak = m.ratios(ON_OFF).max(axis=0), m.peak_over_mppt()
    high = m.ratio("force_power_high", (CONTINUOUS, 400), (ON_OFF, 400))
    excess = PERCENT * m.excess(m.all)
    return [
        by_seed("S1", "on-off skyhook, 300 to 400 km/h: both ratios < 0.5", calm < 0.5, spread(calm)),
        _switching_row(m),
        by_seed(
            "S3",
            "on-off skyhook against both MPPTs, 400 km/h: higher peak force",
            peak > 1.0,
            f"{spread(peak)} times",
        ),
        by_selection(
            "S4",
            "continuous skyhook: both ratios < 0.6, a_max 0 to 40 % above on-off's at every speed",
            f"ratio {m.largest_median_ratio(CONTINUOUS, m.all):.2f}; "
            f"a_max {np.min(excess):+.0f} to {np.max(excess):+.0f} %",
            m.count,
            m.slightly_higher,
        ),
        _swinging_row(m),
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
    short, middle = (np.array([np.quantile(d, q, method="higher") for d in dwells]) for q in (0.1, 0.5))
    return by_seed(
        "S2",
        "on-off skyhook, 400 km/h: commands 0 or 1 only, 10th percentile of dwell < 0.1 s",
        two_valued & (short < FAST_SWITCH - 1e-9),
        f"10th percentile {spread(short, 's')}, median {spread(middle, 's')}"
        + ("" if two_valued.all() else ", other commands than 0 and 1"),
    )


def _swinging_row(m: ControlledMeasures) -> Claim:
    runs = m.runs.at(CONTINUOUS, 400)
    low, high = np.array([end_shares(run) for run in runs]).T
    swings = np.array([swings_per_second(run) for run in runs])
    return by_seed(
        "S5",
        "continuous skyhook, 400 km/h: at both ends (<= 20 %, >= 80 %) for over 10 % of the time each, "
        "more than 5 swings/s",
        (low > OCCUPIED) & (high > OCCUPIED) & (swings > 5.0),
        f"{spread(PERCENT * low, '%', 0)} and {spread(PERCENT * high, '%', 0)} of the time, "
        f"{spread(swings, 'swings/s', 1)}",
    )


def _critical_speed_row(m: ControlledMeasures) -> Claim:
    largest = m.largest_ratio()
    return by_seed(
        "C1",
        "all four controllers: no limit exceeded up to 400 km/h",
        largest <= 1.0,
        f"largest ratio {spread(largest)}",
    )


def _between(values: Array, low: float, high: float) -> Flags:
    """Which values lie between two bounds, both included, up to the rounding of single precision."""
    return np.asarray((values >= low - 1e-5) & (values <= high + 1e-5))
