"""How does one configuration run at given speeds? Cost, EN 14363 ratios and damper forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.scenario import Scenario
from sayd_env.physics.simulator import Telemetry, VehicleModel
from sayd_env.stability import (
    Limits,
    assess,
    assessed_span,
    averaged_spectra,
    band_pass,
    distance_run,
)
from sayd_env.studies.critical_speed import model_limits
from sayd_env.studies.output import Progress, silent
from sayd_env.studies.sweep import parallel, simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

Array = npt.NDArray[np.float64]
KMH = 3.6
AVERAGED = (
    "J",
    "J_acceleration",
    "J_force",
    "acceleration_ratio",
    "track_shift_ratio",
    "force_rms_n",
    "force_peak_n",
)
"""Columns of a row that a summary averages."""


@dataclass(frozen=True)
class Row:
    """One run; units stand in the names, ratios are to the limits of EN 14363."""

    policy: str
    speed_kmh: float
    wear: float
    friction: float
    seed: int
    J: float
    """Mean cost of the bogies, eq. (27), with the off-line filter."""
    J_acceleration: float
    """(psi_y / y_lim)^2, unweighted."""
    J_force: float
    """(psi_F / F_max)^2, unweighted."""
    acceleration_ratio: float
    track_shift_ratio: float
    force_rms_n: float
    force_peak_n: float
    valve_mean: float | None = None
    """Mean valve command; None for a passive damper."""
    valve_travel_per_km: float | None = None


@dataclass(frozen=True)
class EvaluateResult:
    """All runs of an evaluation."""

    scenario: Scenario
    rows: list[Row]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd evaluate --json``."""
        policies = sorted({row.policy for row in self.rows})
        return {
            "rows": [asdict(row) for row in self.rows],
            "summary": {policy: self._summary(policy) for policy in policies},
        }

    def tables(self) -> dict[str, tuple[Sequence[str], list[list[Any]]]]:
        """All runs."""
        header = list(asdict(self.rows[0]))
        return {"runs": (header, [list(asdict(row).values()) for row in self.rows])}

    def plots(self) -> dict[str, Callable[[Figure], None]]:
        """Ratios and damper force over speed."""
        return {"evaluate": self._draw}

    def summary(self, console: Console) -> None:
        """Print the medians over the seeds at each speed."""
        from rich.table import Table  # noqa: PLC0415 - only who prints pays for it

        table = Table(
            title=f"{self.scenario.vehicle.name}, wear {self.scenario.wear:g}: medians over the seeds"
        )
        for name in (
            "policy",
            "km/h",
            "J",
            "J_acceleration",
            "J_force",
            "acc. ratio",
            "track shift ratio",
            "force RMS (kN)",
            "peak (kN)",
        ):
            table.add_column(name, justify="left" if name == "policy" else "right")
        for policy, speed in self._cases():
            m = self._medians(policy, speed)
            ratios = [f"[bold red]{m[k]:.2f}[/]" if m[k] > 1.0 else f"{m[k]:.2f}" for k in AVERAGED[3:5]]
            costs = [f"{m[k]:.4f}" for k in AVERAGED[:3]]
            forces = [f"{m[k] / 1e3:.2f}" for k in AVERAGED[5:]]
            table.add_row(policy, f"{speed:.0f}", *costs, *ratios, *forces)
        console.print(table)

    def _cases(self) -> list[tuple[str, float]]:
        return sorted({(row.policy, row.speed_kmh) for row in self.rows})

    def _medians(self, policy: str, speed: float) -> dict[str, float]:
        rows = [r for r in self.rows if r.policy == policy and r.speed_kmh == speed]
        return {name: float(np.median([getattr(r, name) for r in rows])) for name in AVERAGED}

    def _summary(self, policy: str) -> dict[str, float]:
        rows = [r for r in self.rows if r.policy == policy]
        return {name: float(np.mean([getattr(r, name) for r in rows])) for name in AVERAGED}

    def _draw(self, figure: Figure) -> None:
        panels = (
            ("acceleration_ratio", 1.0, "acceleration, RMS over limit"),
            ("track_shift_ratio", 1.0, "track shift force, RMS over limit"),
            ("force_rms_n", 1e-3, "yaw damper force, RMS (kN)"),
        )
        figure.set_size_inches(8.0, 9.0)
        axes = figure.subplots(3, 1, sharex=True)
        for axis, (name, scale, label) in zip(axes, panels, strict=True):
            for policy in sorted({row.policy for row in self.rows}):
                rows = [r for r in self.rows if r.policy == policy]
                speeds = sorted({r.speed_kmh for r in rows})
                medians = [scale * self._medians(policy, v)[name] for v in speeds]
                axis.plot(speeds, medians, "o-", label=policy)
                axis.plot(
                    [r.speed_kmh for r in rows], [scale * getattr(r, name) for r in rows], "k.", markersize=2
                )
            if name.endswith("ratio"):
                axis.axhline(1.0, color="k", linestyle="--")
            axis.set_ylabel(label)
            axis.grid(alpha=0.3)
        axes[-1].set_xlabel("speed (km/h)")
        axes[0].legend()


