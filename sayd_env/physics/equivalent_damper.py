"""Yaw dampers as linear elements at a given RMS of their stroke speed: equivalent (harmonic) linearisation.

At rest a semi-active damper has no linear part that would say anything: its friction holds the piston, and a
command moves nothing. In motion each of its non-linear elements answers a sine of stroke speed with a force
or flow whose fundamental is a gain times that of its input (describing function; Gelb and Vander Velde,
Multiple-Input Describing Functions and Nonlinear System Design, 1968, chapter 2). The inputs are those of the
compiled damper itself, in a steady cycle on the test rig whose amplitude gives the stated stroke speed: not
assumed sines, so that a low chamber that stands at the tank's pressure for half of the cycle counts. With X_1
for the fundamental of x, w the stroke rate, d = p_A - p_B and K the command's gain,

    C_A p_A' = -A w - N_q d - K r - N_A p_A        N_f = Re(F_1 / W_1)          friction
    C_B p_B' =  A w + N_q d + K r - N_B p_B        N_q = Re(Q_1 / D_1)          rectifier and throttle
    N_A + i omega C_A = -(A W_1 + N_q D_1) / P_A1  relief, suction valve, bleed, oil; N_B, C_B likewise

while masses and mounts are linear already; p_A, p_B are departures from their means. With sliding friction
alone and a sine N_f is 4 F_S / (pi w^); C_A is V_A0 / E unless valves to the tank open. So the pressures'
fundamentals are those of the cycle; left out is what friction that holds for a part of the cycle adds as a
stiffness, since it restrains no slow motion (1 % of the damper's at 5 mm/s, 10 % at 1 mm/s).

A valve that opens changes a gain, not a force: the model is bilinear, and by symmetry a constant change of
the command moves nothing on the mean. What is linear is the force that comes and goes with the damper's own:
the input is r = (i - i_0) d / d^, the change of the acting current times the pressure drop over its
amplitude d^. A change of the current that stays, seen at the fundamental, is r = (i - i_0) cos(omega t). K is
such that at the stated stroke speed a unit of r changes the pressure drop by the derivative of its
fundamental over the current.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.damper import SaydDamperConfig, TableThrottle
from sayd_env.config.units import Array
from sayd_env.physics import sayd
from sayd_env.physics.rig import steady_sayd_states
from sayd_env.physics.throttle import series_table

SHIFTS = ("x_1", "v_1", "x_2", "v_2")
"""Motion of the ends that drives a damper: bogie and carbody, displacement (m) and velocity (m/s)."""

STATES = ("stroke", "stroke_rate", "rod", "rod_rate", "pressure_a", "pressure_b")
"""States of a damper that moves, as departures from rest and from the mean pressures."""
LOCKED = ("rod", "rod_rate")
"""States of one whose friction holds."""
STATE_UNITS = {
    "stroke": "m",
    "stroke_rate": "m/s",
    "rod": "m",
    "rod_rate": "m/s",
    "pressure_a": "Pa",
    "pressure_b": "Pa",
}

_POINTS = 500  # steps of a cycle on the rig
_CURRENT_STEP = 0.01  # of the derivative over the current
_ELONGATION_STEP = 0.01  # of the derivative over the elongation
_ELONGATION_TOLERANCE = 1e-4
_FOUND = 0.02  # by how much the cycle's stroke speed may differ from the stated one
_CIRCLE = (np.arange(720) + 0.5) * (2.0 * np.pi / 720)


@dataclass(frozen=True)
class Stroke:
    """How yaw dampers move where they are linearised."""

    speed: float
    """RMS of the stroke rate's sine (its fundamental), m/s; of a passive damper that of its viscous part."""
    frequency: float
    """Of the sine, Hz."""
    current: float | None = None
    """Acting current of semi-active dampers, 0 to 1; None: their own before any command."""


