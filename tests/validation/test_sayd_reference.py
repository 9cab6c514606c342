"""The semi-active damper's time steps against a stiff reference integration of the paper's equations.

Nothing of the reference is shared with the simulator but the configuration: eq. (1) to (24) are written out
anew for SciPy's integrators, and the flow through rectifier and throttle, a series of two check valves and an
orifice, is solved in closed form. Asked: 0.5 % of the force's RMS over the whole range of currents, of the
difference of the two histories, which is more than of their RMS values.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

from sayd_env.config.damper import OrificeThrottle, SaydDamperConfig, SpringValve, load_sayd
from sayd_env.physics import sayd
from sayd_env.physics.plant import LANES

Array = npt.NDArray[np.float64]
Motion = Callable[[float], tuple[float, float]]
"""Position and velocity of an end over time."""

# Oil that tears at vapour pressure is a valve without resistance; this one gives 1e-6 m3/s for each Pa.
TEARING = 1e-6


def valve(v: SpringValve, drop: float) -> float:
    """Eq. (22) to (24)."""
    if drop < v.opening:
        return 0.0
    if drop <= v.full:
        q_s = v.nominal_flow * math.sqrt(v.full / v.nominal_drop)
        return q_s * (drop - v.opening) / (v.full - v.opening)
    return v.nominal_flow * math.sqrt(drop / v.nominal_drop)


def series(check: SpringValve, orifice: OrificeThrottle, drop: float, current: float) -> float:
    """Flow through two equal check valves and the orifice at a whole pressure drop >= 0."""
    travel = max(0.0, (current - orifice.overlap) / (1.0 - orifice.overlap))
    area = orifice.closed_area + (orifice.open_area - orifice.closed_area) * travel**orifice.exponent
    square = 0.5 * orifice.density / (orifice.discharge * area) ** 2  # drop = square Q^2
    if drop <= 2.0 * check.opening:
        return 0.0
    q_s = check.nominal_flow * math.sqrt(check.full / check.nominal_drop)
    if drop <= 2.0 * check.full + square * q_s**2:
        linear = 2.0 * (check.full - check.opening) / q_s
        over = drop - 2.0 * check.opening
        return 2.0 * over / (linear + math.sqrt(linear**2 + 4.0 * square * over))
    return math.sqrt(drop / (square + 2.0 * check.nominal_drop / check.nominal_flow**2))


@dataclass(frozen=True)
class Equations:
    """The six states' derivatives: stroke, stroke velocity, rod position, rod velocity, p_A, p_B."""

    damper: SaydDamperConfig
    bogie: Motion
    carbody: Motion

    def forces(self, t: float, y: Array) -> tuple[float, float]:
        """F_1 on the rod and F_2 on the housing (N)."""
        d = self.damper
        (x1, v1), (x2, v2) = self.bogie(t), self.carbody(t)
        f_1 = -(d.bogie_mount.stiffness * (y[2] - x1) + d.bogie_mount.damping * (y[3] - v1))
        f_2 = d.carbody_mount.stiffness * (y[2] - y[0] - x2) + d.carbody_mount.damping * (y[3] - y[1] - v2)
        return f_1, -f_2

    def friction(self, velocity: float) -> float:
        """Eq. (11), regularised as configured."""
        f = self.damper.friction
        level = f.sliding + (f.stiction - f.sliding) / (1.0 + (velocity / (10.0 * f.width)) ** 2)
        return level * velocity / math.hypot(velocity, f.width)

    def tank_flow(self, p: float) -> float:
        """Flow from a chamber to the tank."""
        d = self.damper
        return valve(d.relief, p - d.oil.tank_pressure) - valve(d.suction, d.oil.tank_pressure - p)

    def tearing_flow(self, p: float) -> float:
        """Flow of nothing into a chamber at vapour pressure."""
        return TEARING * max(0.0, self.damper.oil.vapour_pressure - p)

    def through_flow(self, drop: float, current: float) -> float:
        """Flow from A to B through the rectifier."""
        d = self.damper
        assert isinstance(d.throttle, OrificeThrottle)
        return math.copysign(series(d.rectifier, d.throttle, abs(drop), current), drop)

    def rates(self, t: float, y: Array, current: float) -> list[float]:
        """The derivatives."""
        d, c = self.damper, self.damper.cylinder
        stroke, stroke_rate, _, rod_rate, p_a, p_b = y
        f_1, f_2 = self.forces(t, y)
        dead = 0.25 * math.pi * c.bore**2
        volume_a = 0.5 * c.stroke * c.area + c.dead_length_a * dead + c.area * stroke
        volume_b = 0.5 * c.stroke * c.area + c.dead_length_b * dead - c.area * stroke
        through = self.through_flow(p_a - p_b, current)
        q_a = -through - self.tank_flow(p_a) + self.tearing_flow(p_a)
        q_b = through - self.tank_flow(p_b) + self.tearing_flow(p_b)
        friction, pressure = self.friction(stroke_rate), c.area * (p_a - p_b)
        rod = (pressure - friction + f_1) / d.rod_mass
        housing = (-pressure + friction + f_2) / d.housing_mass
        modulus = d.oil.bulk_modulus
        rise_a = modulus / volume_a * (-c.area * stroke_rate + q_a)
        rise_b = modulus / volume_b * (c.area * stroke_rate + q_b)
        return [stroke_rate, rod - housing, rod_rate, rod, rise_a, rise_b]