def evaluate(
    scenario: Scenario,
    speeds: Sequence[float],
    seeds: Sequence[int] = range(10),
    *,
    workers: int | None = None,
    progress: Progress = silent,
) -> EvaluateResult:
    """Run one configuration at given speeds.

    Parameters
    ----------
    scenario : Scenario
        The configuration.
    speeds : sequence of float
        Speeds, m/s.
    seeds : sequence of int
        Track seeds.
    workers : int, optional
        Threads.
    progress : Progress
        Told after each run.

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, a profile that cannot be used.
    StudyError
        A run that diverged.
    """
    model = VehicleModel(scenario)
    for speed in speeds:
        model.check_speed(speed)  # refused before any work
    bounds = model_limits(model)
    model.table  # noqa: B018 - made once, before the threads ask for it
    cases = [(speed, seed) for speed in speeds for seed in seeds]
    return EvaluateResult(scenario, parallel(lambda c: _row(model, bounds, *c), cases, workers, progress))


def _row(model: VehicleModel, bounds: Limits, speed: float, seed: int) -> Row:
    scenario, signals = model.scenario, simulate(model, speed, seed)
    settings = scenario.assessment
    both = np.hstack([signals.acceleration, signals.track_shift])
    peak = assess(both, settings.sample_rate, speed, settings).maximum
    w = signals.acceleration.shape[1]
    distance = distance_run(speed, settings.sample_rate, len(signals.time))
    first, last = np.searchsorted(distance, assessed_span(distance, settings))
    force = signals.damper_force[first:last]
    j_acceleration = _acceleration_cost(model, signals, speed, bounds)[first:last].mean()
    j_force = float(np.mean(force**2)) / scenario.cost.force_reference**2 if force.size else 0.0
    damper = scenario.damper
    valve = damper.current if isinstance(damper, SaydDamperConfig) else None
    return Row(
        policy="passive" if valve is None else "constant",
        speed_kmh=speed * KMH,
        wear=scenario.wear,
        friction=scenario.friction,
        seed=seed,
        J=scenario.cost.acceleration_weight * j_acceleration + scenario.cost.force_weight * j_force,
        J_acceleration=j_acceleration,
        J_force=j_force,
        acceleration_ratio=peak[:w].max() / bounds.acceleration,
        track_shift_ratio=peak[w:].max() / bounds.track_shift_force,
        force_rms_n=float(np.sqrt(np.mean(force**2))) if force.size else 0.0,
        force_peak_n=float(np.max(np.abs(force))) if force.size else 0.0,
        valve_mean=valve,
        valve_travel_per_km=None if valve is None else 0.0,
    )


def _acceleration_cost(model: VehicleModel, signals: Telemetry, speed: float, bounds: Limits) -> Array:
    """(y / y_lim)^2 of the band-passed acceleration, mean over the points of each bogie and the bogies, (t,).

    One f_0 for each bogie (two neighbouring points), from the sum of their spectra.
    """
    settings = model.scenario.assessment
    distance = distance_run(speed, settings.sample_rate, len(signals.time))
    span = assessed_span(distance, settings)
    grid, spectra = averaged_spectra(signals.acceleration, settings.sample_rate, distance, settings, span)
    width = 2 if len(spectra) % 2 == 0 else 1  # points of a bogie
    pairs = spectra.reshape(-1, width, spectra.shape[-1]).sum(axis=1)
    f0 = np.repeat(grid[np.argmax(pairs[:, 1:-1], axis=1) + 1], width)
    filtered = band_pass(signals.acceleration, settings.sample_rate, f0, settings)
    return np.asarray(np.mean((filtered / bounds.acceleration) ** 2, axis=1))
