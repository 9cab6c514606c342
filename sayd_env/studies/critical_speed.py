"""From which speed does the vehicle hunt? The critical speed by EN 14363 (paper, section 3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.environment import load_environment
from sayd_env.config.palette import GREY, SKY, VERMILION, wheelset_style
from sayd_env.config.reproduction import load_reproduction
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array
from sayd_env.envs.loop import LOG_ACCELERATION, LOG_TRACK_SHIFT
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.contact.creep import LAWS
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import LIMITED, Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, legend_below, limit_line, panels, with_band
from sayd_env.runs.context import RunContext, refuse_empty, silent
from sayd_env.runs.controlled import controlled_runs
from sayd_env.runs.passive import (
    Criterion,
    PassiveRun,
    Sweep,
    runs_table,
    simulated,
    sweep,
)
from sayd_env.runs.policies import PolicySpec, for_policy
from sayd_env.runs.rollouts import Run, environment_of, roll_out_runs
from sayd_env.stability import CriticalSpeed, Crossing, Limits, assess, band_pass, distance_run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console

HALF_WORN = 0.5


@dataclass(frozen=True)
class AccelerationHistory:
    """Acceleration of the bogie frame in one run, at the wheelset where it is worst, as in figure 8 (a)."""

    speed: float
    """m/s."""
    seed: int
    wheelset: str
    """Its name."""
    frequency: float
    """Dominant frequency, Hz."""
    distance: Array
    """(t,) m, run-in included."""
    filtered: Array
    """(t,) band-passed acceleration, m/s2."""
    position: Array
    """(n,) centres of the windows, m."""
    rms: Array
    """(n,) sliding RMS, m/s2."""


@dataclass(frozen=True)
class CriticalSpeedResult:
    """Assessed quantities over speed, and where they cross their limits."""

    scenario: Scenario
    sweep: Sweep
    limits: Limits
    wheelsets: tuple[str, ...]
    histories: tuple[AccelerationHistory, ...]
    laws: CreepLawComparison | None = None
    """The same by other creep laws, if asked for."""

    @cached_property
    def criteria(self) -> dict[str, Criterion]:
        """What EN 14363 limits, by name."""
        return self.sweep.criteria(self.limits)

    def crossing(self) -> dict[str, CriticalSpeed]:
        """Critical speed (m/s) by each criterion, from the medians over the seeds."""
        return {name: criterion.critical_speed() for name, criterion in self.criteria.items()}

    @cached_property
    def critical(self) -> tuple[float | None, str | None]:
        """The lower of both critical speeds (m/s) and its criterion; None if no limit is exceeded."""
        found = {k: c.speed for k, c in self.crossing().items() if c.crossing is not Crossing.NOT_REACHED}
        if not found:
            return None, None
        name = min(found, key=lambda k: found[k] or -1.0)  # None: below the grid
        return found[name], name

    def _median(self, quantity: str) -> Array:
        """Median over the seeds of a quantity of the sweep, shape (speeds, w)."""
        return np.asarray(np.median(getattr(self.sweep, quantity), axis=1))

    def _sensitive(self, name: str) -> bool:
        return self.criteria[name].sensitive(self.scenario.assessment.grid_tolerance)

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd critical-speed --json``."""
        speed, criterion = self.critical
        frequency, acceleration, force = map(self._median, ("frequency", "acceleration", "track_shift"))
        return {
            "critical_speed_kmh": None if speed is None else speed * KMH,
            "criterion": criterion,
            "limits": {
                "acceleration_rms": self.limits.acceleration,
                "track_shift_rms_kn": self.limits.track_shift_force / 1e3,
            },
            "speeds": [
                {
                    "speed_kmh": v * KMH,
                    "dominant_frequency_hz": frequency[i],
                    "acceleration_rms": acceleration[i],
                    "track_shift_rms_kn": force[i] / 1e3,
                }
                for i, v in enumerate(self.sweep.speeds)
            ],
            "seeds": list(self.sweep.seeds),
            "by_criterion": {
                name: {
                    "critical_speed_kmh": None if c.speed is None else c.speed * KMH,
                    "status": c.crossing.value,
                    "over_seeds_kmh": self.criteria[name].over_seeds_kmh(),
                    "sensitive_to_grid": self._sensitive(name),
                }
                for name, c in self.crossing().items()
            },
            **({} if self.laws is None else {"by_creep_law": self.laws.as_dict()}),
        }

    def tables(self) -> dict[str, Table]:
        """Every run, one line for each wheelset, and the critical speeds by creep law."""
        laws = {} if self.laws is None else {"creep_laws": self.laws.table()}
        found = [
            (name, None if c.speed is None else c.speed * KMH, c.crossing.value)
            for name, c in self.crossing().items()
        ]
        return {
            "runs": runs_table(self.sweep, self.wheelsets),
            "critical_speeds": (("criterion", "critical_speed_kmh", "status"), found),
            **laws,
        }

    def plots(self) -> dict[str, Plot]:
        """Counterparts of figure 10 (trends over speed) and figure 8 (a) (time history)."""
        shown = partial(draw_histories, histories=self.histories, bounds=self.limits)
        histories = {"time_history": shown} if self.histories else {}
        title = f"{self.scenario.vehicle.name}, wear {self.scenario.wear:g}"
        trends = partial(
            draw_trends, sweep=self.sweep, bounds=self.limits, wheelsets=self.wheelsets, title=title
        )
        return {"critical_speed": trends, **histories}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the trends over speed and the critical speed."""
        about = f"{self.scenario.vehicle.name}, wear {self.scenario.wear:g}"
        seeds = len(self.sweep.seeds)
        title = f"{about}: medians of {seeds} seed{'s' * (seeds > 1)}"
        Listing(title, TRENDS, self._trends()).print(console, wide)
        for name in self.crossing():
            console.print(f"critical speed by {name.replace('_', ' ')}: [bold]{self.verdict(name)}[/]")
        if self.laws is not None:
            self.laws.summary(console, "critical speed by creep law, all else equal", wide)

    def overview(self) -> tuple[Sequence[Column], list[dict[str, Any]]]:
        """Critical speeds by criterion, as one of many results is shown."""
        columns = (Column("criterion", "by"), Column("verdict", "critical speed"))
        return columns, [{"criterion": name, "verdict": self.verdict(name)} for name in self.criteria]

    def _trends(self) -> list[dict[str, Any]]:
        """Values by `TRENDS`: medians over the seeds of each run's largest wheelset, as the limits judge."""
        judged = [values for each in self.criteria.values() for values in (each.medians(), each.limit)]
        acceleration, acceleration_limit, force, force_limit = judged
        frequency = self._median("frequency")
        columns = (
            *(self.sweep.speeds * KMH, frequency.min(axis=1), frequency.max(axis=1)),
            *(acceleration, acceleration / acceleration_limit, force, force / force_limit),
        )
        names = [column.name for column in TRENDS]
        return [dict(zip(names, row, strict=True)) for row in np.column_stack(columns).tolist()]

    def verdict(self, name: str) -> str:
        """Say in words what the critical speed by a criterion is."""
        c = self.crossing()[name]
        if c.crossing is Crossing.NOT_REACHED:
            return f"above {self.sweep.speeds[-1] * KMH:.0f} km/h (limit not reached)"
        if c.speed is None:
            return f"below {self.sweep.speeds[0] * KMH:.0f} km/h (limit exceeded at the lowest speed)"
        spread = f" (80 % of the seeds: {self.criteria[name].over_seeds_text()})"
        grid = ", sensitive to the speed grid" if self._sensitive(name) else ""
        return f"{c.speed * KMH:.0f} km/h{spread}{grid}"


