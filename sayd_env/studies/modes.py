"""How does the vehicle swing, and from which speed on does it hunt? Eigenvalues of the linearised model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sayd_env.physics.linear import HUNTING_BAND, RootLocus, linear_critical_speed, root_locus
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.context import Progress, silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.config.scenario import Scenario
    from sayd_env.report.files import Plot, Table

Array = npt.NDArray[np.float64]

AMPLITUDE = 3e-3
"""Amplitude of the wheelsets' lateral motion at which EN 15302 quotes conicities (m)."""
LOWEST, HIGHEST = 100.0 / 3.6, 500.0 / 3.6
"""Speeds between which the linear critical speed is looked for (m/s)."""
SPEEDS = tuple(np.arange(100.0, 501.0, 20.0) / 3.6)
"""Speeds of the root locus (m/s)."""

_SPACING = 10.0 / 3.6  # m/s; modes of speeds this near to each other are told apart by their shapes
_SHOWN_MODES = 8
_SHOWN_SPEEDS = 5
_SHOWN_FREQUENCY = 20.0  # Hz; above it stand the modes of wheelsets and track, which do not decide stability


@dataclass(frozen=True)
class ModesResult:
    """Modes over speed; SI units."""

    amplitude: float
    """Amplitude of the harmonic linearisation of the contact, m."""
    locus: RootLocus
    """Modes at speeds near enough to each other to be followed."""
    asked: npt.NDArray[np.int64]
    """Indices of the speeds that were asked for."""
    critical_speed: float | None
    """Linear critical speed, m/s; None: there is none in the range."""
    critical_range: tuple[float, float]
    """Range in which it was looked for, m/s."""

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``."""
        return {
            "amplitude_mm": self.amplitude * 1e3,
            "linear_critical_speed_kmh": None if self.critical_speed is None else self.critical_speed * 3.6,
            "critical_speed_range_kmh": [speed * 3.6 for speed in self.critical_range],
            "modes": [dict(zip(("speed_kmh", *_KEYS), row, strict=True)) for row in self._rows()],
        }

    def tables(self) -> dict[str, Table]:
        """Return all modes at the speeds asked for."""
        return {"modes": (("speed_kmh", *_KEYS), self._rows())}

    def plots(self) -> dict[str, Plot]:
        """Return root locus and damping over speed."""
        return {"root_locus": self._draw}

    def summary(self, console: Console) -> None:
        """Print the least damped modes and the linear critical speed."""
        from rich.table import Table as RichTable  # noqa: PLC0415 - only who prints pays for it

        few = np.unique(np.linspace(0, len(self.asked) - 1, _SHOWN_SPEEDS).round().astype(int))
        speeds = self.asked[few]
        grid = RichTable(
            title=f"least damped modes below {_SHOWN_FREQUENCY:g} Hz: frequency (Hz), damping ratio"
        )
        grid.add_column("mode")
        for s in speeds:
            grid.add_column(f"{self.locus.speeds[s] * 3.6:.0f} km/h", justify="right")
        for b in self._least_damped()[:_SHOWN_MODES]:
            grid.add_row(self.locus.names[b], *(self._cell(s, b) for s in speeds))
        console.print(grid)
        low, high = (speed * 3.6 for speed in self.critical_range)
        found = "none" if self.critical_speed is None else f"{self.critical_speed * 3.6:.1f} km/h"
        if self.critical_speed == self.critical_range[0]:
            found = f"below {low:.0f} km/h"
        console.print(
            f"linear critical speed at {self.amplitude * 1e3:g} mm: {found} "
            f"({low:.0f} to {high:.0f} km/h searched)"
        )

    def _rows(self) -> list[tuple[float, float, float, str]]:
        """Speed (km/h), frequency, damping ratio and name of every mode, in the order of the frequencies."""
        rows = []
        for s in self.asked:
            frequency, damping = self.locus.frequency_hz[s], self.locus.damping_ratio[s]
            for b in np.argsort(frequency)[: np.count_nonzero(np.isfinite(frequency))]:
                speed = float(self.locus.speeds[s] * 3.6)
                rows.append((speed, float(frequency[b]), float(damping[b]), self.locus.names[b]))
        return rows

    def _cell(self, speed: int, branch: int) -> str:
        frequency = self.locus.frequency_hz[speed, branch]
        if not np.isfinite(frequency):
            return "-"
        damping = self.locus.damping_ratio[speed, branch]
        style = "[bold red]{}[/]" if damping < 0.0 else "{}"
        return style.format(f"{frequency:.2f}  {damping:+.3f}")

    def _least_damped(self) -> list[int]:
        """Branches below the highest shown frequency, the least damped first."""
        frequency, damping = self.locus.frequency_hz[self.asked], self.locus.damping_ratio[self.asked]
        low = np.where(frequency < _SHOWN_FREQUENCY, damping, np.inf)
        least = np.min(low, axis=0, initial=np.inf, where=np.isfinite(low))
        return [int(b) for b in np.argsort(least, kind="stable") if np.isfinite(least[b])]

    def _draw(self, figure: Figure) -> None:
        figure.set_size_inches(11.0, 5.0)
        left, right = figure.subplots(1, 2)
        speeds = self.locus.speeds * 3.6
        values, frequency = self.locus.eigenvalues, self.locus.frequency_hz
        shown = self._least_damped()
        for b in shown:
            left.plot(values[:, b].real, frequency[:, b], color="0.8", linewidth=0.7, zorder=1)
            dots = left.scatter(
                values[:, b].real, frequency[:, b], c=speeds, s=8, vmin=speeds[0], vmax=speeds[-1], zorder=2
            )
        left.axvline(0.0, color="black", linewidth=0.8)
        left.set(
            xlabel="real part (1/s)",
            ylabel="frequency (Hz)",
            title=f"root locus, linearised at {self.amplitude * 1e3:g} mm",
            xlim=(-40.0, max(10.0, 1.1 * np.nanmax(values[:, shown].real))),
            ylim=(0.0, _SHOWN_FREQUENCY),
        )
        figure.colorbar(dots, ax=left, label="speed (km/h)")
        for b in shown[:_SHOWN_MODES]:
            right.plot(speeds, self.locus.damping_ratio[:, b], label=self.locus.names[b])
        right.axhline(0.0, color="black", linewidth=0.8)
        if self.critical_speed is not None:
            right.axvline(self.critical_speed * 3.6, color="tab:red", linestyle="--", linewidth=0.8)
        right.set(xlabel="speed (km/h)", ylabel="damping ratio (-)", title="least damped modes")
        right.grid(visible=True)
        figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=7)


_KEYS = ("frequency_hz", "damping_ratio", "name")


def modes(
    scenario: Scenario,
    speeds: Sequence[float] | None = None,
    amplitude: float = AMPLITUDE,
    *,
    progress: Progress = silent,
) -> ModesResult:
    """Compute a scenario's modes over speed and its linear critical speed.

    Parameters
    ----------
    scenario : Scenario
        The vehicle; its track's irregularities do not matter.
    speeds : sequence of float, optional
        Rising speeds, m/s; by default `SPEEDS`, as far as the vehicle's range goes.
    amplitude : float
        Amplitude at which wheel-rail contact is harmonically linearised, m.
    progress : Progress
        Told between the parts.

    Raises
    ------
    ConfigError, DataError
        A speed or an amplitude out of range.
    StudyError
        No steady running was found.
    """
    model = VehicleModel(scenario)
    low, high = scenario.vehicle.speed_range
    if speeds is None:
        speeds = [speed for speed in SPEEDS if low <= speed <= high]
    for speed in speeds:
        model.step(speed)  # a speed out of range is refused before any work
    fine = _refined(speeds)
    searched = _refined([max(low, LOWEST), min(high, HIGHEST)])
    progress(0, 2, "root locus")
    locus = root_locus(model, fine, amplitude)
    progress(1, 2, f"critical speed, modes of {HUNTING_BAND[0]:g} to {HUNTING_BAND[1]:g} Hz")
    critical = linear_critical_speed(model, amplitude, searched)
    progress(2, 2)
    return ModesResult(
        amplitude=amplitude,
        locus=locus,
        asked=np.searchsorted(fine, np.array(speeds)),
        critical_speed=critical,
        critical_range=(searched[0], searched[-1]),
    )


def _refined(speeds: Sequence[float]) -> list[float]:
    """Add speeds between those that are farther apart than a mode can be followed over."""
    fine = [float(speeds[0])]
    for low, high in pairwise(speeds):
        parts = max(1, int(np.ceil((high - low) / _SPACING - 1e-9)))
        fine.extend(float(low + (high - low) * k / parts) for k in range(1, parts))
        fine.append(float(high))
    return fine
