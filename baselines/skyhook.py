"""Skyhook: dampers that resist where they decelerate the bogie, and yield where they would accelerate it."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.signal import cont2discrete

from sayd_env.baselines.inverse_damper import InverseDamper
from sayd_env.baselines.policy import BogiePolicy, of_all_dampers, semi_active, yaw_part
from sayd_env.config.control import SkyhookConfig
from sayd_env.config.units import Array
from sayd_env.envs.interface import BOGIES, Interface
from sayd_env.physics.kernel import kernel

ACCELERATIONS = tuple(
    f"longitudinal_acceleration.{bogie}.{side}" for bogie in BOGIES for side in ("left", "right")
)
STROKES = of_all_dampers("stroke")


@dataclass
class Motion:
    """Yaw motion of n vehicles' bogies, front and rear, at the dampers' longitudinal mounts."""

    displacement: Array
    """(n, 2) integral of the velocity, high-passed, m."""
    velocity: Array
    """(n, 2) x', absolute longitudinal velocity of the left side's mounts, m/s."""
    strokes: Array
    """(n, 2, 2) yaw strokes of the last two observations, m."""
    rate: Array
    """(n, 2) dL', stroke rate of the left side's dampers, m/s."""
    command: Array
    """(n, 2) valve commands V."""


class Skyhook(BogiePolicy[SkyhookConfig, Motion]):
    """What on-off and continuous skyhook share: x' and dL' of each bogie from its sensors.

    The four dampers of a bogie share one command. Hunting turns the bogie, so the yaw part decides, half the
    difference of left and right: there x' dL' is the same on both sides.

    **x'** is the high-passed integral of the longitudinal acceleration, H(s) = s / (s^2 + 2 zeta w s
    + w^2) instead of 1 / s, w = 2 pi corner, zeta = sqrt(1/2): a constant error of the sensor has no
    effect. The readings are means over the control period, for which the discrete filter is exact.

    **dL'** is the slope at the end of the parabola through the last three means m of the stroke, (2 m_n - 3
    m_(n-1) + m_(n-2)) / T: a plain difference would lag by a control period, 18 degrees at 5 Hz. Before the
    first reading the stroke counts as constant. A first-order low-pass follows.
    """

    def __init__(self, name: str, interface: Interface, parameters: SkyhookConfig) -> None:
        super().__init__(name, interface, parameters, ACCELERATIONS + STROKES)
        period = interface.control_period
        corner = 2.0 * math.pi * parameters.corner
        system = (
            np.array([[0.0, 1.0], [-corner * corner, -math.sqrt(2.0) * corner]]),
            np.array([[0.0], [1.0]]),
            np.eye(2),
            np.zeros((2, 1)),
        )
        transition, entry, *_ = cont2discrete(system, period, method="zoh")
        self._integrator = np.hstack([transition, entry])
        rate_corner = parameters.rate_corner
        self._weight = 1.0 if rate_corner is None else -math.expm1(-2.0 * math.pi * rate_corner * period)

    @abstractmethod
    def _wanted(self, velocity: Array, rate: Array) -> Array:
        """Valve commands for x' and dL' (m/s), all of shape (N, 2)."""

    def _count(self, state: Motion) -> int:
        return len(state.velocity)

    def _begin(self, rows: Array) -> Motion:
        bogies = (len(rows), 2)
        state = Motion(
            displacement=np.zeros(bogies),
            velocity=np.zeros(bogies),
            strokes=np.zeros((*bogies, 2)),
            rate=np.zeros(bogies),
            command=np.full(bogies, self.parameters.closed),
        )
        state.strokes[:] = yaw_part(rows[:, len(ACCELERATIONS) :])[:, :, None]
        return state

    def _restart(self, state: Motion, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        for values in (state.displacement, state.velocity, state.rate):
            values[vehicles] = 0.0
        state.strokes[vehicles] = yaw_part(rows[vehicles, len(ACCELERATIONS) :])[:, :, None]
        state.command[vehicles] = self.parameters.closed

    def _command_bogies(self, state: Motion, rows: Array) -> Array:
        _sense(
            rows,
            self._integrator,
            self._weight,
            1.0 / self.interface.control_period,
            state.displacement,
            state.velocity,
            state.strokes,
            state.rate,
        )
        command = self._wanted(state.velocity, state.rate)
        if self.parameters.dead_band > 0.0:
            slowest = np.minimum(np.abs(state.velocity), np.abs(state.rate))
            command = np.where(slowest < self.parameters.dead_band, state.command, command)
        state.command = command
        return command


class OnOffSkyhook(Skyhook):
    """On-off skyhook: the valve is closed where this decelerates the bogie, and open elsewhere.

        c_YD = c_max if x' dL' >= 0, else c_min                                            (38)

    x' is the absolute longitudinal velocity of the bogie frame at the dampers' mounts, dL' the dampers'
    stroke rate, d/dt (x at the bogie - x at the carbody); `Skyhook` says how they follow from sensors.

    ===============  =====  ============================================================================
    parameter        unit   meaning
    ===============  =====  ============================================================================
    ``closed``       -      command for c_max
    ``open``         -      command for c_min
    ``corner``       Hz     corner of the high-pass in the integration of x'
    ``rate_corner``  Hz     corner of the low-pass on dL'; null: none
    ``dead_band``    m/s    the command stays while abs(x') or abs(dL') is smaller
    ===============  =====  ============================================================================

    Sensors: ``longitudinal_acceleration`` of both sides and ``stroke`` of all dampers of each bogie.
    Valves: ``bogie`` or ``damper``.

    References
    ----------
    Wang, Liu, Di Gialleonardo, Kovacic and Bruni, Vehicle System Dynamics 60(8), 2608-2633 (2022),
    section 4.2.
    """

    def _wanted(self, velocity: Array, rate: Array) -> Array:
        return np.where(velocity * rate >= 0.0, self.parameters.closed, self.parameters.open)


class ContinuousSkyhook(Skyhook):
    """Continuous skyhook: the damper resists like one between the bogie and a fixed point, as far as it can.

        F_ref = -c_sky x', c_sky = c_max                                                   (32)
        c_YD = min(c_max x' / dL', c_max) if x' dL' >= 0, else c_min                       (37)

    and c_min where the first is less, (35). c_max dL' is the force of the damper at the command `closed` and
    this stroke rate; the command that gives the wanted share of it comes from the damper's characteristic
    field (`InverseDamper`). x' and dL' as in `OnOffSkyhook`.

    ===============  =====  ============================================================================
    parameter        unit   meaning
    ===============  =====  ============================================================================
    ``closed``       -      command for c_max
    ``open``         -      command for c_min
    ``corner``       Hz     corner of the high-pass in the integration of x'
    ``rate_corner``  Hz     corner of the low-pass on dL'; null: none
    ``dead_band``    m/s    the command stays while abs(x') or abs(dL') is smaller
    ===============  =====  ============================================================================

    Sensors: ``longitudinal_acceleration`` of both sides and ``stroke`` of all dampers of each bogie.
    Valves: ``bogie`` or ``damper``. The dampers must be semi-active.

    References
    ----------
    Wang, Liu, Di Gialleonardo, Kovacic and Bruni, Vehicle System Dynamics 60(8), 2608-2633 (2022),
    section 4.2.
    """

    def __init__(self, name: str, interface: Interface, parameters: SkyhookConfig) -> None:
        super().__init__(name, interface, parameters)
        damper = semi_active(name, interface)
        self._inverse_damper = InverseDamper(damper, parameters.closed, parameters.open)

    def _wanted(self, velocity: Array, rate: Array) -> Array:
        share = np.ones_like(velocity)
        with np.errstate(over="ignore"):
            np.divide(velocity, rate, out=share, where=rate != 0.0)
        return self._inverse_damper.currents(rate, share)


# It calls no kernel of another file of this package: Numba would not notice an edit there.
@kernel(allocates=False)
def _sense(
    rows: Array,
    integrator: Array,
    weight: float,
    per_period: float,
    displacement: Array,
    velocity: Array,
    strokes: Array,
    rate: Array,
) -> None:
    """Integrate accelerations and differentiate strokes of one control period, in place.

    rows hold for each bogie the accelerations of left and right, then for each the strokes of its four
    dampers.
    """
    for i in range(rows.shape[0]):
        for b in range(2):
            acceleration = 0.5 * (rows[i, 2 * b] - rows[i, 2 * b + 1])
            x, v = displacement[i, b], velocity[i, b]
            displacement[i, b] = integrator[0, 0] * x + integrator[0, 1] * v + integrator[0, 2] * acceleration
            velocity[i, b] = integrator[1, 0] * x + integrator[1, 1] * v + integrator[1, 2] * acceleration
            first = 4 + 4 * b
            left = rows[i, first] + rows[i, first + 1]
            right = rows[i, first + 2] + rows[i, first + 3]
            stroke = 0.25 * (left - right)
            slope = (2.0 * stroke - 3.0 * strokes[i, b, 0] + strokes[i, b, 1]) * per_period
            strokes[i, b, 1] = strokes[i, b, 0]
            strokes[i, b, 0] = stroke
            rate[i, b] += weight * (slope - rate[i, b])
