"""From which speed does the vehicle hunt? The critical speed by EN 14363 (paper, section 3)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH, Array
from sayd_env.physics.contact.creep import LAWS
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.runs.passive import PassiveRun, Sweep, runs_table, simulated, sweep
from sayd_env.stability import (
    CriticalSpeed,
    Crossing,
    GridSensitivity,
    Limits,
    assess,
    band_pass,
    critical_speed,
    grid_sensitivity,
    limits,
    thinned_grids,
)
from sayd_env.studies.paper.passive_claims import NEW_SPEEDS, WORN_SPEEDS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

HALF_WORN = 0.5
LAW_SPEEDS = tuple(v / KMH for v in range(260, 441, 20))
"""Speeds of a comparison of creep laws (m/s): wide enough for all of them on new and on worn wheels."""
CRITERIA = ("acceleration", "track_shift_force")


@dataclass(frozen=True)
class History:
    """Filtered signal of one run, as in figure 8 (a)."""

    speed: float
    wheelset: str
    time: Array
    filtered: Array
    position: Array
    rms: Array


@dataclass(frozen=True)
class CriticalSpeedResult:
    """Assessed quantities over speed, and where they cross their limits."""

    scenario: Scenario
    sweep: Sweep
    limits: Limits
    wheelsets: tuple[str, ...]
    history: History
    laws: CreepLawComparison | None = None
    """The same by other creep laws, if asked for."""

    @cached_property
    def medians(self) -> dict[str, Array]:
        """Median over the seeds of each assessed quantity, shape (speeds, w)."""
        names = ("frequency", "acceleration", "track_shift")
        return {name: np.median(getattr(self.sweep, name), axis=1) for name in names}

    def crossing(self, seeds: npt.NDArray[np.int64] | None = None) -> dict[str, CriticalSpeed]:
        """Critical speed (m/s) by each criterion, from the medians over a selection of the seeds."""
        chosen = np.arange(len(self.sweep.seeds)) if seeds is None else seeds
        return {
            name: critical_speed(self.sweep.speeds, self._peak(values, chosen), limit)
            for name, values, limit in self._criteria()
        }

    @cached_property
    def critical(self) -> tuple[float | None, str | None]:
        """The lower of both critical speeds (m/s) and its criterion; None if no limit is exceeded."""
        found = {k: c for k, c in self.crossing().items() if c.crossing is not Crossing.NOT_REACHED}
        if not found:
            return None, None
        name = min(found, key=lambda k: -1.0 if found[k].speed is None else float(found[k].speed or 0.0))
        return found[name].speed, name

    @cached_property
    def sensitivity(self) -> dict[str, GridSensitivity]:
        """Whether the critical speeds hold on a thinner grid."""
        tolerance = self.scenario.assessment.grid_tolerance
        chosen = np.arange(len(self.sweep.seeds))
        return {
            name: grid_sensitivity(
                critical_speed(self.sweep.speeds, self._peak(values, chosen), limit),
                thinned_grids(self.sweep.speeds, self._peak(values, chosen), limit),
                tolerance,
            )
            for name, values, limit in self._criteria()
        }

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd critical-speed --json``."""
        speed, criterion = self.critical
        crossing = self.crossing()
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
                    "dominant_frequency_hz": self.medians["frequency"][i],
                    "acceleration_rms": self.medians["acceleration"][i],
                    "track_shift_rms_kn": self.medians["track_shift"][i] / 1e3,
                }
                for i, v in enumerate(self.sweep.speeds)
            ],
            "seeds": list(self.sweep.seeds),
            "by_criterion": {
                name: {
                    "critical_speed_kmh": None if c.speed is None else c.speed * KMH,
                    "status": c.crossing.name.lower(),
                    "over_seeds_kmh": self._over_seeds(name),
                    "sensitive_to_grid": self.sensitivity[name].sensitive,
                }
                for name, c in crossing.items()
            },
            **({} if self.laws is None else {"by_creep_law": self.laws.as_dict()}),
        }

    def tables(self) -> dict[str, tuple[Sequence[str], list[list[Any]]]]:
        """Every run, one line for each wheelset, and the critical speeds by creep law."""
        laws = {} if self.laws is None else {"creep_laws": self.laws.table()}
        return {"runs": runs_table(self.sweep, self.wheelsets), **laws}

    def plots(self) -> dict[str, Callable[[Figure], None]]:
        """Counterparts of figure 10 (trends over speed) and figure 8 (a) (time history)."""
        return {"critical_speed": self._draw_trends, "time_history": self._draw_history}

    def summary(self, console: Console) -> None:
        """Print the trends over speed and the critical speed."""
        from rich.table import Table  # noqa: PLC0415 - only who prints pays for it

        about = f"{self.scenario.vehicle.name}, wear {self.scenario.wear:g}"
        table = Table(title=f"{about}: medians of {len(self.sweep.seeds)} seeds")
        for name in ("km/h", "f_0 (Hz)", "acceleration (m/s2)", "ratio", "track shift (kN)", "ratio"):
            table.add_column(name, justify="right")
        chosen = np.arange(len(self.sweep.seeds))
        for i, v in enumerate(self.sweep.speeds):
            f, a, y = (self.medians[k][i] for k in ("frequency", "acceleration", "track_shift"))
            ratios = [self._peak(values, chosen)[i] / limit for _, values, limit in self._criteria()]
            styled = [f"[bold red]{r:.2f}[/]" if r > 1.0 else f"{r:.2f}" for r in ratios]
            table.add_row(
                f"{v * KMH:.0f}",
                f"{f.min():.2f} to {f.max():.2f}",
                f"{a.max():.2f}",
                styled[0],
                f"{y.max() / 1e3:.1f}",
                styled[1],
            )
        console.print(table)
        for name in self.crossing():
            console.print(f"critical speed by {name.replace('_', ' ')}: {self.verdict(name)}")
        if self.laws is not None:
            self.laws.summary(console, "critical speed by creep law, all else equal")

    def verdict(self, name: str) -> str:
        """Say in words what the critical speed by a criterion is."""
        c = self.crossing()[name]
        if c.crossing is Crossing.NOT_REACHED:
            return f"above {self.sweep.speeds[-1] * KMH:.0f} km/h (limit not reached)"
        if c.speed is None:
            return f"below {self.sweep.speeds[0] * KMH:.0f} km/h (limit exceeded at the lowest speed)"
        first, last = self.sweep.speeds[[0, -1]] * KMH
        beyond = {-np.inf: f"below {first:.0f}", np.inf: f"above {last:.0f}"}
        low, high = (beyond.get(v, f"{v:.0f}") for v in self._over_seeds(name))
        spread = f" (80 % of the seeds: {low} to {high})"
        grid = ", sensitive to the speed grid" if self.sensitivity[name].sensitive else ""
        return f"[bold]{c.speed * KMH:.0f} km/h[/]{spread}{grid}"

    def _over_seeds(self, name: str) -> tuple[float, float]:
        """10 % and 90 % quantile over single seeds (km/h); infinite where they lie beyond the grid."""
        single = [self.crossing(np.array([j]))[name] for j in range(len(self.sweep.seeds))]
        beyond = {Crossing.BELOW_GRID: -np.inf, Crossing.NOT_REACHED: np.inf}
        values = [beyond[c.crossing] if c.speed is None else c.speed * KMH for c in single]
        low, high = np.quantile(values, (0.1, 0.9), method="nearest")
        return float(low), float(high)

    def _criteria(self) -> tuple[tuple[str, Array, float], ...]:
        return (
            ("acceleration", self.sweep.acceleration, self.limits.acceleration),
            ("track_shift_force", self.sweep.track_shift, self.limits.track_shift_force),
        )

    @staticmethod
    def _peak(values: Array, seeds: npt.NDArray[np.int64]) -> Array:
        return np.asarray(np.median(values[:, seeds].max(axis=-1), axis=1))

    def _draw_trends(self, figure: Figure) -> None:
        title = f"{self.scenario.vehicle.name}, wear {self.scenario.wear:g}"
        draw_trends(figure, self.sweep, self.limits, self.wheelsets, title)

    def _draw_history(self, figure: Figure) -> None:
        h = self.history
        axis = figure.subplots()
        axis.plot(h.time, h.filtered, linewidth=0.6, label="band-passed")
        axis.plot(h.position / h.speed, h.rms, "rx-", markersize=3, label="sliding RMS")
        for sign in (-1, 1):
            axis.axhline(sign * self.limits.acceleration, color="k", linestyle="--", linewidth=0.8)
        axis.set(
            xlabel="time (s)",
            ylabel="lateral acceleration (m/s²)",
            title=f"{h.wheelset} at {h.speed * KMH:.0f} km/h",
        )
        axis.legend(loc="upper right")


