"""How does a yaw damper answer on a test rig? Force over displacement, as in figures 2 and 3 of the paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.physics.rig import Cycle, steady_cycle
from sayd_env.studies.output import Progress, silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.config.scenario import Scenario
    from sayd_env.studies.output import Plot, Table

Array = npt.NDArray[np.float64]

AMPLITUDES = (1e-3, 2e-3, 4e-3)
"""Amplitudes of the paper's figure 3 (m)."""
FREQUENCIES = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0)
"""Frequencies of the paper's figure 3 (Hz)."""

_POINTS = 2000  # time steps in a cycle: the trapezoidal rule is then good to (pi / 1000)^2 / 3
_KILO, _MILLI = 1e-3, 1e3


@dataclass(frozen=True)
class Loop:
    """One steady cycle on the rig; SI units."""

    amplitude: float
    """m."""
    frequency: float
    """Hz."""
    current: float | None
    """Valve current, 0 to 1; None for a passive damper."""
    cycle: Cycle
    force_limit: float | None
    """Force of the force-velocity curve at the cycle's peak velocity (N), where there is such a curve."""

    @property
    def force_peak(self) -> float:
        """Largest absolute force, N."""
        return float(np.max(np.abs(self.cycle.force)))

    @property
    def energy(self) -> float:
        """Energy dissipated in the cycle, the loop's area, J."""
        return float(np.trapezoid(self.cycle.force, self.cycle.elongation))

    @property
    def stiffness(self) -> complex:
        """First harmonic of the force over that of the displacement, N/m: its real part stores."""
        phase = np.exp(-2j * np.pi * np.arange(1, len(self.cycle.force)) / (len(self.cycle.force) - 1))
        return complex((self.cycle.force[1:] @ phase) / (self.cycle.elongation[1:] @ phase))

    @property
    def zero_force_slope(self) -> float:
        """Slope dF/dx where the force passes through zero, N/m: there the spring alone moves."""
        elongation, force = self.cycle
        i = int(np.flatnonzero(force[:-1] * force[1:] <= 0.0)[0])
        return float((force[i + 1] - force[i]) / (elongation[i + 1] - elongation[i]))

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of one of ``loops``."""
        return {
            "amplitude_mm": self.amplitude * _MILLI,
            "frequency_hz": self.frequency,
            "current": self.current,
            "force_peak_n": self.force_peak,
            "energy_j": self.energy,
            "dynamic_stiffness_n_per_m": abs(self.stiffness),
            "storage_stiffness_n_per_m": self.stiffness.real,
            "loss_stiffness_n_per_m": self.stiffness.imag,
            "zero_force_slope_n_per_m": self.zero_force_slope,
            "force_limit_n": self.force_limit,
        }


@dataclass(frozen=True)
class HysteresisResult:
    """All loops of a damper."""

    damper: PassiveDamperConfig
    loops: tuple[Loop, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``."""
        return {"damper": self.damper.name, "loops": [loop.as_dict() for loop in self.loops]}

    def tables(self) -> dict[str, Table]:
        """Return the figures of the loops, and the loops themselves."""
        rows = [loop.as_dict() for loop in self.loops]
        every = 10
        samples = [
            (loop.amplitude * _MILLI, loop.frequency, loop.current, x * _MILLI, f)
            for loop in self.loops
            for x, f in zip(loop.cycle.elongation[::every], loop.cycle.force[::every], strict=True)
        ]
        header = ("amplitude_mm", "frequency_hz", "current", "displacement_mm", "force_n")
        return {"figures": (list(rows[0]), [list(row.values()) for row in rows]), "loops": (header, samples)}

    def plots(self) -> dict[str, Plot]:
        """Return the loops (figure 3 of the paper) and the force-velocity curve (figure 2)."""
        return {"loops": self._draw_loops, "curve": self._draw_curve}

    def summary(self, console: Console) -> None:
        """Print the figures of the loops."""
        from rich.table import Table as RichTable  # noqa: PLC0415 - only who prints pays for it

        grid = RichTable(title=f"damper {self.damper.name}")
        for heading in (
            "amplitude (mm)",
            "frequency (Hz)",
            "current",
            "peak force (kN)",
            "limit (kN)",
            "energy (J)",
            "dynamic stiffness (MN/m)",
        ):
            grid.add_column(heading, justify="right")
        for loop in self.loops:
            grid.add_row(
                f"{loop.amplitude * _MILLI:g}",
                f"{loop.frequency:g}",
                "-" if loop.current is None else f"{loop.current:g}",
                f"{loop.force_peak * _KILO:.2f}",
                "-" if loop.force_limit is None else f"{loop.force_limit * _KILO:.2f}",
                f"{loop.energy:.2f}",
                f"{abs(loop.stiffness) * 1e-6:.3f}",
            )
        console.print(grid)

    def _draw_loops(self, figure: Figure) -> None:
        panels = list(dict.fromkeys((loop.amplitude, loop.current) for loop in self.loops))
        figure.set_size_inches(7.0, 0.6 + 2.8 * len(panels))
        axes = figure.subplots(len(panels), 1, sharey=True, squeeze=False)[:, 0]
        for axis, (amplitude, current) in zip(axes, panels, strict=True):
            for loop in self.loops:
                if (loop.amplitude, loop.current) == (amplitude, current):
                    x, force = loop.cycle
                    axis.plot(x * _MILLI, force * _KILO, linewidth=1.0, label=f"{loop.frequency:g} Hz")
            valve = "" if current is None else f", current {current:g}"
            axis.set_title(f"{amplitude * _MILLI:g} mm{valve}", fontsize="small")
            axis.set_ylabel("force (kN)")
            axis.grid(visible=True)
        axes[-1].set_xlabel("displacement (mm)")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper")

    def _draw_curve(self, figure: Figure) -> None:
        axes = figure.subplots()
        right = np.array(self.damper.curve)
        both = np.vstack([-right[:0:-1], right])
        axes.plot(both[:, 0], both[:, 1] * _KILO, marker="o", markersize=3)
        axes.set(xlabel="velocity (m/s)", ylabel="force (kN)", title=f"damper {self.damper.name}")
        axes.grid(visible=True)


