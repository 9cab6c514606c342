"""The semi-active damper as a co-simulation unit: what it is told and tells, and its communication step.

The step calls the vehicle's own damper kernels and is compiled like them; `sayd_env.fmu.machine_code` makes
an object file of it. Everything that changes lives in one flat array, so that a unit's state can be copied.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.units import Array
from sayd_env.fmu.variable import INPUT, OUTPUT, PARAMETER, TIME, Variable
from sayd_env.physics import sayd
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import LANES
from sayd_env.physics.rows import SINGLE

LONGEST = 1e-3
"""Longest step of the valve (s): a longer communication step is divided. The hydraulics divide it further."""

LINE_ROWS = 512
"""Commands that the delay line can hold: a communication step must be longer than delay / 511."""

# What the step returns.
DONE, TOO_SHORT, NOT_FINITE = range(3)

# How it takes the ends' motion.
HELD, CONTINUED, REACHED = range(3)

# Values, in the order of the variables: time, inputs, outputs, then the parameters.
(_, X_1, V_1, X_2, V_2, COMMAND, POWERED, F_1, F_2, P_A, P_B, STROKE, ACTING, MOTION, START) = range(15)
FIRST_ROW = START + 1

_PHYSICAL = (
    ("rod_mass", "kg", "m_1, piston rod", sayd.ROD_MASS),
    ("housing_mass", "kg", "m_2, housing", sayd.HOUSING_MASS),
    ("bogie_mount.stiffness", "N/m", "c_b1", sayd.STIFFNESS_1),
    ("bogie_mount.damping", "N.s/m", "d_b1", sayd.DAMPING_1),
    ("carbody_mount.stiffness", "N/m", "c_b2", sayd.STIFFNESS_2),
    ("carbody_mount.damping", "N.s/m", "d_b2", sayd.DAMPING_2),
    ("friction.stiction", "N", "F_C, friction at standstill", sayd.FRICTION_STICTION),
    ("friction.sliding", "N", "F_S, friction while sliding", sayd.FRICTION_SLIDING),
    ("cylinder.area", "m2", "A, piston area less the rod's", sayd.AREA),
    ("cylinder.volume_a", "m3", "V_A0, chamber A at stroke 0, dead volume included", sayd.VOLUME_A),
    ("cylinder.volume_b", "m3", "V_B0, chamber B at stroke 0, dead volume included", sayd.VOLUME_B),
    ("oil.bulk_modulus", "Pa", "E, effective bulk modulus", sayd.BULK_MODULUS),
    ("oil.tank_pressure", "Pa", "Pressure in the tank, absolute", sayd.TANK),
    ("bleed", "m3/(s.Pa)", "Conductance from each chamber to the tank", sayd.BLEED),
    ("failsafe_current", "1", "Current that the unpowered valve's opening corresponds to", sayd.FAILSAFE),
    ("valve.delay", "s", "Delay of the driver", sayd.DRIVER_DELAY),
    ("valve.frequency", "rad/s", "omega, undamped natural frequency of the spool", sayd.SPOOL_FREQUENCY),
    ("valve.damping_ratio", "1", "zeta of the spool", sayd.SPOOL_RATIO),
    ("valve.rate", "1/s", "Largest rate of the acting current", sayd.RATE_LIMIT),
)
_ROWS = np.array([row for *_, row in _PHYSICAL])
_DRY = (sayd.FRICTION_SLIDING, sayd.FRICTION_STICTION)
_ZERO_ALLOWED = (sayd.DAMPING_1, sayd.DAMPING_2, *_DRY, sayd.BLEED, sayd.FAILSAFE, sayd.DRIVER_DELAY)

# Numbers of the memory beside constants, state, inputs and delay line.
(
    STEP,  # internal step that the constants are made for, s; 0 before the first one
    ROWS,  # commands in the delay line
    HYDRAULIC,  # longest step of the hydraulics, s
    LAST,  # last communication step, s
    FROM_1,  # position of the end on the bogie at which the damper's is 0, m
    FROM_2,
    BEFORE_1,  # velocities of the ends at the last communication point, m/s
    BEFORE_2,
    OWN,
) = range(9)
_STATE = OWN + sayd.CONSTANTS * LANES
_INPUT = _STATE + sayd.STATES * LANES
_LINE = _INPUT + sayd.INPUTS * LANES
_SPARE = _LINE + LINE_ROWS * LANES
MEMORY = _SPARE + LINE_ROWS * LANES
"""Numbers in the memory of a damper."""


class DamperModel(NamedTuple):
    """A damper's variables and what its step starts from."""

    variables: tuple[Variable, ...]
    memory: Array
    """(MEMORY,) at rest."""
    table: Array
    """Of `sayd_env.physics.sayd.SaydArrays`."""