def draw_trends(
    figure: Figure,
    sweep: Sweep,
    bounds: Limits,
    wheelsets: Sequence[str],
    title: str,
    *,
    track_shift: bool = True,
) -> None:
    """Draw dominant frequency, track shift force and acceleration over speed, as in figure 10.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        An empty figure.
    sweep : Sweep
        Runs over speeds and seeds.
    bounds : Limits
        Limits of EN 14363, drawn as dashed lines.
    wheelsets : sequence of str
        Their names.
    title : str
        What the runs are of.
    track_shift : bool
        Whether the track shift force has a panel; without it, as in figure 11.
    """
    panels = [
        (sweep.frequency, 1.0, "dominant frequency (Hz)", None),
        (sweep.track_shift, 1e-3, "track shift force, RMS (kN)", bounds.track_shift_force * 1e-3),
        (sweep.acceleration, 1.0, "acceleration, RMS (m/s²)", bounds.acceleration),
    ]
    if not track_shift:
        del panels[1]
    figure.set_size_inches(8.0, 3.0 * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True)
    axes[0].set_title(f"{title}: medians and range of the seeds")
    for axis, (values, scale, label, limit) in zip(axes, panels, strict=True):
        for k, name in enumerate(wheelsets):
            series = values[..., k] * scale
            (line,) = axis.plot(
                sweep.speeds * KMH, np.median(series, axis=1), "o-", label=f"WS{k + 1} {name}"
            )
            axis.fill_between(
                sweep.speeds * KMH, series.min(axis=1), series.max(axis=1), color=line.get_color(), alpha=0.12
            )
        if limit is not None:
            axis.axhline(limit, color="k", linestyle="--", label="limit")
            axis.set_ylim(bottom=0.0)  # so that the margin to the limit is seen
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("speed (km/h)")
    axes[-1].legend(fontsize="small")


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

    def table(self) -> tuple[Sequence[str], list[list[Any]]]:
        """Critical speed (km/h) by law and criterion; empty where the grid does not hold it."""
        rows: list[list[Any]] = []
        for law, result in self.results.items():
            found = result.crossing()
            for name in CRITERIA:
                speed, status = found[name].speed, found[name].crossing.name.lower()
                rows.append([law, name, None if speed is None else speed * KMH, status])
        return ("creep_law", "criterion", "critical_speed_kmh", "status"), rows

    def summary(self, console: Console, title: str) -> None:
        """Print the critical speeds by law."""
        from rich.table import Table  # noqa: PLC0415 - only who prints pays for it

        table = Table(title=title)
        table.add_column("creep law")
        for name in CRITERIA:
            table.add_column(f"by {name.replace('_', ' ')}", justify="right")
        for law, result in self.results.items():
            table.add_row(law, *(result.verdict(name) for name in CRITERIA))
        console.print(table)