def hysteresis(
    scenario: Scenario,
    amplitudes: Sequence[float] = AMPLITUDES,
    frequencies: Sequence[float] = FREQUENCIES,
    *,
    progress: Progress = silent,
) -> HysteresisResult:
    """Move a scenario's yaw damper sinusoidally on a test rig, one end held.

    Parameters
    ----------
    scenario : Scenario
        Its damper is used.
    amplitudes, frequencies : sequence of float
        Grid of amplitudes (m) and frequencies (Hz).
    progress : Progress
        Told after each loop.

    Raises
    ------
    StudyError
        A force that does not become periodic.
    """
    damper = scenario.damper
    grid = [(amplitude, frequency) for amplitude in amplitudes for frequency in frequencies]
    loops = []
    for amplitude, frequency in grid:
        cycle = steady_cycle(damper, amplitude, frequency, _POINTS)
        limit = curve_force(damper, 2.0 * math.pi * frequency * amplitude)
        loops.append(Loop(amplitude, frequency, None, cycle, limit))
        progress(len(loops), len(grid))
    return HysteresisResult(damper, tuple(loops))


def curve_force(damper: PassiveDamperConfig, velocity: float) -> float:
    """Force (N) of the damper's force-velocity curve at a velocity >= 0 (m/s); the last slope goes on."""
    points = np.array(damper.curve)
    (v0, f0), (v1, f1) = points[-2:]
    if velocity > v1:
        return float(f1 + (velocity - v1) * (f1 - f0) / (v1 - v0))
    return float(np.interp(velocity, points[:, 0], points[:, 1]))