TRENDS = (
    Column("speed_kmh", "km/h", digits=0),
    Column("frequency_from_hz", "f_0 from", "Hz", digits=2),
    Column("frequency_to_hz", "to", "Hz", digits=2),
    Column("acceleration_rms", "acceleration", "m/s²", digits=2),
    Column("acceleration_ratio", "/ limit", **LIMITED),
    Column("track_shift_rms_n", "track shift", "kN", 1e-3, 1),
    Column("track_shift_ratio", "/ limit", **LIMITED),
)
"""Of the printed table."""


def draw_histories(figure: Figure, histories: Sequence[AccelerationHistory], bounds: Limits) -> None:
    """Draw band-passed accelerations, their sliding RMS and its limit, one below the other (figure 8 a)."""
    axes = panels(figure, len(histories), size=(8.0, 3.0), sharex=True)
    for axis, h in zip(axes, histories, strict=True):
        axis.plot(h.distance, h.filtered, color=SKY, linewidth=0.5, label="band-passed signal")
        axis.plot(h.position, h.rms, "x-", color=VERMILION, markersize=3, linewidth=0.8, label="sliding RMS")
        limit_line(axis, bounds.acceleration, "limit")
        where = f"{h.wheelset} wheelset at {h.speed * KMH:.0f} km/h, seed {h.seed}"
        axis.set(title=f"{where}: f0 = {h.frequency:.1f} Hz", ylabel="acceleration (m/s²)")
        axis.set_xlim(h.position[0], h.position[-1])
    axes[-1].set_xlabel("distance (m)")
    legend_below(figure, axes[0])