def default_speeds(wear: float) -> tuple[float, ...]:
    """Speed grid of the paper (m/s): figure 8 for new wheels, figure 10 for worn ones."""
    return NEW_SPEEDS if wear < HALF_WORN else WORN_SPEEDS


def model_limits(model: VehicleModel) -> Limits:
    """Limits of EN 14363 for a vehicle, from its axle load and the mass of its bogie."""
    return limits(2.0 * float(np.max(model.multibody.wheel_load)), model.multibody.bogie_mass)


def find_critical_speed(
    scenario: Scenario,
    speeds: Sequence[float] | None = None,
    seeds: Sequence[int] = range(10),
    *,
    creep_laws: Sequence[str] = (),
    context: RunContext | None = None,
) -> CriticalSpeedResult:
    """Assess a vehicle over speed and find where it exceeds a limit of EN 14363.

    Parameters
    ----------
    scenario : Scenario
        The configuration.
    speeds : sequence of float, optional
        Speeds, m/s, rising; the paper's grid for the wear by default.
    seeds : sequence of int
        Track seeds.
    creep_laws : sequence of str
        Creep laws by which the critical speed is found besides, all else equal.
    context : RunContext, optional

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, a profile that cannot be used, a name that is no creep law.
    StudyError
        A run that diverged.
    """
    check_laws(creep_laws, "creep laws")
    context = context or RunContext()
    chosen = default_speeds(scenario.wear) if speeds is None else tuple(speeds)
    each = len(chosen) * len(seeds)
    total = each * (1 + len(creep_laws))
    own = _found(scenario, chosen, seeds, context.part(0, total))
    if not creep_laws:
        return own
    return replace(own, laws=compare_laws(scenario, chosen, seeds, creep_laws, context.part(each, total)))