@dataclass(frozen=True)
class EquivalentSayd:
    """A semi-active damper as a linear system: z' = a z + b e + r command, (F_1, F_2) = c z + d e.

    e is the motion of the ends in the order of `SHIFTS`; F_1 and F_2 are tensions as in
    `sayd_env.physics.sayd` (N).
    """

    states: tuple[str, ...]
    """Names of the states z: `STATES` or `LOCKED`."""
    a: Array
    b: Array
    command: Array
    """(z,) what a unit of r does to z'; zeros if the friction holds."""
    c: Array
    d: Array
    damping: float
    """N_f, friction over stroke rate, N s/m; infinite if it holds."""
    conductance: float
    """N_q, flow through rectifier and throttle over pressure drop, m3/(s Pa)."""
    to_tank: tuple[float, float]
    """N_A and N_B, m3/(s Pa)."""
    mean_pressure: tuple[float, float]
    """Mean of p_A and p_B over the cycle, Pa."""
    drop: float
    """d^, amplitude of the pressure drop's fundamental, Pa."""
    force_per_command: float
    """Derivative of the hydraulic force's fundamental over the current at the stated stroke speed, N."""


def equivalent_slope(curve: Array, speed: float) -> float:
    """Describing function of an odd piecewise-linear damper: force's fundamental over that of a sine.

    Parameters
    ----------
    curve : ndarray, shape (k, 2)
        Velocities from 0 (m/s) and forces (N); the last segment goes on.
    speed : float
        RMS of the velocity, m/s; 0: the first segment.

    Returns
    -------
    float
        N s/m.
    """
    first = (curve[1] - curve[0])[1] / (curve[1] - curve[0])[0]
    if speed == 0.0:
        return float(first)
    amplitude, last = math.sqrt(2.0) * speed, curve[-1] - curve[-2]
    sine = np.abs(np.sin(_CIRCLE))
    beyond = np.maximum(amplitude * sine - curve[-1, 0], 0.0) * last[1] / last[0]
    force = np.interp(amplitude * sine, curve[:, 0], curve[:, 1]) + beyond
    return float(2.0 * np.mean(force * sine) / amplitude)


def equivalent_sayd(config: SaydDamperConfig, stroke: Stroke | None) -> EquivalentSayd:
    """Linearise a semi-active damper.

    Parameters
    ----------
    config : SaydDamperConfig
        The damper.
    stroke : Stroke or None
        How it moves; None: not at all, so that its friction holds the piston and its mounts remain.

    Raises
    ------
    ConfigError
        A stroke speed that the damper's stroke does not allow at this frequency.
    StudyError
        The rig found no steady cycle, or none with this stroke speed.
    DataError
        A throttle table that cannot be used.
    """
    measured = isinstance(config.throttle, TableThrottle)  # its file may change
    return _linearised(config, stroke) if measured else _kept(config, stroke)


def _linearised(config: SaydDamperConfig, stroke: Stroke | None) -> EquivalentSayd:
    if stroke is None:
        return _locked(config)
    current = config.current if stroke.current is None else stroke.current
    currents = [max(0.0, current - _CURRENT_STEP), current, min(1.0, current + _CURRENT_STEP)]
    elongation = _elongation(config, stroke, current)
    cycles = [
        steady_sayd_states(config, size * elongation, stroke.frequency, currents, _POINTS)
        for size in (1.0, 1.0 + _ELONGATION_STEP)
    ]
    (low, found, high), (_, longer, _) = (
        [_Fundamentals.of(config, cycle[:, :, k], i, stroke.frequency) for k, i in enumerate(currents)]
        for cycle in cycles
    )
    if abs(found.speed / (math.sqrt(2.0) * stroke.speed) - 1.0) > _FOUND:
        raise StudyError(
            f"damper '{config.name}': found no steady cycle with a stroke speed of "
            f"{stroke.speed * 1e3:.3g} mm/s (RMS) at {stroke.frequency:g} Hz: friction holds it, or it "
            "breaks away to more; take a larger one"
        )
    # Over the current at a stroke rate of one size: what it changes at one elongation, less what that does.
    slower = (high.speed - low.speed) / (longer.speed - found.speed)
    change = (high.turned - low.turned - slower * (longer.turned - found.turned)) / (
        currents[2] - currents[0]
    )
    unit = found.turned / abs(found.turned)
    mean = cycles[0][:, :, 1].mean(axis=0)
    return _moving(
        config,
        _Gains.of(config.cylinder.area, found, change),
        mean=(float(mean[sayd.PRESSURE_A]), float(mean[sayd.PRESSURE_B])),
        drop=abs(found.drop),
        force=config.cylinder.area * float((change / unit).real),
    )