def draw_trends(
    figure: Figure,
    sweep: Sweep,
    bounds: Limits,
    wheelsets: Sequence[str],
    title: str,
    scatter: tuple[float, float] | None = None,
) -> None:
    """Draw dominant frequency, track shift force and acceleration over speed, with the limits of EN 14363.

    As figure 10 of the paper; with the frequencies (Hz) between which those of a vehicle that does not hunt
    `scatter` as its figure 11, which has no track shift force.
    """
    shown = [
        (sweep.track_shift, 1e-3, "track shift force, RMS (kN)", bounds.track_shift_force * 1e-3),
        (sweep.acceleration, 1.0, "acceleration, RMS (m/s²)", bounds.acceleration),
    ]
    if scatter is not None:
        del shown[0]
    top, *axes = panels(figure, 1 + len(shown), size=(8.0, 3.0), sharex=True)
    top.set_title(f"{title}: every seed, medians and range")
    _draw_frequencies(top, sweep, scatter)
    for axis, (values, scale, quantity, limit) in zip(axes, shown, strict=True):
        for k, name in enumerate(wheelsets):
            with_band(
                axis, sweep.speeds * KMH, values[..., k] * scale, wheelset_style(k), f"WS{k + 1} {name}"
            )
        limit_line(axis, limit, "limit")
        axis.set_ylim(bottom=0.0)  # so that the margin to the limit is seen
        axis.set_ylabel(quantity)
    axes[-1].set_xlabel("speed (km/h)")
    legend_below(figure, axes[-1], columns=5)


def _draw_frequencies(axes: Axes, sweep: Sweep, scatter: tuple[float, float] | None) -> None:
    """Draw a point for each wheelset and seed, and a larger one for their median."""
    kmh = sweep.speeds * KMH
    beside = 0.1 * np.diff(kmh).min(initial=30.0)  # so that the wheelsets do not hide each other
    for k in range(sweep.frequency.shape[-1]):
        found, style = sweep.frequency[..., k], wheelset_style(k)
        point: dict[str, Any] = {"color": style.colour, "marker": style.marker, "linestyle": "none"}
        x = kmh + beside * (k - (sweep.frequency.shape[-1] - 1) / 2.0)
        axes.plot(np.repeat(x, found.shape[1]), found.ravel(), **point, markersize=3, alpha=0.3)
        axes.plot(x, np.median(found, axis=1), **point, markersize=5)
    if scatter is not None:
        name = f"{scatter[0]:g} to {scatter[1]:g} Hz"
        axes.axhspan(*scatter, color=GREY, alpha=0.12, linewidth=0.0, label=name)
        axes.legend(loc="lower right", fontsize="small")
    axes.set(ylabel="dominant frequency (Hz)", ylim=(0.0, max(1.0, 1.1 * axes.dataLim.y1)))


