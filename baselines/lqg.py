"""LQG on the linearised vehicle, clipped to what semi-active dampers can do ("clipped optimal control").

1. The vehicle with closed dampers is linearised at each of a few speeds and reduced, see `lqg_design`.
2. At each of them a Kalman filter estimates its motion from accelerometers, strokes and the forces that the
   dampers' pressures show, and a regulator of least J of eq. (27) wants a force of each bogie's dampers.
3. Wanted forces and estimated stroke rates are blended between the speeds.
4. A damper cannot push: the inverse of its characteristic gives the current, as far as there is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm, solve_continuous_lyapunov, solve_discrete_are

from sayd_env.baselines.inverse_damper import InverseDamper
from sayd_env.baselines.lqg_design import READ, ReducedPlant, reduced_plants
from sayd_env.baselines.policy import BogiePolicy, of_all_dampers, semi_active, yaw_part
from sayd_env.config import ConfigError
from sayd_env.config.control import LqgConfig
from sayd_env.config.units import KMH, Array
from sayd_env.envs.interface import BOGIES, POINTS, Interface

ACCELERATIONS = tuple(f"lateral_acceleration.{bogie}.{point}" for bogie in BOGIES for point in POINTS)
QUANTITIES = ("stroke", "pressure_a", "pressure_b")
REST = 2.0
"""Time in which the strokes' mean is forgotten, s: where the pistons stand is no motion."""
_REGULAR = 1e-12
"""Weight of a state of order 1 in the regulator's cost: keeps the Riccati equation regular."""


@dataclass(frozen=True)
class Design:
    """Regulator and observer of one speed, of n states; forces are those of both bogies' dampers, in N."""

    bare: Array
    """(n, n) transition of the vehicle without dampers over a control period."""
    measured: Array
    """(n, 2) what forces of the dampers do in it."""
    read: Array
    """(6, n) what the sensors read of a state."""
    direct: Array
    """(6, 2) what they read of the forces."""
    observe: Array
    """(n, 6) gain of the observer."""
    ahead: Array
    """(n, n) transition with closed dampers, and with `added` forces beside theirs."""
    added: Array
    """(n, 2)."""
    damper: Array
    """(2, n) force of the closed dampers."""
    regulate: Array
    """(2, n + 2) gain of the regulator, on the state and the force added in this period."""
    rate: Array
    """(2, n) stroke rates, m/s."""


def designed(
    plant: ReducedPlant, period: float, parameters: LqgConfig, limits: tuple[float, float]
) -> Design:
    """Regulator and observer for a plant.

    Parameters
    ----------
    plant : ReducedPlant
    period : float
        Control period, s; a command acts from the next one on.
    parameters : LqgConfig
        Weights, and the sensors' noise.
    limits : tuple of float
        y_lim (m/s2) and F_max (N) of eq. (27).
    """
    a, force, noise, c, d = plant.a, plant.force, plant.noise, plant.c, plant.d
    n = len(a)
    step, entry = sampled(a, force, period)
    # x, and the forces that are on their way.
    late = np.block([[step, entry], [np.zeros((2, n + 2))]])
    into = np.vstack([np.zeros((n, 2)), np.eye(2)])
    weights = [0.25 / limits[0] ** 2] * 4 + [0.5 * parameters.force_weight / limits[1] ** 2] * 2
    seen = np.vstack([np.hstack([c[:4], d[:4]]), np.hstack([c[READ:], np.eye(2)])])
    cost = seen.T @ np.diag(weights) @ seen + np.diag([_REGULAR] * n + [0.0] * 2)
    penalty = parameters.force_penalty / limits[1] ** 2 * np.eye(2)
    s = solve_discrete_are(late, into, 0.5 * (cost + cost.T), penalty)
    gain = np.linalg.solve(penalty + into.T @ s @ into, into.T @ s @ late)
    # The observer sees what the dampers do: for it the vehicle has none, and their forces act on it.
    bare, read = a - force @ c[READ:], c[:READ] - d[:READ] @ c[READ:]
    without, measured = sampled(bare, force, period)
    errors = np.diag((parameters.noise * spread(a, noise, c[:READ])) ** 2)
    drift = noise_over(bare, noise, period)
    p = solve_discrete_are(without.T, read.T, 0.5 * (drift + drift.T), errors)
    observe = p @ read.T @ np.linalg.inv(read @ p @ read.T + errors)
    rate = c[4:READ] @ a
    return Design(without, measured, read, d[:READ], observe, step, entry, c[READ:], gain, rate)


