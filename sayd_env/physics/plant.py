"""What the compiled step works on: constants, state and scratch memory of vehicles side by side.

All arrays of W vehicles are flat: element ``row * W + vehicle``. One vehicle is the case W = 1. What there is
eight of in a vehicle, wheels and yaw dampers, has rows of eight: element ``(row * 8 + i) * W + vehicle``.
Wheels come side by side: those on the left of the four wheelsets first, then those on the right.

A `Plant` holds constants, a `State` what changes, a `Work` scratch memory and outputs. They are named
tuples of arrays, so that compiled code reads `plant.mobility` as its caller in Python does.
"""

from __future__ import annotations

from typing import NamedTuple

from sayd_env.config.units import Array
from sayd_env.physics.ragged import Matrix
from sayd_env.physics.rows import Column

LANES = 8
"""Wheels of a vehicle, and its yaw dampers: so many elements for each vehicle has a row of theirs."""
WHEELSETS = 4
"""Wheelsets of a vehicle; those that it does not have keep their wheels in the air."""

# Rows of `Plant.number`, one number for each vehicle.
(
    STEP,  # time step h, s; the same for vehicles side by side
    SUBSTEPS,  # steps of the semi-active dampers in a time step; likewise
    SPEED,  # V, m/s
    RAIL_START,  # position of the first knot of the irregularities, m
    PER_RAIL_STEP,  # 1 / distance of knots, 1/m
    RAIL_COUNT,  # number of their coefficients
    RAIL_BASE,  # place of the vehicle's first coefficient, counted from `Plant.irregularity`
    WIDEST,  # lateral shift at the end of the contact table, m
    CREEP_LAW,  # place of the creep law in `contact.creep.LAWS`; the same for vehicles side by side
    LINE_START,  # position of the first node of the line, m
    PER_LINE_STEP,  # 1 / distance of nodes, 1/m
    LINE_COUNT,  # number of nodes
    LINE_BASE,  # place of the vehicle's first node, counted from `Plant.line`
    SHAPES,  # contact tables of a side between which a line blends, behind one another; 1: no blend
    NUMBERS,
) = range(15)

# Rows of `Plant.wheel`, one number for each wheel.
(
    TABLE_BASE,  # first element of the contact table in `Plant.table`
    TABLE_START,  # lateral shift of its first node, m
    PER_TABLE_STEP,  # 1 / distance of nodes, 1/m
    TABLE_LAST,  # number of the last node but one
    TABLE_LOAD,  # static wheel load of the table to the power of 2/3, N^(2/3)
    RADIUS,  # nominal rolling radius r_0, m
    PER_RADIUS,  # 1/m
    WHEEL_SPEED,  # V, m/s
    PER_SPEED,  # s/m
    FRICTION,  # coefficient of friction (-)
    SHEAR_MODULUS,  # G of wheel and rail, N/m2; the same for vehicles side by side
    APPROACH,  # vertical approach under the static load at zero shift, m; -1 for a wheel that there is not
    LOAD_FACTOR,  # Hunt-Crossley factor of the normal force, s/m
    SHAPE,  # place between the contact tables, from 0 to `SHAPES` - 1
    WHEEL_ROWS,
) = range(15)


