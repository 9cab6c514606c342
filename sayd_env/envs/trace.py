"""What the simulator writes down of its vehicles at each sample, for sensors, cost and limits."""

from __future__ import annotations

from sayd_env.config.units import Array, Integers
from sayd_env.physics import sayd
from sayd_env.physics.kernel import kernel
from sayd_env.physics.line import speed_of
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.rows import Lanes
from sayd_env.physics.step import largest_shift, measure, record, record_wheels, steps

POINTS = 4
"""Measuring points of the lateral acceleration, two on each bogie."""
DAMPERS = 8
BODY_ROWS = 9
"""Accelerations of the carbody: x, y, z above the front bogie, mid-way and above the rear bogie."""

# Columns of a trace: true values at a sample.
ACCELERATION = 0  # lateral, of the bogie frame above each wheelset, m/s2
TRACK_SHIFT = ACCELERATION + POINTS  # N
FORCE = TRACK_SHIFT + POINTS  # of each damper on the bogie, N
WHEEL_LATERAL = FORCE + DAMPERS  # Y of each wheel on its rail, left and right in turn, N
WHEEL_VERTICAL = WHEEL_LATERAL + LANES  # Q, N
LONGITUDINAL = WHEEL_VERTICAL + LANES  # acceleration of the frames at the damper mounts, m/s2
BODY = LONGITUDINAL + POINTS  # m/s2
STROKE = BODY + BODY_ROWS  # of each damper, m
STROKE_RATE = STROKE + DAMPERS  # m/s; of a passive damper, of its viscous part
PRESSURE_A = STROKE_RATE + DAMPERS  # Pa; 0 for passive dampers, as what follows
PRESSURE_B = PRESSURE_A + DAMPERS
VALVE_CURRENT = PRESSURE_B + DAMPERS  # where the spool stands (-)
COIL_CURRENT = VALVE_CURRENT + DAMPERS
CLIMB = COIL_CURRENT + DAMPERS  # largest shift towards a flange over that at the end of the contact table
PULSE = CLIMB + 1  # velocity of the first unknown: finite as long as all of them are
SPEED = PULSE + 1  # V, m/s
POSITION = SPEED + 1  # of the vehicle's centre along the track, m
TRACE = POSITION + 1
MOTIONS = (
    3  # of the n unknowns, with which a wider trace goes on: displacement, velocity, acceleration, n each
)


@kernel(allocates=False)
def trace_period(
    lanes: Lanes,
    plant: Plant,
    state: State,
    work: Work,
    members: Integers,
    substeps: int,
    trace: Array,
) -> None:
    """Run vehicles side by side over a control period.

    Parameters
    ----------
    lanes, plant, state, work
        The vehicles.
    members : ndarray, shape (W,)
        Their numbers in the batch; negative for a place whose results nobody wants.
    substeps : int
        Steps in a sample.
    trace : ndarray, shape (v, samples, TRACE or TRACE + MOTIONS n)
        Receives the members' rows.
    """
    for t in range(trace.shape[1]):
        steps(lanes, plant, state, work, substeps, t == 0)
        measure(lanes, plant, state, work)
        for k in range(len(lanes)):
            if members[k] >= 0:
                _write(lanes, k, plant, state, work, trace[members[k], t])


@kernel(allocates=False)
def _write(lanes: Lanes, k: int, plant: Plant, state: State, work: Work, row: Array) -> None:
    w = len(lanes)
    n = LANES * w
    record(lanes, k, plant, state, work, row[:WHEEL_LATERAL])
    record_wheels(lanes, k, work, row[WHEEL_LATERAL:LONGITUDINAL])
    for j in range(POINTS + BODY_ROWS):
        row[LONGITUDINAL + j] = work.measured[(POINTS + j) * w + k]
    row[CLIMB] = largest_shift(lanes, k, plant, work)
    row[PULSE] = state.v[k]
    row[SPEED] = speed_of(lanes, k, plant, work)
    row[POSITION] = state.clock[w + k]
    unknowns = (row.shape[0] - TRACE) // MOTIONS
    for j in range(unknowns):
        row[TRACE + j] = state.q[j * w + k]
        row[TRACE + unknowns + j] = state.v[j * w + k]
        row[TRACE + 2 * unknowns + j] = state.a[j * w + k]
    if state.sayd.shape[0] == 0:
        for j in range(DAMPERS):
            row[STROKE + j] = state.elongation[j * w + k]
            row[STROKE_RATE + j] = state.piston[j * w + k]
        return
    for j in range(DAMPERS):
        place = j * w + k
        row[STROKE + j] = state.sayd[sayd.STROKE * n + place]
        row[STROKE_RATE + j] = state.sayd[sayd.STROKE_RATE * n + place]
        row[PRESSURE_A + j] = state.sayd[sayd.PRESSURE_A * n + place]
        row[PRESSURE_B + j] = state.sayd[sayd.PRESSURE_B * n + place]
        row[VALVE_CURRENT + j] = state.sayd[sayd.CURRENT * n + place]
        row[COIL_CURRENT + j] = state.sayd[sayd.COIL * n + place]


@kernel(allocates=False)
def command_valves(lanes: Lanes, k: int, state: State, command: Array) -> None:
    """Give vehicle k its valve commands, (DAMPERS,), if it has valves."""
    w = len(lanes)
    if state.sayd.shape[0] > 0:
        for j in range(DAMPERS):
            state.sayd[(sayd.COMMAND * LANES + j) * w + k] = command[j]
