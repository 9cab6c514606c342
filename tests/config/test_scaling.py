"""Factors on numbers deep in a configuration: what is scaled, what is shared, what is refused."""

from __future__ import annotations

import pytest

from sayd_env.config import ConfigError
from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig
from sayd_env.config.scaling import scaled
from sayd_env.config.scenario import Scenario, load_scenario

DELAY, BULK_MODULUS = 5e-3, 1e9  # s, Pa; frozen for the test, whatever a calibration finds
SAYD = load_scenario(
    "nominal", ["damper=sayd", f"damper.valve.delay={DELAY}", f"damper.oil.bulk_modulus={BULK_MODULUS}"]
)


def refused(*path: str, factor: float = 2.0, base: Scenario = SAYD) -> str:
    with pytest.raises(ConfigError) as caught:
        scaled(base, {path: factor})
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_numbers_lists_entries_and_curves_are_scaled():
    factors = {
        ("contact_damping",): 0.5,
        ("damper", "oil", "bulk_modulus"): 1.5,
        ("vehicle", "elements", "arm_joint", "stiffness"): 1.2,
        ("vehicle", "elements", "air_spring", "stiffness", "2"): 0.9,
        ("vehicle", "elements", "lateral_damper", "curve"): 2.0,
    }
    changed = scaled(SAYD, factors)
    before = {element.name: element for element in SAYD.vehicle.elements}
    after = {element.name: element for element in changed.vehicle.elements}
    assert changed.contact_damping == 0.5 * SAYD.contact_damping
    assert isinstance(changed.damper, SaydDamperConfig)
    assert changed.damper.oil.bulk_modulus == 1.5 * BULK_MODULUS
    assert after["arm_joint"].stiffness == tuple(1.2 * k for k in before["arm_joint"].stiffness)
    x, y, z = before["air_spring"].stiffness
    assert after["air_spring"].stiffness == (x, y, 0.9 * z)
    assert after["lateral_damper"].curve == tuple((v, 2.0 * f) for v, f in before["lateral_damper"].curve)


def test_a_whole_list_and_one_of_its_entries_multiply():
    path = ("vehicle", "elements", "arm_joint", "stiffness")
    changed = scaled(SAYD, {path: 2.0, (*path, "0"): 3.0})
    before = next(e for e in SAYD.vehicle.elements if e.name == "arm_joint").stiffness
    after = next(e for e in changed.vehicle.elements if e.name == "arm_joint").stiffness
    assert after == (6.0 * before[0], 2.0 * before[1], 2.0 * before[2])


def test_what_is_not_touched_is_shared():
    changed = scaled(SAYD, {("damper", "valve", "delay"): 2.0})
    assert changed.vehicle is SAYD.vehicle
    assert changed.track is SAYD.track
    assert changed.damper.valve.delay == 2.0 * DELAY
    assert SAYD.damper.valve.delay == DELAY
    assert scaled(SAYD, {}) is SAYD


def test_a_passive_curve_keeps_its_velocities():
    base = load_scenario("nominal")
    changed = scaled(base, {("damper", "curve"): 0.9})
    assert isinstance(base.damper, PassiveDamperConfig)
    assert isinstance(changed.damper, PassiveDamperConfig)
    assert [v for v, _ in changed.damper.curve] == [v for v, _ in base.damper.curve]
    assert changed.damper.curve[1][1] == 0.9 * base.damper.curve[1][1]


def test_paths_that_lead_nowhere_are_refused():
    assert "at 'vehicle.elements.arm_jont', did you mean 'arm_joint'?" in refused(
        "vehicle", "elements", "arm_jont", "stiffness"
    )
    assert "at 'damper.oil.modulus', did you mean 'bulk_modulus'?" in refused("damper", "oil", "modulus")
    assert "nothing to scale at 'friction.x'" in refused("friction", "x")
    assert "'damper' is not a number, a list of numbers or a curve" in refused("damper")
    assert "'damper.name' is not a number" in refused("damper", "name")


def test_a_product_that_is_not_allowed_is_refused():
    assert "friction: found" in refused("friction", factor=10.0)
    # Relief that opens beyond where it is fully open.
    assert "must be above opening" in refused("damper", "relief", "opening", factor=3.0)
