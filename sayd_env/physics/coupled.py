"""A semi-active damper alone, coupled to somebody else's vehicle at communication points.

Between two of them it takes steps of the vehicle's own damper kernels. Everything that changes lives in one
flat array, so that a state can be copied.
"""

from __future__ import annotations

import math

import numpy as np

from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.units import Array
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
"""Where the values of `PARAMETERS` begin."""

PARAMETERS = (
    sayd.ROD_MASS,
    sayd.HOUSING_MASS,
    sayd.STIFFNESS_1,
    sayd.DAMPING_1,
    sayd.STIFFNESS_2,
    sayd.DAMPING_2,
    sayd.FRICTION_STICTION,
    sayd.FRICTION_SLIDING,
    sayd.AREA,
    sayd.VOLUME_A,
    sayd.VOLUME_B,
    sayd.BULK_MODULUS,
    sayd.TANK,
    sayd.BLEED,
    sayd.FAILSAFE,
    sayd.DRIVER_DELAY,
    sayd.SPOOL_FREQUENCY,
    sayd.SPOOL_RATIO,
    sayd.RATE_LIMIT,
)
"""Rows of a damper's constants that can be set."""
_PARAMETERS = np.array(PARAMETERS)

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


def at_rest(config: SaydDamperConfig, constant: Array) -> Array:
    """Memory (MEMORY,) of a damper with the constants of `sayd_env.physics.sayd.sayd_arrays`."""
    memory = np.zeros(MEMORY)
    memory[HYDRAULIC] = config.step
    memory[OWN:_STATE], memory[_STATE:_INPUT] = constant, sayd.rest(config)
    return memory


@kernel(allocates=False)
def couple(h: float, value: Array, memory: Array, table: Array) -> int:
    """Begin (h = 0), or advance over a communication step.

    Parameters
    ----------
    h : float
        Communication step, s.
    value : ndarray
        Time, inputs, outputs and parameters; outputs are set.
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
    for k in range(_PARAMETERS.shape[0]):
        memory[OWN + _PARAMETERS[k] * LANES] = value[FIRST_ROW + k]
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
