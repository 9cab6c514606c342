"""Linear analysis: closed forms, symmetry, continuity over speed, names of modes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import Array, ComplexArray
from sayd_env.physics.linear import (
    HUNTING_BAND,
    OperatingPoint,
    critical_speed,
    linear_critical_speed,
    linearise,
    modes,
    root_locus,
    state_matrix,
)
from sayd_env.physics.mode_names import describe, numbered
from sayd_env.physics.multibody import Multibody
from sayd_env.physics.simulator import Simulator, VehicleModel

AMPLITUDE = 3e-3
SPEED = 250.0 / 3.6

# A vehicle that hunts on worn wheels, frozen for this test: its arm joints and yaw dampers are soft.
HUNTS = (
    "vehicle.elements.arm_joint.stiffness.0=50e6",
    "vehicle.elements.arm_joint.stiffness.1=6e6",
    "damper.curve=[[0.0, 0.0], [0.12, 12.0e3], [1.0, 15.0e3]]",
    "damper.series_stiffness=5.0e6",
)


def vehicle(*overrides: str) -> VehicleModel:
    return VehicleModel(load_scenario("estimates", ["track.irregularity={type: none}", *overrides]))


@pytest.fixture(scope="module")
def emu() -> VehicleModel:
    return vehicle()


def test_carbody_bounce_is_that_of_two_masses_on_springs(emu: VehicleModel) -> None:
    # Carbody on four air springs on two frames on eight primary springs and dampers; wheelsets at rest.
    # The swing arms' joints carry no vertical force; the dampers' series springs are too stiff to matter.
    config = emu.scenario.vehicle
    mass = {body.name: body.mass for body in config.bodies}
    element = {item.name: item for item in config.elements}
    primary, air = element["primary_spring"], element["air_spring"]
    velocity, force = element["primary_damper"].curve[1]
    k1, c1 = 8 * primary.stiffness[2], 8 * (primary.damping[2] + force / velocity)
    k2, c2 = 4 * air.stiffness[2], 4 * air.damping[2]
    carbody, frames, between = [mass["carbody"], c2, k2], [2 * mass["frame"], c1 + c2, k1 + k2], [c2, k2]
    values = np.roots(np.polysub(np.polymul(carbody, frames), np.polymul(between, between)))
    expected = min(values[values.imag > 0.0], key=abs)
    bounce = next(mode for mode in modes(emu, SPEED, AMPLITUDE) if mode.name == "carbody bounce")
    assert bounce.eigenvalue == pytest.approx(expected, rel=0.01)


def test_steady_running_is_pure_rolling(emu: VehicleModel) -> None:
    steady = linearise(emu, SPEED, AMPLITUDE)
    spin = emu.multibody.wheelset_dofs[:, 4]
    table, radius = steady.tables[0], emu.scenario.vehicle.wheel_radius
    delta_r = np.interp(0.0, table.dy, table.delta_r)
    # Spin rate of a wheel of radius r_0 + delta_r that rolls at V, over V / r_0.
    assert steady.v[spin] == pytest.approx(SPEED / (radius + delta_r) - SPEED / radius, rel=1e-6)
    assert np.max(np.abs(np.delete(steady.v, spin))) == 0.0
    assert np.max(np.abs(steady.q)) < 1e-5
    assert np.max(np.abs(steady.matrix[:, spin])) == 0.0  # nothing depends on the angle of rotation


def test_a_mirrored_vehicle_swings_either_sideways_or_up_and_down(emu: VehicleModel) -> None:
    sideways = np.array([name.rpartition(".")[2] in ("y", "roll", "yaw") for name in emu.multibody.dof_names])
    boxes = np.array([name.startswith("axlebox") for name in emu.multibody.dof_names])
    for mode in modes(emu, SPEED, AMPLITUDE):
        energy = np.where(boxes, 0.0, emu.multibody.mass * np.abs(mode.shape) ** 2)
        share = np.sum(energy[sideways]) / np.sum(energy)
        assert min(share, 1.0 - share) < 1e-6, mode.name


def test_eigenvectors_belong_to_the_state_matrix(emu: VehicleModel) -> None:
    matrix = state_matrix(emu, SPEED, AMPLITUDE)
    for mode in modes(emu, SPEED, AMPLITUDE):
        size = np.linalg.norm(mode.eigenvalue * mode.vector)
        assert np.linalg.norm(matrix @ mode.vector - mode.eigenvalue * mode.vector) < 1e-6 * size
        assert np.max(np.abs(mode.shape)) == pytest.approx(1.0)
        assert mode.frequency_hz == pytest.approx(mode.eigenvalue.imag / (2.0 * np.pi))


def test_worn_wheels_hunt_at_a_lower_speed() -> None:
    # The higher the conicity, the lower the critical speed (Wickens 2003, chapter 5).
    speeds = np.arange(100.0, 501.0, 50.0) / 3.6
    hunts = vehicle(*HUNTS)
    worn = linear_critical_speed(hunts, AMPLITUDE, speeds)
    new = linear_critical_speed(vehicle(*HUNTS, "wear=0.0"), AMPLITUDE, speeds)
    assert worn is not None
    assert new is None or new > 1.1 * worn
    growth = max(
        mode.eigenvalue.real
        for mode in modes(hunts, worn, AMPLITUDE)
        if HUNTING_BAND[0] <= mode.frequency_hz <= HUNTING_BAND[1]
    )
    assert growth == pytest.approx(0.0, abs=1e-6)


def test_root_locus_holds_each_mode_once_and_follows_it_smoothly(emu: VehicleModel) -> None:
    speeds = np.arange(200.0, 301.0, 10.0) / 3.6
    locus = root_locus(emu, speeds, AMPLITUDE)
    for s in (0, 5, 10):
        found = np.sort_complex(locus.eigenvalues[s][np.isfinite(locus.eigenvalues[s])])
        expected = np.sort_complex([mode.eigenvalue for mode in modes(emu, speeds[s], AMPLITUDE)])
        assert found == pytest.approx(expected, rel=1e-9)
    assert len(set(locus.names)) == len(locus.names)
    low = np.all((locus.frequency_hz > 0.5) & (locus.frequency_hz < 12.0), axis=0)
    hunting = [b for b in np.flatnonzero(low) if locus.names[b].startswith("bogie hunting")]
    assert len(hunting) >= 2
    for b in hunting[:2]:
        # Along a branch the second differences are small against the change over the range.
        path = locus.eigenvalues[:, b]
        assert np.max(np.abs(np.diff(path, 2))) < 0.02 * np.abs(path[-1] - path[0])


def test_critical_speed_of_an_oscillator_whose_damping_falls_with_speed() -> None:
    def matrix(speed: float) -> Array:
        return np.array([[0.0, 1.0], [-((2.0 * np.pi * 4.0) ** 2), speed - 60.0]])

    assert critical_speed(matrix, [40.0, 50.0, 70.0]) == pytest.approx(60.0, abs=1e-5)
    assert critical_speed(matrix, [20.0, 30.0, 50.0]) is None
    assert critical_speed(matrix, [65.0, 70.0]) == 65.0
    assert critical_speed(matrix, [40.0, 50.0, 70.0], band=(5.0, 15.0)) is None


def test_a_speed_or_amplitude_out_of_range_is_refused(emu: VehicleModel) -> None:
    with pytest.raises(ConfigError, match="outside the range of vehicle 'emu-estimate'"):
        state_matrix(emu, 300.0, AMPLITUDE)
    with pytest.raises(DataError, match="linearisation amplitude: found 50 mm"):
        state_matrix(emu, SPEED, 0.05)
    for wrong in ({"shift": -1e-3}, {"stroke_speed": math.nan}, {"frequency": 0.0}):
        with pytest.raises(ConfigError, match=f"{next(iter(wrong))}: found .*; expected a number"):
            OperatingPoint(SPEED, **{"shift": 1e-3, "stroke_speed": 1e-2} | wrong)
    with pytest.raises(ConfigError, match=r"distance: found -1\.0 m"):
        Simulator(emu, SPEED, 0).run(-1.0)


class TestNames:
    """Names of motions made by hand."""

    @staticmethod
    def shape(body: Multibody, **values: complex) -> ComplexArray:
        """Shape from values by body and freedom: carbody_z=1, or wheelset_y=1 for all wheelsets."""
        result = np.zeros(body.n, dtype=complex)
        for key, value in values.items():
            name, _, dof = key.rpartition("_")
            for instance in body.instances.values():
                if instance.name.replace(".", "_").startswith(name) and dof in instance.columns:
                    result[instance.columns[dof]] = value
        return result

    @pytest.mark.parametrize(
        ("motion", "name"),
        [
            ({"carbody_z": 1.0}, "carbody bounce"),
            ({"carbody_pitch": 1.0}, "carbody pitch"),
            ({"carbody_yaw": 1.0, "frame_y": 0.1}, "carbody yaw"),
            # Turned about a pole 1 m below its centre: the roof goes left (y > 0), which is roll < 0.
            ({"carbody_y": 1.0, "carbody_roll": -1.0}, "carbody lower sway"),
            ({"carbody_y": 1.0, "carbody_roll": 1.0}, "carbody upper sway"),
            ({"frame_y": 1.0, "wheelset_y": 1.0, "wheelset_yaw": 0.4j}, "bogie hunting in phase"),
            (
                {"frame_front_y": 1, "wheelset_front_y": 1, "frame_rear_y": -1, "wheelset_rear_y": -1},
                "bogie hunting anti phase",
            ),
            (
                {"frame_front_y": 1, "wheelset_front_y": 1, "frame_rear_y": 1j, "wheelset_rear_y": 1j},
                "bogie hunting out of phase",
            ),
            ({"frame_rear_y": 1.0, "wheelset_rear_y": 1.0}, "bogie hunting rear"),
            ({"frame_y": 1.0, "wheelset_y": -0.5}, "bogie lateral in phase"),
            ({"frame_front_z": 1.0, "frame_rear_z": -1.0}, "bogie bounce anti phase"),
            ({"frame_front_pitch": 1.0}, "bogie pitch front"),
            ({"frame_x": 1.0, "wheelset_x": 1.0}, "bogie longitudinal in phase"),
            ({"wheelset_front_leading_yaw": 1.0}, "wheelset yaw"),
            ({"wheelset_z": 1.0, "frame_z": -0.3}, "wheelset bounce"),
            ({"axlebox_pitch": 1.0}, "axlebox pitch"),
        ],
    )
    def test_motion(self, emu: VehicleModel, motion: dict[str, complex], name: str) -> None:
        assert describe(emu.multibody, self.shape(emu.multibody, **motion)) == name

    def test_track(self, emu: VehicleModel) -> None:
        shape = np.zeros(emu.multibody.n, dtype=complex)
        shape[emu.multibody.section_dofs[:, 0]] = 1.0
        assert describe(emu.multibody, shape) == "track lateral"

    def test_equal_names_are_numbered(self) -> None:
        assert numbered(["a", "b", "a", "a"]) == ["a", "b", "a 2", "a 3"]
        assert numbered(["a", "a"], order=[1, 0]) == ["a 2", "a"]

    def test_a_vehicle_has_each_carbody_mode_once(self, emu: VehicleModel) -> None:
        names = [mode.name for mode in modes(emu, SPEED, AMPLITUDE)]
        for name in ("bounce", "pitch", "yaw", "lower sway", "upper sway"):
            assert f"carbody {name}" in names
            assert f"carbody {name} 2" not in names
        assert sum(name.startswith("bogie hunting") for name in names) >= 2
