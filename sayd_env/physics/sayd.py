"""The semi-active yaw damper of the paper's section 2.2: hydraulics, mounts, friction and valve dynamics.

Signs as corrected in the paper's equations: with ends at x'_1 (bogie) and x'_2 (carbody),

    F_1 = -(c_b1 (x_1 - x'_1) + d_b1 (v_1 - v'_1))        on the rod,      -F_1 on the bogie
    F_2 = -(c_b2 (x_2 - x'_2) + d_b2 (v_2 - v'_2))        on the housing,  -F_2 on the carbody
    m_1 v_1' =  A (p_A - p_B) - F_friction + F_1
    m_2 v_2' = -A (p_A - p_B) + F_friction + F_2          x_St = x_1 - x_2
    p_A' = E / (V_A0 + A x_St) (-A v_St + Q_A)
    p_B' = E / (V_B0 - A x_St) ( A v_St + Q_B)

Integration: the diagonally implicit Runge-Kutta method SDIRK2 with gamma = 1 - 1/sqrt(2), of second order,
L-stable and stiffly accurate (Alexander, SIAM J. Numer. Anal. 14 (1977) 1006), in equal sub-steps of a
vehicle step. The first stage is solved by one Newton step on the pressures, the second by two; within each
of them everything but the dry friction is linear in the stroke velocity, and the friction law, eq. (11), is
solved exactly: a piston that cannot overcome stiction stands still, one that moves meets the sliding
friction. No velocity stands for standstill. Displacements, rod velocity and pressures are eliminated by hand:
no matrix is factorised.

The flat arrays hold ``n = LANES * W`` dampers of W vehicles: element ``row * n + i`` belongs to damper
``i = k * W + w``, the k-th of vehicle w. Nothing is computed across dampers, so that W changes no bits.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import elementwise

from sayd_env.config.damper import SaydDamperConfig, SpringValve
from sayd_env.config.units import Array
from sayd_env.physics.kernel import gathered_reads, kernel
from sayd_env.physics.plant import LANES
from sayd_env.physics.throttle import (
    CURRENTS,
    DROP_ROOT,
    DROP_SCALE,
    ROOT_STEP,
    ROOTS,
    series_table,
    spring_valve_drop,
    spring_valve_flow,
    table_start,
)

# Rows of the constants.
(
    ROD_MASS,  # m_1, kg
    HOUSING_MASS,  # m_2, kg
    STIFFNESS_1,  # c_b1, N/m
    DAMPING_1,  # d_b1, N s/m
    STIFFNESS_2,  # c_b2, N/m
    DAMPING_2,  # d_b2, N s/m
    AREA,  # A, m2
    PER_AREA,
    BLEED,  # conductance from each chamber to the tank, m3/(s Pa)
    CHECKED,  # pressure drop at which both check valves in the throttle's way begin to open, Pa
    CURRENT_START,  # current of the throttle table's first row
    PER_CURRENT,  # 1 / (1 - CURRENT_START)
    TABLE_START,  # where the damper's own throttle table begins in the array of tables
    TANK,  # tank pressure, Pa
    VAPOUR,  # vapour pressure, Pa
    RELIEF_OPENING,  # p_o, Pa
    RELIEF_FULL,  # p_s, Pa
    RELIEF_GAIN,  # Q_N sqrt(p_s / dp_N) / (p_s - p_o), m3/(s Pa)
    RELIEF_ROOT,  # Q_N / sqrt(dp_N), m3/(s Pa^0.5)
    SUCTION_OPENING,
    SUCTION_FULL,
    SUCTION_GAIN,
    SUCTION_ROOT,
    # What depends on the length g of an implicit stage:
    CAPACITY_A,  # V_A0 / (E g), m3/(s Pa)
    CAPACITY_B,  # V_B0 / (E g), m3/(s Pa)
    CAPACITY_SLOPE,  # A / (E g), m2/(s Pa)
    PER_MASS_1,  # reciprocals of masses with what their mounts add to them, 1/kg
    PER_MASS_2,
    ROD_SHARE,  # the first's share of their sum
    YIELDING,  # flow that the piston displaces in the stage for each Pa, were it not held, m3/(s Pa)
    SLIDING,  # flow that the sliding friction F_S takes from it, m3/s
    STICTION,  # the same of F_C, m3/s
    # and on the vehicle's step:
    SPOOL_HOLD,  # exact solution of the spool's equation over a vehicle step: change of place over deviation
    SPOOL_DRIFT,  # change of place over rate, s
    SPOOL_PULL,  # new rate over deviation, 1/s
    SPOOL_KEEP,  # new rate over rate
    RATE_LIMIT,  # largest rate of the spool, 1/s
    REACH,  # largest change of the acting current in a vehicle step
    FAILSAFE,  # current of the unpowered valve
    DELAY,  # the command of so many steps ago is the oldest that counts
    DELAY_SHARE,  # share of that command; the rest is of the one after it
    # What `set_step` makes these of, beside masses, mounts and area:
    BULK_MODULUS,  # E, Pa
    VOLUME_A,  # V_A0, m3
    VOLUME_B,  # V_B0, m3
    FRICTION_SLIDING,  # F_S, N
    FRICTION_STICTION,  # F_C, N
    SPOOL_FREQUENCY,  # omega, rad/s
    SPOOL_RATIO,  # zeta
    DRIVER_DELAY,  # s
    CONSTANTS,
) = range(50)

# Rows of the state: the paper's six, the forces, and the valve.
(
    STROKE,  # x_St, m
    STROKE_RATE,  # v_St, m/s; 0 while the piston sticks
    ROD,  # x_1, m
    ROD_RATE,  # v_1, m/s
    PRESSURE_A,  # p_A, Pa
    PRESSURE_B,  # p_B, Pa
    FORCE_1,  # F_1, N: the damper's tension on the bogie's side
    FORCE_2,  # F_2, N
    CURRENT,  # acting current (-): where the spool stands
    COMMAND,  # commanded current (-)
    POWERED,  # 1 with power, 0 without
    STUCK,  # current at which the valve is stuck; negative: it moves
    ATTACHED,  # 1; 0 for a damper that has come off and moves along without force
    COIL,  # current in the coil (-): where the spool would stand, were it free; 0 without power
    CURRENT_RATE,  # rate of the acting current, 1/s
    COIL_RATE,  # rate of the coil's current, 1/s
    STATES,
) = range(17)

# Rows of the inputs of one vehicle step: ends at its end and at its start, and the acting current.
(
    END_1,  # x'_1 at the end of the step, m
    RATE_1,  # v'_1 at the end, m/s
    OLD_RATE_1,  # v'_1 at the start, m/s
    END_2,
    RATE_2,
    OLD_RATE_2,
    OLD_CURRENT,
    INPUTS,
) = range(8)

_GAMMA = 1.0 - math.sqrt(0.5)
_PER_GAMMA = 1.0 / _GAMMA
_CRITICAL = 1e-6  # a spool is damped critically if its roots are nearer over a step
_SMALL = 1e-6  # Pa, keeps a reciprocal finite: no valve is wide open near it
_TEARING = 1e6  # stiffness of oil that tears at vapour pressure, over that of the chamber
_PER_ROOT_STEP = 1.0 / ROOT_STEP
_NEXT, _BELOW = np.uint32(1), np.uint32(ROOTS)  # unsigned: indices that need no check for being negative
_LAST_CURRENT = float(CURRENTS - 2)
LAST_ROOT = float(ROOTS - 2)


@kernel(inline=True, allocates=False)
def _rectified(
    over: float, root: float, per_root: float, first: int, share: float, table: Array
) -> tuple[float, float]:
    """Flow through rectifier and throttle and its slope over the pressure drop.

    `over` is what the drop has above the check valves' opening, `root` that of `over` (0 if negative) and
    DROP_SCALE, `per_root` its reciprocal; `first` is the index of the table's row below the current, and
    `share` how far the current is above it.
    """
    place = (root - DROP_ROOT) * _PER_ROOT_STEP
    below = place if place < LAST_ROOT else LAST_ROOT
    node = np.uint32(below)
    right = place - node
    p = first + node
    low = table[p] + share * (table[p + _BELOW] - table[p])
    high = table[p + _NEXT] + share * (table[p + _BELOW + _NEXT] - table[p + _NEXT])
    rise = high - low
    slope = rise * (0.5 * _PER_ROOT_STEP) * per_root
    return low + right * rise, (slope if over > 0.0 else 0.0)


@kernel(inline=True, allocates=False)
def _drained(
    over: float, wide: float, per_wide: float, constant: Array, i: int, n: int
) -> tuple[float, float]:
    """Flow from a chamber to the tank and its slope over the pressure: valves, eq. (22) to (24), and bleed.

    `over` is the chamber's pressure over the tank's, `wide` the root of its size and `per_wide` half the
    reciprocal of that. No choice is made between two loaded numbers: it would become a gather.
    """
    beyond = over - constant[RELIEF_OPENING * n + i]
    gain = constant[RELIEF_GAIN * n + i] if beyond > 0.0 else 0.0
    root = constant[RELIEF_ROOT * n + i]
    full = over > constant[RELIEF_FULL * n + i]
    relief = root * wide if full else gain * beyond
    slope = root * per_wide if full else gain

    beyond = -over - constant[SUCTION_OPENING * n + i]
    gain = constant[SUCTION_GAIN * n + i] if beyond > 0.0 else 0.0
    root = constant[SUCTION_ROOT * n + i]
    full = -over > constant[SUCTION_FULL * n + i]
    suction = root * wide if full else gain * beyond
    slope += root * per_wide if full else gain

    bleed = constant[BLEED * n + i]
    return bleed * over + (relief - suction), bleed + slope


@kernel(inline=True, allocates=False)
def _place(current: float, start: float, per_current: float) -> tuple[Any, float]:
    """Index of a throttle table's row below a current and how far the current is above it."""
    # Comparisons with a number that is none are false: it closes the valve and reaches nothing.
    travel = (current - start) * per_current
    place = math.sqrt(travel if travel > 0.0 else 0.0) * (CURRENTS - 1.0)
    whole = place if place < _LAST_CURRENT else _LAST_CURRENT
    row = np.uint32(whole)
    share = place - row
    return row * np.uint32(ROOTS), (share if share < 1.0 else 1.0)