def compare_laws(
    scenario: Scenario,
    speeds: Sequence[float],
    seeds: Sequence[int],
    creep_laws: Sequence[str],
    context: RunContext,
) -> CreepLawComparison:
    """Critical speeds by several creep laws; parameters and errors as of `find_critical_speed`."""
    each = len(speeds) * len(seeds)
    return CreepLawComparison(
        {
            law: _found(
                with_law(scenario, law), speeds, seeds, context.part(i * each, len(creep_laws) * each)
            )
            for i, law in enumerate(creep_laws)
        }
    )


def _found(
    scenario: Scenario, speeds: Sequence[float], seeds: Sequence[int], context: RunContext
) -> CriticalSpeedResult:
    found = sweep(scenario, speeds, seeds, context)
    model = VehicleModel(scenario)
    history = _history(PassiveRun(scenario, speeds[0], seeds[0]), wheelset_names(model))
    return CriticalSpeedResult(scenario, found, model_limits(model), wheelset_names(model), history)


def wheelset_names(model: VehicleModel) -> tuple[str, ...]:
    """Names of the wheelsets in the order of the assessed quantities."""
    return tuple(name.removeprefix("wheelset.") for name, _ in model.multibody.measuring_points)


def _history(run: PassiveRun, names: Sequence[str]) -> History:
    settings = run.scenario.assessment
    ((acceleration, _),) = simulated([run])
    found = assess(acceleration, settings.sample_rate, run.speed, settings)
    worst = int(np.argmax(found.maximum))
    frequency = found.dominant_frequency[[worst]]
    filtered = band_pass(acceleration[:, [worst]], settings.sample_rate, frequency, settings)[:, 0]
    time = np.arange(1, len(filtered) + 1) / settings.sample_rate
    return History(run.speed, names[worst], time, filtered, found.position, found.rms[:, worst])


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


def with_law(scenario: Scenario, law: str) -> Scenario:
    """Return the same scenario with another creep law."""
    contact = scenario.contact.model_copy(update={"creep_law": law})
    return scenario.model_copy(update={"contact": contact})
