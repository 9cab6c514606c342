"""One compiled time step of one vehicle: track and contact, suspension, dampers, integration, in this order.

Scheme: explicit Newmark (beta = 0, gamma = 1/2) with one evaluation of the forces for each step,

    q_1 = q_0 + h v_0 + h^2/2 a_0
    M a_1 = f(q_1, v_0 + h a_0) - D (v_0 + h/2 (a_0 + a_1))
    v_1 = v_0 + h/2 (a_0 + a_1)

The velocity in the forces is predicted; the diagonal D of the damping matrix (the strongly damped track
sections) is treated implicitly, which costs a division. Maxwell dampers use the trapezoidal rule, solved
exactly on their piecewise-linear curves; semi-active dampers take steps of their own between the same
instants (`sayd_env.physics.sayd`). All of it is second order in h.
"""

from __future__ import annotations

import math

from sayd_env.physics import sayd
from sayd_env.physics.contact import geometry
from sayd_env.physics.contact.polach import polach
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import LANES, Array, Plant, State, Work
from sayd_env.physics.track.spline import spline_weights

# Rows of `Work.rail`: values and slopes of the irregularities.
ALIGNMENT, VERTICAL, CROSS_LEVEL, GAUGE = 0, 1, 2, 3
SLOPE = 4

# Rows of `Work.lane_in`: the kinematics of a wheel against its rail.
(
    SIDE,  # +1 left, -1 right
    SHIFT,  # lateral shift of the wheel towards flange contact, m
    OFFSET,  # lateral offset of the wheelset from the track's centre at rail level, m
    LIFT,  # height of the unloaded wheelset over the track plane at the centre, m
    TILT,  # roll of the wheelset against the track plane, times side
    SWAY,  # lateral position of the wheelset's lowest point over its centre: radius times roll, m
    YAW,  # against the rails: less the slope of their alignment
    SLIP_X,  # longitudinal slip velocity of the axle's centre, m/s
    YAW_RATE,
    SPIN_RATE,  # pitch rate over the nominal one, rad/s
    SLIP_Y,  # lateral slip velocity at rail level, m/s
    SHIFT_RATE,  # d SHIFT / dt, m/s
    LIFT_RATE,  # d LIFT / dt, m/s
    TILT_RATE,
    SLIP_Z,  # vertical velocity of the axle's centre over the rail's, m/s
    ROLL_RATE,  # wheelset, rad/s
    PLANE_RATE,  # turning of the track plane with the train, rad/s
    PLANE,  # angle of the track plane, rad
    LOAD_FACTOR,  # Hunt-Crossley factor, s/m
    ROWS_IN,
) = range(20)

# Rows of `Work.lane_out`: what the contact does to wheelset and track.
(
    FORCE_X,
    FORCE_Y,
    FORCE_Z,
    MOMENT_ROLL,
    MOMENT_PITCH,
    MOMENT_YAW,
    MOMENT_TRACK,  # roll moment on the track section
    NORMAL,  # normal force, N
    PENETRATION,  # normal approach, m
    POWER_SLIP,  # dissipated by slip, W
    POWER_DAMPING,  # dissipated by the contact damping, W
    STORED,  # elastic energy of the contact, J
    ROWS_OUT,
) = range(13)


@kernel(allocates=False)
def read_track(plant: Plant, position: float, work: Work) -> None:
    """Irregularities under each wheelset and their slopes along the track."""
    c, rail = plant.irregularity, work.rail
    for j in range(plant.wheelset_x.shape[0]):
        x = position + plant.wheelset_x[j]
        i, w0, w1, w2, w3, d0, d1, d2, d3 = spline_weights(
            c.shape[0], plant.irregularity_start, plant.irregularity_step, x
        )
        for k in range(SLOPE):
            rail[j, k] = w0 * c[i, k] + w1 * c[i + 1, k] + w2 * c[i + 2, k] + w3 * c[i + 3, k]
            rail[j, SLOPE + k] = d0 * c[i, k] + d1 * c[i + 1, k] + d2 * c[i + 2, k] + d3 * c[i + 3, k]