@kernel(inline=True, allocates=False)
def _end(
    inputs: Array,
    i: int,
    n: int,
    position: int,
    velocity: int,
    old_velocity: int,
    left: float,
    step: float,
) -> tuple[float, float]:
    """Position and velocity of an end when the share `left` of the vehicle step is still to come."""
    new = inputs[velocity * n + i]
    change = new - inputs[old_velocity * n + i]
    return inputs[position * n + i] - step * left * (new - 0.5 * left * change), new - left * change


@kernel(inline=True, allocates=False)
def _slip(drive: float, stiff: float, before: float, constant: Array, i: int, n: int) -> float:
    """Solve ``flow = drive - stiff * friction(flow)`` exactly for eq. (11).

    `before` is the velocity that the piston comes from: in its direction it goes on against the sliding
    friction, from standstill and in the other direction it must overcome stiction.
    """
    sliding = stiff * constant[SLIDING * n + i]
    stiction = stiff * constant[STICTION * n + i]
    size = abs(drive)
    threshold = sliding if drive * before > 0.0 else stiction
    return math.copysign(size - sliding, drive) if size > threshold else 0.0


@kernel(inline=True, allocates=False)
def _newton(
    known: tuple[float, float, float, float, float],
    guess: tuple[float, float],
    before: float,
    valve: tuple[int, float],
    table: Array,
    constant: Array,
    i: int,
    n: int,
) -> tuple[float, float, float]:
    """One Newton step of a stage of length g.

    Parameters
    ----------
    known : tuple
        Flow that the piston would displace without pressures and friction (m3/s); the chambers' capacities
        over g (m3/(s Pa)), and these times the pressures that they would have without flow (m3/s).
    guess : tuple
        Pressures so far, Pa.
    before : float
        Stroke velocity that the stage comes from, m/s.
    valve : tuple
        Table index of the current and the share beyond it.

    Returns
    -------
    flow, p_a, p_b : float
        Flow that the piston displaces, m3/s, and pressures, Pa.
    """
    free, cap_a, cap_b, held_a, held_b = known
    p_a, p_b = guess
    vapour, tank, yielding = constant[VAPOUR * n + i], constant[TANK * n + i], constant[YIELDING * n + i]
    drop = p_a - p_b
    over = abs(drop) - constant[CHECKED * n + i]
    root = math.sqrt((over if over > 0.0 else 0.0) + DROP_SCALE)
    over_a, over_b = p_a - tank, p_b - tank
    wide_a, wide_b = math.sqrt(abs(over_a) + _SMALL), math.sqrt(abs(over_b) + _SMALL)
    wide = wide_a * wide_b
    per_all = 1.0 / (root * wide)  # one division for three
    half = 0.5 * per_all * root
    through, throttle = _rectified(over, root, per_all * wide, valve[0], valve[1], table)
    fixed = math.copysign(through, drop) - throttle * drop
    out_a, drain_a = _drained(over_a, wide_a, half * wide_b, constant, i, n)
    out_b, drain_b = _drained(over_b, wide_b, half * wide_a, constant, i, n)
    # At vapour pressure the oil tears: nothing keeps the pressure up.
    torn_a = _TEARING * cap_a if p_a <= vapour else 0.0
    torn_b = _TEARING * cap_b if p_b <= vapour else 0.0
    diagonal_a, diagonal_b = cap_a + drain_a + torn_a, cap_b + drain_b + torn_b
    right_a = held_a - fixed - out_a + drain_a * p_a + torn_a * vapour
    right_b = held_b + fixed - out_b + drain_b * p_b + torn_b * vapour

    # The piston's flow first, with friction, then p_A - p_B, then p_A; one division serves all three.
    both = diagonal_a + diagonal_b
    lean = right_a * diagonal_b - right_b * diagonal_a
    stiff = diagonal_a * diagonal_b + throttle * both
    mass = stiff + yielding * both
    moved = _slip(stiff * free + yielding * lean, stiff, before, constant, i, n)
    product = mass * stiff
    per_all = 1.0 / (product * both)
    per_product = per_all * both
    flow = moved * (per_product * stiff)
    drop = (lean - both * flow) * (per_product * mass)
    p_a = (right_a + right_b + diagonal_b * drop) * (per_all * product)
    return flow, p_a, p_a - drop


