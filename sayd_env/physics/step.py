"""One compiled time step of vehicles side by side: track and contact, suspension, dampers, integration.

Scheme: explicit Newmark (beta = 0, gamma = 1/2) with one evaluation of the forces for each step,

    q_1 = q_0 + h v_0 + h^2/2 a_0
    M a_1 = f(q_1, v_0 + h a_0) - D (v_0 + h/2 (a_0 + a_1))
    v_1 = v_0 + h/2 (a_0 + a_1)

The velocity in the forces is predicted; the diagonal D of the damping matrix (the strongly damped track
sections) is treated implicitly, which costs a division. Maxwell dampers use the trapezoidal rule, solved
exactly on their piecewise-linear curves; semi-active dampers take steps of their own between the same
instants (`sayd_env.physics.sayd`). All of it is second order in h.

How W vehicles stand side by side is said in `sayd_env.physics.plant`, whose names for rows are used as in
``wheel[at.RADIUS * n + i]``. Loops run over what is alike: all
wheels of all vehicles, all dampers. They have no branches, and their bounds come from arrays' lengths, so
that the compiler makes vector instructions of them (of a loop whose length it knows it makes a long
straight line instead). Sums over a vehicle's unknowns are sparse products (`sayd_env.physics.rows`). A
vehicle's results are the same bits alone and beside others: what is done to its numbers, and in which
order, does not depend on W.
"""

from __future__ import annotations

import math

from sayd_env.config.units import Array
from sayd_env.physics import plant as at
from sayd_env.physics import sayd
from sayd_env.physics.contact import creep, geometry
from sayd_env.physics.kernel import kernel
from sayd_env.physics.line import between, blend, curved, follow, speed_of, turn
from sayd_env.physics.plant import LANES, WHEELSETS, Plant, State, Work
from sayd_env.physics.rows import SINGLE, Lanes, add_product, multiply
from sayd_env.physics.track.spline import CHANNELS, spline_weights, weighted_rows

# Rows of `Work.rail`: values and slopes of the irregularities.
ALIGNMENT, VERTICAL, CROSS_LEVEL, GAUGE = 0, 1, 2, 3
SLOPE = CHANNELS


@kernel(inline=True, distinct=True, allocates=False)
def _predict(
    h: float,
    q: Array,
    v: Array,
    a: Array,
    load: Array,
    diagonal: Array,
    displacement: Array,
    predicted: Array,
    present: Array,
    f: Array,
) -> None:
    """Displacements at the end of the step, the motion that makes the forces, and their first terms."""
    for i in range(f.shape[0]):
        half = v[i] + 0.5 * h * a[i]
        moved = q[i] + h * half
        f[i] = load[i] - diagonal[i] * half
        q[i] = moved
        displacement[i] = moved
        predicted[i] = v[i] + h * a[i]
        present[i] = v[i]


@kernel(inline=True, distinct=True, allocates=False)
def _shift(h: float, line: Array, displacement: Array, predicted: Array, present: Array) -> None:
    """Move the offsets of the unknowns' frames on a line, and add them and their rates to the motion."""
    n = displacement.shape[0]
    for i in range(n):
        line[n + i] += h * line[2 * n + i]
        displacement[i] += line[n + i]
        predicted[i] += line[2 * n + i]
        present[i] += line[2 * n + i]


@kernel(inline=True, distinct=True, allocates=False)
def _sum(a: Array, b: Array, out: Array) -> None:
    for i in range(out.shape[0]):
        out[i] = a[i] + b[i]


@kernel(inline=True, distinct=True, allocates=False)
def _correct(h: float, f: Array, mobility: Array, v: Array, a: Array) -> None:
    """Accelerations from forces, velocities at the end of the step."""
    for i in range(f.shape[0]):
        new = f[i] * mobility[i]
        v[i] += 0.5 * h * (a[i] + new)
        a[i] = new


