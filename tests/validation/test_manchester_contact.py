"""Contact position and angle against CONTACT on the Manchester contact benchmark.

Source: Manchester contact benchmark, case A-2.2 (Shackleton and Iwnicki 2006), S1002 on UIC60, left wheel,
lateral shift 0 to 10 mm to the right with yaw, 10 kN a wheel, computed with CONTACT (Vollebregt); see
data/NOTICE.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from sayd_env.config.profile import RailProfileConfig, Shape, WheelProfileConfig, load_rail, load_wheel
from sayd_env.config.scenario import load_scenario
from sayd_env.physics.contact.geometry import ContactTable, contact_table, rigid_contact
from sayd_env.physics.profiles import Profile, gauge_point, rail_profile, wheel_profile

DATA = Path(__file__).parent / "data"
RADIUS, HALF_DISTANCE, GAUGE, LOAD = 0.46, 0.75, 1.435, 10e3


@pytest.fixture(scope="module")
def wheel() -> Profile:
    shape = Shape(file=str(DATA / "MBench_S1002_v3.prw"))
    return wheel_profile(
        WheelProfileConfig(kind="wheel", name="S1002", shape=shape, back_to_back=1.36, tape_to_back=0.07)
    )


@pytest.fixture(scope="module")
def rail() -> Profile:
    shape = Shape(file=str(DATA / "MBench_UIC60_v3.prr"), invert=True)
    return rail_profile(
        RailProfileConfig(kind="rail", name="UIC60", shape=shape, cant=0.0, gauge_depth=0.014)
    )


@pytest.fixture(scope="module")
def cases() -> dict[str, np.ndarray]:
    with (DATA / "manchester_A22_left.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    case = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
    # The benchmark has y to the right: its left wheel runs off its rail. The wheel's bottom moves with the
    # roll, and a yawed axle brings its wheels nearer to the centre line.
    case["shift"] = -case["y_ws_mm"] * 1e-3 + RADIUS * case["roll_rad"]
    case["dy"] = case["shift"] - 0.5 * HALF_DISTANCE * case["yaw_rad"] ** 2
    return case


@pytest.fixture(scope="module")
def table(wheel: Profile, rail: Profile) -> ContactTable:
    # The packaged settings of the contact, at the benchmark's wheel load and over its range of shifts.
    config = load_scenario().contact.model_copy(update={"table_half_width": 16e-3})
    return contact_table(wheel, rail, GAUGE, config, RADIUS, LOAD)


def test_rail_stands_where_the_benchmark_puts_it(rail: Profile) -> None:
    # The rail's origin lies 760.53 mm from the track centre: -751.8726 - 8.66 mm in the benchmark's output.
    assert 0.5 * GAUGE - gauge_point(rail) == pytest.approx(0.76053, abs=1e-5)


def test_position_on_the_wheel(table: ContactTable, cases: dict[str, np.ndarray]) -> None:
    s = np.interp(cases["dy"], table.dy, table.y_c) - HALF_DISTANCE
    np.testing.assert_allclose(s * 1e3, -cases["ycp_wheel_mm"], atol=0.1)


def test_contact_angle(table: ContactTable, cases: dict[str, np.ndarray]) -> None:
    angle = np.arctan(np.interp(cases["dy"], table.dy, table.tan_gamma))
    np.testing.assert_allclose(angle, cases["delta_tr_rad"], atol=4e-4)


def test_position_on_the_rail(
    wheel: Profile, rail: Profile, table: ContactTable, cases: dict[str, np.ndarray]
) -> None:
    contact = rigid_contact(wheel, rail, GAUGE, 16e-3, step=5e-5)
    offset = float(np.interp(0.0, contact.y, contact.t - contact.s))
    t = np.interp(cases["dy"], table.dy, table.y_c) - HALF_DISTANCE + cases["dy"] + offset
    # The benchmark's rail position is turned by the contact angle's small wheel height; 0.1 mm covers it.
    np.testing.assert_allclose(t * 1e3, -cases["ycp_rail_mm"], atol=0.1)


def test_penetration(table: ContactTable, cases: dict[str, np.ndarray]) -> None:
    # CONTACT's is of profiles that are no quadrics: where the patch reaches over a jump it is up to 7 % more.
    penetration = np.interp(cases["dy"], table.dy, table.static_penetration)
    np.testing.assert_allclose(penetration * 1e3, cases["approach_mm"], rtol=0.07)
    np.testing.assert_allclose(penetration[4:] * 1e3, cases["approach_mm"][4:], rtol=0.01)


def test_kinematic_roll(table: ContactTable, cases: dict[str, np.ndarray]) -> None:
    # The right wheel, whose flange approaches, decides the roll. Two terms of second order that the table
    # leaves out are added, 1 to 3 % of the climb: a yawed wheel touches r tan(gamma) psi ahead of its
    # axle, which moves it by psi^2 / 2 (e - r tan(gamma)) away from its rail, and roll tilts the flange by
    # phi * delta_r.
    right = -cases["shift"]
    steepness, radius = (np.interp(right, table.dy, q) for q in (table.tan_gamma, table.delta_r))
    right = right - 0.5 * cases["yaw_rad"] ** 2 * (HALF_DISTANCE - RADIUS * steepness)
    right = right - cases["roll_rad"] * radius
    roll = -np.interp(right, table.dy, table.phi_k)
    np.testing.assert_allclose(roll, cases["roll_rad"], rtol=0.01, atol=1e-5)


def test_our_formulas_are_the_benchmarks_profiles(wheel: Profile, rail: Profile) -> None:
    ours = wheel_profile(load_wheel("s1002"))
    inner = (ours.y > -0.0695) & (ours.y < 0.0595)
    np.testing.assert_allclose(np.interp(ours.y, wheel.y, wheel.z)[inner], ours.z[inner], atol=3e-5)
    ours = rail_profile(load_rail("60e1"))
    head = (ours.y > -0.036) & (ours.y < 0.025)  # beyond, on the outer corner, heights differ by 20 um
    np.testing.assert_allclose(np.interp(ours.y, rail.y, rail.z)[head], ours.z[head], atol=1e-5)