@kernel(allocates=False)
def wheel_kinematics(plant: Plant, q: Array, v: Array, work: Work) -> None:
    """Position and velocity of each wheel against its rail, into `work.lane_in`."""
    lane = work.lane_in
    speed, radius = plant.speed, plant.radius
    for j in range(plant.wheelset_x.shape[0]):
        w, s, rail = plant.wheelset_dofs[j], plant.section_dofs[j], work.rail[j]
        plane = rail[CROSS_LEVEL] + q[s[2]]
        plane_rate = speed * rail[SLOPE + CROSS_LEVEL] + v[s[2]]
        bottom = v[w[1]] + radius * v[w[3]] - v[s[0]]
        offset = q[w[1]] + radius * q[w[3]] - rail[ALIGNMENT] - q[s[0]]
        offset_rate = bottom - speed * rail[SLOPE + ALIGNMENT]
        rise = v[w[2]] - v[s[1]] - speed * rail[SLOPE + VERTICAL]
        sway = radius * q[w[3]]
        lift = q[w[2]] - q[s[1]] - rail[VERTICAL] - plane * offset + 0.5 * sway * q[w[3]] - plant.approach[j]
        lift_rate = rise - plane_rate * offset - plane * offset_rate + sway * v[w[3]]
        for k in range(2):
            i, side = 2 * j + k, 1.0 - 2.0 * k
            lane[SIDE * LANES + i] = side
            lane[SHIFT * LANES + i] = side * offset - 0.5 * rail[GAUGE]
            lane[OFFSET * LANES + i] = offset
            lane[LIFT * LANES + i] = lift
            lane[TILT * LANES + i] = side * (q[w[3]] - plane)
            lane[SWAY * LANES + i] = sway
            lane[YAW * LANES + i] = q[w[5]] - rail[SLOPE + ALIGNMENT]
            lane[SLIP_X * LANES + i] = v[w[0]]
            lane[YAW_RATE * LANES + i] = v[w[5]]
            lane[SPIN_RATE * LANES + i] = v[w[4]]
            lane[SLIP_Y * LANES + i] = bottom - speed * q[w[5]]
            lane[SHIFT_RATE * LANES + i] = side * offset_rate - 0.5 * speed * rail[SLOPE + GAUGE]
            lane[LIFT_RATE * LANES + i] = lift_rate
            lane[TILT_RATE * LANES + i] = side * (v[w[3]] - plane_rate)
            lane[SLIP_Z * LANES + i] = rise
            lane[ROLL_RATE * LANES + i] = v[w[3]]
            lane[PLANE_RATE * LANES + i] = plane_rate
            lane[PLANE * LANES + i] = plane
            lane[LOAD_FACTOR * LANES + i] = plant.contact_damping[j]


