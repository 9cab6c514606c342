"""How does the vehicle swing, and from which speed on does it hunt? Eigenvalues of the linearised model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config.palette import SHADE, cycled
from sayd_env.config.units import KMH, Integers
from sayd_env.physics.contact.conicity import AMPLITUDE
from sayd_env.physics.linear import HUNTING_BAND, RootLocus, linear_critical_speed, root_locus
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, label, legend_below, limit_line, panels, reference_line
from sayd_env.runs.context import Progress, silent
from sayd_env.stability import Crossing

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.config.scenario import Scenario

LOWEST, HIGHEST = 100.0 / KMH, 500.0 / KMH
"""Speeds between which the linear critical speed is looked for (m/s)."""
SPEEDS = tuple(np.arange(100.0, 501.0, 20.0) / KMH)
"""Speeds of the root locus (m/s)."""

_SPACING = 10.0 / KMH  # m/s; modes of speeds this near to each other are distinguished by their shapes
SHOWN_MODES = 8
_SHOWN_SPEEDS, _NARROW_SPEEDS = 5, 3
SHOWN_FREQUENCY = 20.0  # Hz; above it stand the modes of wheelsets and track, which do not decide stability


@dataclass(frozen=True)
class ModesResult:
    """Modes over speed; SI units."""

    amplitude: float
    """Amplitude of the harmonic linearisation of the contact, m."""
    locus: RootLocus
    """Modes at speeds near enough to each other to be followed."""
    asked: Integers
    """Indices of the speeds that were asked for."""
    critical_speed: float | None
    """Linear critical speed, m/s; None: there is none in the range."""
    critical_range: tuple[float, float]
    """Range in which it was looked for, m/s."""

    @property
    def crossing(self) -> Crossing:
        """Whether the critical speed lies in the range; below it, `critical_speed` is its end."""
        if self.critical_speed is None:
            return Crossing.NOT_REACHED
        return Crossing.BELOW_GRID if self.critical_speed == self.critical_range[0] else Crossing.FOUND

    def _critical_kmh(self) -> float | None:
        found = self.critical_speed if self.crossing is Crossing.FOUND else None
        return None if found is None else found * KMH

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``."""
        return {
            "amplitude_mm": self.amplitude * 1e3,
            "linear_critical_speed_kmh": self._critical_kmh(),
            "status": self.crossing.value,
            "critical_speed_range_kmh": [speed * KMH for speed in self.critical_range],
            "modes": self._rows(),
        }

    def tables(self) -> dict[str, Table]:
        """Return all modes at the speeds asked for."""
        return {"modes": csv_table([Column(key) for key in _KEYS], self._rows())}

    def plots(self) -> dict[str, Plot]:
        """Return root locus and damping over speed."""
        return {"root_locus": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the least damped modes and the linear critical speed."""
        few = np.unique(np.linspace(0, len(self.asked) - 1, _SHOWN_SPEEDS).round().astype(int))
        speeds = {f"{self.locus.speeds[s] * KMH:.0f}": s for s in self.asked[few]}
        rows: list[dict[str, str | None]] = [
            {"name": self.locus.names[b], **{kmh: self._words(s, b) for kmh, s in speeds.items()}}
            for b in self._least_damped()[:SHOWN_MODES]
        ]
        columns = [
            Column(kmh, f"{kmh} km/h", bad=is_unstable, wide=len(speeds) > _NARROW_SPEEDS and i % 2 == 1)
            for i, kmh in enumerate(speeds)
        ]
        title = f"least damped modes below {SHOWN_FREQUENCY:g} Hz: frequency (Hz), damping ratio"
        Listing(title, [Column("name", "mode"), *columns], rows).print(console, wide)
        low, high = (speed * KMH for speed in self.critical_range)
        critical = self._critical_kmh()
        found = "none" if critical is None else f"{critical:.1f} km/h"
        if self.crossing is Crossing.BELOW_GRID:
            found = f"below {low:.0f} km/h"
        console.print(
            f"linear critical speed at {self.amplitude * 1e3:g} mm: {found} "
            f"({low:.0f} to {high:.0f} km/h searched)"
        )

    def _rows(self) -> list[dict[str, Any]]:
        """Speed (km/h), frequency, damping ratio and name of every mode, in the order of the frequencies."""
        rows = []
        for s in self.asked:
            frequency, damping = self.locus.frequency_hz[s], self.locus.damping_ratio[s]
            for b in np.argsort(frequency)[: np.count_nonzero(np.isfinite(frequency))]:
                speed = float(self.locus.speeds[s] * KMH)
                values = (speed, float(frequency[b]), float(damping[b]), self.locus.names[b])
                rows.append(dict(zip(_KEYS, values, strict=True)))
        return rows

    def _words(self, speed: int, branch: int) -> str | None:
        frequency = self.locus.frequency_hz[speed, branch]
        if not np.isfinite(frequency):
            return None
        return f"{frequency:.2f}  {self.locus.damping_ratio[speed, branch]:+.3f}"

    def _least_damped(self) -> list[int]:
        """Branches below the highest shown frequency, the least damped first."""
        frequency, damping = self.locus.frequency_hz[self.asked], self.locus.damping_ratio[self.asked]
        low = np.where(frequency < SHOWN_FREQUENCY, damping, np.inf)
        least = np.min(low, axis=0, initial=np.inf, where=np.isfinite(low))
        return [int(b) for b in np.argsort(least, kind="stable") if np.isfinite(least[b])]

    def _draw(self, figure: Figure) -> None:
        left, right = panels(figure, 2, 2, (5.5, 4.6))
        speeds = self.locus.speeds * KMH
        values, frequency = self.locus.eigenvalues, self.locus.frequency_hz
        shown = self._least_damped()
        for b in shown:
            left.plot(values[:, b].real, frequency[:, b], color=SHADE, linewidth=0.7, zorder=1)
            dots = left.scatter(
                values[:, b].real, frequency[:, b], c=speeds, s=8, vmin=speeds[0], vmax=speeds[-1], zorder=2
            )
        reference_line(left, 0.0, vertical=True)
        left.set(
            xlabel="real part (1/s)",
            ylabel="frequency (Hz)",
            title=f"root locus, linearised at {self.amplitude * 1e3:g} mm",
            xlim=(-40.0, max(10.0, 1.1 * np.nanmax(values[:, shown].real))),
            ylim=(0.0, SHOWN_FREQUENCY),
        )
        figure.colorbar(dots, ax=left, label="speed (km/h)")
        for i, b in enumerate(shown[:SHOWN_MODES]):
            named = label(self.locus.names[b])
            right.plot(speeds, self.locus.damping_ratio[:, b], label=named, **cycled(i).plain)
        reference_line(right, 0.0)
        critical = self._critical_kmh()
        if critical is not None:
            limit_line(right, critical, "linear critical speed", vertical=True)
        right.set(xlabel="speed (km/h)", ylabel="damping ratio (-)", title="least damped modes")
        legend_below(figure, right)


def is_unstable(words: str | None) -> bool:
    """Whether the printed damping ratio of a mode is negative."""
    return words is not None and "-" in words


_KEYS = ("speed_kmh", "frequency_hz", "damping_ratio", "name")


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