_kept = lru_cache(maxsize=64)(_linearised)


@dataclass(frozen=True)
class _Fundamentals:
    """Complex amplitudes of a steady cycle: x(t) = Re(X e^(i omega t))."""

    omega: float
    rate: complex
    friction: complex
    drop: complex
    through: complex
    pressure_a: complex
    pressure_b: complex

    @property
    def speed(self) -> float:
        """Amplitude of the stroke rate."""
        return abs(self.rate)

    @property
    def turned(self) -> complex:
        """The pressure drop, its phase counted from the stroke rate's."""
        return self.drop * self.speed / self.rate

    @classmethod
    def of(cls, config: SaydDamperConfig, cycle: Array, current: float, frequency: float) -> _Fundamentals:
        omega, of = 2.0 * math.pi * frequency, fundamental
        p_a, p_b = cycle[:, sayd.PRESSURE_A], cycle[:, sayd.PRESSURE_B]
        table = series_table(config.throttle, config.rectifier).ravel()
        # Friction is what the rod's other forces leave, also while it holds.
        inertia = 1j * omega * config.rod_mass * of(cycle[:, sayd.ROD_RATE])
        pushed = of(config.cylinder.area * (p_a - p_b) + cycle[:, sayd.FORCE_1])
        return cls(
            omega=omega,
            rate=of(cycle[:, sayd.STROKE_RATE]),
            friction=pushed - inertia,
            drop=of(p_a - p_b),
            through=of(sayd.rectified_flow(config, table, p_a - p_b, current)),
            pressure_a=of(p_a),
            pressure_b=of(p_b),
        )


@dataclass(frozen=True)
class _Gains:
    """Equivalent linear numbers of a cycle."""

    friction: float
    conductance: float
    to_tank: tuple[float, float]
    capacity: tuple[float, float]
    command: float

    @classmethod
    def of(cls, area: float, found: _Fundamentals, change: complex) -> _Gains:
        """Take them from fundamentals and the change of `turned` with the current at one stroke speed."""
        through = (found.through / found.drop).real
        # What a chamber gives off over its own pressure: through the throttle, to the tank, into its oil.
        whole = (
            -(area * found.rate + through * found.drop) / found.pressure_a,
            (area * found.rate + through * found.drop) / found.pressure_b,
        )
        between = through + 0.25 * sum(whole)
        return cls(
            friction=(found.friction / found.rate).real,
            conductance=through,
            to_tank=(whole[0].real, whole[1].real),
            capacity=(whole[0].imag / found.omega, whole[1].imag / found.omega),
            command=float((-between * change * abs(found.turned) / found.turned).real),
        )


def fundamental(values: Array) -> complex:
    """Complex amplitude X of a cycle's values Re(X e^(i 2 pi k / n)) + ... at k = 1, ..., n."""
    n = len(values)
    return complex(2.0 / n * np.exp(-2j * np.pi * np.arange(1, n + 1) / n) @ values)