@kernel(inline=True, allocates=False)
def _stage(
    held: tuple[float, float, float, float, float, float],
    guess: tuple[float, float],
    before: float,
    ends: tuple[float, float, float, float],
    current: float,
    g: float,
    last: bool,
    table: Array,
    constant: Array,
    i: int,
    n: int,
) -> tuple[float, float, float, float]:
    """Solve ``Y = held + g f(Y)`` for stroke velocity, rod velocity and pressures.

    Parameters
    ----------
    held : tuple
        Stroke, stroke velocity, rod position, rod velocity, p_A and p_B.
    guess : tuple
        Pressures from which the iteration starts, Pa.
    before : float
        Stroke velocity that the stage comes from, m/s.
    ends : tuple
        x'_1, v'_1, x'_2, v'_2 at the stage's time.
    current : float
        Acting current then.
    g : float
        Length of an implicit stage, s.
    last : bool
        The stage ends the sub-step and takes a second Newton step; the first only leads to it.
    """
    stroke, stroke_rate, rod, rod_rate, p_a, p_b = held
    push_1 = constant[DAMPING_1 * n + i] * ends[1] - constant[STIFFNESS_1 * n + i] * (rod - ends[0])
    push_2 = constant[DAMPING_2 * n + i] * ends[3] - constant[STIFFNESS_2 * n + i] * (rod - stroke - ends[2])
    per_1, per_2 = constant[PER_MASS_1 * n + i], constant[PER_MASS_2 * n + i]
    free_1 = per_1 * (constant[ROD_MASS * n + i] * rod_rate + g * push_1)
    free_2 = per_2 * (constant[HOUSING_MASS * n + i] * (rod_rate - stroke_rate) + g * push_2)
    free = free_1 - free_2
    # The chambers' volumes change little within a stage.
    swept = constant[CAPACITY_SLOPE * n + i] * (stroke + g * before)
    cap_a, cap_b = constant[CAPACITY_A * n + i] + swept, constant[CAPACITY_B * n + i] - swept
    known = constant[AREA * n + i] * free, cap_a, cap_b, cap_a * p_a, cap_b * p_b
    row, share = _place(current, constant[CURRENT_START * n + i], constant[PER_CURRENT * n + i])
    valve = np.uint32(constant[TABLE_START * n + i]) + row, share
    flow, p_a, p_b = _newton(known, guess, before, valve, table, constant, i, n)
    if last:
        flow, p_a, p_b = _newton(known, (p_a, p_b), before, valve, table, constant, i, n)
    rate = flow * constant[PER_AREA * n + i]
    vapour = constant[VAPOUR * n + i]
    p_a = p_a if p_a > vapour else vapour
    p_b = p_b if p_b > vapour else vapour
    return rate, free_1 + constant[ROD_SHARE * n + i] * (rate - free), p_a, p_b


