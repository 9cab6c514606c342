"""A damper alone on a test rig: one end held, the other moved, with the vehicle's own damper solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sayd_env.config import StudyError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.units import Array
from sayd_env.config.vehicle import MaxwellLaw
from sayd_env.measured.dampers import force_velocity
from sayd_env.physics import sayd
from sayd_env.physics.kernel import kernel
from sayd_env.physics.multibody import ForceElement
from sayd_env.physics.plant import LANES
from sayd_env.physics.rows import SINGLE
from sayd_env.physics.simulator import DamperCurves, damper_curves
from sayd_env.physics.step import step_dampers

_MAX_CYCLES = 1000
_STEADY = 1e-9  # change of the force from cycle to cycle over its peak
_STEADY_SAYD = 1e-6  # the same of the semi-active damper, whose valves open and close


class Cycle(NamedTuple):
    """One steady cycle; the last sample closes it."""

    elongation: Array
    """(k + 1,) m."""
    force: Array
    """(k + 1,) pulling when positive, N."""


@kernel
def _drive(h: float, curves: DamperCurves, elongation: Array, state: Array, force: Array) -> None:
    """Force at each of the elongations, a time step h apart; the state is elongation, piston, force."""
    for t in range(elongation.shape[0]):
        step_dampers(
            h,
            elongation[t : t + 1],
            curves.velocity,
            curves.knot,
            curves.slope,
            curves.stiffness,
            state[:1],
            state[1:2],
            state[2:],
        )
        force[t] = state[2]


def steady_cycle(law: MaxwellLaw, amplitude: float, frequency: float, points: int) -> Cycle:
    """Move a damper sinusoidally until its force repeats.

    Parameters
    ----------
    law : MaxwellLaw
        The damper.
    amplitude : float
        Amplitude of the elongation, m.
    frequency : float
        Hz.
    points : int
        Time steps in a cycle.

    Raises
    ------
    StudyError
        The force still changes after 1000 cycles.
    """
    h = 1.0 / (frequency * points)
    curves = damper_curves((ForceElement("rig", np.ones(1), force_velocity(law), law.series_stiffness),), h)
    state = np.zeros(3)
    elongation = amplitude * np.sin(2.0 * np.pi * np.arange(1, points + 1) / points)
    force, before = np.zeros(points), np.full(points, np.inf)
    for _ in range(_MAX_CYCLES):
        _drive(h, curves, elongation, state, force)
        if np.max(np.abs(force - before)) <= _STEADY * np.max(np.abs(force)):
            return Cycle(np.r_[elongation[-1], elongation], np.r_[force[-1], force])
        before = force.copy()
    raise StudyError(f"the damper has no steady cycle at {amplitude * 1e3:g} mm and {frequency:g} Hz")


@kernel
def _drive_sayds(
    step: float,
    substeps: int,
    constant: Array,
    table: Array,
    inputs: Array,
    state: Array,
    motion: Array,
    states: Array,
) -> None:
    """States of all dampers (t, STATES * LANES) at positions and velocities (t, 2) of their bogie's ends."""
    for t in range(motion.shape[0]):
        for i in range(LANES):
            inputs[sayd.OLD_RATE_1 * LANES + i] = inputs[sayd.RATE_1 * LANES + i]
            inputs[sayd.END_1 * LANES + i] = motion[t, 0]
            inputs[sayd.RATE_1 * LANES + i] = motion[t, 1]
        sayd.integrate(SINGLE, step, substeps, constant, table, inputs, state)
        for i in range(state.shape[0]):
            states[t, i] = state[i]


def steady_sayd_cycles(
    config: SaydDamperConfig, amplitude: float, frequency: float, currents: Sequence[float], points: int
) -> tuple[Cycle, ...]:
    """Move semi-active dampers of different constant currents sinusoidally until their forces repeat.

    As `steady_sayd_states`, of each damper elongation and force alone.
    """
    states = steady_sayd_states(config, amplitude, frequency, currents, points)
    x = amplitude * np.sin(2.0 * np.pi * np.r_[points, np.arange(1, points + 1)] / points)
    force = states[:, sayd.FORCE_1]
    return tuple(Cycle(x, np.r_[row[-1], row]) for row in force.T)


def steady_sayd_states(
    config: SaydDamperConfig, amplitude: float, frequency: float, currents: Sequence[float], points: int
) -> Array:
    """Move semi-active dampers of different constant currents sinusoidally until their forces repeat.

    Parameters
    ----------
    config : SaydDamperConfig
        The damper; the end on the carbody is held.
    amplitude : float
        Amplitude of the elongation, m.
    frequency : float
        Hz.
    currents : sequence of float
        Acting currents, 0 to 1.
    points : int
        Vehicle steps in a cycle; the hydraulics divide them further.

    Returns
    -------
    ndarray, shape (points, STATES, currents)
        Their states in the last cycle, by the rows of `sayd_env.physics.sayd`; the elongation is
        ``amplitude * sin(2 pi k / points)`` at k = 1, 2, ..., points.

    Raises
    ------
    StudyError
        The force still changes after 1000 cycles.
    DataError
        A throttle table that cannot be used.
    """
    step = 1.0 / (frequency * points)
    arrays = sayd.sayd_arrays(config, step)
    phase = 2.0 * np.pi * np.arange(1, points + 1) / points
    speed = 2.0 * np.pi * frequency * amplitude
    motion = np.stack([amplitude * np.sin(phase), speed * np.cos(phase)], axis=1)
    found = []
    for first in range(0, len(currents), LANES):
        acting = np.array(currents[first : first + LANES])
        count = len(acting)
        state, inputs = sayd.rest(config), np.zeros(sayd.INPUTS * LANES)
        lanes = slice(sayd.CURRENT * LANES, sayd.CURRENT * LANES + count)
        old = slice(sayd.OLD_CURRENT * LANES, sayd.OLD_CURRENT * LANES + count)
        state[lanes], inputs[old] = acting, acting
        inputs[sayd.RATE_1 * LANES : sayd.OLD_RATE_1 * LANES] = speed
        states = np.zeros((points, sayd.STATES, LANES))
        before = np.full((points, count), np.inf)
        for _ in range(_MAX_CYCLES):
            rows = states.reshape(points, -1)
            _drive_sayds(step, arrays.substeps, arrays.constant, arrays.table, inputs, state, motion, rows)
            force = states[:, sayd.FORCE_1, :count]
            if np.all(np.max(np.abs(force - before), axis=0) <= _STEADY_SAYD * np.max(np.abs(force), axis=0)):
                break
            before = force.copy()
        else:
            raise StudyError(f"the damper has no steady cycle at {amplitude * 1e3:g} mm and {frequency:g} Hz")
        found.append(states[:, :, :count])
    return np.concatenate(found, axis=2)