@dataclass(frozen=True)
class CreepLawComparison:
    """Critical speeds by creep law."""

    results: Mapping[str, CriticalSpeedResult]
    """By the law's name."""

    def as_dict(self) -> dict[str, Any]:
        """Critical speed and criteria by law, with the keys of ``sayd critical-speed --json``."""
        kept = ("critical_speed_kmh", "criterion", "by_criterion")
        return {
            law: {key: value for key, value in result.as_dict().items() if key in kept}
            for law, result in self.results.items()
        }

    def table(self) -> Table:
        """Critical speed (km/h) by law and criterion; empty where the grid does not hold it."""
        return csv_table(_LAW_COLUMNS, self._rows())

    def _rows(self) -> list[dict[str, Any]]:
        return [
            {
                "creep_law": law,
                "criterion": name,
                "critical_speed_kmh": None if found.speed is None else found.speed * KMH,
                "status": found.crossing.value,
                "verdict": result.verdict(name),
            }
            for law, result in self.results.items()
            for name, found in result.crossing().items()
        ]

    def summary(self, console: Console, title: str, wide: bool = False) -> None:
        """Print the critical speeds by law."""
        columns = (*_LAW_COLUMNS, Column("verdict", "critical speed"))
        Listing(title, columns, self._rows()).print(console, wide)


_LAW_COLUMNS = (
    Column("creep_law", "creep law"),
    Column("criterion", "by"),
    Column("critical_speed_kmh"),
    Column("status"),
)


def default_speeds(wear: float) -> tuple[float, ...]:
    """Speed grid of the paper (m/s): figure 8 for new wheels, figure 10 for worn ones."""
    return load_reproduction().speeds("new" if wear < HALF_WORN else "worn")


def find_critical_speed(
    scenario: Scenario,
    speeds: Sequence[float] | None = None,
    seeds: Sequence[int] = range(10),
    *,
    policy: PolicySpec | None = None,
    creep_laws: Sequence[str] = (),
    context: RunContext | None = None,
) -> CriticalSpeedResult:
    """Assess a vehicle over speed and find where it exceeds a limit of EN 14363.

    Parameters
    ----------
    speeds : sequence of float, optional
        Speeds, m/s, rising; the paper's grid for the wear by default.
    seeds : sequence of int
        Track seeds.
    policy : PolicySpec, optional
        What commands semi-active dampers; these replace passive ones. Their own constant command by default.
    creep_laws : sequence of str
        Creep laws by which the critical speed is found besides, all else equal.

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, a profile that cannot be used, a name that is no creep law, a
        policy that does not fit; no speed or no seed.
    StudyError
        A run that diverged.
    """
    check_laws(creep_laws, "creep laws")
    context = context or RunContext()
    chosen = default_speeds(scenario.wear) if speeds is None else tuple(speeds)
    refuse_empty(speeds=chosen, seeds=seeds)
    each = len(chosen) * len(seeds)
    total = each * (1 + len(creep_laws))
    own = _found(scenario, chosen, seeds, context.part(0, total), policy)
    if not creep_laws:
        return own
    rest = context.part(each, total)
    return replace(own, laws=compare_laws(scenario, chosen, seeds, creep_laws, rest, policy))


def compare_laws(
    scenario: Scenario,
    speeds: Sequence[float],
    seeds: Sequence[int],
    creep_laws: Sequence[str],
    context: RunContext,
    policy: PolicySpec | None = None,
) -> CreepLawComparison:
    """Critical speeds by several creep laws; parameters and errors as of `find_critical_speed`."""
    each = len(speeds) * len(seeds)
    results = {}
    for i, law in enumerate(creep_laws):
        contact = scenario.contact.model_copy(update={"creep_law": law})
        part = context.part(i * each, len(creep_laws) * each)
        results[law] = _found(scenario.model_copy(update={"contact": contact}), speeds, seeds, part, policy)
    return CreepLawComparison(results)