def damper_model(config: SaydDamperConfig) -> DamperModel:
    """Describe a damper as a unit.

    Parameters
    ----------
    config : SaydDamperConfig
        Throttle, rectifier, relief and suction valves are baked in; the other numbers become parameters.

    Raises
    ------
    DataError
        A throttle table that cannot be used.
    """
    arrays = sayd.sayd_arrays(config, config.step)
    memory = np.zeros(MEMORY)
    memory[OWN:_STATE] = arrays.constant
    memory[_STATE:_INPUT] = sayd.rest(config)
    memory[HYDRAULIC] = config.step
    tank = config.oil.tank_pressure
    variables = [
        Variable("time", "s", "Time", TIME),
        Variable("x_1", "m", "x'_1, displacement of the end on the bogie", INPUT),
        Variable("v_1", "m/s", "v'_1, velocity of the end on the bogie", INPUT),
        Variable("x_2", "m", "x'_2, displacement of the end on the carbody", INPUT),
        Variable("v_2", "m/s", "v'_2, velocity of the end on the carbody", INPUT),
        Variable("current", "1", "Commanded valve current: 0 closed, 1 open", INPUT, config.current),
        Variable("powered", "1", "1 with power, 0 without: the valve goes to failsafe_current", INPUT, 1.0),
        Variable("F_1", "N", "F_1, tension on the piston rod; the bogie gets -F_1", OUTPUT),
        Variable("F_2", "N", "F_2, on the housing; the carbody gets -F_2", OUTPUT),
        Variable("p_A", "Pa", "Pressure in chamber A, absolute", OUTPUT, tank),
        Variable("p_B", "Pa", "Pressure in chamber B, absolute", OUTPUT, tank),
        Variable("stroke", "m", "x_St, stroke of the piston", OUTPUT),
        Variable("acting_current", "1", "Current that the spool's place corresponds to", OUTPUT),
        Variable(
            "motion",
            "1",
            "Ends within a communication step: 0 go on at the velocities of its start, 1 go on as in the "
            "step before, 2 arrive at the inputs, which are those of its end",
            PARAMETER,
            float(CONTINUED),
            low=0.0,
            high=2.0,
            integer=True,
        ),
        Variable("stroke_start", "m", "Stroke at the ends' displacements at the start", PARAMETER),
    ]
    variables += [
        Variable(
            name,
            unit,
            text,
            PARAMETER,
            float(arrays.constant[row * LANES]),
            low=0.0 if row in _ZERO_ALLOWED else np.finfo(float).tiny,
            high=1.0 if row == sayd.FAILSAFE else math.inf,
        )
        for name, unit, text, row in _PHYSICAL
    ]
    return DamperModel(tuple(variables), memory, arrays.table)


@kernel(allocates=False)
def damper_step(h: float, value: Array, memory: Array, table: Array) -> int:
    """Begin (h = 0), or advance over a communication step.

    Parameters
    ----------
    h : float
        Communication step, s.
    value : ndarray
        Values of the variables; outputs are set.
    memory : ndarray, shape (MEMORY,)
        Advanced in place.
    table : ndarray
        Of the throttle.

    Returns
    -------
    int
        DONE, TOO_SHORT or NOT_FINITE.
    """
    state = memory[_STATE:_INPUT]
    if h == 0.0:
        _begin(value, memory, state)
    else:
        count = math.ceil(h / LONGEST - 1e-9)
        if not _set_step(h / count, memory):
            return TOO_SHORT
        _advance(h, count, value, memory, state, table)
    value[F_1], value[F_2] = state[sayd.FORCE_1 * LANES], state[sayd.FORCE_2 * LANES]
    value[P_A], value[P_B] = state[sayd.PRESSURE_A * LANES], state[sayd.PRESSURE_B * LANES]
    value[STROKE], value[ACTING] = state[sayd.STROKE * LANES], state[sayd.CURRENT * LANES]
    whole = value[F_1] + value[F_2] + value[P_A] + value[P_B] + value[STROKE]
    return DONE if math.isfinite(whole) else NOT_FINITE


