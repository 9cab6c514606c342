"""The schema of a vehicle: what cannot be assembled is refused with the name of the part."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config import ConfigError, packaged_names, parse_yaml, validate
from sayd_env.config.scenario import load_scenario
from sayd_env.config.vehicle import VehicleConfig, checked_curve
from sayd_env.physics.simulator import VehicleModel

CART = """
name: cart
wheel_radius: 0.45
measuring_height: 0.5
speed_range: [10.0, 60.0]
sets:
  axle:
    front: {origin: [1.0, 0.0, 0.0]}
    rear: {origin: [-1.0, 0.0, 0.0], sign: [-1, 1, 1]}
bodies:
  - {name: frame, role: frame, mass: 2000.0, inertia: [1e3, 1e3, 2e3], position: [0.0, 0.0, 0.6]}
  - {name: wheelset, role: wheelset, per: [axle], mass: 1500.0, inertia: [800.0, 100.0, 800.0],
     position: [0.0, 0.0, 0.45]}
elements:
  - {name: spring, type: bush, per: [axle], stiffness: [1e7, 5e6, 1e6], carries_weight: true,
     a: {body: wheelset, at: [0.0, 0.0, 0.5]}, b: {body: frame, at: [0.0, 0.0, 0.5]}}
  - {name: shock, type: damper, axis: y, curve: [[0.0, 0.0], [0.1, 5e3], [0.3, 9e3]], series_stiffness: 1e7,
     a: {body: frame, at: [0.0, 0.0, 0.5]}, b: {body: ground, at: [0.0, 0.0, 0.5]}}
  - {name: buffer, type: stop, axis: y, curve: [[0.0, 0.0], [0.02, 0.0], [0.04, 2e4]],
     a: {body: frame, at: [0.0, 0.0, 0.5]}, b: {body: ground, at: [0.0, 0.0, 0.5]}}
