"""The semi-active yaw damper of the paper's section 2.2: hydraulics, mounts, friction and valve dynamics.

Up to eight dampers side by side, structure of arrays: element ``row * LANES + i`` of a flat array belongs to
damper i. Signs as corrected in the paper's equations: with ends at x'_1 (bogie) and x'_2 (carbody),

    F_1 = -(c_b1 (x_1 - x'_1) + d_b1 (v_1 - v'_1))        on the rod,      -F_1 on the bogie
    F_2 = -(c_b2 (x_2 - x'_2) + d_b2 (v_2 - v'_2))        on the housing,  -F_2 on the carbody
    m_1 v_1' =  A (p_A - p_B) - F_friction + F_1
    m_2 v_2' = -A (p_A - p_B) + F_friction + F_2          x_St = x_1 - x_2
    p_A' = E / (V_A0 + A x_St) (-A v_St + Q_A)
    p_B' = E / (V_B0 - A x_St) ( A v_St + Q_B)

Integration: the Rosenbrock method ROS2 with gamma = 1 - 1/sqrt(2), L-stable, of second order for any
approximation of the Jacobian (Verwer, Spee, Blom and Hundsdorfer, SIAM J. Sci. Comput. 20 (1999) 1456). The
Jacobian used here leaves out how the chamber volumes change within a step, takes one slope for all of an open
valve's root law, and the friction's secant for its tangent, which keeps a piston from shooting through
standstill. Displacements and one of each pair of
coupled unknowns are eliminated by hand: no matrix is factorised.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import elementwise

from sayd_env.config.damper import SaydDamperConfig, SpringValve
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import LANES
from sayd_env.physics.throttle import (
    CURRENTS,
    DROP_SCALE,
    ROOT_STEP,
    ROOTS,
    series_table,
    spring_valve_drop,
    spring_valve_flow,
)

Array = npt.NDArray[np.float64]

# Rows of the constants.
(
    ROD_MASS,  # m_1, kg
    HOUSING_MASS,  # m_2, kg
    STIFFNESS_1,  # c_b1, N/m
    DAMPING_1,  # d_b1, N s/m
    STIFFNESS_2,  # c_b2, N/m
    DAMPING_2,  # d_b2, N s/m
    SLIDING,  # F_S, N
    STICTION_EXCESS,  # F_C - F_S, N
    WIDTH,  # of standstill, m/s
    PER_STRIBECK,  # 1 / velocity at which half of the excess is left, s/m
    AREA,  # A, m2
    CAPACITY_A,  # V_A0 / E, m3/Pa
    CAPACITY_B,  # V_B0 / E, m3/Pa
    CAPACITY_SLOPE,  # A / E, m2/Pa
    CHECKED,  # pressure drop at which both check valves in the throttle's way begin to open, Pa
    TANK,  # tank pressure, Pa
    VAPOUR,  # vapour pressure, Pa
    RELIEF_OPENING,  # p_o, Pa
    RELIEF_FULL,  # p_s, Pa
    RELIEF_GAIN,  # Q_N sqrt(p_s / dp_N) / (p_s - p_o), m3/(s Pa)
    RELIEF_ROOT,  # Q_N / sqrt(dp_N), m3/(s Pa^0.5)
    RELIEF_SLOPE,  # slope of eq. (22) at p_s, m3/(s Pa)
    SUCTION_OPENING,
    SUCTION_FULL,
    SUCTION_GAIN,
    SUCTION_ROOT,
    SUCTION_SLOPE,
    PER_MASS_1,  # reciprocals of what mounts and masses put on the diagonal of a sub-step's matrix, 1/kg
    PER_MASS_2,
    LAG,  # share of the way to the target that the acting current goes in a vehicle step
    REACH,  # largest change of the acting current in a vehicle step
    FAILSAFE,  # current of the unpowered valve
    DELAY_SHARE,  # share of the delay's last step that counts
    CONSTANTS,
) = range(34)

# Rows of the state: the paper's six, the forces, and the valve.
(
    STROKE,  # x_St, m
    STROKE_RATE,  # v_St, m/s
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
    STATES,
) = range(15)

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
_STRIBECK_WIDTHS = 10.0  # the stiction has half gone at so many widths of standstill
_PER_ROOT_STEP = 1.0 / ROOT_STEP
_LAST_CURRENT = float(CURRENTS - 2)
_LAST_ROOT = float(ROOTS - 2)


@kernel(inline=True, allocates=False)
def _friction(velocity: float, constant: Array, i: int) -> tuple[float, float]:
    """Friction force over velocity, eq. (11) with standstill widened: secant slope and force."""
    width = constant[WIDTH * LANES + i]
    decay = velocity * constant[PER_STRIBECK * LANES + i]
    spread = 1.0 + decay * decay
    level = constant[SLIDING * LANES + i] * spread + constant[STICTION_EXCESS * LANES + i]
    secant = level / (spread * math.sqrt(velocity * velocity + width * width))
    return secant, secant * velocity


@kernel(inline=True, allocates=False)
def _rectified(drop: float, checked: float, first: int, share: float, table: Array) -> tuple[float, float]:
    """Flow from A to B through rectifier and throttle and its slope over the pressure drop p_A - p_B.

    Nothing passes below the drop `checked`; `first` is the index of the table's row below the current, and
    `share` how far the current is above it.
    """
    over = abs(drop) - checked
    size = over if over > 0.0 else 0.0
    per_root = 1.0 / math.sqrt(size + DROP_SCALE)
    place = size * per_root * _PER_ROOT_STEP
    below = place if place < _LAST_ROOT else _LAST_ROOT
    node = int(below)
    right = place - node
    p = first + node
    low = table[p] + share * (table[p + ROOTS] - table[p])
    high = table[p + 1] + share * (table[p + ROOTS + 1] - table[p + 1])
    flow = low + right * (high - low)
    warp_slope = (0.5 * size + DROP_SCALE) * per_root * per_root * per_root
    return (flow if drop > 0.0 else -flow), (high - low) * _PER_ROOT_STEP * warp_slope


@kernel(inline=True, allocates=False)
def _drained(over: float, constant: Array, i: int) -> tuple[float, float]:
    """Flow from a chamber to the tank (suction negative) and about its slope over p - p_tank, eq. (24)."""
    relief = over > 0.0
    size = abs(over)
    # Loaded before the choice: a conditional load would be a branch.
    opening_out, opening_in = constant[RELIEF_OPENING * LANES + i], constant[SUCTION_OPENING * LANES + i]
    full_out, full_in = constant[RELIEF_FULL * LANES + i], constant[SUCTION_FULL * LANES + i]
    gain_out, gain_in = constant[RELIEF_GAIN * LANES + i], constant[SUCTION_GAIN * LANES + i]
    root_out, root_in = constant[RELIEF_ROOT * LANES + i], constant[SUCTION_ROOT * LANES + i]
    slope_out, slope_in = constant[RELIEF_SLOPE * LANES + i], constant[SUCTION_SLOPE * LANES + i]
    full = full_out if relief else full_in
    gain = gain_out if relief else gain_in
    beyond = size - (opening_out if relief else opening_in)
    beyond = beyond if beyond > 0.0 else 0.0
    free = (root_out if relief else root_in) * math.sqrt(size)
    free_slope = slope_out if relief else slope_in
    partial = gain * beyond
    partial_slope = gain if beyond > 0.0 else 0.0
    flow = free if size > full else partial
    slope = free_slope if size > full else partial_slope
    return (flow if relief else -flow), slope


@kernel(inline=True, allocates=False)
def _residuals(
    state: tuple[float, float, float, float, float, float],
    ends: tuple[float, float, float, float],
    valve: tuple[int, float],
    table: Array,
    constant: Array,
    i: int,
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """Forces and flows at a state: what masses and capacities times the derivatives equal.

    Returns
    -------
    force_1, force_2, flow_a, flow_b : float
        Net forces on rod and housing (N) and net flows into the chambers (m3/s).
    capacity_a, capacity_b : float
        Chamber volume over bulk modulus, m3/Pa.
    friction, throttle, drain_a, drain_b : float
        Slopes: friction over stroke velocity (N s/m), flows over pressures (m3/(s Pa)).
    """
    stroke, stroke_rate, rod, rod_rate, p_a, p_b = state
    area, tank = constant[AREA * LANES + i], constant[TANK * LANES + i]
    secant, friction = _friction(stroke_rate, constant, i)
    through, throttle = _rectified(p_a - p_b, constant[CHECKED * LANES + i], valve[0], valve[1], table)
    out_a, drain_a = _drained(p_a - tank, constant, i)
    out_b, drain_b = _drained(p_b - tank, constant, i)
    mount_1 = constant[STIFFNESS_1 * LANES + i] * (rod - ends[0])
    mount_1 += constant[DAMPING_1 * LANES + i] * (rod_rate - ends[1])
    mount_2 = constant[STIFFNESS_2 * LANES + i] * (rod - stroke - ends[2])
    mount_2 += constant[DAMPING_2 * LANES + i] * (rod_rate - stroke_rate - ends[3])
    inner = area * (p_a - p_b) - friction
    flow_a = -area * stroke_rate - through - out_a
    flow_b = area * stroke_rate + through - out_b
    # At vapour pressure the oil tears: the chamber grows without a further fall of pressure.
    vapour = constant[VAPOUR * LANES + i]
    flow_a = 0.0 if (p_a <= vapour) & (flow_a < 0.0) else flow_a
    flow_b = 0.0 if (p_b <= vapour) & (flow_b < 0.0) else flow_b
    return (
        inner - mount_1,
        -inner - mount_2,
        flow_a,
        flow_b,
        constant[CAPACITY_A * LANES + i] + constant[CAPACITY_SLOPE * LANES + i] * stroke,
        constant[CAPACITY_B * LANES + i] - constant[CAPACITY_SLOPE * LANES + i] * stroke,
        secant,
        throttle,
        drain_a,
        drain_b,
    )


@kernel(inline=True, allocates=False)
def _place(current: float) -> tuple[int, float]:
    """Table index below a current and how far the current is above it."""
    place = current * (CURRENTS - 1.0)
    # Comparisons with a number that is none are false: it closes the valve and reaches nothing.
    place = place if place > 0.0 else 0.0
    whole = place if place < _LAST_CURRENT else _LAST_CURRENT
    row = int(whole)
    share = place - row
    return row * ROOTS, (share if share < 1.0 else 1.0)


@kernel(inline=True, allocates=False)
def _end(
    inputs: Array, i: int, position: int, velocity: int, old_velocity: int, left: float, step: float
) -> tuple[float, float]:
    """Position and velocity of an end when the share `left` of the vehicle step is still to come."""
    new = inputs[velocity * LANES + i]
    change = new - inputs[old_velocity * LANES + i]
    return inputs[position * LANES + i] - step * left * (new - 0.5 * left * change), new - left * change


@kernel(inline=True, allocates=False)
def _solve(
    right: tuple[float, float, float, float],
    masses: tuple[float, float],
    capacities: tuple[float, float],
    slopes: tuple[float, float, float],
) -> tuple[float, float, float, float]:
    """Solve a stage's equations for the derivatives of rod velocity, stroke velocity, p_A and p_B.

    Parameters
    ----------
    right : tuple
        Right-hand sides: forces on rod and housing (N), flows into A and B (m3/s).
    masses, capacities : tuple
        Reciprocals of the diagonal's masses (1/kg) and capacities (Pa/m3).
    slopes : tuple
        gamma h times area, friction slope and throttle slope: what couples the four.
    """
    b_1, b_2, r_a, r_b = right
    per_1, per_2 = masses
    per_a, per_b = capacities
    area, friction, throttle = slopes
    # Rate of the stroke velocity first, then that of p_A - p_B: all that couples depends on these two.
    held = 1.0 / (1.0 + throttle * (per_a + per_b))
    compliance = held * (per_a + per_b)
    mobility = per_1 + per_2
    source = held * (r_a * per_a - r_b * per_b)
    rate = b_1 * per_1 - b_2 * per_2 + mobility * area * source
    rate /= 1.0 + mobility * (friction + area * area * compliance)
    rise = source - compliance * area * rate
    return (
        (b_1 + area * rise - friction * rate) * per_1,
        rate,
        (r_a - throttle * rise - area * rate) * per_a,
        (r_b + throttle * rise + area * rate) * per_b,
    )


@kernel(distinct=True, allocates=False)
def integrate(  # noqa: PLR0915 - the method's two stages read best side by side
    step: float, substeps: int, constant: Array, table: Array, inputs: Array, state: Array
) -> None:
    """Advance all dampers over one vehicle step.

    Parameters
    ----------
    step : float
        Length of the step, s.
    substeps : int
        Number of equal sub-steps in it.
    constant : ndarray, shape (CONSTANTS * LANES,)
    table : ndarray, shape (CURRENTS * ROOTS,)
        `sayd_env.physics.throttle.series_table`, flat.
    inputs : ndarray, shape (INPUTS * LANES,)
        Motion of the ends. Between start and end of the step their velocities change linearly.
    state : ndarray, shape (STATES * LANES,)
        Advanced in place; the acting current is that at the end of the step.
    """
    h = step / substeps
    g = _GAMMA * h
    per_step = 1.0 / step
    for n in range(substeps):
        start, end = n / substeps, (n + 1) / substeps
        for i in range(constant.shape[0] // CONSTANTS):
            c_1, d_1 = constant[STIFFNESS_1 * LANES + i], constant[DAMPING_1 * LANES + i]
            c_2, d_2 = constant[STIFFNESS_2 * LANES + i], constant[DAMPING_2 * LANES + i]
            mass_1, mass_2 = constant[ROD_MASS * LANES + i], constant[HOUSING_MASS * LANES + i]
            vapour = constant[VAPOUR * LANES + i]

            # Inputs at both ends of the sub-step.
            now_1 = _end(inputs, i, END_1, RATE_1, OLD_RATE_1, 1.0 - start, step)
            now_2 = _end(inputs, i, END_2, RATE_2, OLD_RATE_2, 1.0 - start, step)
            next_1 = _end(inputs, i, END_1, RATE_1, OLD_RATE_1, 1.0 - end, step)
            next_2 = _end(inputs, i, END_2, RATE_2, OLD_RATE_2, 1.0 - end, step)
            # Forces rise in time with the moving ends: gamma h df/dt, without which stiff mounts lag behind.
            speed_up_1 = per_step * (inputs[RATE_1 * LANES + i] - inputs[OLD_RATE_1 * LANES + i])
            speed_up_2 = per_step * (inputs[RATE_2 * LANES + i] - inputs[OLD_RATE_2 * LANES + i])
            drift_1 = g * (c_1 * now_1[1] + d_1 * speed_up_1)
            drift_2 = g * (c_2 * now_2[1] + d_2 * speed_up_2)
            old, new = inputs[OLD_CURRENT * LANES + i], state[CURRENT * LANES + i]
            valve = _place(old + start * (new - old))
            next_valve = _place(old + end * (new - old))

            stroke, stroke_rate = state[STROKE * LANES + i], state[STROKE_RATE * LANES + i]
            rod, rod_rate = state[ROD * LANES + i], state[ROD_RATE * LANES + i]
            p_a, p_b = state[PRESSURE_A * LANES + i], state[PRESSURE_B * LANES + i]
            f_1, f_2, q_a, q_b, cap_a, cap_b, friction, throttle, drain_a, drain_b = _residuals(
                (stroke, stroke_rate, rod, rod_rate, p_a, p_b), (*now_1, *now_2), valve, table, constant, i
            )

            # I - gamma h J times masses and capacities, the displacements eliminated.
            masses = constant[PER_MASS_1 * LANES + i], constant[PER_MASS_2 * LANES + i]
            diagonal_a, diagonal_b = cap_a + g * drain_a, cap_b + g * drain_b
            both = 1.0 / (diagonal_a * diagonal_b)  # one division for two
            capacities = diagonal_b * both, diagonal_a * both
            slopes = g * constant[AREA * LANES + i], g * friction, g * throttle

            # Stage 1, for rod (x), stroke (s), rod velocity (v), stroke velocity (w), p_A and p_B.
            right = (
                f_1 + drift_1 - g * c_1 * rod_rate,
                f_2 + drift_2 - g * c_2 * (rod_rate - stroke_rate),
                q_a,
                q_b,
            )
            k_v, k_w, k_a, k_b = _solve(right, masses, capacities, slopes)
            k_x, k_s = rod_rate + g * k_v, stroke_rate + g * k_w

            # Stage 2, with the same matrix.
            middle = (
                stroke + h * k_s,
                stroke_rate + h * k_w,
                rod + h * k_x,
                rod_rate + h * k_v,
                p_a + h * k_a,
                p_b + h * k_b,
            )
            f_1, f_2, q_a, q_b, next_cap_a, next_cap_b, _, _, _, _ = _residuals(
                middle, (*next_1, *next_2), next_valve, table, constant, i
            )
            both = 1.0 / (next_cap_a * next_cap_b)
            x_rate, s_rate = middle[3] - 2.0 * k_x, middle[1] - 2.0 * k_s
            right = (
                f_1 - drift_1 - 2.0 * mass_1 * k_v - g * c_1 * x_rate,
                f_2 - drift_2 - 2.0 * mass_2 * (k_v - k_w) - g * c_2 * (x_rate - s_rate),
                cap_a * (q_a * next_cap_b * both - 2.0 * k_a),
                cap_b * (q_b * next_cap_a * both - 2.0 * k_b),
            )
            l_v, l_w, l_a, l_b = _solve(right, masses, capacities, slopes)

            stroke += h * (1.5 * k_s + 0.5 * (s_rate + g * l_w))
            stroke_rate += h * (1.5 * k_w + 0.5 * l_w)
            rod += h * (1.5 * k_x + 0.5 * (x_rate + g * l_v))
            rod_rate += h * (1.5 * k_v + 0.5 * l_v)
            p_a += h * (1.5 * k_a + 0.5 * l_a)
            p_b += h * (1.5 * k_b + 0.5 * l_b)
            state[STROKE * LANES + i] = stroke
            state[STROKE_RATE * LANES + i] = stroke_rate
            state[ROD * LANES + i] = rod
            state[ROD_RATE * LANES + i] = rod_rate
            state[PRESSURE_A * LANES + i] = p_a if p_a > vapour else vapour
            state[PRESSURE_B * LANES + i] = p_b if p_b > vapour else vapour
            state[FORCE_1 * LANES + i] = c_1 * (next_1[0] - rod) + d_1 * (next_1[1] - rod_rate)
            state[FORCE_2 * LANES + i] = c_2 * (next_2[0] - rod + stroke) + d_2 * (
                next_2[1] - rod_rate + stroke_rate
            )


@kernel(distinct=True, allocates=False)
def move_valves(constant: Array, line: Array, inputs: Array, state: Array) -> None:
    """Advance the acting currents over one vehicle step: delay, lag, rate limit, fail-safe, a stuck valve.

    Parameters
    ----------
    constant : ndarray, shape (CONSTANTS * LANES,)
    line : ndarray, shape ((delay steps + 1) * LANES,)
        The commands of the last steps, the newest first; advanced in place.
    inputs : ndarray, shape (INPUTS * LANES,)
        Receives the acting current at the start of the step.
    state : ndarray, shape (STATES * LANES,)
        Advanced in place.
    """
    lanes = constant.shape[0] // CONSTANTS
    last = line.shape[0] - LANES
    for j in range(line.shape[0] - 1, LANES - 1, -1):
        line[j] = line[j - LANES]
    for i in range(lanes):
        # The border refuses such commands; should one come through: no number closes the valve.
        command = state[COMMAND * LANES + i]
        command = command if command > 0.0 else 0.0
        line[i] = command if command < 1.0 else 1.0
    before = last - LANES if last >= LANES else last
    for i in range(lanes):
        share = constant[DELAY_SHARE * LANES + i]
        asked = share * line[last + i] + (1.0 - share) * line[before + i]
        powered, stuck = state[POWERED * LANES + i] > 0.5, state[STUCK * LANES + i]
        free = asked if powered else constant[FAILSAFE * LANES + i]
        target = stuck if stuck >= 0.0 else free
        lag, reach = constant[LAG * LANES + i], constant[REACH * LANES + i]
        now = state[CURRENT * LANES + i]
        change = lag * (target - now)
        change = change if change < reach else reach
        change = change if change > -reach else -reach
        inputs[OLD_CURRENT * LANES + i] = now
        state[CURRENT * LANES + i] = now + change
        flow = state[COIL * LANES + i]
        rise = lag * ((asked if powered else 0.0) - flow)
        rise = rise if rise < reach else reach
        rise = rise if rise > -reach else -reach
        state[COIL * LANES + i] = flow + rise


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
    delay_steps = line_length(config, step) - 1
    column = np.zeros(CONSTANTS)
    cylinder, oil, friction = config.cylinder, config.oil, config.friction
    dead = 0.25 * math.pi * cylinder.bore**2
    column[ROD_MASS], column[HOUSING_MASS] = config.rod_mass, config.housing_mass
    column[STIFFNESS_1], column[DAMPING_1] = config.bogie_mount.stiffness, config.bogie_mount.damping
    column[STIFFNESS_2], column[DAMPING_2] = config.carbody_mount.stiffness, config.carbody_mount.damping
    column[SLIDING] = friction.sliding
    column[STICTION_EXCESS] = friction.stiction - friction.sliding
    column[WIDTH] = friction.width
    column[PER_STRIBECK] = 1.0 / (_STRIBECK_WIDTHS * friction.width)
    column[AREA] = cylinder.area
    # Eq. (20) and (21).
    half = 0.5 * cylinder.stroke * cylinder.area
    column[CAPACITY_A] = (half + cylinder.dead_length_a * dead) / oil.bulk_modulus
    column[CAPACITY_B] = (half + cylinder.dead_length_b * dead) / oil.bulk_modulus
    column[CAPACITY_SLOPE] = cylinder.area / oil.bulk_modulus
    column[CHECKED] = 2.0 * config.rectifier.opening
    column[TANK], column[VAPOUR] = oil.tank_pressure, oil.vapour_pressure
    column[RELIEF_OPENING : RELIEF_SLOPE + 1] = _valve_column(config.relief)
    column[SUCTION_OPENING : SUCTION_SLOPE + 1] = _valve_column(config.suction)
    substeps = math.ceil(step / config.step - 1e-9)
    g = _GAMMA * step / substeps
    for row, mass, mount in (
        (PER_MASS_1, config.rod_mass, config.bogie_mount),
        (PER_MASS_2, config.housing_mass, config.carbody_mount),
    ):
        column[row] = 1.0 / (mass + g * (mount.damping + g * mount.stiffness))
    lag = config.valve.lag
    column[LAG] = 1.0 if lag == 0.0 else -math.expm1(-step / lag)
    column[REACH] = config.valve.rate * step
    column[FAILSAFE] = config.failsafe_current
    column[DELAY_SHARE] = 1.0 if delay_steps == 0 else config.valve.delay / step - (delay_steps - 1)
    return SaydArrays(
        constant=np.repeat(column, LANES),
        table=np.ascontiguousarray(series_table(config.throttle, config.rectifier).ravel()),
        substeps=substeps,
    )


def line_length(config: SaydDamperConfig, step: float) -> int:
    """Number of commands that a valve's delay line holds at a vehicle step (s)."""
    return math.ceil(config.valve.delay / step - 1e-9) + 1


