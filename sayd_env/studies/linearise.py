"""What is the vehicle as a linear system, at which amplitude? State space, modes, frequency responses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config import ConfigError
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.palette import cycled
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import KMH, ComplexArray
from sayd_env.physics.contact.conicity import AMPLITUDE
from sayd_env.physics.linear import Linearisation, Mode, OperatingPoint, equivalent, modes_of
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.state_space import StateSpace, state_space_of, wheelset_delays
from sayd_env.report.columns import Column, Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot, label, legend_below, log_axis, panels
from sayd_env.runs.context import Progress, silent
from sayd_env.studies.modes import SHOWN_FREQUENCY, SHOWN_MODES, is_unstable

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.config.scenario import Scenario

SHIFT = AMPLITUDE / math.sqrt(2.0)
"""RMS of the wheelsets' shift at the amplitude at which EN 15302 quotes conicities (m)."""
STROKE_SPEED = 10e-3
"""RMS of the dampers' stroke rate (m/s): beyond the knee of published curves at 4 to 10 mm/s."""
FREQUENCIES = np.geomspace(0.3, 30.0, 161)
"""Of the frequency responses (Hz)."""


@dataclass(frozen=True)
class LineariseResult:
    """A vehicle as a linear system; SI units."""

    point: OperatingPoint
    steady: Linearisation
    modes: list[Mode]
    system: StateSpace
    responses: Mapping[str, ComplexArray]
    """(f,) frequency responses at `FREQUENCIES` by their names: what, then of what."""

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``; the matrices are in the files."""
        stroke, sayd = self.steady.stroke, self.steady.sayd
        return {
            "speed_kmh": self.point.speed * KMH,
            "shift_rms_mm": self.point.shift * 1e3,
            "stroke_speed_rms_mm_s": self.point.stroke_speed * 1e3,
            "frequency_hz": None if stroke is None else stroke.frequency,
            "creep_factor": self.steady.creep,
            "damper": None
            if sayd is None
            else {
                "friction_n_s_m": sayd.damping,
                "conductance_m3_s_pa": sayd.conductance,
                "pressure_drop_bar": sayd.drop * 1e-5,
                "force_per_command_n": sayd.force_per_command,
            },
            "modes": json_rows(_MODES, self.modes),
            "states": len(self.system.states),
            "inputs": {name: self.system.units[name] for name in self.system.inputs},
            "outputs": {name: self.system.units[name] for name in self.system.outputs},
        }

    def tables(self) -> dict[str, Table]:
        """Return modes, names with units, and frequency responses."""
        names = [
            {"kind": kind, "number": k, "name": name, "unit": self.system.units[name]}
            for kind, group in (
                ("state", self.system.states),
                ("input", self.system.inputs),
                ("output", self.system.outputs),
            )
            for k, name in enumerate(group)
        ]
        columns = [Column(key) for key in ("response", "frequency_hz", "magnitude", "phase_deg")]
        rows = [
            dict(zip((c.name for c in columns), (name, f, abs(h), np.degrees(np.angle(h))), strict=True))
            for name, values in self.responses.items()
            for f, h in zip(FREQUENCIES, values, strict=True)
        ]
        return {
            "modes": csv_table(_MODES, self.modes),
            "names": csv_table([Column(key) for key in ("kind", "number", "name", "unit")], names),
            "responses": csv_table(columns, rows),
        }

    def plots(self) -> dict[str, Plot]:
        """Return magnitude and phase of the frequency responses."""
        return {"bode": self._draw}

    def files(self) -> dict[str, bytes]:
        """Return the state space for MATLAB and NumPy."""
        return {"state_space.mat": self.system.mat(), "state_space.npz": self.system.npz()}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the operating point, the size of the system and the least damped modes."""
        point, stroke, sayd = self.point, self.steady.stroke, self.steady.sayd
        console.print(
            f"linear system at {point.speed * KMH:g} km/h: {len(self.system.states)} states, "
            f"{len(self.system.inputs)} inputs, {len(self.system.outputs)} outputs",
            highlight=False,
        )
        shifted = (
            f"shift of {point.shift * 1e3:.3g} mm (RMS): creep stiffness x {self.steady.creep:.3f}"
            if point.shift > 0.0
            else "contact: tangent in the centred position"
        )
        moving = "yaw dampers: at rest, tangent"
        if not yaw_group(self.system, "force"):
            moving = "no yaw dampers"
        elif stroke is not None:
            moving = f"yaw dampers: {stroke.speed * 1e3:.3g} mm/s (RMS) at {stroke.frequency:.2f} Hz"
        elif sayd is not None:
            moving = "yaw dampers: at rest, held by friction: a command moves nothing"
        console.print(f"{shifted}; {moving}", highlight=False)
        if sayd is not None and stroke is not None:
            console.print(
                f"pressure drop {sayd.drop * 1e-5:.3g} bar, command: "
                f"{sayd.force_per_command * 1e-3:+.3g} kN per unit of current",
                highlight=False,
            )
        low = [mode for mode in self.modes if mode.frequency_hz < SHOWN_FREQUENCY]
        rows = [
            {
                "name": mode.name,
                "frequency": f"{mode.frequency_hz:.2f}",
                "damping": f"{mode.damping_ratio:+.3f}",
            }
            for mode in sorted(low, key=lambda mode: mode.damping_ratio)[:SHOWN_MODES]
        ]
        columns = [
            Column("name", "mode"),
            Column("frequency", "frequency (Hz)"),
            Column("damping", "damping ratio", bad=is_unstable),
        ]
        title = f"least damped modes below {SHOWN_FREQUENCY:g} Hz"
        Listing(title, columns, rows).print(console, wide)

    def _draw(self, figure: Figure) -> None:
        magnitude, phase = panels(figure, 2, 1, (7.5, 3.2), sharex=True)
        for k, (name, values) in enumerate(self.responses.items()):
            magnitude.plot(FREQUENCIES, np.abs(values), label=label(name), **cycled(k).plain)
            phase.plot(FREQUENCIES, np.degrees(np.unwrap(np.angle(values))), **cycled(k).plain)
        for axes in (magnitude, phase):
            log_axis(axes, "x")
        log_axis(magnitude)
        magnitude.set(ylabel="magnitude (SI units)", title=f"at {self.point.speed * KMH:g} km/h")
        phase.set(xlabel="frequency (Hz)", ylabel="phase (degrees)")
        legend_below(figure, magnitude, columns=1)


