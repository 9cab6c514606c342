"""How does a yaw damper answer on a test rig? Force over displacement, as in figures 2 and 3 of the paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig
from sayd_env.config.palette import cycled, policy_style
from sayd_env.config.units import Array
from sayd_env.measured.dampers import force_velocity, with_points
from sayd_env.physics.rig import Cycle, steady_cycle, steady_sayd_cycles
from sayd_env.physics.sayd import steady_force
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot, legend_below, limit_line, log_axis, panels
from sayd_env.runs.context import Progress, silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.config.scenario import Scenario

AMPLITUDES = (1e-3, 2e-3, 4e-3)
"""Amplitudes of the paper's figure 3 (m)."""
FREQUENCIES = (1.0, 2.0, 4.0, 6.0, 8.0, 10.0)
"""Frequencies of the paper's figure 3 (Hz)."""

CURRENTS = (0.0, 0.25, 0.5, 1.0)
"""Valve currents of a semi-active damper's loops."""

_FIELD_VELOCITIES = np.linspace(0.0, 0.3, 61)  # m/s, beyond the fastest of the paper's loops
_POINTS = 2000  # time steps in a cycle: the trapezoidal rule is then good to (pi / 1000)^2 / 3
_ACROSS = 4  # panels side by side
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
    force_limit: float
    """Force of the quasi-static force-velocity curve at the cycle's peak velocity, N."""

    @property
    def velocity(self) -> float:
        """Peak velocity of the rig, m/s."""
        return 2.0 * math.pi * self.frequency * self.amplitude

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

    def row(self) -> dict[str, Any]:
        """Values by `COLUMNS`."""
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


COLUMNS = (
    Column("amplitude_mm", "amplitude", "mm"),
    Column("frequency_hz", "frequency", "Hz"),
    Column("current", "current"),
    Column("force_peak_n", "peak force", "kN", _KILO, 2),
    Column("energy_j", "energy", "J", digits=2),
    Column("dynamic_stiffness_n_per_m", "dynamic stiffness", "MN/m", 1e-6, 3),
    Column("storage_stiffness_n_per_m", "storing", "MN/m", 1e-6, 3, wide=True),
    Column("loss_stiffness_n_per_m", "losing", "MN/m", 1e-6, 3, wide=True),
    Column("zero_force_slope_n_per_m", "slope at zero force", "MN/m", 1e-6, 3, wide=True),
    Column("force_limit_n", "limit", "kN", _KILO, 2),
)
"""Of the loops' figures."""


