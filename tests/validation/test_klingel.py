"""A free wheelset with conical wheels at low speed against Klingel's wavelength.

J. Klingel, Organ f. d. Fortschritte d. Eisenbahnwesens 38 (1883): L = 2 pi sqrt(e r_0 / (2 lambda)) with the
distance e of the contact points, which is taken from the contact geometry (twice the distance of a contact
from the wheelset's centre) in simulation, eigenvalue and formula alike. The formula is kinematic. What it
leaves out is smaller than a per cent here: the rail head's radius R = 80 mm, on which the roll moves the
contact (it raises the effective conicity by 2 lambda R / e, 0.5 to 1 %, and shortens the wave by half of
that), and inertia, which at 2 m/s does not matter. No part that a calibration moves is left in the model.

The simulation begins in kinematic motion, where no wheel slips and both are loaded alike: a wheelset that is
displaced by y rolls by 2 lambda y / e, the difference of its rolling radii over the distance of its contacts,
and yaws at -(2 lambda y / e) V / r_0. Begun upright, it falls on one wheel and loses up to 7 % of y to that.
"""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config import validate
from sayd_env.config.loader import parse_yaml
from sayd_env.config.profile import RailProfileConfig, WheelProfileConfig
from sayd_env.config.scenario import load_scenario
from sayd_env.config.vehicle import VehicleConfig
from sayd_env.physics.linear import modes
from sayd_env.physics.simulator import Simulator, VehicleModel

SPEED = 2.0
RADIUS = 0.46
AMPLITUDE = 5e-4
CONICITIES = (0.05, 0.1)

WHEELSET = """
name: wheelset
wheel_radius: 0.46
measuring_height: 0.46
speed_range: [1.0, 20.0]
bodies:
  - {name: wheelset, role: wheelset, mass: 1500.0, inertia: [750.0, 110.0, 750.0], position: [0.0, 0.0, 0.46]}
elements:
  - name: speed_hold
    type: bush
    a: {body: ground, at: [0.0, 0.0, 0.46]}
    b: {body: wheelset, at: [0.0, 0.0, 0.46]}
    stiffness: [1.0e3, 0.0, 0.0]
    damping: [1.0e3, 0.0, 0.0]
"""
WHEEL = """
kind: wheel
name: cone
back_to_back: 1.360
tape_to_back: 0.070
shape:
  zones:
    - {{type: line, start: -60.0, end: -30.0, offset: {flange}, slope: -0.4}}
    - {{type: line, start: -30.0, end: 45.0, offset: 0.0, slope: -{conicity}}}
"""
RAIL = """
kind: rail
name: arc
cant: 0.0
gauge_depth: 0.005
shape:
  zones: [{type: arc, start: -40.0, end: 40.0, centre_y: 0.0, centre_z: -80.0, radius: 80.0, side: upper}]
"""


def model(conicity: float) -> VehicleModel:
    wheel = WHEEL.format(conicity=conicity, flange=30.0 * conicity - 12.0)
    rigid = [f"track.section.{side}_stiffness=1e9" for side in ("lateral", "vertical")]
    fixed = ["friction=0.35", "track.section.lateral_damping=3.5e5"]
    base = load_scenario("estimates", ["wear=0.0", "track=smooth", *rigid, *fixed])
    return VehicleModel(
        base.model_copy(
            update={
                "vehicle": validate(VehicleConfig, parse_yaml(WHEELSET, "wheelset"), "wheelset"),
                "wheel": validate(WheelProfileConfig, parse_yaml(wheel, "wheel"), "wheel"),
                "rail": validate(RailProfileConfig, parse_yaml(RAIL, "rail"), "rail"),
            }
        )
    )


def distance(vehicle: VehicleModel) -> float:
    """Distance of the contacts of a wheelset in its middle position."""
    return 2.0 * float(np.interp(0.0, vehicle.table.dy, vehicle.table.y_c))


def klingel(vehicle: VehicleModel, conicity: float) -> float:
    return float(2.0 * np.pi * np.sqrt(distance(vehicle) * RADIUS / (2.0 * conicity)))


@pytest.mark.parametrize("conicity", CONICITIES)
def test_simulated_wavelength(conicity: float) -> None:
    vehicle = model(conicity)
    simulator = Simulator(vehicle, SPEED)
    _, lateral, _, roll, _, yaw = vehicle.multibody.wheelset_dofs[0]
    simulator.state.q[lateral] = AMPLITUDE
    simulator.state.q[roll] = 2.0 * conicity * AMPLITUDE / distance(vehicle)
    simulator.state.v[yaw] = -simulator.state.q[roll] * SPEED / RADIUS
    telemetry = simulator.run(4.0 * klingel(vehicle, conicity), motion=True)
    y, x = telemetry.motion[:, lateral], telemetry.time * SPEED
    before = np.flatnonzero(y[:-1] * y[1:] < 0.0)
    crossing = x[before] + (x[before + 1] - x[before]) * y[before] / (y[before] - y[before + 1])
    assert len(crossing) >= 7
    wavelength = 2.0 * np.mean(np.diff(crossing))
    assert wavelength == pytest.approx(klingel(vehicle, conicity), rel=0.01)
    # Kinematic motion neither grows nor decays.
    assert np.max(np.abs(y[x > 2.0 * klingel(vehicle, conicity)])) == pytest.approx(AMPLITUDE, rel=0.05)


@pytest.mark.parametrize("conicity", CONICITIES)
def test_linear_eigenfrequency(conicity: float) -> None:
    vehicle = model(conicity)
    length = klingel(vehicle, conicity)
    slow = [mode for mode in modes(vehicle, SPEED, AMPLITUDE) if mode.frequency_hz < 2.0 * SPEED / length]
    hunting = max(slow, key=lambda mode: abs(mode.shape[vehicle.multibody.wheelset_dofs[0, 1]]))
    assert SPEED / hunting.frequency_hz == pytest.approx(length, rel=0.01)
    assert abs(hunting.damping_ratio) < 0.01