_MODES = [Column(name) for name in ("frequency_hz", "damping_ratio", "name")]


def linearise(
    scenario: Scenario,
    speed: float,
    shift: float = SHIFT,
    stroke_speed: float = STROKE_SPEED,
    *,
    current: float | None = None,
    frequency: float | None = None,
    delay_order: int | None = None,
    progress: Progress = silent,
) -> LineariseResult:
    """Linearise a scenario's vehicle.

    Parameters
    ----------
    scenario : Scenario
        The vehicle; its track's irregularities do not matter.
    speed : float
        m/s.
    shift : float
        RMS of the wheelsets' lateral shift, m; 0: the tangent in the centred position.
    stroke_speed : float
        RMS of the yaw dampers' stroke rate, m/s; 0: at rest.
    current : float, optional
        Acting current of semi-active dampers; by default their own before any command.
    frequency : float, optional
        Of the motion, Hz; by default that of the least damped hunting mode.
    delay_order : int, optional
        One track passes under all wheelsets, the delays in Pade approximation of this order; by default each
        wheelset has irregularities of its own.

    Raises
    ------
    ConfigError, DataError
        What is out of range; a current for passive dampers.
    StudyError
        No steady running, no steady cycle of the dampers, or no equivalent that settles.
    """
    if current is not None and isinstance(scenario.damper, PassiveDamperConfig):
        raise ConfigError(f"current: damper '{scenario.damper.name}' has no valve; choose damper sayd")
    model = VehicleModel(scenario)
    point = OperatingPoint(speed, shift, stroke_speed, current, frequency)
    model.step(speed)  # a speed out of range is refused before any work
    progress(0, 2, "equivalent linear vehicle")
    steady = equivalent(model, point)
    progress(1, 2, "frequency responses")
    whole = state_space_of(model, steady)
    system = whole
    if delay_order is not None:
        system = whole.delayed(*wheelset_delays(model, speed), delay_order)
    result = LineariseResult(point, steady, modes_of(model, steady), system, _responses(model, whole, speed))
    progress(2, 2)
    return result


def _responses(model: VehicleModel, system: StateSpace, speed: float) -> dict[str, ComplexArray]:
    """Lateral acceleration of one track's irregularities, and of forces and commands that turn a bogie."""
    out = next(name for name in system.outputs if name.startswith("lateral_acceleration"))
    names, delays = wheelset_delays(model, speed)
    late = np.exp(-2j * np.pi * FREQUENCIES[:, None] * np.array(delays))
    found = {}
    for channel in (CHANNELS[0], CHANNELS[2]):
        each = system.select([f"{channel}.{name}" for name in names], [out]).response(FREQUENCIES)
        found[f"{out} of {channel} ({system.units[f'{channel}.{names[0]}']}), one track"] = np.sum(
            each[:, 0] * late, axis=1
        )
    for kind, scale, unit in (("force", 1e3, "kN"), ("command", 1.0, "-")):
        turning = yaw_group(system, kind)
        if turning:
            first = next(iter(turning))
            bogie = system.combined({first: turning[first]}).select(outputs=[out])
            found[f"{out} of {first} ({unit})"] = scale * bogie.response(FREQUENCIES)[:, 0, 0]
    return found


def yaw_group(system: StateSpace, kind: str) -> dict[str, dict[str, float]]:
    """Groups for `StateSpace.combined`: a bogie's inputs of a kind, left against right."""
    names = [name for name in system.inputs if name.partition(".")[0] == kind]
    bogies = dict.fromkeys(name.split(".")[1] for name in names)
    sides = {"left": 1.0, "right": -1.0}
    return {
        f"{kind}.{bogie}": {name: sides[name.split(".")[2]] for name in names if name.split(".")[1] == bogie}
        for bogie in bogies
    }