@kernel(inline=True, allocates=False)
def read_track(
    lanes: Lanes, number: Array, wheelset_x: Array, irregularity: Array, clock: Array, rail: Array
) -> None:
    """Irregularities under each wheelset and their slopes along the track."""
    w = len(lanes)
    block = WHEELSETS * w
    for j in range(wheelset_x.shape[0] // w):
        for k in range(w):
            x = clock[w + k] + wheelset_x[j * w + k]
            i, w0, w1, w2, w3, d0, d1, d2, d3 = spline_weights(
                int(number[at.RAIL_COUNT * w + k]),
                number[at.RAIL_START * w + k],
                number[at.PER_RAIL_STEP * w + k],
                x,
            )
            first = int(number[at.RAIL_BASE * w + k]) + CHANNELS * i
            place = j * w + k
            weighted_rows(irregularity, first, (w0, w1, w2, w3), rail, place, block)
            weighted_rows(irregularity, first, (d0, d1, d2, d3), rail, SLOPE * block + place, block)


@kernel(inline=True, distinct=True, allocates=False)
def wheel_kinematics(lanes: Lanes, wheel: Array, y: Array, rail: Array, lane: Array) -> None:
    """Position and velocity of each wheel against its rail, into `Work.lane_in`, from its wheelset's."""
    n = LANES * len(lanes)
    block = n // 2
    for e in range(rail.shape[0] // (2 * SLOPE)):
        right = e + block
        speed = wheel[at.WHEEL_SPEED * n + e]
        alignment, vertical = rail[ALIGNMENT * block + e], rail[VERTICAL * block + e]
        half_gauge = 0.5 * rail[GAUGE * block + e]
        plane = rail[CROSS_LEVEL * block + e] + y[at.M_PLANE * block + e]
        plane_rate = speed * rail[(SLOPE + CROSS_LEVEL) * block + e] + y[at.M_PLANE_RATE * block + e]
        bottom = y[at.M_BOTTOM * block + e]
        offset = y[at.M_OFFSET * block + e] - alignment
        offset_rate = bottom - speed * rail[(SLOPE + ALIGNMENT) * block + e]
        rise = y[at.M_RISE * block + e] - speed * rail[(SLOPE + VERTICAL) * block + e]
        half_gauge_rate = 0.5 * speed * rail[(SLOPE + GAUGE) * block + e]
        roll, roll_rate = y[at.M_ROLL * block + e], y[at.M_ROLL_RATE * block + e]
        sway = wheel[at.RADIUS * n + e] * roll
        height = y[at.M_HEIGHT * block + e] - vertical - plane * offset + 0.5 * sway * roll
        lift_rate = rise - plane_rate * offset - plane * offset_rate + sway * roll_rate
        tilt, tilt_rate = roll - plane, roll_rate - plane_rate
        slip_y = bottom - speed * y[at.M_YAW * block + e]
        yaw = y[at.M_YAW * block + e] - rail[(SLOPE + ALIGNMENT) * block + e]
        slip_x, yaw_rate, spin_rate = (
            y[at.M_SLIP_X * block + e],
            y[at.M_YAW_RATE * block + e],
            y[at.M_SPIN_RATE * block + e],
        )
        lane[at.SIDE * n + e], lane[at.SIDE * n + right] = 1.0, -1.0
        lane[at.SHIFT * n + e], lane[at.SHIFT * n + right] = offset - half_gauge, -offset - half_gauge
        lane[at.OFFSET * n + e], lane[at.OFFSET * n + right] = offset, offset
        lane[at.LIFT * n + e] = height - wheel[at.APPROACH * n + e]
        lane[at.LIFT * n + right] = height - wheel[at.APPROACH * n + right]
        lane[at.TILT * n + e], lane[at.TILT * n + right] = tilt, -tilt
        lane[at.SWAY * n + e], lane[at.SWAY * n + right] = sway, sway
        lane[at.YAW * n + e], lane[at.YAW * n + right] = yaw, yaw
        lane[at.SLIP_X * n + e], lane[at.SLIP_X * n + right] = slip_x, slip_x
        lane[at.YAW_RATE * n + e], lane[at.YAW_RATE * n + right] = yaw_rate, yaw_rate
        lane[at.SPIN_RATE * n + e], lane[at.SPIN_RATE * n + right] = spin_rate, spin_rate
        lane[at.SLIP_Y * n + e], lane[at.SLIP_Y * n + right] = slip_y, slip_y
        lane[at.SHIFT_RATE * n + e] = offset_rate - half_gauge_rate
        lane[at.SHIFT_RATE * n + right] = -offset_rate - half_gauge_rate
        lane[at.LIFT_RATE * n + e], lane[at.LIFT_RATE * n + right] = lift_rate, lift_rate
        lane[at.TILT_RATE * n + e], lane[at.TILT_RATE * n + right] = tilt_rate, -tilt_rate
        lane[at.SLIP_Z * n + e], lane[at.SLIP_Z * n + right] = rise, rise
        lane[at.ROLL_RATE * n + e], lane[at.ROLL_RATE * n + right] = roll_rate, roll_rate
        lane[at.PLANE_RATE * n + e], lane[at.PLANE_RATE * n + right] = plane_rate, plane_rate
        lane[at.PLANE * n + e], lane[at.PLANE * n + right] = plane, plane


@kernel(inline=True, distinct=True, allocates=False)
def _touch(  # noqa: PLR0915 - one loop body, as the physics reads
    lanes: Lanes, wheel: Array, x: Array, table: Array, law: Array, patch: Array, out: Array
) -> None:
    """Contact geometry, normal force and creepages of all wheels, from `Work.lane_in`.

    Normal force: the gradient of the contact's potential (`sayd_env.physics.contact.geometry`), with
    Hunt-Crossley damping, zero when the wheel lifts off. Creepages: slip over V (Kalker), spin from yaw
    rate and contact angle.

    Forces are the transposes of the velocities on which they work, also in what is of second order:

    - The lowest points of a rolled wheelset lie r phi beside its centre and r phi^2 / 2 higher: the lever of
      the vertical forces is side * Y_c + r phi (REACH), in moments and in slips.
    - Yaw against the rails, psi (less the slope of their alignment), turns the tread across them: at the
      tread's speed V + `faster` the slip is psi (V + faster) / cos(gamma), and the lateral creep force has a
      moment about the axle. Rolling freely, a wheelset so has the longitudinal force -psi F_y. Forces are
      along the rail and across it.
    - Where the wheel's radius is larger by delta_r, as on its flange, lateral forces act by as much (less
      phi Y_c, by which roll lifts it) below the wheelset's lowest point, and roll moves the wheel across its
      rail there.
    - The contact's angle moves with its load, with roll and with yaw, as its potential asks for.

    Left out: the contact's motion with roll at a fixed shift in the lever, the way across inclined rails of a
    wheelset that stands higher over them, and the force along the track of rails at an angle to it.
    """
    n = LANES * len(lanes)
    for i in range(x.shape[0] // at.ROWS_IN):
        side = x[at.SIDE * n + i]
        radius, per_radius = wheel[at.RADIUS * n + i], wheel[at.PER_RADIUS * n + i]
        speed, per_speed = wheel[at.WHEEL_SPEED * n + i], wheel[at.PER_SPEED * n + i]
        per_step, last = wheel[at.PER_TABLE_STEP * n + i], wheel[at.TABLE_LAST * n + i]
        # Contact geometry at this shift, linear between the nodes of a fine table.
        place = (x[at.SHIFT * n + i] - wheel[at.TABLE_START * n + i]) * per_step
        place = place if place > 0.0 else 0.0
        place = place if place < last + 1.0 else last + 1.0
        below = place if place < last else last
        node = int(below)
        right = place - node
        left = 1.0 - right
        p = int(wheel[at.TABLE_BASE * n + i]) + node * geometry.WIDTH
        q = p + geometry.WIDTH
        delta_left, delta_right = table[p + geometry.DELTA_R], table[q + geometry.DELTA_R]
        delta_r = left * delta_left + right * delta_right
        delta_slope = (delta_right - delta_left) * per_step
        gap_0 = left * table[p + geometry.G0] + right * table[q + geometry.G0]
        arm_left, arm_right = table[p + geometry.Y_C], table[q + geometry.Y_C]
        arm = left * arm_left + right * arm_right
        arm_slope = (arm_right - arm_left) * per_step
        tilt_0 = left * table[p + geometry.PHI_K] + right * table[q + geometry.PHI_K]
        tangent_left, tangent_right = table[p + geometry.TAN_GAMMA], table[q + geometry.TAN_GAMMA]
        tangent = left * tangent_left + right * tangent_right
        tangent_slope = (tangent_right - tangent_left) * per_step
        soft = left * table[p + geometry.COMPLIANCE] + right * table[q + geometry.COMPLIANCE]
        soft_slope = (
            left * table[p + geometry.COMPLIANCE_SLOPE] + right * table[q + geometry.COMPLIANCE_SLOPE]
        )
        a_s = left * table[p + geometry.A_S] + right * table[q + geometry.A_S]
        b_s = left * table[p + geometry.B_S] + right * table[q + geometry.B_S]
        law[creep.C11 * n + i] = left * table[p + geometry.C11] + right * table[q + geometry.C11]
        law[creep.C22 * n + i] = left * table[p + geometry.C22] + right * table[q + geometry.C22]
        law[creep.C23 * n + i] = left * table[p + geometry.C23] + right * table[q + geometry.C23]

        # Vertical force of the elastic contact. Roll moves a wheel that is larger where it touches across its
        # rail, and so `nearer` to it; a yawed wheel touches ahead of or behind its axle, by `lead`.
        tilt, yaw, yaw_rate = x[at.TILT * n + i], x[at.YAW * n + i], x[at.YAW_RATE * n + i]
        rolling = radius + delta_r
        lever = arm - rolling * tangent
        lead = -side * yaw * lever
        raised = tangent * lever
        deeper = delta_r - tilt * arm
        nearer = tangent * deeper
        half_yaw, half_tilt = 0.5 * yaw * yaw, 0.5 * tilt * tilt
        gap = x[at.LIFT * n + i] + gap_0 + tilt * (arm - nearer)
        gap += half_yaw * raised - half_tilt * tangent * arm
        # The contact's slope is that of the gap. The table is made at the kinematic roll and without yaw.
        tangent += (
            (tilt_0 - tilt) * arm_slope
            + tilt * (tangent_slope * delta_r + tangent * delta_slope)
            - (half_yaw + half_tilt) * (tangent_slope * arm + tangent * arm_slope)
            + half_yaw * tangent * (2.0 * rolling * tangent_slope + tangent * delta_slope)
        )
        pressed = -gap if gap < 0.0 else 0.0
        power = pressed / soft
        root = math.sqrt(power)
        elastic = power * root

        # Another load than the static one moves the contact likewise: its potential changes with the shift.
        tangent -= 0.6 * soft_slope * (power - wheel[at.TABLE_LOAD * n + i])
        secant = math.sqrt(1.0 + tangent * tangent)
        cosine = 1.0 / secant
        sine = tangent * cosine
        gap_rate = (
            x[at.LIFT_RATE * n + i]
            + x[at.TILT_RATE * n + i] * (arm - nearer)
            + yaw * yaw_rate * raised
            - tangent * x[at.SHIFT_RATE * n + i]
        )
        factor = 1.0 - wheel[at.LOAD_FACTOR * n + i] * gap_rate * cosine
        up = elastic * (factor if factor > 0.0 else 0.0)
        normal = up * secant

        # Slip of the wheel over the rail, and creepages.
        reach = side * arm + x[at.SWAY * n + i]
        rail_arm = side * arm + x[at.OFFSET * n + i]
        faster = x[at.SPIN_RATE * n + i] * rolling + speed * delta_r * per_radius
        slip_x = x[at.SLIP_X * n + i] - yaw_rate * reach - faster
        slip_y = x[at.SLIP_Y * n + i] + lead * yaw_rate + side * x[at.TILT_RATE * n + i] * deeper
        slip_z = x[at.SLIP_Z * n + i] + x[at.ROLL_RATE * n + i] * reach - x[at.PLANE_RATE * n + i] * rail_arm
        # The tread moves across the rail, and touching ahead of its axle by r yaw tan(gamma) also downwards:
        # with both the slip of yaw is V yaw / cos(gamma), and along the normal none is left.
        slip_t = slip_y * cosine + side * sine * slip_z - yaw * (speed * tangent * sine + faster * secant)
        spin = yaw_rate * cosine * per_speed + side * (tilt * cosine - sine) * per_radius
        law[creep.XI_X * n + i] = slip_x * per_speed
        law[creep.XI_Y * n + i] = slip_t * per_speed
        law[creep.SPIN * n + i] = spin
        law[creep.BOUND * n + i] = wheel[at.FRICTION * n + i] * normal
        law[creep.SEMI_A * n + i] = a_s * root
        law[creep.SEMI_B * n + i] = b_s * root
        patch[at.TANGENT * n + i] = tangent
        patch[at.SECANT * n + i] = secant
        patch[at.LEAD * n + i] = lead
        patch[at.RAISED * n + i] = raised
        patch[at.DEEPER * n + i] = deeper
        patch[at.NEARER * n + i] = nearer
        patch[at.ROLLING * n + i] = rolling
        patch[at.REACH * n + i] = reach
        patch[at.RAIL_ARM * n + i] = rail_arm
        patch[at.UP * n + i] = up
        patch[at.CREEP_X * n + i] = slip_x
        patch[at.CREEP_T * n + i] = slip_t
        patch[at.CREEP_SPIN * n + i] = spin * speed
        out[at.NORMAL * n + i] = normal
        out[at.PENETRATION * n + i] = pressed * cosine
        out[at.POWER_DAMPING * n + i] = (elastic - up) * gap_rate
        out[at.STORED * n + i] = 0.4 * elastic * pressed


@kernel(inline=True, distinct=True, allocates=False)
def _resultants(lanes: Lanes, wheel: Array, x: Array, patch: Array, law: Array, out: Array) -> None:
    """What the wheels' forces do to the wheelsets (about their centres) and to the track sections."""
    n = LANES * len(lanes)
    for i in range(x.shape[0] // at.ROWS_IN):
        side, yaw = x[at.SIDE * n + i], x[at.YAW * n + i]
        force_x, force_t, moment = law[creep.FX * n + i], law[creep.FY * n + i], law[creep.MZ * n + i]
        tangent, secant, up = patch[at.TANGENT * n + i], patch[at.SECANT * n + i], patch[at.UP * n + i]
        reach, lead = patch[at.REACH * n + i], patch[at.LEAD * n + i]
        cosine = 1.0 / secant
        creep_y = force_t * cosine
        force_y = creep_y - up * (side * tangent + x[at.PLANE * n + i])
        force_z = up + side * tangent * creep_y
        upright = moment * cosine
        below = patch[at.DEEPER * n + i] * creep_y - side * up * patch[at.NEARER * n + i]
        out[at.FORCE_X * n + i] = force_x
        out[at.FORCE_Y * n + i] = force_y
        out[at.FORCE_Z * n + i] = force_z
        out[at.MOMENT_ROLL * n + i] = wheel[at.RADIUS * n + i] * force_y + reach * force_z + below
        out[at.MOMENT_PITCH * n + i] = (
            -patch[at.ROLLING * n + i] * (force_x + yaw * secant * force_t) - side * tangent * upright
        )
        out[at.MOMENT_YAW * n + i] = (
            -reach * force_x + lead * creep_y + up * yaw * patch[at.RAISED * n + i] + upright
        )
        out[at.MOMENT_TRACK * n + i] = -patch[at.RAIL_ARM * n + i] * force_z - below
        out[at.POWER_SLIP * n + i] = -(
            force_x * patch[at.CREEP_X * n + i]
            + force_t * patch[at.CREEP_T * n + i]
            + moment * patch[at.CREEP_SPIN * n + i]
        )


@kernel(allocates=False)
def _creep(which: int, x: Array, out: Array, scratch: Array, table: Array, shear_modulus: float) -> None:
    """Creep forces of all wheels by one of the laws."""
    if which == creep.TABLE:
        creep.table_rows(x, out, scratch, table, shear_modulus)
    elif which == creep.POLACH:
        creep.polach_rows(x, out, scratch, table, shear_modulus)
    else:
        creep.fastsim_rows(x, out, scratch, table, shear_modulus)


@kernel(inline=True, allocates=False)
def step_stops(stretch: Array, shift: Array, force: Array, out: Array) -> None:
    """Forces of the lateral stops at their elongations."""
    for i in range(stretch.shape[0]):
        size = abs(stretch[i])
        if size <= shift[1, i] and force[1, i] == 0.0:
            out[i] = 0.0
        else:
            out[i] = math.copysign(_curve(shift[:, i], force[:, i], size), stretch[i])


@kernel(allocates=False)
def _curve(x: Array, y: Array, place: float) -> float:
    """Piecewise-linear interpolation for place >= 0, the last segment going on."""
    p = 0
    while p < x.shape[0] - 2 and place > x[p + 1]:
        p += 1
    return float(y[p] + (place - x[p]) * (y[p + 1] - y[p]) / (x[p + 1] - x[p]))


@kernel(inline=True, distinct=True, allocates=False)
def step_dampers(
    h: float,
    shift: Array,
    velocity: Array,
    knot: Array,
    slope: Array,
    stiffness: Array,
    elongation: Array,
    piston: Array,
    force: Array,
) -> None:
    """Advance the Maxwell dampers by the trapezoidal rule, exactly on their piecewise-linear curves.

    The force F in spring and viscous part obeys F' = k (x' - w), F = curve(w). With kappa = k h / 2:
    curve(w_1) + kappa w_1 = F_0 - kappa w_0 + k (x_1 - x_0), whose left side rises strictly.

    Parameters
    ----------
    h : float
        Time step, s.
    shift : ndarray, shape (m,)
        Elongations at the end of the step, m.
    velocity, knot, slope : ndarray, shape (p, m)
    stiffness : ndarray, shape (m,)
        As in `Plant`.
    elongation, piston, force : ndarray, shape (m,)
        As in `State`; advanced.
    """
    for k in range(shift.shape[0]):
        kappa = 0.5 * h * stiffness[k]
        force[k] = force[k] - kappa * piston[k] + stiffness[k] * (shift[k] - elongation[k])
        elongation[k] = shift[k]
        piston[k] = abs(force[k]) * slope[0, k]
    for p in range(1, knot.shape[0]):
        for k in range(shift.shape[0]):
            over = abs(force[k]) - knot[p, k]
            beyond = velocity[p, k] + over * slope[p, k]
            piston[k] = beyond if over > 0.0 else piston[k]
    for k in range(shift.shape[0]):
        speed = piston[k] if force[k] >= 0.0 else -piston[k]
        piston[k] = speed
        force[k] -= 0.5 * h * stiffness[k] * speed


@kernel(inline=True, allocates=False)
def _copy(values: Array, row: Array) -> None:
    for i in range(values.shape[0]):
        row[i] = values[i]


@kernel(distinct=True, allocates=False)
def _follow_lost_ends(n: int, state: Array, inputs: Array) -> None:
    """Torn off the bogie, a damper's rod goes with its housing."""
    for k in range(n):
        attached = state[sayd.ATTACHED * n + k] != 0.0
        stroke = state[sayd.STROKE * n + k]
        end, rate, old = (
            inputs[sayd.END_1 * n + k],
            inputs[sayd.RATE_1 * n + k],
            inputs[sayd.OLD_RATE_1 * n + k],
        )
        housing, its_rate = inputs[sayd.END_2 * n + k], inputs[sayd.RATE_2 * n + k]
        its_old = inputs[sayd.OLD_RATE_2 * n + k]
        inputs[sayd.END_1 * n + k] = end if attached else housing + stroke
        inputs[sayd.RATE_1 * n + k] = rate if attached else its_rate
        inputs[sayd.OLD_RATE_1 * n + k] = old if attached else its_old


@kernel(distinct=True, allocates=False)
def _sayd_forces(n: int, state: Array, forces: Array) -> None:
    """What the semi-active dampers do: F_1 on bogies, F_2 on the carbody, nothing if they are lost."""
    for k in range(n):
        attached = state[sayd.ATTACHED * n + k]
        forces[k] = attached * state[sayd.FORCE_1 * n + k]
        forces[n + k] = attached * state[sayd.FORCE_2 * n + k]


@kernel(inline=True, allocates=False)
def wheels(lanes: Lanes, plant: Plant, work: Work) -> None:
    """Contact: from kinematics in `Work.y` and irregularities in `Work.rail` to the wheels' forces."""
    n = LANES * len(lanes)
    first = 3 * work.f.shape[0]
    out = work.x[first : first + at.ROWS_OUT * n]
    wheel = work.wheel if plant.line.shape[0] > 0 else plant.wheel
    wheel_kinematics(lanes, wheel, work.y, work.rail, work.lane_in)
    blended = work.shape.shape[0] > 0 and between(lanes, work)
    if blended:
        blend(lanes, plant, work)
    table = work.shape if blended else plant.table
    _touch(lanes, wheel, work.lane_in, table, work.creep_in, work.patch, out)
    scratch = work.creep_scratch[: creep.SCRATCH_ROWS * n + creep.WIDTH]
    which, shear_modulus = int(plant.number[at.CREEP_LAW * len(lanes)]), wheel[at.SHEAR_MODULUS * n]
    _creep(which, work.creep_in, work.creep_out, scratch, plant.creep, shear_modulus)
    _resultants(lanes, wheel, work.lane_in, work.patch, work.creep_out, out)


@kernel(inline=True, allocates=False)
def contact(lanes: Lanes, plant: Plant, clock: Array, work: Work) -> None:
    """Track and contact."""
    read_track(lanes, plant.number, plant.wheelset_x, plant.irregularity, clock, work.rail)
    wheels(lanes, plant, work)


@kernel(inline=True, allocates=False)
def motions(lanes: Lanes, plant: Plant, work: Work) -> None:
    """Kinematics of wheelsets, dampers and stops in `Work.y`, from the motion in `Work.x`."""
    multiply(lanes, plant.motion_start, plant.motion_column, plant.motion_value, work.x, work.y)
    if plant.line.shape[0] > 0:
        turn(lanes, plant, work)


@kernel(inline=True, allocates=False)
def forces(lanes: Lanes, plant: Plant, work: Work) -> None:
    """Add suspension, contact, dampers and stops to the generalised forces, all from `Work.x`."""
    add_product(lanes, plant.force_start, plant.force_column, plant.force_value, work.x, work.f)


@kernel(inline=True, allocates=False)
def sections(lanes: Lanes, plant: Plant, work: Work) -> tuple[int, int, int, int, int]:
    """Where Maxwell, semi-active dampers and stops begin in `Work.x`, Maxwell dampers and stops in y."""
    w = len(lanes)
    m = plant.damper_stiffness.shape[0]
    x_dampers = 3 * work.f.shape[0] + at.ROWS_OUT * LANES * w
    x_sayds = x_dampers + m
    x_stops = x_sayds + (2 * LANES * w if plant.sayd_constant.shape[0] > 0 else 0)
    y_dampers = at.MOTIONS * WHEELSETS * w
    return x_dampers, x_sayds, x_stops, y_dampers, y_dampers + m


@kernel(inline=True, allocates=False)
def dampers(lanes: Lanes, plant: Plant, state: State, work: Work) -> None:
    """Advance the Maxwell dampers."""
    x_dampers, x_sayds, _, y_dampers, y_stops = sections(lanes, plant, work)
    step_dampers(
        plant.number[at.STEP * len(lanes)],
        work.y[y_dampers:y_stops],
        plant.damper_velocity,
        plant.damper_knot,
        plant.damper_slope,
        plant.damper_stiffness,
        state.elongation,
        state.piston,
        state.force,
    )
    _copy(state.force, work.x[x_dampers:x_sayds])


@kernel(inline=True, allocates=False)
def stops(lanes: Lanes, plant: Plant, work: Work) -> None:
    """Press the lateral stops."""
    _, _, x_stops, _, y_stops = sections(lanes, plant, work)
    count = plant.stop_shift.shape[1]
    stretch = work.y[y_stops : y_stops + count]
    step_stops(stretch, plant.stop_shift, plant.stop_force, work.x[x_stops:])


@kernel(inline=True, allocates=False)
def sayds(lanes: Lanes, plant: Plant, state: State, work: Work) -> None:
    """Advance the semi-active dampers over the step that ends with the motion in `Work.y`."""
    w = len(lanes)
    _, x_sayds, x_stops, _, y_stops = sections(lanes, plant, work)
    inputs = work.y[y_stops + plant.stop_shift.shape[1] :]
    h, substeps = plant.number[at.STEP * w], int(plant.number[at.SUBSTEPS * w])
    _follow_lost_ends(LANES * w, state.sayd, inputs)
    sayd.move_valves(lanes, plant.sayd_constant, state.sayd_line, inputs, state.sayd)
    sayd.integrate(lanes, h, substeps, plant.sayd_constant, plant.sayd_table, inputs, state.sayd)
    _sayd_forces(LANES * w, state.sayd, work.x[x_sayds:x_stops])


@kernel(inline=True, allocates=False)
def predict(lanes: Lanes, plant: Plant, state: State, work: Work) -> None:
    """Begin a step: move displacements and clock, and predict the velocities."""
    w, n = len(lanes), state.q.shape[0]
    h = plant.number[at.STEP * w]
    _predict(
        h,
        state.q,
        state.v,
        state.a,
        work.line[:n] if plant.line.shape[0] > 0 else plant.load,
        plant.damping_diagonal,
        work.x[:n],
        work.x[n : 2 * n],
        work.x[2 * n : 3 * n],
        work.f,
    )
    if plant.line.shape[0] > 0 and curved(lanes, work):
        _shift(h, work.line, work.x[:n], work.x[n : 2 * n], work.x[2 * n : 3 * n])
    for k in range(w):
        state.clock[k] += h
        state.clock[w + k] += h * speed_of(lanes, k, plant, work)


@kernel(inline=True, allocates=False)
def steps(lanes: Lanes, plant: Plant, state: State, work: Work, count: int, first: bool) -> None:
    """Advance vehicles by a number of the plant's time steps, in which the conditions of a line hold.

    `first` says that `Work` is not from the steps before.
    """
    if plant.line.shape[0] > 0:
        follow(lanes, plant, state.clock, work, count, first)
    for _ in range(count):
        predict(lanes, plant, state, work)
        motions(lanes, plant, work)
        contact(lanes, plant, state.clock, work)
        dampers(lanes, plant, state, work)
        if state.sayd.shape[0] > 0:
            sayds(lanes, plant, state, work)
        stops(lanes, plant, work)
        forces(lanes, plant, work)
        _correct(plant.number[at.STEP * len(lanes)], work.f, plant.mobility, state.v, state.a)


@kernel(allocates=False)
def step(plant: Plant, state: State, work: Work) -> None:
    """Advance one vehicle by the plant's time step."""
    steps(SINGLE, plant, state, work, 1, True)


@kernel(allocates=False)
def _set_motion(q: Array, v: Array, x: Array) -> None:
    """Write one vehicle's displacements and velocities into `Work.x`."""
    n = q.shape[0]
    for i in range(n):
        x[i] = q[i]
        x[n + i] = v[i]
        x[2 * n + i] = v[i]


@kernel(allocates=False)
def contact_at(plant: Plant, q: Array, v: Array, position: float, work: Work) -> None:
    """Contact of one vehicle at displacements and velocities (n,) and a position on the track (m)."""
    _set_motion(q, v, work.x)
    motions(SINGLE, plant, work)
    clock = work.f  # scratch, and never shorter
    clock[0], clock[1] = 0.0, position
    contact(SINGLE, plant, clock, work)


@kernel(allocates=False)
def rates(plant: Plant, position: float, q: Array, v: Array, force: Array, work: Work, out: Array) -> None:
    """Time derivative of (q, v, F) of one vehicle for a general integrator: the same forces as `steps`.

    Semi-active dampers have states of their own and are left out.

    Parameters
    ----------
    plant : Plant
    position : float
        Position of the vehicle's centre along the track, m.
    q, v, force : ndarray
        Displacements (n,), velocities (n,), damper forces (m,).
    work : Work
        Scratch; holds the contact's outputs afterwards.
    out : ndarray, shape (2 n + m,)
        The derivative.
    """
    n = q.shape[0]
    x_dampers, x_sayds, x_stops, y_dampers, _ = sections(SINGLE, plant, work)
    # Rates of the dampers' elongations: their rows act on displacements.
    _set_motion(v, v, work.x)
    motions(SINGLE, plant, work)
    for k in range(force.shape[0]):
        size = _curve(plant.damper_force[:, k], plant.damper_velocity[:, k], abs(force[k]))
        piston = math.copysign(size, force[k])
        out[2 * n + k] = plant.damper_stiffness[k] * (work.y[y_dampers + k] - piston)
    work.x[x_sayds:x_stops] = 0.0
    contact_at(plant, q, v, position, work)
    _copy(force, work.x[x_dampers:x_sayds])
    stops(SINGLE, plant, work)
    for i in range(n):
        work.f[i] = plant.load[i] - plant.damping_diagonal[i] * v[i]
    forces(SINGLE, plant, work)
    for i in range(n):
        out[i] = v[i]
        out[n + i] = work.f[i] / plant.mass[i]


@kernel(inline=True, allocates=False)
def measure(lanes: Lanes, plant: Plant, state: State, work: Work) -> None:
    """Accelerations of the measuring points at this instant, on a line against free fall: `Work.measured`."""
    n = state.a.shape[0]
    moved = plant.line.shape[0] > 0 and curved(lanes, work)
    if moved:
        _sum(state.a, work.line[3 * n : 4 * n], work.f)
    a = work.f if moved else state.a
    multiply(lanes, plant.measure_start, plant.measure_column, plant.measure_value, a, work.measured)


@kernel(inline=True, allocates=False)
def record(lanes: Lanes, k: int, plant: Plant, state: State, work: Work, row: Array) -> None:
    """Write the assessed signals of vehicle k at this instant; `measure` comes before.

    Order: bogie-frame lateral acceleration above each wheelset (w), track shift force of each wheelset (w),
    force of each yaw damper (the rest of the row).
    """
    w = len(lanes)
    n = LANES * w
    first = 3 * work.f.shape[0] + at.FORCE_Y * n
    count = plant.wheelset_x.shape[0] // w
    for j in range(count):
        left, right = j * w + k, (WHEELSETS + j) * w + k
        row[j] = work.measured[left]
        row[count + j] = -(work.x[first + left] + work.x[first + right])
    for j in range(row.shape[0] - 2 * count):
        place = j * w + k
        if state.sayd.shape[0] > 0:
            row[2 * count + j] = state.sayd[sayd.ATTACHED * n + place] * state.sayd[sayd.FORCE_1 * n + place]
        else:
            row[2 * count + j] = state.force[place]


@kernel(inline=True, allocates=False)
def record_wheels(lanes: Lanes, k: int, work: Work, row: Array) -> None:
    """Write lateral and vertical force of each wheel of vehicle k on the rail.

    Two rows of LANES, in each the wheelsets one after another, left and right in turn.
    """
    w = len(lanes)
    n = LANES * w
    first = 3 * work.f.shape[0]
    for j in range(WHEELSETS):
        for side in range(2):
            place = first + (side * WHEELSETS + j) * w + k
            row[2 * j + side] = -work.x[at.FORCE_Y * n + place]
            row[LANES + 2 * j + side] = work.x[at.FORCE_Z * n + place]


@kernel(inline=True, allocates=False)
def largest_shift(lanes: Lanes, k: int, plant: Plant, work: Work) -> float:
    """Largest shift of a wheel of vehicle k towards its flange over that of the contact table's end.

    Beyond 1 the wheel has climbed its rail.
    """
    w = len(lanes)
    largest = 0.0
    for i in range(LANES):
        largest = max(largest, work.lane_in[(at.SHIFT * LANES + i) * w + k])
    return float(largest / plant.number[at.WIDEST * w + k])


@kernel(allocates=False, announce="the simulator (first start, about 10 s)")
def advance(
    plant: Plant,
    state: State,
    work: Work,
    substeps: int,
    signals: Array,
    wheels: Array,
    motion: Array,
    sayds: Array,
) -> int:
    """Advance one vehicle by as many samples as `signals` has rows, `substeps` steps each.

    Parameters
    ----------
    plant, state, work
        One vehicle.
    substeps : int
        Steps between two samples.
    signals : ndarray, shape (samples, 2 w + d)
        Receives the signals of `record`.
    wheels : ndarray, shape (samples or 0, 2 LANES)
        Receives the wheel forces of `record_wheels`, unless it is empty.
    motion : ndarray, shape (samples or 0, n)
        Receives the displacements q, unless it is empty.
    sayds : ndarray, shape (samples or 0, sayd.STATES * LANES)
        Receives the states of the semi-active dampers, unless it is empty.

    Returns
    -------
    int
        Number of samples taken: fewer than asked for if the state is no longer finite or a wheel has left
        the contact table.
    """
    for t in range(signals.shape[0]):
        steps(SINGLE, plant, state, work, substeps, t == 0)
        measure(SINGLE, plant, state, work)
        record(SINGLE, 0, plant, state, work, signals[t])
        if wheels.shape[0] > 0:
            record_wheels(SINGLE, 0, work, wheels[t])
        if motion.shape[0] > 0:
            _copy(state.q, motion[t])
        if sayds.shape[0] > 0:
            _copy(state.sayd, sayds[t])
        if not math.isfinite(signals[t, 0] + state.v[0]) or largest_shift(SINGLE, 0, plant, work) >= 1.0:
            return t
    return int(signals.shape[0])