def sampled(a: Array, b: Array, period: float) -> tuple[Array, Array]:
    """A and B for inputs that hold over a period (s)."""
    n, m = b.shape
    step = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * period)
    return np.asarray(step[:n, :n]), np.asarray(step[:n, n:])


def noise_over(a: Array, noise: Array, period: float) -> Array:
    """Covariance that white noise leaves in the states after a period (s): Van Loan (1978)."""
    n = len(a)
    step = expm(np.block([[-a, noise @ noise.T], [np.zeros((n, n)), a.T]]) * period)
    return np.asarray(step[n:, n:].T @ step[:n, n:])


def spread(a: Array, noise: Array, c: Array) -> Array:
    """RMS of outputs under white noise."""
    return np.sqrt(np.diag(c @ solve_continuous_lyapunov(a, -noise @ noise.T) @ c.T))


@dataclass
class Estimate:
    """State of n vehicles' controllers."""

    states: list[Array]
    """For each speed of the designs: (n, states)."""
    rest: Array
    """(n, 2) mean yaw strokes of front and rear, m."""


class Lqg(BogiePolicy[LqgConfig, Estimate]):
    """LQG on the linearised vehicle, clipped to what the dampers can do.

    =================  =====  ==========================================================================
    parameter          unit   meaning
    =================  =====  ==========================================================================
    ``study``          -      vehicle that is linearised, with the environment's dampers
    ``speeds_kmh``     km/h   rising speeds of the designs
    ``stroke_speed``   m/s    RMS of the stroke rate at which the dampers are linearised
    ``shifts``         m      RMS of the wheelsets' shift for the contact: the first with a stable vehicle
    ``corner``         Hz     from which the irregularities' density falls with f^2
    ``states``         -      states of the reduced vehicle
    ``force_weight``   -      k_F of the cost that the regulator minimises, at k_y = 1
    ``force_penalty``  -      weight of the force added to a closed damper's, over F_max
    ``noise``          -      errors of the sensors, over the RMS of what they read
    ``widest``         -      largest command: a valve on its way from further open is late
    =================  =====  ==========================================================================

    Sensors: ``lateral_acceleration``, and of all dampers ``stroke``, ``pressure_a``, ``pressure_b``, the
    train's ``speed``. Valves: ``bogie`` or ``damper``. The dampers must be semi-active.

    References
    ----------
    Dyke, Spencer, Sain and Carlson, Smart Materials and Structures 5, 565-575 (1996): clipped optimal
    control.
    """

    def __init__(self, name: str, interface: Interface, parameters: LqgConfig) -> None:
        damper = semi_active(name, interface)
        dampers = tuple(signal for quantity in QUANTITIES for signal in of_all_dampers(quantity))
        super().__init__(name, interface, parameters, ("speed", *ACCELERATIONS, *dampers))
        period, limits = interface.control_period, (interface.acceleration_limit, interface.force_reference)
        plants = reduced_plants(parameters, damper)
        try:
            self.designs = [designed(plant, period, parameters, limits) for plant in plants]
        except np.linalg.LinAlgError:
            raise ConfigError(
                f"{name}: no regulator is found for {parameters.states} states (states) and a control period "
                f"of {period:g} s (control_period); it takes fewer states or a shorter period"
            ) from None
        self._area, self._sliding = damper.cylinder.area, damper.friction.sliding
        cylinder = damper.cylinder
        dead = math.pi / 4.0 * cylinder.bore**2 * 0.5 * (cylinder.dead_length_a + cylinder.dead_length_b)
        # Stroke that the oil takes for each newton, both chambers sharing it.
        volume = 0.5 * (0.5 * cylinder.stroke * cylinder.area + dead)
        self._yielding = volume / damper.oil.bulk_modulus / cylinder.area**2
        self._inverse = InverseDamper(damper, 0.0, parameters.widest)
        self._forget = -math.expm1(-period / REST)

    def commands(self, force: Array, wanted: Array, rate: Array) -> Array:
        """Commands, (n, 2), with which the dampers come nearest to a wanted force.

        Where the force would drive the motion the valve opens. What the oil takes on the way from one force
        to the other does not pass the throttle.

        Parameters
        ----------
        force, wanted : ndarray, shape (n, 2)
            Tension of each bogie's dampers, left against right, now and at the end of the period, N.
        rate : ndarray, shape (n, 2)
            Stroke rate, m/s.
        """
        side = np.sign(wanted)
        through = side * (rate - self._yielding * (wanted - force) / self.interface.control_period)
        middle = 0.5 * side * (force + wanted)
        # Where all flow is needed to bring the oil to the pressure, none may pass.
        resisting = self._inverse.for_forces(
            np.maximum(through, 0.0), np.maximum(middle, 0.0) + self._sliding
        )
        return np.where(wanted * rate > 0.0, resisting, self.parameters.widest)

    def _count(self, state: Estimate) -> int:
        return len(state.rest)

    def _begin(self, rows: Array) -> Estimate:
        states = [np.zeros((len(rows), len(each.bare))) for each in self.designs]
        return Estimate(states, yaw_part(_of(rows, "stroke")))

    def _restart(self, state: Estimate, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        for each in state.states:
            each[vehicles] = 0.0
        state.rest[vehicles] = yaw_part(_of(rows[vehicles], "stroke"))

    def _command_bogies(self, state: Estimate, rows: Array) -> Array:
        strokes = yaw_part(_of(rows, "stroke"))
        state.rest += self._forget * (strokes - state.rest)
        force = -self._area * yaw_part(_of(rows, "pressure_a") - _of(rows, "pressure_b"))
        readings = np.hstack([rows[:, 1 : 1 + len(ACCELERATIONS)], strokes - state.rest])
        wanted, rate = np.zeros_like(force), np.zeros_like(force)
        shares = self._shares(rows[:, 0])
        for k, each in enumerate(self.designs):
            state.states[k] = observed(each, state.states[k], force, readings)
            forces, rates = regulated(each, state.states[k], force)
            wanted += shares[:, k, None] * forces
            rate += shares[:, k, None] * rates
        return self.commands(force, wanted, rate)

    def _shares(self, speed: Array) -> Array:
        """(n, speeds) weights of the designs at speeds (m/s), linear between them."""
        eye = np.eye(len(self.designs))
        kmh, grid = speed * KMH, self.parameters.speeds_kmh
        return np.stack([np.interp(kmh, grid, column) for column in eye], axis=1)


def observed(design: Design, state: Array, force: Array, readings: Array) -> Array:
    """States of n vehicles now, (n, states): of a period ago, the forces, and what the sensors read.

    Parameters
    ----------
    design : Design
    state : ndarray, shape (n, states)
    force : ndarray, shape (n, 2)
        Of the dampers, N.
    readings : ndarray, shape (n, 6)
        Four lateral accelerations (m/s2) and the yaw strokes of both bogies (m).
    """
    moved = _times(state, design.bare) + _times(force, design.measured)
    unexpected = readings - _times(moved, design.read) - _times(force, design.direct)
    return moved + _times(unexpected, design.observe)


def regulated(design: Design, state: Array, force: Array) -> tuple[Array, Array]:
    """Wanted forces (N) and the stroke rates (m/s) of the next period, both of shape (n, 2)."""
    beyond = force - _times(state, design.damper)
    ahead = _times(state, design.ahead) + _times(beyond, design.added)
    wanted = _times(ahead, design.damper) - _times(np.hstack([state, beyond]), design.regulate)
    return wanted, _times(ahead, design.rate)


def _times(rows: Array, matrix: Array) -> Array:
    """A matrix times each row, by itself: a vehicle's numbers do not depend on how many there are."""
    return np.asarray(np.matmul(rows[:, None, :], matrix.T)[:, 0])


def _of(rows: Array, quantity: str) -> Array:
    """(n, 8) readings of a quantity of all dampers."""
    first = 1 + len(ACCELERATIONS) + 8 * QUANTITIES.index(quantity)
    return rows[:, first : first + 8]
