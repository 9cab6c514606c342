"""What the compiled step works on: a vehicle's constants and its state, as arrays of one type.

A `Plant` holds the constants of one vehicle on one track at one speed, a `State` what changes. Both are
named tuples of arrays, so that a compiled function reads `plant.stiffness` as its uncompiled caller does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
Column = npt.NDArray[np.uint32]
"""Indices that compiled code need not check for being negative."""

LANES = 8
"""Wheels of a vehicle, and the width of the loops over them: four wheelsets, left and right in turn."""


class Plant(NamedTuple):
    """Constants of one vehicle (n unknowns, w wheelsets, m Maxwell dampers, s stops)."""

    mass: Array
    """(n,) diagonal mass matrix, kg and kg m2."""
    linear_start: Column
    """(n + 1,) where the entries of each row of K and C begin (compressed sparse rows)."""
    linear_column: Column
    """(entries,) their columns."""
    linear_value: Array
    """(entries, 2) K and C + (V / r0) G there, C without its diagonal."""
    damping_diagonal: Array
    """(n,) diagonal D of C: treated implicitly."""
    mobility: Array
    """(n,) 1 / (M + h/2 D)."""
    wheelset_dofs: Index
    """(w, 6) columns of x, y, z, roll, pitch, yaw."""
    section_dofs: Index
    """(w, 3) columns of the track sections' y, z, roll."""
    wheelset_x: Array
    """(w,) position along the vehicle, m."""
    wheel_load: Array
    """(w,) static load of a wheel, N."""
    table: Array
    """(nodes * columns,) contact table of all wheels, packed node by node."""
    table_start: float
    """Lateral shift of the first node, m."""
    table_step: float
    """Distance of nodes, m."""
    table_load: float
    """Static wheel load of the table to the power of 2/3, N^(2/3)."""
    approach: Array
    """(w,) vertical approach of a wheel under its static load at zero shift, m."""
    contact_damping: Array
    """(w,) Hunt-Crossley factor of the normal force, s/m."""
    shear_modulus: float
    """G of wheel and rail, N/m2."""
    friction: float
    """Coefficient of friction (-)."""
    radius: float
    """Nominal rolling radius, m."""
    speed: float
    """V, m/s."""
    step: float
    """Time step h, s."""
    damper_start: Column
    """(m + 1,) where the entries of each Maxwell damper's connection vector begin."""
    damper_column: Column
    """(entries,) the degrees of freedom that it connects."""
    damper_value: Array
    """(entries,) the connection vectors' entries."""
    damper_velocity: Array
    """(p, m) abscissae of the force-velocity curves, m/s."""
    damper_force: Array
    """(p, m) ordinates, N."""
    damper_knot: Array
    """(p, m) F + k h / 2 v at these points, N."""
    damper_slope: Array
    """(p, m) dv / d(F + k h / 2 v) behind each point, m/(N s)."""
    damper_stiffness: Array
    """(m,) series stiffness, N/m."""
    sayd_start: Column
    """(2 d + 1,) where the d semi-active dampers' ends begin: those on bogies, then those on the carbody."""
    sayd_column: Column
    """(entries,) the degrees of freedom that move them."""
    sayd_value: Array
    """(entries,) by how much."""
    sayd_constant: Array
    """Constants of the semi-active dampers, as in `sayd_env.physics.sayd`; empty without them."""
    sayd_table: Array
    """Their flow through throttle and rectifier, flat; empty without them."""
    sayd_substeps: float
    """Steps of their hydraulics in a time step."""
    stop_g: Array
    """(s, n) connection vectors of the stops."""
    stop_shift: Array
    """(p, s) abscissae of their curves, m."""
    stop_force: Array
    """(p, s) ordinates, N."""
    measure: Array
    """(w, n) rows that give the lateral motion of the bogie frame above each wheelset."""
    irregularity: Array
    """(nodes, 4) spline coefficients of alignment, vertical, cross-level angle, gauge."""
    irregularity_start: float
    """Position of the first coefficient's knot, m."""
    irregularity_step: float
    """Knot distance, m."""


class State(NamedTuple):
    """State of one vehicle; the compiled functions change it in place."""

    q: Array
    """(n,) displacements, m and rad."""
    v: Array
    """(n,) velocities."""
    a: Array
    """(n,) accelerations."""
    elongation: Array
    """(m,) elongation of each Maxwell damper, m."""
    piston: Array
    """(m,) velocity of each Maxwell damper's viscous part, m/s."""
    force: Array
    """(m,) damper forces on the elements' b ends, pulling when positive, N."""
    sayd: Array
    """States, forces and valves of the semi-active dampers, as in `sayd_env.physics.sayd`; may be empty."""
    sayd_line: Array
    """Their commands of the last steps, on the way through the valve drivers."""
    clock: Array
    """(2,) time (s) and position of the vehicle's centre along the track (m)."""


class Work(NamedTuple):
    """Scratch memory and outputs of one vehicle; no state survives in it."""

    f: Array
    """(n,) generalised forces."""
    velocity: Array
    """(n,) predicted velocities."""
    motion: Array
    """(n, 2) displacements and velocities side by side, as the product with K and C reads them."""
    shift: Array
    """(m,) elongations at the end of the step."""
    sayd_inputs: Array
    """Motion of the semi-active dampers' ends, as in `sayd_env.physics.sayd`; may be empty."""
    rail: Array
    """(w, 8) irregularity under each wheelset: four values and their four slopes."""
    lane_in: Array
    """(rows * LANES,) kinematics of each wheel."""
    lane_out: Array
    """(rows * LANES,) contact forces of each wheel."""
