"""Assembly of vehicles: counts, statics, symmetries and closed forms."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from sayd_env.config import ConfigError, apply_overrides, read_config, validate
from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import SectionConfig, read_track
from sayd_env.config.units import Array
from sayd_env.config.vehicle import VehicleConfig
from sayd_env.physics import layout
from sayd_env.physics.multibody import Multibody, assemble
from sayd_env.physics.simulator import VehicleModel

STANDARD_GRAVITY = 9.81


def section() -> SectionConfig:
    return read_track("smooth").section


def raw(name: str) -> dict[str, Any]:
    data, _ = read_config("vehicle", name)
    return dict(data)


def assembled(data: dict[str, Any], *overrides: str) -> Multibody:
    return assemble(validate(VehicleConfig, apply_overrides(data, overrides), "test"), section())


@pytest.fixture(scope="module")
def emu() -> Multibody:
    return assembled(raw("emu-estimate"))


def wheelset(**more: Any) -> dict[str, Any]:
    """One wheelset below a body on four springs, two on each side: the smallest vehicle with a pendulum."""
    data: dict[str, Any] = {
        "name": "trolley",
        "wheel_radius": 0.46,
        "measuring_height": 0.5,
        "speed_range": [5.0, 100.0],
        "sets": {
            "end": {"fore": {}, "aft": {"sign": [-1, 1, 1]}},
            "side": {"left": {}, "right": {"sign": [1, -1, 1]}},
        },
        "bodies": [
            {
                "name": "axle",
                "role": "wheelset",
                "mass": 1500.0,
                "inertia": [700.0, 100.0, 700.0],
                "position": [0.0, 0.0, 0.46],
            },
            {
                "name": "box",
                "role": "carbody",
                "mass": 12000.0,
                "inertia": [9e3, 8e3, 7e3],
                "position": [0.0, 0.0, 1.3],
            },
        ],
        "elements": [
            {
                "name": "spring",
                "type": "bush",
                "per": ["end", "side"],
                "carries_weight": True,
                "a": {"body": "axle", "at": [0.3, 0.9, 0.7]},
                "b": {"body": "box", "at": [0.3, 0.9, 0.7]},
                "stiffness": [1e5, 2e5, 4e5],
            },
        ],
    }
    return data | more


def test_count_of_the_papers_vehicle(emu: Multibody) -> None:
    """Wang et al. (2022): 62 degrees of freedom and eight yaw dampers; 6 (1 + 2 + 4) + 8 + 4 x 3 = 62."""
    assert emu.n == 62
    assert len(set(emu.dof_names)) == 62
    assert len(emu.yaw_dampers) == 8
    assert emu.wheelset_dofs.shape == (4, 6)
    assert emu.section_dofs.shape == (4, 3)


def test_count_of_the_manchester_vehicle() -> None:
    """Rigid axleboxes: 6 x 7 + 4 x 3 = 54, no yaw dampers."""
    body = assembled(raw("manchester"))
    assert body.n == 54
    assert body.yaw_dampers == ()


def test_static_wheel_loads(emu: Multibody) -> None:
    """Axle load 150 kN and bogie mass 5.6 t (Wang et al. 2022): an eighth of the weight on each wheel."""
    np.testing.assert_allclose(emu.wheel_load, emu.total_mass * STANDARD_GRAVITY / 8.0, rtol=1e-6)
    np.testing.assert_allclose(2.0 * emu.wheel_load, 150e3, rtol=1e-5)
    assert emu.bogie_mass == pytest.approx(5600.0)


def test_total_mass_of_the_manchester_vehicle() -> None:
    """Body 32 t, two frames of 2.615 t, four wheelsets of 1.813 t (Iwnicki 1998)."""
    body = assembled(raw("manchester"))
    assert body.total_mass == pytest.approx(32000.0 + 2 * 2615.0 + 4 * 1813.0)
    np.testing.assert_allclose(body.wheel_load, body.total_mass * STANDARD_GRAVITY / 8.0, rtol=1e-6)


@pytest.mark.parametrize("name", ["emu-estimate", "manchester"])
def test_matrices_are_symmetric(name: str) -> None:
    """Springs, dampers and dead loads have a potential; gyroscopic forces do no work."""
    body = assembled(raw(name))
    scale = np.max(np.abs(body.stiffness))
    np.testing.assert_allclose(body.stiffness, body.stiffness.T, atol=1e-12 * scale)
    np.testing.assert_array_equal(body.damping, body.damping.T)
    np.testing.assert_array_equal(body.gyroscopic, -body.gyroscopic.T)
    assert np.min(np.linalg.eigvalsh(body.damping)) > -1e-6


def rigid_motion(body: Multibody, axis: int) -> Array:
    """Displacements of all bodies in a rigid translation (0 to 2) or rotation about the origin (3 to 5)."""
    motion = np.zeros(body.n)
    for item in body.instances.values():
        if axis < 3:
            values = dict(zip(("x", "y", "z"), np.eye(3)[axis], strict=True))
        else:
            move = np.cross(np.eye(3)[axis - 3], item.position)
            values = dict(
                zip(("x", "y", "z", "roll", "pitch", "yaw"), [*move, *np.eye(3)[axis - 3]], strict=True)
            )
        for dof, column in item.columns.items():
            motion[column] = values.get(dof, 0.0)
    return motion


@pytest.mark.parametrize("name", ["emu-estimate", "manchester"])
@pytest.mark.parametrize("axis", range(6))
def test_rigid_motion_strains_no_element(name: str, axis: int) -> None:
    """Free of rails, traction and gravity, a vehicle moves as one without a force, whatever its geometry."""
    data = raw(name)
    elements = [e for e in data["elements"] if e["name"] != "speed_hold"]
    for element in elements:
        element.pop("carries_weight", None)
    body = _weightless(data | {"elements": elements})
    motion = rigid_motion(body, axis)
    scale = np.max(np.abs(body.stiffness))
    np.testing.assert_allclose(body.stiffness @ motion, 0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(body.damping @ motion, 0.0, atol=1e-9 * np.max(body.damping))
    for element in (*body.dampers, *body.stops):
        assert element.connection @ motion == pytest.approx(0.0, abs=1e-12)
    for _, bogie, car in body.yaw_dampers:
        assert (bogie - car) @ motion == pytest.approx(0.0, abs=1e-12)


def _weightless(data: dict[str, Any]) -> Multibody:
    """Assemble without gravity, so that no spring needs to carry weight."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sayd_env.physics.multibody.GRAVITY", 0.0)
        return assembled(data)


