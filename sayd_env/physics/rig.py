"""A damper alone on a test rig: one end held, the other moved, with the vehicle's own damper solver."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sayd_env.config import StudyError
from sayd_env.config.vehicle import MaxwellLaw
from sayd_env.physics.kernel import kernel
from sayd_env.physics.multibody import ForceElement
from sayd_env.physics.simulator import damper_curves
from sayd_env.physics.step import step_dampers

Array = npt.NDArray[np.float64]

_MAX_CYCLES = 1000
_STEADY = 1e-9  # change of the force from cycle to cycle over its peak


class Rig(NamedTuple):
    """The part of a `sayd_env.physics.plant.Plant` that `step_dampers` reads, for one damper."""

    step: float
    damper_velocity: Array
    damper_knot: Array
    damper_slope: Array
    damper_stiffness: Array


class RigState(NamedTuple):
    """The part of a `sayd_env.physics.plant.State` that `step_dampers` advances; shapes (1,)."""

    elongation: Array
    piston: Array
    force: Array


class RigWork(NamedTuple):
    """The part of a `sayd_env.physics.plant.Work` that `step_dampers` reads; shape (1,)."""

    shift: Array


class Cycle(NamedTuple):
    """One steady cycle; the last sample closes it."""

    elongation: Array
    """(k + 1,) m."""
    force: Array
    """(k + 1,) pulling when positive, N."""


@kernel
def _drive(rig: Rig, state: RigState, work: RigWork, elongation: Array, force: Array) -> None:
    """Force at each of the elongations, one time step apart."""
    for t in range(elongation.shape[0]):
        work.shift[0] = elongation[t]
        step_dampers(rig, state, work)
        force[t] = state.force[0]


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
    curves = damper_curves((ForceElement("rig", np.ones(1), np.array(law.curve), law.series_stiffness),), h)
    rig = Rig(h, curves.velocity, curves.knot, curves.slope, curves.stiffness)
    state, work = RigState(np.zeros(1), np.zeros(1), np.zeros(1)), RigWork(np.zeros(1))
    elongation = amplitude * np.sin(2.0 * np.pi * np.arange(1, points + 1) / points)
    force, before = np.zeros(points), np.full(points, np.inf)
    for _ in range(_MAX_CYCLES):
        _drive(rig, state, work, elongation, force)
        if np.max(np.abs(force - before)) <= _STEADY * np.max(np.abs(force)):
            return Cycle(np.r_[elongation[-1], elongation], np.r_[force[-1], force])
        before = force.copy()
    raise StudyError(f"the damper has no steady cycle at {amplitude * 1e3:g} mm and {frequency:g} Hz")