def _elongation(config: SaydDamperConfig, stroke: Stroke, current: float) -> float:
    """Amplitude of the elongation on the rig that gives the stated stroke speed, m."""

    def excess(elongation: float) -> float:
        states = steady_sayd_states(config, elongation, stroke.frequency, [current], _POINTS)
        rate = fundamental(states[:, sayd.STROKE_RATE, 0])
        return abs(rate) / (math.sqrt(2.0) * stroke.speed) - 1.0

    amplitude = math.sqrt(2.0) * stroke.speed / (2.0 * math.pi * stroke.frequency)
    if amplitude > 0.5 * config.cylinder.stroke:
        raise ConfigError(
            f"stroke speed of {stroke.speed * 1e3:g} mm/s (RMS) at {stroke.frequency:g} Hz: found an "
            f"amplitude of {amplitude * 1e3:.3g} mm, damper '{config.name}' has "
            f"{config.cylinder.stroke * 500.0:g} mm"
        )
    # The elongation is that of the stroke and what mounts and oil give.
    low = high = amplitude
    while excess(low) > 0.0:
        low = 0.5 * low
    while excess(high) < 0.0:
        low, high = high, 2.0 * high
    return float(brentq(excess, low, high, rtol=_ELONGATION_TOLERANCE)) if low < high else high


def _mounted(
    config: SaydDamperConfig, rod: Array, rate: Array, housing: Array, its_rate: Array
) -> tuple[Array, Array]:
    """F_1 and F_2 over the states and over the ends' motion; the arguments pick x_1, v_1, x_2, v_2."""
    one, two = config.bogie_mount, config.carbody_mount
    c = -np.array(
        [one.stiffness * rod + one.damping * rate, two.stiffness * housing + two.damping * its_rate]
    )
    d = np.array([[one.stiffness, one.damping, 0.0, 0.0], [0.0, 0.0, two.stiffness, two.damping]])
    return c, d


def _locked(config: SaydDamperConfig) -> EquivalentSayd:
    rod, rate = np.eye(2)
    c, d = _mounted(config, rod, rate, rod, rate)
    mass = config.rod_mass + config.housing_mass
    tank = config.oil.tank_pressure
    return EquivalentSayd(
        states=LOCKED,
        a=np.array([rate, np.sum(c, axis=0) / mass]),
        b=np.array([np.zeros(len(SHIFTS)), np.sum(d, axis=0) / mass]),
        command=np.zeros(2),
        c=c,
        d=d,
        damping=math.inf,
        conductance=0.0,
        to_tank=(0.0, 0.0),
        mean_pressure=(tank, tank),
        drop=0.0,
        force_per_command=0.0,
    )


def _moving(
    config: SaydDamperConfig, gains: _Gains, *, mean: tuple[float, float], drop: float, force: float
) -> EquivalentSayd:
    stroke, rate, rod, rod_rate, p_a, p_b = np.eye(len(STATES))
    c, d = _mounted(config, rod, rod_rate, rod - stroke, rod_rate - rate)
    area, (cap_a, cap_b) = config.cylinder.area, gains.capacity
    inner = area * (p_a - p_b) - gains.friction * rate  # on the rod; the housing gets its opposite
    rod_acceleration = (inner + c[0]) / config.rod_mass
    housing_acceleration = (-inner + c[1]) / config.housing_mass
    flow = area * rate + gains.conductance * (p_a - p_b)
    a = np.array(
        [
            rate,
            rod_acceleration - housing_acceleration,
            rod_rate,
            rod_acceleration,
            (-flow - gains.to_tank[0] * p_a) / cap_a,
            (flow - gains.to_tank[1] * p_b) / cap_b,
        ]
    )
    b = np.zeros((len(STATES), len(SHIFTS)))
    b[1], b[3] = d[0] / config.rod_mass - d[1] / config.housing_mass, d[0] / config.rod_mass
    return EquivalentSayd(
        states=STATES,
        a=a,
        b=b,
        command=gains.command * (p_b / cap_b - p_a / cap_a),
        c=c,
        d=d,
        damping=gains.friction,
        conductance=gains.conductance,
        to_tank=gains.to_tank,
        mean_pressure=mean,
        drop=drop,
        force_per_command=force,
    )