def test_gravity_stiffness_of_a_body_on_springs() -> None:
    """A body whose centre is h above its springs: 4 k_z b^2 + 4 k_y h^2 in roll, 4 k_y h + m g / 2 coupled.

    The springs' forces m g / 4 turn with half the body's roll: of the inverted pendulum's - m g h (feet that
    move under a vertical force) nothing is left, and the coupling gains half the weight.
    """
    body = assembled(wheelset())
    box = body.instances["box"].columns
    h, half, along = 1.3 - 0.7, 0.9, 0.3
    weight = 12000.0 * STANDARD_GRAVITY
    k = body.stiffness
    assert k[box["roll"], box["roll"]] == pytest.approx(4 * 4e5 * half**2 + 4 * 2e5 * h**2)
    assert k[box["pitch"], box["pitch"]] == pytest.approx(4 * 4e5 * along**2 + 4 * 1e5 * h**2)
    # Positive roll moves the springs' feet, below the centre, to +y.
    assert k[box["y"], box["roll"]] == pytest.approx(4 * 2e5 * h + weight / 2)
    assert k[box["yaw"], box["yaw"]] == pytest.approx(4 * (1e5 * half**2 + 2e5 * along**2))


def test_a_body_on_a_canted_base_slides_down() -> None:
    """Equilibrium along the plane: the springs' lateral force 4 k_y d carries m g times the mean roll."""
    body = assembled(wheelset())
    box = [body.instances["box"].columns[d] for d in ("x", "y", "z", "roll", "pitch", "yaw")]
    cant = 1e-3 * rigid_motion(body, 3)
    rest = cant.copy()
    held = np.setdiff1d(np.arange(body.n), box)
    rest[box] = np.linalg.solve(
        body.stiffness[np.ix_(box, box)], -body.stiffness[np.ix_(box, held)] @ cant[held]
    )
    foot = np.array([0.3, 0.9, 0.7])
    lateral = np.array([0.0, 1.0, 0.0])
    name = next(n for n, i in body.instances.items() if i.body.role == "wheelset")
    shift = (body.point("box", foot, lateral) - body.point(name, foot, lateral)) @ rest
    roll = 0.5 * (1e-3 + rest[body.instances["box"].columns["roll"]])
    assert 4 * 2e5 * shift == pytest.approx(-12000.0 * STANDARD_GRAVITY * roll, rel=1e-9)


