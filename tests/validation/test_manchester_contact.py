"""Contact position, angle and forces against CONTACT on the Manchester contact benchmark.

Source: Manchester contact benchmark, case A-2.2 (Shackleton and Iwnicki 2006), S1002 on UIC60: a wheelset
shifted by 0 to 10 mm to the right and yawed by 0 to 24 mrad, as in a curve, 10 kN a wheel, friction 0.3,
computed with CONTACT (Vollebregt); see data/NOTICE. Its axes: y to the right, z down, forces on the rails.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import root

from sayd_env.config import validate
from sayd_env.config.loader import parse_yaml
from sayd_env.config.profile import RailProfileConfig, Shape, WheelProfileConfig, load_rail, load_wheel
from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import NoIrregularityConfig
from sayd_env.config.units import GRAVITY
from sayd_env.config.vehicle import VehicleConfig
from sayd_env.physics import plant as at
from sayd_env.physics import step as kernels
from sayd_env.physics.contact.geometry import ContactTable, contact_table, rigid_contact
from sayd_env.physics.profiles import Profile, gauge_point, rail_profile, wheel_profile
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.physics.track.realisation import realise

DATA = Path(__file__).parent / "data"
RADIUS, HALF_DISTANCE, GAUGE, LOAD, FRICTION = 0.46, 0.75, 1.435, 10e3, 0.3
BENCHMARK_SPEED, SPEED = 2.0, 50.0  # m/s; creepages are the same at both
WHEEL = WheelProfileConfig(
    kind="wheel",
    name="S1002",
    shape=Shape(file=str(DATA / "MBench_S1002_v3.prw")),
    back_to_back=1.36,
    tape_to_back=0.07,
)
RAIL = RailProfileConfig(
    kind="rail",
    name="UIC60",
    shape=Shape(file=str(DATA / "MBench_UIC60_v3.prr"), invert=True),
    cant=0.0,
    gauge_depth=0.014,
)
WHEELSET = f"""
name: wheelset
wheel_radius: {RADIUS}
measuring_height: {RADIUS}
speed_range: [1.0, 80.0]
bodies:
  - name: wheelset
    role: wheelset
    mass: {2.0 * LOAD / GRAVITY}
    inertia: [750.0, 110.0, 750.0]
    position: [0.0, 0.0, {RADIUS}]
elements:
  - name: speed_hold
    type: bush
    a: {{body: ground, at: [0.0, 0.0, {RADIUS}]}}
    b: {{body: wheelset, at: [0.0, 0.0, {RADIUS}]}}
    stiffness: [1.0e3, 0.0, 0.0]
    damping: [1.0e3, 0.0, 0.0]
"""


@pytest.fixture(scope="module")
def wheel() -> Profile:
    return wheel_profile(WHEEL)


@pytest.fixture(scope="module")
def rail() -> Profile:
    return rail_profile(RAIL)


def columns(name: str) -> dict[str, np.ndarray]:
    with (DATA / name).open() as stream:
        rows = list(csv.DictReader(stream))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


@pytest.fixture(scope="module")
def cases() -> dict[str, np.ndarray]:
    case = columns("manchester_A22_left.csv")
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


@pytest.fixture(scope="module")
def published() -> dict[str, np.ndarray]:
    """What CONTACT gives; the force vectors by wheel, (case, left and right, along and across)."""
    case = columns("manchester_A22_forces.csv")
    wheels = [[case[f"f{axis}_{side}_N"] for axis in "xy"] for side in ("left", "right")]
    return case | {"forces": np.moveaxis(np.array(wheels), 2, 0)}


@pytest.fixture(scope="module")
def ours(published: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What the time loop makes of these cases, in the benchmark's axes.

    Shift, yaw and speed of rotation are given; height and roll are those at which the rails carry 10 kN each.
    """
    overrides = ["wear=0.0", "track=smooth", f"track.gauge={GAUGE}", f"friction={FRICTION}"]
    scenario = load_scenario("estimates", [*overrides, "contact.table_half_width=0.016"])
    vehicle = validate(VehicleConfig, parse_yaml(WHEELSET, "wheelset"), "wheelset")
    model = VehicleModel(scenario.model_copy(update={"vehicle": vehicle, "wheel": WHEEL, "rail": RAIL}))
    simulator = Simulator(model, SPEED, track=realise(NoIrregularityConfig(type="none"), 1000.0, 0))
    _, y, z, roll, pitch, yaw = model.multibody.wheelset_dofs[0]
    q, v = np.zeros((2, len(simulator.state.q)))
    wheels = simulator.work.lane_out.reshape(at.ROWS_OUT, at.LANES)[:, [0, at.WHEELSETS]]

    def imbalance(place: np.ndarray) -> np.ndarray:
        q[[z, roll]] = 1e-4 * place
        kernels.contact_at(simulator.plant, q, v, 100.0, simulator.work)
        wheels[:] = simulator.work.lane_out.reshape(at.ROWS_OUT, at.LANES)[:, [0, at.WHEELSETS]]
        return wheels[at.FORCE_Z] / LOAD - 1.0

    found: dict[str, list[np.ndarray]] = {"roll": [], "forces": []}
    for k, guess in enumerate(published["roll_rad"]):
        q[y], q[yaw] = -1e-3 * published["y_ws_mm"][k], -published["yaw_rad"][k]
        v[pitch] = -published["vpitch_rad_s"][k] * SPEED / BENCHMARK_SPEED - SPEED / RADIUS
        solution = root(imbalance, [0.0, 1e4 * guess], tol=1e-10)
        assert solution.success, solution.message
        found["roll"].append(q[roll].copy())
        # Forces on the rails are the opposite, and y is turned round as well.
        found["forces"].append(np.stack([-wheels[at.FORCE_X], wheels[at.FORCE_Y]], axis=1))
    return {name: np.array(values) for name, values in found.items()}


