"""The Cooperrider bogie, assembled from data by the project's own code, against its published limit.

Model and parameters: N. K. Cooperrider, The hunting behavior of conventional railway trucks, J. Eng. Ind. 94
(1972) 752-762; C. Kaas-Petersen, Chaos in a railway bogie, Acta Mechanica 61 (1986) 89-107; creep by
Vermeulen and Johnson with G pi a b = 6.563 MN and the divisors 0.60252 and 0.54219. Hopf bifurcation:
68.66 m/s, rounded (bifurcation.de, example 10, from Hassard's data); 68.644367 m/s from the equations
printed there, computed independently of this project.
"""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config import validate
from sayd_env.config.loader import parse_yaml
from sayd_env.config.units import Array
from sayd_env.config.vehicle import VehicleConfig
from sayd_env.physics.linear import critical_speed
from sayd_env.physics.multibody import Multibody, assemble

# Heights above the rail follow from h1 = 0.0762 m (axles below the frame's centre) and h2 = 0.6584 m
# (secondary springs above it). Inertias of motions that are not free do not count; the schema wants them
# positive.
BOGIE = """
name: cooperrider
wheel_radius: 0.4572
measuring_height: 0.5334
speed_range: [1.0, 200.0]
sets:
  axle: {leading: {origin: [1.074, 0.0, 0.0]}, trailing: {origin: [-1.074, 0.0, 0.0]}}
  side: {left: {}, right: {sign: [1, -1, 1]}}
bodies:
  - name: frame
    role: frame
    mass: 2918.0
    inertia: [6780.0, 1.0, 6780.0]
    position: [0.0, 0.0, 0.5334]
    dofs: [y, roll, yaw]
  - name: wheelset
    role: wheelset
    per: [axle]
    mass: 1022.0
    inertia: [1.0, 1.0, 678.0]
    position: [0.0, 0.0, 0.4572]
    dofs: [y, yaw]
elements:
  - name: primary
    type: bush
    per: [axle, side]
    a: {body: frame, at: [0.0, 0.62, 0.4572]}
    b: {body: wheelset, at: [0.0, 0.62, 0.4572]}
    stiffness: [3.646e6, 1.823e6, 3.646e6]
  - name: secondary
    type: bush
    per: [side]
    a: {body: ground, at: [0.0, 0.68, 1.1918]}
    b: {body: frame, at: [0.0, 0.68, 1.1918]}
    stiffness: [0.0, 182.3e3, 333.3e3]
    damping: [0.0, 29.2e3, 20.0e3]
  - name: secondary_yaw
    type: torsion
    axis: yaw
    a: {body: ground, at: [0.0, 0.0, 1.1918]}
    b: {body: frame, at: [0.0, 0.0, 1.1918]}
    stiffness: 2.71e6
"""
CREEP = (6.563e6 / 0.60252, 6.563e6 / 0.54219)


@pytest.fixture(scope="module")
def bogie() -> Multibody:
    return assemble(validate(VehicleConfig, parse_yaml(BOGIE, "cooperrider"), "cooperrider"), None)


def conical_contact(bogie: Multibody, speed: float) -> tuple[Array, Array]:
    """Stiffness and damping of linear creep forces of conical wheels on rigid rails.

    Creepages xi_y = y' / V - psi and xi_x = a psi' / V + lambda y / r_0 (of opposite sign left and right);
    lateral force -2 f_22 xi_y, yaw moment -2 a f_11 xi_x (Wickens, Fundamentals of Rail Vehicle Dynamics,
    2003, chapter 2; spin and gravity stiffness left out).
    """
    half_distance, conicity, radius = 0.7163, 0.05, 0.4572
    longitudinal, lateral = 2.0 * CREEP[0], 2.0 * CREEP[1]
    stiffness, damping = np.zeros((2, bogie.n, bogie.n))
    y, yaw = bogie.wheelset_dofs[:, 1], bogie.wheelset_dofs[:, 5]
    damping[y, y] = lateral / speed
    stiffness[y, yaw] = -lateral
    damping[yaw, yaw] = longitudinal * half_distance**2 / speed
    stiffness[yaw, y] = longitudinal * half_distance * conicity / radius
    return stiffness, damping