def test_falling_over_follows_the_pendulum() -> None:
    """A rigid vehicle rotated about the track's centre loses m g z of stiffness for every body at height z.

    Bodies that hang together turn as one about the rail: what is left of K is gravity alone, and the
    potential energy m g z cos(theta) has the second derivative -m g z. The wheelset's own weight meets no
    spring: it and the load on it are carried by the contacts, which are not part of K.
    """
    body = assembled(wheelset())
    motion = rigid_motion(body, 3)
    box_weight = 12000.0 * STANDARD_GRAVITY
    axle = 0.46 * box_weight  # contact forces at the axle's foot, which K leaves out
    expected = -box_weight * 1.3 + axle
    assert motion @ body.stiffness @ motion == pytest.approx(expected, rel=1e-9)


def test_anti_roll_bar() -> None:
    """A torsion bar adds its stiffness to relative roll and to nothing else."""
    bar = {
        "name": "bar",
        "type": "torsion",
        "axis": "roll",
        "stiffness": 3e6,
        "a": {"body": "axle", "at": [0.0, 0.0, 0.5]},
        "b": {"body": "box", "at": [0.0, 0.0, 0.5]},
    }
    plain, data = assembled(wheelset()), wheelset()
    data["elements"].append(bar)
    more = assembled(data)

    def value(body: Multibody, a: str, b: str) -> float:
        i, j = body.instances[a].columns["roll"], body.instances[b].columns["roll"]
        return float(body.stiffness[i, j])

    for a, b, expected in (("axle", "axle", 3e6), ("box", "box", 3e6), ("axle", "box", -3e6)):
        assert value(more, a, b) - value(plain, a, b) == pytest.approx(expected)
    assert np.sum(np.abs(more.stiffness)) - np.sum(np.abs(plain.stiffness)) == pytest.approx(4 * 3e6)


def test_hinged_axlebox(emu: Multibody) -> None:
    """A point of a swing arm moves with the wheelset, but for its pitch, which is the arm's own."""
    name = "axlebox.front.leading.left"
    arm, carrier = emu.instances[name].columns, emu.instances["wheelset.front.leading"].columns
    bolt = np.array([8.75 + 1.25 - 0.5, 1.0, 0.476])
    rows = {axis: emu.point(name, bolt, d) for axis, d in zip("xyz", np.eye(3), strict=True)}
    expected = {  # theta x r with r = (-0.5, 1, 0.016) from the axle's centre, pitch from the hinge
        "x": {carrier["x"]: 1.0, arm["pitch"]: 0.016, carrier["yaw"]: -1.0},
        "y": {carrier["y"]: 1.0, carrier["roll"]: -0.016, carrier["yaw"]: -0.5},
        "z": {carrier["z"]: 1.0, carrier["roll"]: 1.0, arm["pitch"]: 0.5},
    }
    for axis, entries in expected.items():
        wanted = np.zeros(emu.n)
        wanted[list(entries)] = list(entries.values())
        np.testing.assert_allclose(rows[axis], wanted, atol=1e-12)


def dynamic_stiffness(body: Multibody) -> tuple[complex, float]:
    """Sign and logarithm of det(s^2 M + s C + K) at a complex s: a number that all eigenvalues determine."""
    s = 3.0 + 7.0j
    matrix = s**2 * np.diag(body.mass) + s * (body.damping + 170.0 * body.gyroscopic) + body.stiffness
    sign, logarithm = np.linalg.slogdet(matrix)
    return complex(sign), float(logarithm)