def integrated(
    equations: Equations, times: Array, command: Array, *, method: str = "LSODA", rtol: float = 1e-7
) -> tuple[Array, Array]:
    """States (t, 6) and acting currents (t,) at evenly spaced times, for commands held from each to the next.

    The valve's delay, lag and rate limit are a seventh equation, integrated from switch to switch.
    """
    d = equations.damper
    dynamics = d.valve
    scale = np.array([1e-6, 1e-5, 1e-6, 1e-5, 1e2, 1e2, 1e-6])
    start = np.array([0.0, 0.0, 0.0, 0.0, d.oil.tank_pressure, d.oil.tank_pressure, command[0]])
    switches = np.flatnonzero(np.diff(command)) + 1
    edges = np.unique(np.r_[times[0], times[switches] + dynamics.delay, times[-1]])
    edges = edges[edges <= times[-1]]
    values = np.empty((len(times), 7))
    values[0] = start

    for a, b in pairwise(edges):
        index = np.searchsorted(times, a - dynamics.delay + 1e-9, side="right") - 1
        target = command[max(index, 0)]

        def rates(t: float, y: Array, target: float = target) -> list[float]:
            rate = float(np.clip((target - y[6]) / dynamics.lag, -dynamics.rate, dynamics.rate))
            return [*equations.rates(t, y[:6], float(np.clip(y[6], 0.0, 1.0))), rate]

        inside = (times > a) & (times <= b + 1e-12)
        at = np.unique(np.r_[np.minimum(times[inside], b), b])
        found = solve_ivp(
            rates, (a, b), start, method=method, t_eval=at, rtol=rtol, atol=scale * rtol * 10, max_step=2e-3
        )
        assert found.success, found.message
        values[inside] = found.y.T[: np.count_nonzero(inside)]
        start = found.y[:, -1]
    return values[:, :6], values[:, 6]


STEP = 5e-4
"""The vehicle's time step, s."""
DURATION = 0.4


def random_motion(seed: int, speed: float) -> Motion:
    """Eight sines of random frequency and phase with about this velocity's RMS, from rest."""
    rng = np.random.default_rng(seed)
    omega, phase = 2.0 * np.pi * rng.uniform(0.5, 25.0, 8), rng.uniform(0.0, 2.0 * np.pi, 8)
    size = speed / omega / 2.0

    def motion(t: float) -> tuple[float, float]:
        x = float(size @ (np.sin(omega * t + phase) - np.sin(phase)))
        v = float((size * omega) @ np.cos(omega * t + phase))
        r = min(t / 0.1, 1.0)
        fade, rate = r * r * (3.0 - 2.0 * r), 60.0 * r * (1.0 - r)
        return fade * x, fade * v + rate * x

    return motion


