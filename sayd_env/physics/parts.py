"""Repeat the parts of a time step, to measure what each of them costs."""

from __future__ import annotations

from sayd_env.config.units import Array
from sayd_env.physics import sayd
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.rows import SINGLE
from sayd_env.physics.step import (
    contact_at,
    dampers,
    forces,
    motions,
    read_track,
    sayds,
    sections,
    stops,
    wheels,
)

PARTS = ("track", "contact", "suspension", "dampers")
"""Parts that `repeat` knows, in the order of a step; integration is what else a step does. The suspension
is all sums over the unknowns: what moves elements, and what their forces do to the vehicle."""
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
        Displacements and velocities at two instants, taken in turn. (Dampers move to and fro: at rest their
        forces would decay into denormal numbers, whose arithmetic takes many times as long.)
    """
    n = q.shape[1]
    contact_at(plant, q[0], v[0], state.clock[1], work)
    if part == 0:
        for _ in range(count):
            read_track(SINGLE, plant.number, plant.wheelset_x, plant.irregularity, state.clock, work.rail)
    elif part == 1:
        for _ in range(count):
            wheels(SINGLE, plant, work)
    elif part == 2:
        for i in range(count):
            for j in range(n):
                work.x[j] = q[i & 1, j]
                work.x[n + j] = v[i & 1, j]
            motions(SINGLE, plant, work)
            stops(SINGLE, plant, work)
            forces(SINGLE, plant, work)
    else:
        _, _, _, first, last = sections(SINGLE, plant, work)
        for _ in range(count):
            for k in range(first, last):
                work.y[k] = -work.y[k]
            dampers(SINGLE, plant, state, work)


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
    n = q.shape[1]
    inputs = work.y[-sayd.INPUTS * LANES :]
    if part == 0:
        for _ in range(count):
            sayd.move_valves(SINGLE, plant.sayd_constant, state.sayd_line, inputs, state.sayd)
    else:
        for i in range(count):
            for j in range(n):
                work.x[j] = q[i & 1, j]
            motions(SINGLE, plant, work)
            sayds(SINGLE, plant, state, work)