"""


def cart(old: str = "", new: str = "") -> VehicleConfig:
    assert old in CART
    return validate(VehicleConfig, parse_yaml(CART.replace(old, new, 1), "cart.yaml"), "cart.yaml")


def test_the_cart_itself_is_sound():
    assert [body.name for body in cart().bodies] == ["frame", "wheelset"]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("body: wheelset", "body: wheelst", "spring: unknown body 'wheelst', did you mean 'wheelset'?"),
        ("per: [axle], mass", "per: [axel], mass", "wheelset: unknown set 'axel', did you mean 'axle'?"),
        (
            "per: [axle], stiffness",
            "stiffness",
            "spring: is repeated per [], so it cannot reach 'wheelset', one per",
        ),
        ("name: frame", "name: wheelset", "two bodies have the same name"),
        ("role: wheelset", "role: body", "a vehicle needs at least one body with the role 'wheelset'"),
        ("role: wheelset", "role: wheel", "bodies.wheelset.role: found 'wheel'; expected 'carbody', 'frame'"),
        (
            "role: frame",
            "role: frame, carrier: wheelset",
            "bodies.frame: a hinged body, and no other, names its carrier",
        ),
        (
            "mass: 2000.0",
            "mass: -2000.0",
            "bodies.frame.mass: found -2000.0; expected a number greater than or equal to 0",
        ),
        ("mass: 2000.0", "mass: 0.0", "bodies.frame: mass and moments of inertia must be positive"),
        ("mass: 2000.0", "mass: 2 t", "bodies.frame.mass: found '2 t'; expected a number"),
        ("[1e3, 1e3, 2e3]", "[1e3, 1e3]", "bodies.frame.inertia: found [1000.0, 1000.0]; entry 3 is missing"),
        (
            "[1e3, 1e3, 2e3]",
            "[1e3, -1, 2e3]",
            "bodies.frame.inertia.1: found -1; expected a number greater than",
        ),
        ("[1e7, 5e6, 1e6]", "[1e7, '5', 1e6]", "elements.spring.stiffness.1: found '5'; expected a number"),
        (
            "stiffness: [1e7",
            "stifness: [1e7",
            "unknown key 'elements.spring.stifness', did you mean 'stiffness'?",
        ),
        (
            "type: bush",
            "type: bushing",
            "elements.spring.type: found 'bushing', did you mean 'bush'?; expected bush, ",
        ),
        ("sign: [-1, 1, 1]", "sign: [-1, 0.5, 1]", "sets.axle.rear.sign.1: found 0.5; expected -1 or 1"),
        ("[0.1, 5e3]", "[0.4, 5e3]", "elements.shock.curve: found"),
        ("[0.1, 5e3]", "[0.4, 5e3]", "velocity (m/s) must increase: 0.3 follows 0.4"),
        ("[0.3, 9e3]", "[0.3, 1e3]", "the force must not fall: 1000 N follows 5000 N"),
        ("[0.02, 0.0]", "[0.05, 0.0]", "displacement (m) must increase: 0.04 follows 0.05"),
        ("curve: [[0.0, 0.0], [0.1", "curve: [[0.1", "the first of which is [0, 0]"),
        (
            "series_stiffness: 1e7",
            "series_stiffness: 0",
            "elements.shock.series_stiffness: found 0; expected a number",
        ),
        ("axis: y", "axis: yaw", "elements.shock.axis: found 'yaw'; expected 'x', 'y' or 'z'"),
        ("wheel_radius: 0.45", "wheel_radius: 450", "wheel_radius: found 450; expected a number less than 1"),
        ("[10.0, 60.0]", "[60.0, 10.0]", "speed_range: found [60.0, 10.0]; needs 0 < lowest < highest"),
        ("[10.0, 60.0]", "[0.0, 60.0]", "needs 0 < lowest < highest"),
    ],
)
def test_what_cannot_be_assembled_is_one_line(old: str, new: str, expected: str):
    with pytest.raises(ConfigError) as caught:
        cart(old, new)
    assert str(caught.value).startswith("cart.yaml: ")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_curve_is_its_right_half():
    assert checked_curve(((0.0, 0.0), (1.0, 2.0)), "x") == ((0.0, 0.0), (1.0, 2.0))
    with pytest.raises(ValueError, match="at least two points"):
        checked_curve(((0.0, 0.0),), "x")


@pytest.mark.parametrize(
    ("items", "expected"),
    [
        (["vehicle.elements.air_spring.carries_weight=false"], "the static weight is not carried"),
        (["vehicle.sets.axle.middle={origin: [0.0, 0.0, 0.0]}"], "6 wheelsets; at most 4"),
        (["vehicle.bodies.wheelset.dofs=[y, yaw]"], "needs all six degrees of freedom of a wheelset"),
        (["vehicle.bodies.axlebox.position=[1.0, 0.0, 0.46]"], "is hinged beside the axle of 'wheelset"),
    ],
)
def test_a_vehicle_that_cannot_run_is_refused_when_it_is_assembled(items: list[str], expected: str):
    scenario = load_scenario("estimates", items)
    with pytest.raises(ConfigError, match=expected):
        VehicleModel(scenario)


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("axlebox.carrier", "ground", "carrier: found 'ground'; expected a wheelset"),
        ("axlebox.carrier", "frame", "carrier: found 'frame'; expected a wheelset"),
        ("frame.dofs", "[y, yaw, yaw]", "found y, yaw, yaw; expected each once"),
    ],
)
def test_hinges_and_degrees_of_freedom(key: str, value: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        load_scenario("estimates", [f"vehicle.bodies.{key}={value}"])


def test_limits_are_those_of_the_lightest_wheelset_and_the_heaviest_bogie() -> None:
    """A load over the front bogie raises its axles' P alone, by half of it each; limits are the others'."""
    plain = VehicleModel(load_scenario("estimates")).multibody
    ahead = VehicleModel(load_scenario("estimates", ["vehicle.bodies.carbody.position=[2.0, 0.0, 1.7]"]))
    loads = 2.0 * ahead.multibody.wheel_load
    assert np.ptp(loads) > 1e3
    assert ahead.multibody.axle_load == loads.min() < plain.axle_load
    assert ahead.multibody.bogie_mass == plain.bogie_mass


def test_every_packaged_vehicle_is_assembled():
    for name in packaged_names("vehicle"):
        assert VehicleModel(load_scenario("estimates", [f"vehicle={name}"])).multibody.n > 0


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("bodies.carbody.mass", "49.962"),
        ("bodies.frame.mass", "2.5"),
        ("bodies.wheelset.mass", "1.55"),
        ("bodies.carbody.inertia", "[135.0, 2040.0, 1920.0]"),
        ("elements.air_spring.stiffness", "[0.18, 0.18, 0.28]"),
        ("elements.air_spring.damping", "[0.0, 0.0, 40.0]"),
        ("elements.air_spring.a.at", "[0.0, 1230.0, 930.0]"),
        ("elements.arm_joint.stiffness", "[99.0, 11.0, 17.1]"),
        ("elements.anti_roll_bar.stiffness", "2.0"),
        ("elements.lateral_damper.series_stiffness", "17.15"),
        ("elements.lateral_stop.curve", "[[0.0, 0.0], [20.0, 0.0], [48.0, 49.0e+3]]"),
        ("sets.bogie.front.origin", "[8750.0, 0.0, 0.0]"),
        ("measuring_height", "540.0"),
        ("speed_range", "[30.0, 500.0]"),
    ],
)
def test_a_number_in_another_unit_is_refused(key: str, value: str) -> None:
    """Tonnes, MN/m, kN s/m, millimetres and km/h in their places of SI."""
    section, _, last = key.rpartition(".")
    named = rf"vehicle\.{section}" if last in ("mass", "inertia") else rf"vehicle\.{key}"
    with pytest.raises(ConfigError, match=named):
        load_scenario(None, [f"vehicle.{key}={value}"])