def _valve_column(valve: SpringValve) -> tuple[float, float, float, float, float]:
    root = valve.nominal_flow / math.sqrt(valve.nominal_drop)
    gain = root * math.sqrt(valve.full) / (valve.full - valve.opening)
    return valve.opening, valve.full, gain, root, 0.5 * root / math.sqrt(valve.full)


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
        pressures: A v = Q(p_A - p_B, i) + Q_relief(p_A), and the tank gives back what it gets.

    Raises
    ------
    DataError
        A throttle table that cannot be used.
    """
    v, i = np.broadcast_arrays(np.asarray(velocity, dtype=float), np.asarray(current, dtype=float))
    table = series_table(config.throttle, config.rectifier).ravel()
    tank, vapour = config.oil.tank_pressure, config.oil.vapour_pressure

    def suction_pressure(high: Array) -> Array:
        flow = spring_valve_flow(config.relief, high - tank)
        drop = spring_valve_drop(config.suction, flow)
        return np.where(flow > 0.0, np.maximum(tank - drop, vapour), tank)

    def excess(high: Array, wanted: Array, at: Array) -> Array:
        drop = high - suction_pressure(high)
        relief = spring_valve_flow(config.relief, high - tank)
        return np.asarray(rectified_flow(config, table, drop, at) + relief - wanted)

    wanted = config.cylinder.area * v
    top = tank + spring_valve_drop(config.relief, wanted)
    found = elementwise.find_root(excess, (np.full_like(wanted, tank), top + 1e3), args=(wanted, i))
    force = config.cylinder.area * (found.x - suction_pressure(found.x))
    friction = config.friction.sliding * v / np.hypot(v, config.friction.width)
    return np.asarray(np.where(wanted > 0.0, force + friction, 0.0))


def rectified_flow(
    config: SaydDamperConfig, table: Array, drop: npt.ArrayLike, current: npt.ArrayLike
) -> Array:
    """Flow (m3/s) through throttle and rectifier as the compiled damper computes it."""
    dp, i = np.broadcast_arrays(np.asarray(drop, dtype=float), np.asarray(current, dtype=float))
    out = np.empty(dp.size)
    _rectified_loop(table, 2.0 * config.rectifier.opening, np.ravel(dp), np.ravel(i), out)
    return out.reshape(dp.shape)


@kernel(allocates=False)
def _rectified_loop(table: Array, checked: float, drop: Array, current: Array, out: Array) -> None:
    for k in range(out.shape[0]):
        first, share = _place(current[k])
        out[k], _ = _rectified(drop[k], checked, first, share, table)