def state_matrix(bogie: Multibody, speed: float) -> Array:
    stiffness, damping = conical_contact(bogie, speed)
    n, per_mass = bogie.n, 1.0 / bogie.mass[:, None]
    position = -per_mass * (bogie.stiffness + stiffness)
    return np.block([[np.zeros((n, n)), np.eye(n)], [position, -per_mass * (bogie.damping + damping)]])


def printed_equations(speed: float) -> Array:
    """State matrix of (y1, psi1, y2, psi2, y_f, psi_f, phi_f) from the equations as they are printed."""
    k1, k2, k3, k4, k5, k6 = 1.823e6, 3.646e6, 3.646e6, 182.3e3, 333.3e3, 2.71e6
    d1, d2, damping1, damping2, h1, h2 = 0.62, 0.68, 20.0e3, 29.2e3, 0.0762, 0.6584
    b, a, r0, slope = 1.074, 0.7163, 0.4572, 0.05

    def accelerations(q: Array, v: Array) -> Array:
        y1, psi1, y2, psi2, y, psi, phi = q
        a1, a2 = 2 * k1 * (y1 - y - b * psi - h1 * phi), 2 * k1 * (y2 - y + b * psi - h1 * phi)
        a3, a4 = 2 * k2 * d1**2 * (psi1 - psi), 2 * k2 * d1**2 * (psi2 - psi)
        a5, a6 = 2 * damping2 * (v[4] - h2 * v[6]) + 2 * k4 * (y - h2 * phi), k6 * psi
        a7 = 2 * damping1 * d2**2 * v[6] + (2 * k5 * d2**2 + 4 * k3 * d1**2) * phi
        fx = [CREEP[0] * (a * v[i + 1] / speed + slope * q[i] / r0) for i in (0, 2)]
        fy = [CREEP[1] * (v[i] / speed - q[i + 1]) for i in (0, 2)]
        force = [-a1 - 2 * fy[0], -a3 - 2 * a * fx[0], -a2 - 2 * fy[1], -a4 - 2 * a * fx[1]]
        frame = [a1 + a2 - a5, b * a1 - b * a2 + a3 + a4 - a6, h1 * a1 + h1 * a2 + h2 * a5 - a7]
        return np.array([*force, *frame]) / [1022, 678, 1022, 678, 2918, 6780, 6780]

    rows = np.zeros((14, 14))
    rows[:7, 7:] = np.eye(7)
    for j, unit in enumerate(np.eye(14)):
        rows[7:, j] = accelerations(unit[:7], unit[7:])
    return rows


def test_critical_speed_is_the_published_one(bogie: Multibody) -> None:
    speed = critical_speed(lambda v: state_matrix(bogie, v), np.arange(40.0, 101.0, 5.0))
    assert speed == pytest.approx(68.644367, rel=1e-6)
    assert speed == pytest.approx(68.66, rel=1e-3)


@pytest.mark.parametrize("speed", [30.0, 68.644367, 90.0])
def test_all_eigenvalues_are_those_of_the_printed_equations(bogie: Multibody, speed: float) -> None:
    ours, printed = (np.linalg.eigvals(m) for m in (state_matrix(bogie, speed), printed_equations(speed)))
    apart = np.abs(ours[:, None] - printed)
    assert np.max(apart.min(axis=1)) < 1e-6
    assert np.max(apart.min(axis=0)) < 1e-6


def test_hunting_frequency_at_the_limit(bogie: Multibody) -> None:
    # Limit cycles at 70 m/s have 3.984 Hz; at the bifurcation itself the frequency is nearly the same.
    values = np.linalg.eigvals(state_matrix(bogie, 68.644367))
    least = values[np.argmax(values.real)]
    assert abs(least.imag) / (2 * np.pi) == pytest.approx(3.984, rel=0.03)