@kernel(allocates=False)
def wheel_forces(plant: Plant, work: Work) -> None:  # noqa: PLR0915 - one loop body, as the physics reads
    """Normal and creep forces of all wheels, from `work.lane_in` into `work.lane_out`.

    One branch-free loop over eight wheels, which compiles to vector instructions. Normal force: the gradient
    of the contact's potential (`sayd_env.physics.contact.geometry`), with Hunt-Crossley damping, zero when
    the wheel lifts off. Creepages: slip over V (Kalker), spin from yaw rate and contact angle. Creep forces:
    Polach.

    Forces are the transposes of the velocities on which they work, also in what is of second order:

    - The lowest points of a rolled wheelset lie r phi beside its centre and r phi^2 / 2 higher: the lever of
      the vertical forces is side * Y_c + r phi (`reach`), in moments and in slips.
    - Yaw against the rails, psi (less the slope of their alignment), turns the tread across them: at the
      tread's speed V + `faster` the slip is psi (V + faster) / cos(gamma), and the lateral creep force has a
      moment about the axle. Rolling freely, a wheelset so has the longitudinal force -psi F_y. Forces are
      along the rail and across it.
    - The contact's angle moves with its load, as its potential asks for.

    Left out: the spin moment, the contact's motion with roll at a fixed shift in the lever, the wheel's other
    height over rail level at a climbed flange, and the force along the track of rails at an angle to it.
    """
    x, out, table = work.lane_in, work.lane_out, plant.table
    nodes = table.shape[0] // geometry.WIDTH
    per_step, last = 1.0 / plant.table_step, float(nodes - 2)
    speed, radius = plant.speed, plant.radius
    per_speed, per_radius = 1.0 / speed, 1.0 / radius
    start = plant.table_start
    friction, shear, rest = plant.friction, plant.shear_modulus, plant.table_load
    for i in range(x.shape[0] // ROWS_IN):
        side = x[SIDE * LANES + i]
        # Contact geometry at this shift, linear between the nodes of a fine table.
        place = (x[SHIFT * LANES + i] - start) * per_step
        place = place if place > 0.0 else 0.0
        place = place if place < last else last
        node = int(place)
        right = place - node
        left = 1.0 - right
        p = node * geometry.WIDTH
        n = p + geometry.WIDTH
        delta_r = left * table[p + geometry.DELTA_R] + right * table[n + geometry.DELTA_R]
        gap_0 = left * table[p + geometry.G0] + right * table[n + geometry.G0]
        arm = left * table[p + geometry.Y_C] + right * table[n + geometry.Y_C]
        arm_slope = (table[n + geometry.Y_C] - table[p + geometry.Y_C]) * per_step
        tilt_0 = left * table[p + geometry.PHI_K] + right * table[n + geometry.PHI_K]
        tangent = left * table[p + geometry.TAN_GAMMA] + right * table[n + geometry.TAN_GAMMA]
        soft = left * table[p + geometry.COMPLIANCE] + right * table[n + geometry.COMPLIANCE]
        soft_slope = (
            left * table[p + geometry.COMPLIANCE_SLOPE] + right * table[n + geometry.COMPLIANCE_SLOPE]
        )
        a_s = left * table[p + geometry.A_S] + right * table[n + geometry.A_S]
        b_s = left * table[p + geometry.B_S] + right * table[n + geometry.B_S]
        c11 = left * table[p + geometry.C11] + right * table[n + geometry.C11]
        c22 = left * table[p + geometry.C22] + right * table[n + geometry.C22]
        c23 = left * table[p + geometry.C23] + right * table[n + geometry.C23]
        gain = left * table[p + geometry.SPIN_GAIN] + right * table[n + geometry.SPIN_GAIN]

        # The table is made at the kinematic roll; another roll moves the contact and so the slope.
        tilt, yaw, plane = x[TILT * LANES + i], x[YAW * LANES + i], x[PLANE * LANES + i]
        tangent += (tilt_0 - tilt) * arm_slope

        # Vertical force of the elastic contact. A yawed wheel touches ahead of or behind its axle, by `lead`.
        lever = arm - radius * tangent
        lead = -side * yaw * lever
        raised = tangent * lever
        gap = x[LIFT * LANES + i] + tilt * arm + gap_0 + 0.5 * yaw * yaw * raised
        pressed = -gap if gap < 0.0 else 0.0
        power = pressed / soft
        root = math.sqrt(power)
        elastic = power * root

        # Another load than the static one moves the contact likewise: its potential changes with the shift.
        tangent -= 0.6 * soft_slope * (power - rest)
        secant = math.sqrt(1.0 + tangent * tangent)
        cosine = 1.0 / secant
        sine = tangent * cosine
        gap_rate = (
            x[LIFT_RATE * LANES + i]
            + x[TILT_RATE * LANES + i] * arm
            + yaw * x[YAW_RATE * LANES + i] * raised
            - tangent * x[SHIFT_RATE * LANES + i]
        )
        factor = 1.0 - x[LOAD_FACTOR * LANES + i] * gap_rate * cosine
        up = elastic * (factor if factor > 0.0 else 0.0)
        normal = up * secant

        # Slip of the wheel over the rail, and creepages. The contact lies at `reach` from the wheelset's
        # centre and at `rail_arm` from the track's.
        reach = side * arm + x[SWAY * LANES + i]
        rail_arm = side * arm + x[OFFSET * LANES + i]
        rolling = radius + delta_r
        faster = x[SPIN_RATE * LANES + i] * rolling + speed * delta_r * per_radius
        slip_x = x[SLIP_X * LANES + i] - x[YAW_RATE * LANES + i] * reach - faster
        slip_y = x[SLIP_Y * LANES + i] + lead * x[YAW_RATE * LANES + i]
        slip_z = (
            x[SLIP_Z * LANES + i] + x[ROLL_RATE * LANES + i] * reach - x[PLANE_RATE * LANES + i] * rail_arm
        )
        # The tread moves across the rail, and touching ahead of its axle by r yaw tan(gamma) also downwards:
        # with both the slip of yaw is V yaw / cos(gamma), and along the normal none is left.
        slip_t = slip_y * cosine + side * sine * slip_z - yaw * (speed * tangent * sine + faster * secant)
        spin = x[YAW_RATE * LANES + i] * cosine * per_speed + side * (tilt * cosine - sine) * per_radius
        force_x, force_t = polach(
            slip_x * per_speed,
            slip_t * per_speed,
            spin,
            normal,
            a_s * root,
            b_s * root,
            c11,
            c22,
            c23,
            gain,
            friction,
            shear,
        )

        # Resultants on the wheelset (about its centre) and on the track section.
        creep_y = force_t * cosine
        force_y = creep_y - up * (side * tangent + plane)
        force_z = up + side * sine * force_t
        out[FORCE_X * LANES + i] = force_x
        out[FORCE_Y * LANES + i] = force_y
        out[FORCE_Z * LANES + i] = force_z
        out[MOMENT_ROLL * LANES + i] = radius * force_y + reach * force_z
        out[MOMENT_PITCH * LANES + i] = -rolling * (force_x + yaw * secant * force_t)
        out[MOMENT_YAW * LANES + i] = -reach * force_x + lead * creep_y + up * yaw * raised
        out[MOMENT_TRACK * LANES + i] = -rail_arm * force_z
        out[NORMAL * LANES + i] = normal
        out[PENETRATION * LANES + i] = pressed * cosine
        out[POWER_SLIP * LANES + i] = -(force_x * slip_x + force_t * slip_t)
        out[POWER_DAMPING * LANES + i] = (elastic - up) * gap_rate
        out[STORED * LANES + i] = 0.4 * elastic * pressed


@kernel(allocates=False)
def add_contact(plant: Plant, work: Work) -> None:
    """Add the wheels' resultants, less the static loads, to the generalised forces."""
    out, f = work.lane_out, work.f
    for j in range(plant.wheelset_x.shape[0]):
        w, s, load = plant.wheelset_dofs[j], plant.section_dofs[j], 2.0 * plant.wheel_load[j]
        left, right = 2 * j, 2 * j + 1
        lateral = out[FORCE_Y * LANES + left] + out[FORCE_Y * LANES + right]
        vertical = out[FORCE_Z * LANES + left] + out[FORCE_Z * LANES + right] - load
        f[w[0]] += out[FORCE_X * LANES + left] + out[FORCE_X * LANES + right]
        f[w[1]] += lateral
        f[w[2]] += vertical
        f[w[3]] += out[MOMENT_ROLL * LANES + left] + out[MOMENT_ROLL * LANES + right]
        f[w[4]] += out[MOMENT_PITCH * LANES + left] + out[MOMENT_PITCH * LANES + right]
        f[w[5]] += out[MOMENT_YAW * LANES + left] + out[MOMENT_YAW * LANES + right]
        f[s[0]] -= lateral
        f[s[1]] -= vertical
        f[s[2]] += out[MOMENT_TRACK * LANES + left] + out[MOMENT_TRACK * LANES + right]


@kernel(allocates=False)
def add_suspension(plant: Plant, q: Array, v: Array, work: Work) -> None:
    """Add -K q - C v (C without its diagonal), row by row over the entries that are not zero."""
    start, column, value, motion = plant.linear_start, plant.linear_column, plant.linear_value, work.motion
    for i in range(q.shape[0]):
        motion[i, 0] = q[i]
        motion[i, 1] = v[i]
    for i in range(q.shape[0]):
        elastic, viscous = 0.0, 0.0
        for e in range(start[i], start[i + 1]):
            j = column[e]
            elastic += value[e, 0] * motion[j, 0]
            viscous += value[e, 1] * motion[j, 1]
        work.f[i] -= elastic + viscous


@kernel(allocates=False)
def add_stops(plant: Plant, q: Array, f: Array) -> None:
    """Add the lateral stops' forces."""
    for s in range(plant.stop_g.shape[0]):
        g = plant.stop_g[s]
        stretch = 0.0
        for j in range(q.shape[0]):
            stretch += g[j] * q[j]
        size = abs(stretch)
        if size <= plant.stop_shift[1, s] and plant.stop_force[1, s] == 0.0:
            continue
        force = math.copysign(_curve(plant.stop_shift[:, s], plant.stop_force[:, s], size), stretch)
        for j in range(q.shape[0]):
            f[j] -= g[j] * force


@kernel(allocates=False)
def _curve(x: Array, y: Array, at: float) -> float:
    """Piecewise-linear interpolation for at >= 0, the last segment going on."""
    p = 0
    while p < x.shape[0] - 2 and at > x[p + 1]:
        p += 1
    return float(y[p] + (at - x[p]) * (y[p + 1] - y[p]) / (x[p + 1] - x[p]))


@kernel(allocates=False)
def damper_elongations(plant: Plant, q: Array, shift: Array) -> None:
    """Elongation of each Maxwell damper, g.q."""
    start, column, value = plant.damper_start, plant.damper_column, plant.damper_value
    for k in range(shift.shape[0]):
        total = 0.0
        for e in range(start[k], start[k + 1]):
            total += value[e] * q[column[e]]
        shift[k] = total


@kernel(allocates=False)
def step_dampers(plant: Plant, state: State, work: Work) -> None:
    """Advance the Maxwell dampers by the trapezoidal rule, exactly on their piecewise-linear curves.

    The force F in spring and viscous part obeys F' = k (x' - w), F = curve(w). With kappa = k h / 2:
    curve(w_1) + kappa w_1 = F_0 - kappa w_0 + k (x_1 - x_0), whose left side rises strictly.
    """
    elongation, piston, force, shift = state.elongation, state.piston, state.force, work.shift
    velocity, knot, slope = plant.damper_velocity, plant.damper_knot, plant.damper_slope
    for k in range(shift.shape[0]):
        stiffness = plant.damper_stiffness[k]
        kappa = 0.5 * plant.step * stiffness
        right = force[k] - kappa * piston[k] + stiffness * (shift[k] - elongation[k])
        size = abs(right)
        speed = size * slope[0, k]
        for p in range(1, knot.shape[0]):
            beyond = velocity[p, k] + (size - knot[p, k]) * slope[p, k]
            speed = beyond if size > knot[p, k] else speed
        speed = speed if right >= 0.0 else -speed
        piston[k] = speed
        force[k] = right - kappa * speed
        elongation[k] = shift[k]


@kernel(allocates=False)
def add_dampers(plant: Plant, force: Array, f: Array) -> None:
    """Add -g F of the Maxwell dampers to the generalised forces."""
    start, column, value = plant.damper_start, plant.damper_column, plant.damper_value
    for k in range(force.shape[0]):
        for e in range(start[k], start[k + 1]):
            f[column[e]] -= value[e] * force[k]


@kernel(inline=True, allocates=False)
def step_sayds(plant: Plant, state: State, work: Work) -> None:
    """Advance the semi-active dampers over the step that ends at state.q with the velocities work.velocity.

    `state.v` still holds the velocities at the step's start.
    """
    start, column, value = plant.sayd_start, plant.sayd_column, plant.sayd_value
    inputs, count = work.sayd_inputs, (plant.sayd_start.shape[0] - 1) // 2
    for r in range(2 * count):
        position, velocity, before = 0.0, 0.0, 0.0
        for e in range(start[r], start[r + 1]):
            j = column[e]
            position += value[e] * state.q[j]
            velocity += value[e] * work.velocity[j]
            before += value[e] * state.v[j]
        place = sayd.END_1 * LANES + r if r < count else sayd.END_2 * LANES + r - count
        inputs[place] = position
        inputs[LANES + place] = velocity
        inputs[2 * LANES + place] = before
    for k in range(count):
        if state.sayd[sayd.ATTACHED * LANES + k] == 0.0:
            # Torn off the bogie, the rod goes with the housing.
            stroke = state.sayd[sayd.STROKE * LANES + k]
            inputs[sayd.END_1 * LANES + k] = inputs[sayd.END_2 * LANES + k] + stroke
            inputs[sayd.RATE_1 * LANES + k] = inputs[sayd.RATE_2 * LANES + k]
            inputs[sayd.OLD_RATE_1 * LANES + k] = inputs[sayd.OLD_RATE_2 * LANES + k]
    sayd.move_valves(plant.sayd_constant, state.sayd_line, inputs, state.sayd)
    sayd.integrate(
        plant.step, int(plant.sayd_substeps), plant.sayd_constant, plant.sayd_table, inputs, state.sayd
    )


@kernel(allocates=False)
def add_sayds(plant: Plant, state: State, f: Array) -> None:
    """Add the semi-active dampers' reactions: -F_1 on the bogie, -F_2 on the carbody."""
    start, column, value = plant.sayd_start, plant.sayd_column, plant.sayd_value
    count = (start.shape[0] - 1) // 2
    for r in range(2 * count):
        force = state.sayd[sayd.FORCE_1 * LANES + r if r < count else sayd.FORCE_2 * LANES + r - count]
        force *= state.sayd[sayd.ATTACHED * LANES + (r if r < count else r - count)]
        for e in range(start[r], start[r + 1]):
            f[column[e]] -= value[e] * force


@kernel(inline=True, allocates=False)
def contact(plant: Plant, q: Array, v: Array, position: float, work: Work) -> None:
    """Track and contact: from the vehicle's motion to the wheels' forces in `work`."""
    read_track(plant, position, work)
    wheel_kinematics(plant, q, v, work)
    wheel_forces(plant, work)


@kernel(allocates=False)
def step(plant: Plant, state: State, work: Work) -> None:
    """Advance one vehicle by the plant's time step."""
    h = plant.step
    q, v, a, f = state.q, state.v, state.a, work.f
    n = q.shape[0]
    # Short loops over few arrays: the compiler can rule out overlap and make them vector instructions.
    for i in range(n):
        q[i] += h * (v[i] + 0.5 * h * a[i])
    for i in range(n):
        work.velocity[i] = v[i] + h * a[i]
    for i in range(n):
        f[i] = -plant.damping_diagonal[i] * (v[i] + 0.5 * h * a[i])
    state.clock[0] += h
    state.clock[1] += h * plant.speed

    contact(plant, q, work.velocity, state.clock[1], work)
    add_contact(plant, work)
    add_suspension(plant, q, work.velocity, work)
    add_stops(plant, q, f)
    damper_elongations(plant, q, work.shift)
    step_dampers(plant, state, work)
    add_dampers(plant, state.force, f)
    if state.sayd.shape[0] > 0:
        step_sayds(plant, state, work)
        add_sayds(plant, state, f)

    for i in range(n):
        f[i] *= plant.mobility[i]
    for i in range(n):
        v[i] += 0.5 * h * (a[i] + f[i])
    for i in range(n):
        a[i] = f[i]


@kernel(allocates=False)
def rates(plant: Plant, position: float, q: Array, v: Array, force: Array, work: Work, out: Array) -> None:
    """Time derivative of (q, v, F) for a general integrator: the same forces as `step`.

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
    n, f = q.shape[0], work.f
    for i in range(n):
        f[i] = 0.0
    contact(plant, q, v, position, work)
    add_contact(plant, work)
    add_suspension(plant, q, v, work)
    add_stops(plant, q, f)
    add_dampers(plant, force, f)
    damper_elongations(plant, v, work.shift)
    for i in range(n):
        out[i] = v[i]
        out[n + i] = (f[i] - plant.damping_diagonal[i] * v[i]) / plant.mass[i]
    for k in range(force.shape[0]):
        size = _curve(plant.damper_force[:, k], plant.damper_velocity[:, k], abs(force[k]))
        piston = math.copysign(size, force[k])
        out[2 * n + k] = plant.damper_stiffness[k] * (work.shift[k] - piston)


@kernel(allocates=False)
def record(plant: Plant, state: State, work: Work, row: Array) -> None:
    """Write the assessed signals of this instant.

    Order: bogie-frame lateral acceleration above each wheelset (w), track shift force of each wheelset (w),
    force of each yaw damper (the rest of the row).
    """
    w = plant.wheelset_x.shape[0]
    for j in range(w):
        g = plant.measure[j]
        total = 0.0
        for i in range(g.shape[0]):
            total += g[i] * state.a[i]
        row[j] = total
        out = work.lane_out
        row[w + j] = -(out[FORCE_Y * LANES + 2 * j] + out[FORCE_Y * LANES + 2 * j + 1])
    for k in range(row.shape[0] - 2 * w):
        if state.sayd.shape[0] > 0:
            attached = state.sayd[sayd.ATTACHED * LANES + k]
            row[2 * w + k] = attached * state.sayd[sayd.FORCE_1 * LANES + k]
        else:
            row[2 * w + k] = state.force[k]


@kernel(allocates=False)
def record_wheels(work: Work, row: Array) -> None:
    """Write lateral and vertical force of each wheel on the rail (two rows of LANES)."""
    for i in range(LANES):
        row[i] = -work.lane_out[FORCE_Y * LANES + i]
        row[LANES + i] = work.lane_out[FORCE_Z * LANES + i]


@kernel(allocates=False)
def largest_shift(plant: Plant, work: Work) -> float:
    """Largest shift of a wheel towards its flange, m: beyond the contact table it has climbed the rail."""
    largest = 0.0
    for i in range(2 * plant.wheelset_x.shape[0]):
        largest = max(largest, work.lane_in[SHIFT * LANES + i])
    return largest


@kernel(allocates=False)
def _copy(values: Array, row: Array) -> None:
    for i in range(values.shape[0]):
        row[i] = values[i]


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
    """Advance by as many samples as `signals` has rows, `substeps` steps each.

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
    widest = plant.table_start + plant.table_step * (plant.table.shape[0] // geometry.WIDTH - 1)
    for t in range(signals.shape[0]):
        for _ in range(substeps):
            step(plant, state, work)
        record(plant, state, work, signals[t])
        if wheels.shape[0] > 0:
            record_wheels(work, wheels[t])
        if motion.shape[0] > 0:
            _copy(state.q, motion[t])
        if sayds.shape[0] > 0:
            _copy(state.sayd, sayds[t])
        if not math.isfinite(signals[t, 0] + state.v[0]) or largest_shift(plant, work) >= widest:
            return t
    return int(signals.shape[0])