def _found(
    scenario: Scenario,
    speeds: Sequence[float],
    seeds: Sequence[int],
    context: RunContext,
    policy: PolicySpec | None,
) -> CriticalSpeedResult:
    if policy is None:
        found = sweep(scenario, speeds, seeds, context)
        shown = histories(scenario, found, model_limits(VehicleModel(scenario)), context)
    else:
        scenario, name = for_policy(scenario, policy), policy.title
        environment = environment_of(scenario, load_environment())
        required = [(name, speed, 0.0) for speed in speeds]
        runs = controlled_runs(scenario, environment, seeds, required, context, {name: policy})
        found = runs.sweep(name)
        whole = np.isfinite(found.acceleration[:, 0]).all(axis=1)  # no derailment
        slowest = [Run(policy, scenario, environment, v, seeds[0]) for v in found.speeds[whole][:1].tolist()]
        shown = tuple(_quiet(context).records(recorded_controlled, slowest, AccelerationHistory))
    model = VehicleModel(scenario)
    return CriticalSpeedResult(scenario, found, model_limits(model), wheelset_names(model), shown)


def histories(
    scenario: Scenario, found: Sweep, bounds: Limits, context: RunContext
) -> tuple[AccelerationHistory, ...]:
    """Make the histories of figure 8 on the first seed's track: they count as no step of the progress.

    One at the lowest speed, and one at the first speed whose median acceleration is above its limit.
    """
    above = found.criteria(bounds)["acceleration"].medians() > bounds.acceleration
    places = dict.fromkeys([0, *np.flatnonzero(above)[:1].tolist()])
    runs = [PassiveRun(scenario, float(found.speeds[i]), found.seeds[0]) for i in places]
    return tuple(_quiet(context).records(recorded, runs, AccelerationHistory))


def _quiet(context: RunContext) -> RunContext:
    return replace(context, progress=silent)


def recorded(runs: list[PassiveRun]) -> list[AccelerationHistory]:
    """Make runs that are companions, and keep their histories."""
    return [history(signals, run) for run, (signals, _) in zip(runs, simulated(runs), strict=True)]


def recorded_controlled(runs: list[Run]) -> list[AccelerationHistory]:
    """The same of runs with a policy."""
    return [
        history(rollout.true[:, LOG_ACCELERATION:LOG_TRACK_SHIFT], run)
        for run, rollout in zip(runs, roll_out_runs(runs), strict=True)
    ]


def wheelset_names(model: VehicleModel) -> tuple[str, ...]:
    """Names of the wheelsets in the order of the assessed quantities."""
    return tuple(name.removeprefix("wheelset.") for name, _ in model.multibody.measuring_points)


def history(acceleration: Array, run: PassiveRun | Run) -> AccelerationHistory:
    """Assess the accelerations of a run, shape (t, w) in m/s2, and keep those of its worst wheelset."""
    settings = run.scenario.assessment
    rate, names = settings.sample_rate, wheelset_names(VehicleModel(run.scenario))
    found = assess(acceleration, rate, run.speed, settings)
    worst = int(np.argmax(found.maximum))
    frequency = found.dominant_frequency[[worst]]
    filtered = band_pass(acceleration[:, [worst]], rate, frequency, settings)[:, 0]
    distance = distance_run(run.speed, rate, len(filtered))
    signals = distance, filtered, found.position, found.rms[:, worst]
    return AccelerationHistory(run.speed, run.seed, names[worst], float(frequency[0]), *signals)


def check_laws(laws: Sequence[str], option: str) -> None:
    """Refuse names that are no creep law, or are named twice.

    Raises
    ------
    ConfigError
        Naming the option, the name and what is expected.
    """
    for law in laws:
        if law not in LAWS:
            raise ConfigError(f"{option} {law}: unknown creep law; expected {', '.join(LAWS)}")
        if laws.count(law) > 1:
            raise ConfigError(f"{option}: '{law}' is named twice")