class Plant(NamedTuple):
    """Constants of W vehicles (n unknowns, w wheelsets, m Maxwell dampers, s stops, d yaw dampers each)."""

    number: Array
    """(NUMBERS * W,)."""
    wheel: Array
    """(WHEEL_ROWS * 8 * W,)."""
    mass: Array
    """(n * W,) diagonal mass matrix, kg and kg m2."""
    damping_diagonal: Array
    """(n * W,) diagonal D of C: treated implicitly."""
    mobility: Array
    """(n * W,) 1 / (M + h/2 D)."""
    load: Array
    """(n * W,) what static loads put on the unknowns where wheels stand on rails, N."""
    wheelset_x: Array
    """(w * W,) position along the vehicle, m."""
    table: Array
    """(nodes * columns,) contact tables, each packed node by node."""
    motion_start: Column
    """`Rows` that give `Work.y` from the motion in `Work.x`."""
    motion_column: Column
    motion_value: Array
    force_start: Column
    """`Rows` that give the generalised forces from motion and element forces in `Work.x`."""
    force_column: Column
    force_value: Array
    measure_start: Column
    """`Rows` that give the measuring points' accelerations from those of the unknowns."""
    measure_column: Column
    measure_value: Array
    damper_velocity: Matrix
    """(p, m * W) abscissae of the Maxwell dampers' force-velocity curves, m/s."""
    damper_force: Matrix
    """(p, m * W) ordinates, N."""
    damper_knot: Matrix
    """(p, m * W) F + k h / 2 v at these points, N."""
    damper_slope: Matrix
    """(p, m * W) dv / d(F + k h / 2 v) behind each point, m/(N s)."""
    damper_stiffness: Array
    """(m * W,) series stiffness, N/m."""
    stop_shift: Matrix
    """(p, s * W) abscissae of the stops' curves, m."""
    stop_force: Matrix
    """(p, s * W) ordinates, N."""
    sayd_constant: Array
    """Constants of the semi-active dampers, as in `sayd_env.physics.sayd`; empty without them."""
    sayd_table: Array
    """Their flow through throttle and rectifier, flat; empty without them."""
    irregularity: Array
    """(nodes * 4,) spline coefficients of alignment, vertical, cross-level angle, gauge, node by node."""
    creep: Array
    """What the creep law reads as its table."""
    line: Array
    """(nodes * columns,) the line, node by node, as in `sayd_env.physics.line`; empty: straight, and as the
    other constants have it."""
    body: Array
    """(`line.BODY_ROWS` * bodies * W,) places, carried loads and spin of the bodies, wheelsets first; empty
    without a line."""
    body_column: Column
    """(4 * bodies,) their y, z, roll and yaw among the unknowns."""

    @property
    def speed(self) -> float:
        """Speed V of the first vehicle (m/s)."""
        return float(self.number[SPEED * len(self.number) // NUMBERS])

    @property
    def radius(self) -> float:
        """Nominal rolling radius r_0 of the first vehicle (m)."""
        return float(self.wheel[RADIUS * len(self.wheel) // WHEEL_ROWS])


class State(NamedTuple):
    """State of W vehicles; the compiled functions change it in place. All arrays are flat."""

    q: Array
    """(n * W,) displacements, m and rad."""
    v: Array
    """(n * W,) velocities."""
    a: Array
    """(n * W,) accelerations."""
    elongation: Array
    """(m * W,) elongation of each Maxwell damper, m."""
    piston: Array
    """(m * W,) velocity of each Maxwell damper's viscous part, m/s."""
    force: Array
    """(m * W,) damper forces on the elements' b ends, pulling when positive, N."""
    sayd: Array
    """States, forces and valves of the semi-active dampers, as in `sayd_env.physics.sayd`; may be empty."""
    sayd_line: Array
    """Their commands of the last steps, on the way through the valve drivers."""
    clock: Array
    """(2 * W,) time (s) and position of the vehicle's centre along the track (m)."""


class Work(NamedTuple):
    """Scratch memory and outputs of W vehicles; no state survives in it."""

    f: Array
    """(n * W,) generalised forces."""
    x: Array
    """Displacements, predicted and present velocities (3 n * W); then the wheels' forces (ROWS_OUT * 8 *
    W) and those of Maxwell dampers (m * W), semi-active dampers' ends (2 * 8 * W) and stops (s * W), N."""
    y: Array
    """Kinematics of the wheelsets (MOTIONS * 4 * W), elongations of Maxwell dampers (m * W) and stops (s *
    W), inputs of the semi-active dampers (`sayd.INPUTS` * 8 * W)."""
    rail: Array
    """(8 * 4 * W,) irregularity under each wheelset: four values, then their four slopes."""
    lane_in: Array
    """(ROWS_IN * 8 * W,) kinematics of each wheel."""
    patch: Array
    """(PATCH_ROWS * 8 * W,) geometry and slip of each contact patch."""
    creep_in: Array
    """(creep.ROWS_IN * 8 * W,) what the creep law reads, by the rows of `contact.creep`."""
    creep_out: Array
    """(creep.ROWS_OUT * 8 * W,) what it gives."""
    creep_scratch: Array
    """Its scratch memory."""
    measured: Array
    """(measuring points * W,) accelerations, m/s2."""
    wheel: Array
    """`Plant.wheel` at present places on a line; empty without one."""
    shape: Array
    """(8 * W * 2 * columns,) two nodes of the blended contact table for each wheel; empty without a blend."""
    line: Array
    """Of a line at present places: loads (n * W), offsets of the unknowns' frames and their rates (n * W
    each), accelerations of these frames against free fall (n * W); then the line at the centres
    (`line.CENTRE_ROWS` * W) and whether any vehicle is in a curve, at another speed than its plant's, or
    between two shapes of rails (3 * W); empty without a line."""

    @property
    def lane_out(self) -> Array:
        """The part of x that holds what the contact does, (ROWS_OUT * 8 * W,)."""
        first = 3 * len(self.f)
        return self.x[first : first + ROWS_OUT * LANES * len(self.rail) // (8 * WHEELSETS)]


# Rows of the kinematics of a wheelset in `Work.y`.
(
    M_OFFSET,  # y + r_0 roll - y of the track section, m
    M_HEIGHT,  # z less that of the track section, m
    M_ROLL,
    M_PLANE,  # roll of the track section
    M_YAW,
    M_SLIP_X,  # longitudinal velocity, m/s
    M_BOTTOM,  # rate of M_OFFSET
    M_RISE,  # rate of M_HEIGHT
    M_ROLL_RATE,
    M_PLANE_RATE,
    M_SPIN_RATE,  # pitch rate over the nominal one, rad/s
    M_YAW_RATE,
    MOTIONS,
) = range(13)

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
    ROWS_IN,
) = range(19)

# Rows of `Work.patch`: geometry and slip where a wheel touches its rail.
(
    TANGENT,  # of the contact angle
    SECANT,
    LEAD,  # by how much the contact leads its axle, m
    RAISED,  # how much higher a wheel stands that touches ahead or behind, over half of yaw squared, m
    DEEPER,  # how far below the wheelset's lowest point lateral forces act, m
    NEARER,  # by how much roll so brings the wheel nearer to its rail, over the roll, m
    ROLLING,  # rolling radius, m
    REACH,  # lateral position of the contact from the wheelset's centre, m
    RAIL_ARM,  # the same from the track's centre, m
    UP,  # vertical part of the normal force, N
    CREEP_X,  # slip velocities of the wheel over the rail in the contact plane, m/s
    CREEP_T,
    CREEP_SPIN,  # 1/s
    PATCH_ROWS,
) = range(14)

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