@kernel(inline=True, allocates=False)
def _begin(value: Array, memory: Array, state: Array) -> None:
    """Take over parameters; the damper follows its ends without force, its valve settled."""
    for k in range(_ROWS.shape[0]):
        memory[OWN + _ROWS[k] * LANES] = value[FIRST_ROW + k]
    tank, fallback = memory[OWN + sayd.TANK * LANES], memory[OWN + sayd.FAILSAFE * LANES]
    command = min(max(value[COMMAND], 0.0), 1.0)
    powered = value[POWERED] > 0.5
    state[sayd.STROKE * LANES] = state[sayd.ROD * LANES] = value[START]
    state[sayd.STROKE_RATE * LANES], state[sayd.ROD_RATE * LANES] = value[V_1] - value[V_2], value[V_1]
    state[sayd.PRESSURE_A * LANES] = state[sayd.PRESSURE_B * LANES] = tank
    state[sayd.FORCE_1 * LANES] = state[sayd.FORCE_2 * LANES] = 0.0
    state[sayd.CURRENT * LANES] = command if powered else fallback
    state[sayd.COIL * LANES] = command if powered else 0.0
    state[sayd.CURRENT_RATE * LANES] = state[sayd.COIL_RATE * LANES] = 0.0
    state[sayd.COMMAND * LANES] = command
    memory[STEP] = memory[LAST] = 0.0
    memory[FROM_1], memory[FROM_2] = value[X_1] - value[START], value[X_2]
    memory[BEFORE_1], memory[BEFORE_2] = value[V_1], value[V_2]


@kernel(inline=True, allocates=False)
def _set_step(step: float, memory: Array) -> bool:
    """Adapt constants and delay line to an internal step (s); False if the line cannot hold the delay."""
    before = memory[STEP]
    if step == before:
        return True
    rows = sayd.delay_steps(memory[OWN + sayd.DRIVER_DELAY * LANES], step) + 1
    if rows > LINE_ROWS:
        return False
    sayd.set_step(memory[OWN:_STATE], 0, LANES, step, _hydraulic_steps(step, memory))
    known = int(memory[ROWS])
    for j in range(known):
        memory[_SPARE + j] = memory[_LINE + j * LANES]
    for age in range(rows):
        # The command that held in the middle of the step of this age.
        command = memory[_STATE + sayd.COMMAND * LANES]
        if before > 0.0:
            old = min(int((age + 0.5) * step / before), known - 1)
            command = memory[_SPARE + known - 1 - old]
        memory[_LINE + (rows - 1 - age) * LANES] = command
    memory[STEP], memory[ROWS] = step, rows
    return True


@kernel(inline=True, allocates=False)
def _hydraulic_steps(step: float, memory: Array) -> int:
    count: int = math.ceil(step / memory[HYDRAULIC] - 1e-9)
    return count


@kernel(inline=True, allocates=False)
def _path(
    h: float, x: float, v: float, before: float, memory: Array, how: float
) -> tuple[float, float, float]:
    """Position, velocity and acceleration of an end at the start of a step."""
    if how >= REACHED:
        return x - 0.5 * h * (before + v), before, (v - before) / h
    if how >= CONTINUED and memory[LAST] > 0.0:
        return x, v, (v - before) / memory[LAST]
    return x, v, 0.0


@kernel(inline=True, allocates=False)
def _advance(h: float, count: int, value: Array, memory: Array, state: Array, table: Array) -> None:
    step, how = h / count, value[MOTION]
    inputs = memory[_INPUT:_LINE]
    line = memory[_LINE : _LINE + int(memory[ROWS]) * LANES]
    # The kernels' loops run over as many dampers as the constants have columns: the first one alone.
    constant = memory[OWN : OWN + sayd.CONSTANTS]
    x_1, v_1, a_1 = _path(h, value[X_1] - memory[FROM_1], value[V_1], memory[BEFORE_1], memory, how)
    x_2, v_2, a_2 = _path(h, value[X_2] - memory[FROM_2], value[V_2], memory[BEFORE_2], memory, how)
    state[sayd.COMMAND * LANES], state[sayd.POWERED * LANES] = value[COMMAND], value[POWERED]
    for k in range(count):
        then, now = k * step, (k + 1) * step
        inputs[sayd.OLD_RATE_1 * LANES], inputs[sayd.RATE_1 * LANES] = v_1 + a_1 * then, v_1 + a_1 * now
        inputs[sayd.OLD_RATE_2 * LANES], inputs[sayd.RATE_2 * LANES] = v_2 + a_2 * then, v_2 + a_2 * now
        inputs[sayd.END_1 * LANES] = x_1 + now * (v_1 + 0.5 * a_1 * now)
        inputs[sayd.END_2 * LANES] = x_2 + now * (v_2 + 0.5 * a_2 * now)
        sayd.move_valves(SINGLE, constant, line, inputs, state)
        sayd.integrate(SINGLE, step, _hydraulic_steps(step, memory), constant, table, inputs, state)
    memory[BEFORE_1], memory[BEFORE_2], memory[LAST] = value[V_1], value[V_2], h
