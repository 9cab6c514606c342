"""Repeat the parts of a time step, to measure what each of them costs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sayd_env.physics import sayd
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import Plant, State, Work
from sayd_env.physics.step import (
    add_contact,
    add_dampers,
    add_sayds,
    add_stops,
    add_suspension,
    damper_elongations,
    read_track,
    step_dampers,
    step_sayds,
    wheel_forces,
    wheel_kinematics,
)

Array = npt.NDArray[np.float64]

PARTS = ("track", "contact", "suspension", "dampers")
"""Parts that `repeat` knows, in the order of a step; integration is what else a step does."""
SAYD_PARTS = ("valves", "semi-active dampers")
"""Parts of semi-active dampers that `repeat_sayds` knows; the second one contains the first."""


@kernel
def repeat(part: int, count: int, plant: Plant, state: State, work: Work, q: Array, v: Array) -> None:
    """Evaluate one part of the step many times.

    Parameters
    ----------
    part : int
        Index in `PARTS`.
    count : int
        Number of evaluations.
    plant, state, work
        One vehicle that has run for a while; its dampers and scratch memory change.
    q, v : ndarray, shape (2, n)
        Displacements and velocities at two instants, taken in turn: dampers at rest would let their forces
        decay into denormal numbers, whose arithmetic takes many times as long.
    """
    if part == 0:
        for i in range(count):
            read_track(plant, state.clock[1] + i * plant.step * plant.speed, work)
    elif part == 1:
        for i in range(count):
            wheel_kinematics(plant, q[i & 1], v[i & 1], work)
            wheel_forces(plant, work)
            add_contact(plant, work)
    elif part == 2:
        for i in range(count):
            add_suspension(plant, q[i & 1], v[i & 1], work)
            add_stops(plant, q[i & 1], work.f)
    else:
        for i in range(count):
            damper_elongations(plant, q[i & 1], work.shift)
            step_dampers(plant, state, work)
            add_dampers(plant, state.force, work.f)


@kernel
def repeat_sayds(part: int, count: int, plant: Plant, state: State, work: Work, q: Array) -> None:
    """Evaluate a part of the semi-active dampers' step many times.

    Parameters
    ----------
    part : int
        Index in `SAYD_PARTS`.
    count : int
        Number of evaluations.
    plant, state, work
        One vehicle that has run for a while; its displacements and its dampers change.
    q : ndarray, shape (2, n)
        Displacements at two instants, taken in turn. The dampers' mounts are stiff: a sample apart, not more.
    """
    if part == 0:
        for _ in range(count):
            sayd.move_valves((0,), plant.sayd_constant, state.sayd_line, work.sayd_inputs, state.sayd)
    else:
        for i in range(count):
            for j in range(q.shape[1]):
                state.q[j] = q[i & 1, j]
            step_sayds(plant, state, work)
            add_sayds(plant, state, work.f)