def test_order_and_names_do_not_matter(emu: Multibody) -> None:
    """The same vehicle written down differently has the same eigenvalues and loads."""
    data = raw("emu-estimate")
    data["bodies"] = data["bodies"][::-1]
    data["elements"] = data["elements"][::-1]
    text = json.dumps(data).replace('"side"', '"flank"')
    for key in ("name", "body"):
        text = text.replace(f'"{key}": "frame"', f'"{key}": "bogie"')
    other = assembled(json.loads(text))
    assert other.n == emu.n
    assert {name.split(".")[0] for name in other.dof_names} ^ {n.split(".")[0] for n in emu.dof_names} == {
        "frame",
        "bogie",
    }
    (sign, size), (other_sign, other_size) = dynamic_stiffness(emu), dynamic_stiffness(other)
    assert size == pytest.approx(other_size, rel=1e-12)
    assert abs(sign - other_sign) < 1e-9
    np.testing.assert_allclose(other.wheel_load, emu.wheel_load, rtol=1e-9)


def test_another_number_is_another_vehicle(emu: Multibody) -> None:
    """Only the data differ: a heavier frame raises its share of the load, a softer spring lowers K."""
    heavier = assembled(raw("emu-estimate"), "bodies.frame.mass=3500")
    extra = 2 * 1000.0 * STANDARD_GRAVITY / 8.0
    np.testing.assert_allclose(heavier.wheel_load - emu.wheel_load, extra, rtol=1e-5)
    assert dynamic_stiffness(heavier)[1] > dynamic_stiffness(emu)[1]


def test_weight_that_nothing_carries() -> None:
    with pytest.raises(ConfigError, match=r"static weight is not carried.*carries_weight"):
        assembled(raw("emu-estimate"), "elements.air_spring.carries_weight=false")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("elements.air_spring.a.body=fram", "unknown body 'fram', did you mean 'frame'"),
        ("elements.air_spring.per=[bogy, side]", "unknown set 'bogy', did you mean 'bogie'"),
        ("elements.primary_spring.per=[bogie]", "cannot reach 'axlebox'"),
        ("bodies.frame.mass=-1", "mass"),
        ("bodies.frame.inertia=[0, 1, 1]", "moments of inertia must be positive"),
        ("bodies.frame.name=carbody", "same name"),
        ("elements.lateral_damper.curve=[[0, 0], [0.1, 5], [0.1, 6]]", "must increase"),
        ("elements.lateral_stop.curve=[[0, 0], [0.1, 5], [0.2, 4]]", "must not fall"),
    ],
)
def test_refused_vehicles(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        assembled(raw("emu-estimate"), override)


def test_a_wheelset_on_rails_moves_in_all_directions() -> None:
    """A reduced wheelset serves the linear analysis alone: the contact needs all of its motion."""
    scenario = load_scenario(overrides=["vehicle.bodies.wheelset.dofs=[x, y, z, roll, yaw]"])
    with pytest.raises(ConfigError, match="needs all six degrees of freedom"):
        VehicleModel(scenario)


def test_vehicles_of_one_design_share_its_layout_and_nothing_else() -> None:
    """Whatever was assembled before: numbers are each vehicle's own."""
    stiffer = ("elements.arm_joint.stiffness=[60e6,7e6,20e6]", "bodies.carbody.mass=45000.0")
    emu, after = assembled(raw("emu-estimate")), assembled(raw("emu-estimate"), *stiffer)
    assert after.arrangement is emu.arrangement
    layout._layout.cache_clear()
    fresh = assembled(raw("emu-estimate"), *stiffer)
    for name in ("mass", "stiffness", "damping", "gyroscopic", "wheel_load"):
        np.testing.assert_array_equal(getattr(after, name), getattr(fresh, name))
        assert np.any(getattr(after, name) != getattr(emu, name)) == (name not in ("damping", "gyroscopic"))
    assert after.instances["carbody"].body.mass == 45000.0
    assert emu.instances["carbody"].body.mass != 45000.0


def test_another_place_of_an_element_is_another_design(emu: Multibody) -> None:
    moved = assembled(raw("emu-estimate"), "elements.traction_rod.a.at=[0.0, 0.0, 0.519]")
    assert moved.arrangement is not emu.arrangement
    assert np.any(moved.stiffness != emu.stiffness)