@kernel(distinct=True, allocates=False)
def integrate(
    lanes: tuple[int, ...],
    step: float,
    substeps: int,
    constant: Array,
    table: Array,
    inputs: Array,
    state: Array,
) -> None:
    """Advance all dampers over one vehicle step.

    Parameters
    ----------
    lanes : tuple
        Of as many entries as there are vehicles W: ``n = LANES * W`` is then known to the compiler.
    step : float
        Length of the step, s.
    substeps : int
        Number of equal sub-steps in it.
    constant : ndarray, shape (CONSTANTS * n,)
    table : ndarray
        `sayd_env.physics.throttle.series_table` of each kind of damper, flat; TABLE_START says where.
    inputs : ndarray, shape (INPUTS * n,)
        Motion of the ends. Between start and end of the step their velocities change linearly.
    state : ndarray, shape (STATES * n,)
        Advanced in place; the acting current is that at the end of the step.
    """
    gathered_reads()
    n = LANES * len(lanes)
    h = step / substeps
    g = _GAMMA * h
    for s in range(substeps):
        # Shares of the vehicle step still to come at both stages.
        left_1, left_2 = 1.0 - (s + _GAMMA) / substeps, 1.0 - (s + 1.0) / substeps
        for i in range(constant.shape[0] // CONSTANTS):
            old, new = inputs[OLD_CURRENT * n + i], state[CURRENT * n + i]
            stroke, stroke_rate = state[STROKE * n + i], state[STROKE_RATE * n + i]
            rod, rod_rate = state[ROD * n + i], state[ROD_RATE * n + i]
            p_a, p_b = state[PRESSURE_A * n + i], state[PRESSURE_B * n + i]

            ends_1 = _end(inputs, i, n, END_1, RATE_1, OLD_RATE_1, left_1, step)
            ends_2 = _end(inputs, i, n, END_2, RATE_2, OLD_RATE_2, left_1, step)
            w, v, a, b = _stage(
                (stroke, stroke_rate, rod, rod_rate, p_a, p_b),
                (p_a, p_b),
                stroke_rate,
                (*ends_1, *ends_2),
                new - left_1 * (new - old),
                g,
                False,
                table,
                constant,
                i,
                n,
            )

            # What the first stage's derivatives add up to before the second.
            on = (1.0 - _GAMMA) * h
            per = (1.0 - _GAMMA) / _GAMMA
            stroke += on * w
            rod += on * v
            ends_1 = _end(inputs, i, n, END_1, RATE_1, OLD_RATE_1, left_2, step)
            ends_2 = _end(inputs, i, n, END_2, RATE_2, OLD_RATE_2, left_2, step)
            rise_a, rise_b = a - p_a, b - p_b
            w, v, a, b = _stage(
                (
                    stroke,
                    stroke_rate + per * (w - stroke_rate),
                    rod,
                    rod_rate + per * (v - rod_rate),
                    p_a + per * rise_a,
                    p_b + per * rise_b,
                ),
                (p_a + rise_a * _PER_GAMMA, p_b + rise_b * _PER_GAMMA),
                w,
                (*ends_1, *ends_2),
                new - left_2 * (new - old),
                g,
                True,
                table,
                constant,
                i,
                n,
            )
            stroke += g * w
            rod += g * v
            state[STROKE * n + i] = stroke
            state[STROKE_RATE * n + i] = w
            state[ROD * n + i] = rod
            state[ROD_RATE * n + i] = v
            state[PRESSURE_A * n + i] = a
            state[PRESSURE_B * n + i] = b
            state[FORCE_1 * n + i] = constant[STIFFNESS_1 * n + i] * (ends_1[0] - rod) + constant[
                DAMPING_1 * n + i
            ] * (ends_1[1] - v)
            state[FORCE_2 * n + i] = constant[STIFFNESS_2 * n + i] * (ends_2[0] - rod + stroke) + constant[
                DAMPING_2 * n + i
            ] * (ends_2[1] - v + w)


@kernel(inline=True, allocates=False)
def _spool(place: float, rate: float, target: float, constant: Array, i: int, n: int) -> tuple[float, float]:
    """Where the spool stands and its rate a vehicle step later, held to its rate limit and to 0..1."""
    deviation = place - target
    limit, reach = constant[RATE_LIMIT * n + i], constant[REACH * n + i]
    change = constant[SPOOL_HOLD * n + i] * deviation + constant[SPOOL_DRIFT * n + i] * rate
    change = change if change < reach else reach
    change = change if change > -reach else -reach
    new_rate = constant[SPOOL_PULL * n + i] * deviation + constant[SPOOL_KEEP * n + i] * rate
    new_rate = new_rate if new_rate < limit else limit
    new_rate = new_rate if new_rate > -limit else -limit
    new = place + change
    inside = new if new > 0.0 else 0.0
    inside = inside if inside < 1.0 else 1.0
    return inside, (new_rate if inside == new else 0.0)


@kernel(distinct=True, allocates=False)
def move_valves(lanes: tuple[int, ...], constant: Array, line: Array, inputs: Array, state: Array) -> None:
    """Advance the acting currents over one vehicle step: delay, spool, rate limit, fail-safe, a stuck valve.

    Parameters
    ----------
    lanes : tuple
        As for `integrate`.
    constant : ndarray, shape (CONSTANTS * n,)
    line : ndarray, shape (rows * n,)
        The commands of the last steps, the newest last; advanced in place. It has at least as many rows as
        the longest delay needs (`line_length`); a damper with a shorter delay does not read the first ones.
    inputs : ndarray, shape (INPUTS * n,)
        Receives the acting current at the start of the step.
    state : ndarray, shape (STATES * n,)
        Advanced in place.
    """
    n = LANES * len(lanes)
    count = constant.shape[0] // CONSTANTS
    newest = line.shape[0] - n
    for j in range(newest):
        line[j] = line[j + n]
    for i in range(count):
        # The border refuses such commands; should one come through: no number closes the valve.
        command = state[COMMAND * n + i]
        command = command if command > 0.0 else 0.0
        line[newest + i] = command if command < 1.0 else 1.0
    for i in range(count):
        age, share = constant[DELAY * n + i], constant[DELAY_SHARE * n + i]
        last, after = np.uint32(age), np.uint32(age - 1.0 if age > 1.0 else 0.0)
        asked = share * line[newest + i - last * n] + (1.0 - share) * line[newest + i - after * n]
        powered, stuck = state[POWERED * n + i], state[STUCK * n + i]
        fallback = constant[FAILSAFE * n + i]
        free = asked if powered > 0.5 else fallback
        target = stuck if stuck >= 0.0 else free
        now = state[CURRENT * n + i]
        inputs[OLD_CURRENT * n + i] = now
        now, rate = _spool(now, state[CURRENT_RATE * n + i], target, constant, i, n)
        state[CURRENT * n + i], state[CURRENT_RATE * n + i] = now, rate
        flow = asked if powered > 0.5 else 0.0
        coil, rate = _spool(state[COIL * n + i], state[COIL_RATE * n + i], flow, constant, i, n)
        state[COIL * n + i], state[COIL_RATE * n + i] = coil, rate


class SaydArrays(NamedTuple):
    """What the kernels need of up to `LANES` equal dampers."""

    constant: Array
    """(CONSTANTS * LANES,)."""
    table: Array
    """(CURRENTS * ROOTS,) flow of throttle and rectifier."""
    substeps: int
    """Sub-steps of a vehicle step."""


def sayd_arrays(config: SaydDamperConfig, step: float) -> SaydArrays:
    """Constants of the kernels for dampers of one kind at a vehicle step (s).

    Raises
    ------
    DataError
        A throttle table that cannot be used.
    """
    column = np.zeros(CONSTANTS)
    cylinder, oil, valve = config.cylinder, config.oil, config.valve
    column[ROD_MASS], column[HOUSING_MASS] = config.rod_mass, config.housing_mass
    column[STIFFNESS_1], column[DAMPING_1] = config.bogie_mount.stiffness, config.bogie_mount.damping
    column[STIFFNESS_2], column[DAMPING_2] = config.carbody_mount.stiffness, config.carbody_mount.damping
    column[AREA], column[BLEED] = cylinder.area, config.bleed
    column[CURRENT_START] = table_start(config.throttle)
    column[PER_CURRENT] = 1.0 / (1.0 - column[CURRENT_START])
    column[CHECKED] = 2.0 * config.rectifier.opening
    column[TANK], column[VAPOUR] = oil.tank_pressure, oil.vapour_pressure
    column[RELIEF_OPENING : RELIEF_ROOT + 1] = _valve_column(config.relief)
    column[SUCTION_OPENING : SUCTION_ROOT + 1] = _valve_column(config.suction)
    # Eq. (20) and (21).
    half, dead = 0.5 * cylinder.stroke * cylinder.area, 0.25 * math.pi * cylinder.bore**2
    column[BULK_MODULUS] = oil.bulk_modulus
    column[VOLUME_A] = half + cylinder.dead_length_a * dead
    column[VOLUME_B] = half + cylinder.dead_length_b * dead
    column[FRICTION_SLIDING], column[FRICTION_STICTION] = config.friction.sliding, config.friction.stiction
    column[SPOOL_FREQUENCY] = 2.0 * math.pi * valve.natural_frequency
    column[SPOOL_RATIO], column[DRIVER_DELAY] = valve.damping_ratio, valve.delay
    column[RATE_LIMIT], column[FAILSAFE] = valve.rate, config.failsafe_current
    substeps = math.ceil(step / config.step - 1e-9)
    set_step(column, 0, 1, step, substeps)
    return SaydArrays(
        constant=np.repeat(column, LANES),
        table=np.ascontiguousarray(series_table(config.throttle, config.rectifier).ravel()),
        substeps=substeps,
    )


@kernel(allocates=False)
def delay_steps(delay: float, step: float) -> int:
    """Number of vehicle steps (s) that a driver's delay (s) begins in."""
    return math.ceil(delay / step - 1e-9)


@kernel(allocates=False)
def set_step(constant: Array, i: int, n: int, step: float, substeps: int) -> None:
    """Set what of damper i's constants depends on the vehicle's step (s) and the sub-steps in it.

    The spool's are the exact solution of y'' + 2 zeta omega y' + omega^2 (y - target) = 0 over a step with a
    constant target. With sigma = zeta omega and d = sigma^2 - omega^2 the exponential of the system's matrix
    A is ``exp(-sigma h) (C + (A + sigma) S)``, C = cosh(sqrt(d) h) and S = sinh(sqrt(d) h) / sqrt(d).

    Parameters
    ----------
    constant : ndarray, shape (CONSTANTS * n,)
        The rows that these come from are set.
    i, n : int
        Column and number of columns.
    step : float
        The vehicle's step, s.
    substeps : int
        Number of equal sub-steps of the hydraulics in it.
    """
    g = _GAMMA * step / substeps
    area, modulus = constant[AREA * n + i], constant[BULK_MODULUS * n + i]
    constant[PER_AREA * n + i] = 1.0 / area
    constant[CAPACITY_A * n + i] = constant[VOLUME_A * n + i] / (modulus * g)
    constant[CAPACITY_B * n + i] = constant[VOLUME_B * n + i] / (modulus * g)
    constant[CAPACITY_SLOPE * n + i] = area / (modulus * g)
    mount = constant[DAMPING_1 * n + i] + g * constant[STIFFNESS_1 * n + i]
    per_1 = 1.0 / (constant[ROD_MASS * n + i] + g * mount)
    mount = constant[DAMPING_2 * n + i] + g * constant[STIFFNESS_2 * n + i]
    per_2 = 1.0 / (constant[HOUSING_MASS * n + i] + g * mount)
    constant[PER_MASS_1 * n + i], constant[PER_MASS_2 * n + i] = per_1, per_2
    constant[ROD_SHARE * n + i] = per_1 / (per_1 + per_2)
    per_force = g * (per_1 + per_2) * area
    constant[YIELDING * n + i] = per_force * area
    constant[SLIDING * n + i] = per_force * constant[FRICTION_SLIDING * n + i]
    constant[STICTION * n + i] = per_force * constant[FRICTION_STICTION * n + i]

    omega = constant[SPOOL_FREQUENCY * n + i]
    sigma = constant[SPOOL_RATIO * n + i] * omega
    d = sigma * sigma - omega * omega
    root = math.sqrt(abs(d))
    x = root * step
    even = math.cosh(x) if d > 0.0 else math.cos(x)
    odd = (math.sinh(x) if d > 0.0 else math.sin(x)) / root if x > _CRITICAL else step
    decay = math.exp(-sigma * step)
    constant[SPOOL_HOLD * n + i] = decay * (even + sigma * odd) - 1.0
    constant[SPOOL_DRIFT * n + i] = decay * odd
    constant[SPOOL_PULL * n + i] = -decay * omega * omega * odd
    constant[SPOOL_KEEP * n + i] = decay * (even - sigma * odd)
    constant[REACH * n + i] = constant[RATE_LIMIT * n + i] * step
    delay = constant[DRIVER_DELAY * n + i]
    steps = delay_steps(delay, step)
    constant[DELAY * n + i] = steps
    constant[DELAY_SHARE * n + i] = 1.0 if steps == 0 else delay / step - (steps - 1)


def line_length(config: SaydDamperConfig, step: float) -> int:
    """Number of commands that a valve's delay line holds at a vehicle step (s)."""
    return delay_steps(config.valve.delay, step) + 1


def _valve_column(valve: SpringValve) -> tuple[float, float, float, float]:
    root = valve.nominal_flow / math.sqrt(valve.nominal_drop)
    gain = root * math.sqrt(valve.full) / (valve.full - valve.opening)
    return valve.opening, valve.full, gain, root


def rest(config: SaydDamperConfig, current: float | None = None) -> Array:
    """State at rest under tank pressure, powered, its current settled: shape (STATES * LANES,)."""
    column = np.zeros(STATES)
    column[PRESSURE_A] = column[PRESSURE_B] = config.oil.tank_pressure
    column[CURRENT] = column[COMMAND] = column[COIL] = config.current if current is None else current
    column[POWERED] = column[ATTACHED] = 1.0
    column[STUCK] = -1.0
    return np.repeat(column, LANES)


def steady_force(config: SaydDamperConfig, velocity: npt.ArrayLike, current: npt.ArrayLike) -> Array:
    """Quasi-static force at constant stroke velocity and current: the damper's characteristic field.

    Parameters
    ----------
    config : SaydDamperConfig
        The damper.
    velocity : array_like
        Stroke velocities >= 0, m/s.
    current : array_like
        Acting currents, 0 to 1.

    Returns
    -------
    ndarray
        Force of pressures and sliding friction (N), in the broadcast shape. Flow balance with constant
        pressures: A v = Q(p_A - p_B, i) + Q_tank(p_A), and the tank gives back what it gets.

    Raises
    ------
    DataError
        A throttle table that cannot be used.
    """
    v, i = np.broadcast_arrays(np.asarray(velocity, dtype=float), np.asarray(current, dtype=float))
    table = series_table(config.throttle, config.rectifier).ravel()
    tank = config.oil.tank_pressure

    def excess(high: Array, wanted: Array, at: Array) -> Array:
        drop = high - fed_pressure(config, high)
        return np.asarray(rectified_flow(config, table, drop, at) + to_tank(config, high) - wanted)

    wanted = config.cylinder.area * v
    top = tank + spring_valve_drop(config.relief, wanted)
    found = elementwise.find_root(excess, (np.full_like(wanted, tank), top + 1e3), args=(wanted, i))
    force = config.cylinder.area * (found.x - fed_pressure(config, found.x))
    return np.asarray(np.where(wanted > 0.0, force + config.friction.sliding, 0.0))


def to_tank(config: SaydDamperConfig, pressure: npt.ArrayLike) -> Array:
    """Flow (m3/s) from a chamber at a pressure (Pa) to the tank: bleed, relief, suction (negative)."""
    over = np.asarray(pressure, dtype=float) - config.oil.tank_pressure
    relief, suction = spring_valve_flow(config.relief, over), spring_valve_flow(config.suction, -over)
    return np.asarray(config.bleed * over + relief - suction)


def fed_pressure(config: SaydDamperConfig, high: npt.ArrayLike) -> Array:
    """Pressure (Pa) of the low chamber at which it gets from the tank what the high one (Pa) gives to it.

    Without a bleed and with the relief valve closed any pressure between those at which the valves open is
    one; it is then the tank's.
    """
    flow, valve, bleed = to_tank(config, high), config.suction, config.bleed
    root = valve.nominal_flow / math.sqrt(valve.nominal_drop)
    gain = root * math.sqrt(valve.full) / (valve.full - valve.opening)
    closed = flow / bleed if bleed > 0.0 else np.where(flow > 0.0, np.inf, 0.0)
    partial = (flow + gain * valve.opening) / (gain + bleed)
    wide = (2.0 * flow / (root + np.sqrt(root**2 + 4.0 * bleed * flow))) ** 2  # bleed d + root sqrt(d) = flow
    depth = np.where(partial > valve.full, wide, np.where(closed > valve.opening, partial, closed))
    return np.asarray(np.maximum(config.oil.tank_pressure - depth, config.oil.vapour_pressure))


def rectified_flow(
    config: SaydDamperConfig, table: Array, drop: npt.ArrayLike, current: npt.ArrayLike
) -> Array:
    """Flow (m3/s) through throttle and rectifier as the compiled damper computes it."""
    dp, i = np.broadcast_arrays(np.asarray(drop, dtype=float), np.asarray(current, dtype=float))
    out = np.empty(dp.size)
    start, checked = table_start(config.throttle), 2.0 * config.rectifier.opening
    _rectified_loop(table, start, checked, np.ravel(dp), np.ravel(i), out)
    return out.reshape(dp.shape)


@kernel(allocates=False)
def _rectified_loop(
    table: Array, start: float, checked: float, drop: Array, current: Array, out: Array
) -> None:
    for k in range(out.shape[0]):
        first, share = _place(current[k], start, 1.0 / (1.0 - start))
        over = abs(drop[k]) - checked
        root = math.sqrt(max(over, 0.0) + DROP_SCALE)
        out[k] = math.copysign(_rectified(over, root, 1.0 / root, first, share, table)[0], drop[k])