@dataclass(frozen=True)
class Field:
    """Quasi-static force-velocity curves over the valve current."""

    current: tuple[float, ...]
    velocity: Array
    """(v,) m/s."""
    force: Array
    """(currents, v) N."""

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``field``."""
        return {
            "current": list(self.current),
            "velocity_m_per_s": self.velocity.tolist(),
            "force_n": self.force.tolist(),
        }

    def table(self) -> Table:
        """Every point."""
        points = [
            (current, v, f)
            for current, forces in zip(self.current, self.force, strict=True)
            for v, f in zip(self.velocity, forces, strict=True)
        ]
        return ("current", "velocity_m_per_s", "force_n"), points


@dataclass(frozen=True)
class HysteresisResult:
    """All loops of a damper."""

    damper: PassiveDamperConfig | SaydDamperConfig
    loops: tuple[Loop, ...]
    field: Field | None
    """Characteristic field of a semi-active damper."""

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``."""
        field = {} if self.field is None else {"field": self.field.as_dict()}
        return {"damper": self.damper.name, "loops": self._rows(), **field}

    def tables(self) -> dict[str, Table]:
        """Return the figures of the loops, and the loops themselves."""
        every = 10
        samples = [
            (loop.amplitude * _MILLI, loop.frequency, loop.current, x * _MILLI, f)
            for loop in self.loops
            for x, f in zip(loop.cycle.elongation[::every], loop.cycle.force[::every], strict=True)
        ]
        header = ("amplitude_mm", "frequency_hz", "current", "displacement_mm", "force_n")
        return {
            "figures": csv_table(COLUMNS, self._rows()),
            "loops": (header, samples),
            **({} if self.field is None else {"field": self.field.table()}),
        }

    def plots(self) -> dict[str, Plot]:
        """Return the loops (figure 3 of the paper) and the force-velocity curve (figure 2)."""
        return {"loops": self._draw_loops, "curve": self._draw_curve}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the figures of the loops."""
        title = f"damper {self.damper.name}"
        Listing(title, COLUMNS, self._rows(), "amplitude_mm").print(console, wide)

    def _rows(self) -> list[dict[str, Any]]:
        return [loop.row() for loop in self.loops]

    def _draw_loops(self, figure: Figure) -> None:
        """Draw a panel for each amplitude and current, in a grid of the same width for any of them."""
        currents, amplitudes, frequencies = (
            list(dict.fromkeys(getattr(loop, name) for loop in self.loops))
            for name in ("current", "amplitude", "frequency")
        )
        places = list(product(amplitudes, currents))
        across = len(currents) * max(1, _ACROSS // len(currents)) if len(currents) <= _ACROSS else _ACROSS
        axes = panels(figure, len(places), across, (3.6, 3.0), sharey=True)
        for panel, (amplitude, current) in zip(axes, places, strict=True):
            for loop in self.loops:
                if (loop.amplitude, loop.current) == (amplitude, current):
                    x, force = loop.cycle
                    style = cycled(frequencies.index(loop.frequency)).plain
                    panel.plot(x * _MILLI, force * _KILO, label=f"{loop.frequency:g} Hz", **style)
            for knee in self._knees[:, 1]:
                for side in (-knee, knee):
                    limit_line(panel, side * _KILO, "knee of the curve")
            valve = "" if current is None else f", current {current:g}"
            panel.set_title(f"{amplitude * _MILLI:g} mm{valve}", fontsize="small")
        for panel in axes[::across]:
            panel.set_ylabel("force (kN)")
        for panel in axes[-min(across, len(axes)) :]:
            panel.set_xlabel("displacement (mm)")
        legend_below(figure, axes[0], columns=7)

    @property
    def _knees(self) -> Array:
        """Inner points of a passive damper's curve, shape (knees, 2): m/s and N."""
        if isinstance(self.damper, PassiveDamperConfig):
            return force_velocity(self.damper)[1:-1]
        return np.empty((0, 2))

    def _draw_curve(self, figure: Figure) -> None:
        if self.field is None:
            self._draw_passive(figure)
            return
        (axes,) = panels(figure, 1, size=(8.0, 4.5))
        v = np.r_[-self.field.velocity[:0:-1], self.field.velocity]
        for i, (current, force) in enumerate(zip(self.field.current, self.field.force, strict=True)):
            curve = np.r_[-force[:0:-1], force] * _KILO
            axes.plot(v, curve, label=f"current {current:g}", **cycled(i).plain)
        axes.legend()
        axes.set(xlabel="velocity (m/s)", ylabel="force (kN)", title=f"damper {self.damper.name}")

    def _draw_passive(self, figure: Figure) -> None:
        """Draw the curve whole, and from rest on with its knees and what the loops reach of it."""
        assert isinstance(self.damper, PassiveDamperConfig)
        reached = np.array([(loop.amplitude, loop.velocity, loop.force_peak * _KILO) for loop in self.loops])
        points, knees = force_velocity(self.damper), self._knees
        slowest, fastest = (
            0.3 * min(reached[:, 1].min(), points[1, 0]),
            max(reached[:, 1].max(), points[-1, 0]),
        )
        v = np.union1d(np.geomspace(slowest, fastest, 200), knees[:, 0])
        force = np.array([curve_force(self.damper, x) for x in v]) * _KILO
        whole, detail = panels(figure, 2, 2, (5.0, 4.0), width_ratios=(2, 3))
        curve = policy_style("passive").plain
        whole.plot(np.r_[-v[::-1], 0.0, v] * _MILLI, np.r_[-force[::-1], 0.0, force], **curve)
        detail.plot(v * _MILLI, force, label="curve", **curve)
        for i, amplitude in enumerate(np.unique(reached[:, 0])):
            x, y = reached[reached[:, 0] == amplitude, 1:].T
            style = cycled(i).drawn | {"linestyle": "none"}
            detail.plot(x * _MILLI, y, label=f"loops of {amplitude * _MILLI:g} mm", markersize=5, **style)
        for x, y in knees:
            limit_line(
                detail, x * _MILLI, f"knee at {x * _MILLI:.3g} mm/s, {y * _KILO:.3g} kN", vertical=True
            )
        log_axis(detail, "x")
        whole.set(xlabel="velocity (mm/s)", ylabel="force (kN)", title=f"damper {self.damper.name}")
        detail.set(xlabel="velocity (mm/s)", ylabel="force (kN)", title="peaks of the loops")
        legend_below(figure, detail, columns=5)