# The flange touches from 6.5 mm on. At 0, 0.5 and 5 to 6 mm the contact passes from one part of the tread to
# another.
TREAD, BETWEEN, FLANGE = slice(2, 10), [0, 1, 10, 11, 12], slice(13, None)


def test_forces_on_the_tread(ours: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> None:
    error = np.linalg.norm(ours["forces"] - published["forces"], axis=2) / (FRICTION * LOAD)
    assert error[TREAD].max() < 0.015
    # At 0.5 mm the angle of the regularised contact is 1 mrad off, with the slip still below its bound.
    assert error[BETWEEN].max() < 0.11


def test_track_shift_force(ours: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> None:
    """Sum of the lateral forces of a wheelset, up to 10.4 kN, half of its weight."""
    force, reference = (each["forces"][..., 1].sum(axis=1) for each in (ours, published))
    np.testing.assert_allclose(force[TREAD], reference[TREAD], rtol=0.01)
    np.testing.assert_allclose(force[BETWEEN], reference[BETWEEN], rtol=0.07, atol=1.0)
    np.testing.assert_allclose(force[FLANGE], reference[FLANGE], rtol=0.02)


def test_steering_moment(ours: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> None:
    """Moment of the longitudinal forces about the wheelset's centre, up to 3.3 kN m."""
    moment, reference = (-HALF_DISTANCE * np.diff(each["forces"][..., 0])[:, 0] for each in (ours, published))
    np.testing.assert_allclose(moment[TREAD], reference[TREAD], rtol=0.035)
    np.testing.assert_allclose(moment[BETWEEN], reference[BETWEEN], rtol=0.11, atol=1.0)
    np.testing.assert_allclose(moment[FLANGE], reference[FLANGE], rtol=0.026)


def test_roll_under_load(ours: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> None:
    np.testing.assert_allclose(ours["roll"][TREAD], published["roll_rad"][TREAD], rtol=0.025)
    np.testing.assert_allclose(ours["roll"][FLANGE], published["roll_rad"][FLANGE], rtol=0.015)


def steepest(along: float, across: float) -> float:
    """Largest contact angle (rad) at which a wheel with these forces on its rail is within its friction."""
    angle = np.linspace(0.0, 0.5 * np.pi, 9001)
    normal = LOAD * np.cos(angle) + abs(across) * np.sin(angle)
    tangential = np.hypot(along, LOAD * np.sin(angle) - abs(across) * np.cos(angle))
    return float(angle[tangential <= FRICTION * normal].max())


def test_angle_of_the_flange(ours: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> None:
    """The benchmark gives forces of the right wheel, no angle; a sliding one has the steepest they allow."""
    pairs = zip(ours["forces"][FLANGE, 1], published["forces"][FLANGE, 1], strict=True)
    error = [steepest(*own) - steepest(*reference) for own, reference in pairs]
    assert np.degrees(np.abs(error)).max() < 0.25