def simulated(damper: SaydDamperConfig, bogie: Motion, carbody: Motion, command: Array) -> Array:
    """States of the compiled damper at each vehicle step, shape (t, sayd.STATES)."""
    arrays = sayd.sayd_arrays(damper, STEP)
    state, inputs = sayd.rest(damper, command[0]), np.zeros(sayd.INPUTS * LANES)
    line = np.full(sayd.line_length(damper, STEP) * LANES, command[0])
    rows, ends = state.reshape(-1, LANES), inputs.reshape(-1, LANES)
    history = [rows[:, 0].copy()]
    for n in range(1, len(command)):
        ends[sayd.OLD_RATE_1], ends[sayd.OLD_RATE_2] = ends[sayd.RATE_1], ends[sayd.RATE_2]
        ends[sayd.END_1], ends[sayd.RATE_1] = bogie(n * STEP)
        ends[sayd.END_2], ends[sayd.RATE_2] = carbody(n * STEP)
        rows[sayd.COMMAND] = command[n - 1]
        sayd.move_valves(arrays.constant, line, inputs, state)
        sayd.integrate(STEP, arrays.substeps, arrays.constant, arrays.table, inputs, state)
        history.append(rows[:, 0].copy())
    return np.array(history)


def commands(kind: str | float, count: int) -> Array:
    """A constant current, or switching from closed to open and back after so many ms."""
    if isinstance(kind, float):
        return np.full(count, kind)
    return (np.arange(count) * STEP // (float(kind) * 1e-3) % 2.0).astype(float)


def errors(speed: float, kind: str | float, seed: int) -> tuple[Array, float]:
    """RMS of the difference over the RMS of F_1 and F_2, and the largest error of the acting current."""
    damper = load_sayd("sayd")
    times = STEP * np.arange(round(DURATION / STEP) + 1)
    command = commands(kind, len(times))
    bogie, carbody = random_motion(seed, speed), random_motion(seed + 100, 0.3 * speed)
    equations = Equations(damper, bogie, carbody)
    states, current = integrated(equations, times, command)
    force = np.array([equations.forces(t, y) for t, y in zip(times, states, strict=True)])
    found = simulated(damper, bogie, carbody, command)
    difference = found[:, [sayd.FORCE_1, sayd.FORCE_2]] - force
    error = np.sqrt(np.mean(difference**2, axis=0) / np.mean(force**2, axis=0))
    return error, float(np.max(np.abs(found[:, sayd.CURRENT] - current)))


@pytest.mark.parametrize(
    ("speed", "kind", "seed"),
    [
        (0.02, 0.0, 3),
        (0.02, 0.25, 2),
        (0.02, 1.0, 1),
        (0.1, 0.0, 4),
        (0.1, 0.05, 5),
        (0.1, 0.5, 6),
        (0.1, 1.0, 7),
        (0.02, "20", 8),
        (0.1, "20", 9),
        (0.1, "60", 10),
    ],
)
def test_force_is_that_of_a_stiff_reference(speed: float, kind: str | float, seed: int) -> None:
    error, current = errors(speed, kind, seed)
    assert np.all(error < 5e-3)
    assert current < 1e-3


def test_the_reference_does_not_depend_on_its_integrator() -> None:
    """Radau (Runge-Kutta) and LSODA (multistep), at different tolerances, agree to 0.01 % of the RMS."""
    equations = Equations(load_sayd("sayd"), random_motion(4, 0.1), random_motion(104, 0.03))
    times = STEP * np.arange(301)
    command = commands("60", len(times))
    one, _ = integrated(equations, times, command)
    two, _ = integrated(equations, times, command, method="Radau", rtol=1e-6)
    f, g = (np.array([equations.forces(t, y)[0] for t, y in zip(times, s, strict=True)]) for s in (one, two))
    assert np.sqrt(np.mean((f - g) ** 2)) < 1e-4 * np.sqrt(np.mean(f**2))