def hysteresis(
    scenario: Scenario,
    amplitudes: Sequence[float] = AMPLITUDES,
    frequencies: Sequence[float] = FREQUENCIES,
    currents: Sequence[float] | None = None,
    *,
    progress: Progress = silent,
) -> HysteresisResult:
    """Move a scenario's yaw damper sinusoidally on a test rig, the end on the carbody held.

    Parameters
    ----------
    scenario : Scenario
        Its damper is used.
    amplitudes, frequencies : sequence of float
        Grid of amplitudes (m) and frequencies (Hz).
    currents : sequence of float, optional
        Valve currents of a semi-active damper, 0 to 1; `CURRENTS` by default.

    Raises
    ------
    ConfigError
        Currents for a damper without a valve, or outside 0 to 1.
    StudyError
        A force that does not become periodic.
    """
    damper = scenario.damper
    if isinstance(damper, PassiveDamperConfig):
        if currents is not None:
            raise ConfigError(f"damper '{damper.name}' has no valve: currents need a damper of type sayd")
        damper = with_points(damper)
    chosen = CURRENTS if currents is None else tuple(currents)
    for current in chosen:
        if not 0.0 <= current <= 1.0:
            raise ConfigError(f"current {current:g}: expected a number from 0 to 1")
    grid = list(product(amplitudes, frequencies))
    loops: list[Loop] = []
    for done, (amplitude, frequency) in enumerate(grid, start=1):
        loops += _loops(damper, amplitude, frequency, chosen)
        progress(done, len(grid))
    if isinstance(damper, PassiveDamperConfig):
        return HysteresisResult(damper, tuple(loops), None)
    force = steady_force(damper, _FIELD_VELOCITIES, np.array(chosen)[:, None])
    return HysteresisResult(damper, tuple(loops), Field(chosen, _FIELD_VELOCITIES, force))


def _loops(
    damper: PassiveDamperConfig | SaydDamperConfig,
    amplitude: float,
    frequency: float,
    currents: tuple[float, ...],
) -> list[Loop]:
    """A passive damper's loop, or one for each current."""
    velocity = 2.0 * math.pi * frequency * amplitude
    if isinstance(damper, PassiveDamperConfig):
        cycle = steady_cycle(damper, amplitude, frequency, _POINTS)
        return [Loop(amplitude, frequency, None, cycle, curve_force(damper, velocity))]
    cycles = steady_sayd_cycles(damper, amplitude, frequency, currents, _POINTS)
    limits = steady_force(damper, velocity, np.array(currents)).tolist()
    return [Loop(amplitude, frequency, *each) for each in zip(currents, cycles, limits, strict=True)]


def curve_force(damper: PassiveDamperConfig, velocity: float) -> float:
    """Force (N) of the damper's force-velocity curve at a velocity >= 0 (m/s); the last slope goes on."""
    points = force_velocity(damper)
    (v0, f0), (v1, f1) = points[-2:]
    if velocity > v1:
        return float(f1 + (velocity - v1) * (f1 - f0) / (v1 - v0))
    return float(np.interp(velocity, points[:, 0], points[:, 1]))
