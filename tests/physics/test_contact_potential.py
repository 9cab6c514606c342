"""Frictionless contact of a displaced, rolled and yawed wheelset: forces are the gradient of the rigid gap.

A wheel without friction has the generalised forces N dg/dq, with the vertical contact force N and the least
vertical gap g between the wheel, a surface of revolution about the wheelset's axis, and its rail. Here g is
found in space, by rotation matrices and a search over the wheel's surface, and differentiated by differences.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from sayd_env.config.contact import ContactConfig
from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import Array
from sayd_env.physics import step as kernels
from sayd_env.physics.contact.geometry import contact_table
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import (
    FORCE_X,
    FORCE_Y,
    FORCE_Z,
    MOMENT_PITCH,
    MOMENT_ROLL,
    MOMENT_YAW,
    WHEELSETS,
    Plant,
    Work,
)
from sayd_env.physics.profiles import Profile
from sayd_env.physics.rows import SINGLE
from sayd_env.physics.simulator import Simulator, VehicleModel

RADIUS, HALF, LOAD = 0.46, 0.75, 75e3
OUT = {
    "x": FORCE_X,
    "y": FORCE_Y,
    "z": FORCE_Z,
    "roll": MOMENT_ROLL,
    "pitch": MOMENT_PITCH,
    "yaw": MOMENT_YAW,
}


class Track(NamedTuple):
    """Attitude of the rails, rad."""

    yaw: float = 0.0
    cant: float = 0.0


class Pair(NamedTuple):
    """A conical wheel on a circular rail head."""

    cone: float
    """Slope of the wheel."""
    crown: float
    """Radius of the rail head, m."""
    larger: float
    """Radius of the wheel over `RADIUS` where it touches in the centre, m."""

    @property
    def middle(self) -> float:
        """Where that is, from the tape circle and from the rail's crown, m."""
        return -self.crown * self.cone / np.hypot(1.0, self.cone)

    def radius(self, s: Array | float) -> Array | float:
        """Radius of the wheel at a distance from its tape circle, m."""
        return RADIUS + self.larger - self.cone * (s - self.middle)


TREAD = Pair(cone=0.05, crown=0.3, larger=7.5e-4)
FLANGE = Pair(cone=1.0, crown=0.08, larger=20e-3)


def gap(surface: Array, pose: dict[str, float], side: float, track: Track, pair: Pair) -> float:
    """Gap below the point (s, theta) of a conical wheel, over a circular rail, upright to the track plane."""
    s, theta = surface
    radius = pair.radius(s)
    theta += pose["pitch"]
    point = np.array([radius * np.sin(theta), side * (HALF + s), -radius * np.cos(theta)])
    x, y, z = about_z(pose["yaw"]) @ about_x(pose["roll"]) @ point
    centre = np.array([x + pose["x"], y + pose["y"], z + RADIUS + pose["z"]])
    _, y, z = about_x(-track.cant) @ about_z(-track.yaw) @ centre
    t = side * y - HALF
    return float(z - (np.sqrt(pair.crown**2 - t**2) - pair.crown))


def about_x(angle: float) -> Array:
    """Rotation by a roll."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def about_z(angle: float) -> Array:
    """Rotation by a yaw."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def lowest_point(pose: dict[str, float], side: float, track: Track, pair: Pair) -> Array:
    """Point (s, theta) of least gap, by Newton's method on differences; the gap is nearly quadratic."""
    point, h = np.array([pair.middle, -pose["pitch"]]), 1e-4 * np.eye(2)
    for _ in range(6):
        at = {
            (i, j): gap(point + i * h[0] + j * h[1], pose, side, track, pair)
            for i in range(-1, 2)
            for j in range(-1, 2)
        }
        slope = np.array([at[1, 0] - at[-1, 0], at[0, 1] - at[0, -1]]) / 2e-4
        cross = (at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]) / 4e-8
        second = [at[1, 0] - 2.0 * at[0, 0] + at[-1, 0], at[0, 1] - 2.0 * at[0, 0] + at[0, -1]]
        point -= np.linalg.solve([[second[0] / 1e-8, cross], [cross, second[1] / 1e-8]], slope)
    return point


def gradient(pose: dict[str, float], side: float, track: Track, pair: Pair) -> dict[str, float]:
    """Derivatives of the least gap: those at the point where it is least (envelope theorem)."""
    least = lowest_point(pose, side, track, pair)
    h = 1e-6
    return {
        k: (
            gap(least, pose | {k: pose[k] + h}, side, track, pair)
            - gap(least, pose | {k: pose[k] - h}, side, track, pair)
        )
        / (2.0 * h)
        for k in pose
    }


def simulator(pair: Pair) -> Simulator:
    s = pair.middle + np.arange(-1000, 1001) * 5e-5
    wheel = Profile("cone", "wheel", s, pair.radius(s) - RADIUS, half_distance=HALF)
    t = np.arange(-1400, 1401) * (5e-5 if pair is FLANGE else 7.5e-5)
    rail = Profile("arc", "rail", t, np.sqrt(pair.crown**2 - t**2) - pair.crown, gauge_depth=0.014)
    gauge = 2.0 * (HALF - np.sqrt(2.0 * pair.crown * 0.014 - 0.014**2))
    config = ContactConfig(
        youngs_modulus=2.1e11,
        poisson_ratio=0.28,
        regularisation=0.01,
        table_step=5e-5,
        table_half_width=12e-3,
    )
    table = contact_table(wheel, rail, gauge, config, RADIUS, LOAD, HALF)
    overrides = ["track=smooth", "friction=1e-9", "contact_damping=0"]
    return Simulator(VehicleModel(load_scenario(overrides=overrides)), 80.0, table=table)


@pytest.fixture(scope="module")
def simulators() -> dict[Pair, Simulator]:
    return {pair: simulator(pair) for pair in (TREAD, FLANGE)}


@kernel
def touch(plant: Plant, work: Work) -> None:
    kernels.motions(SINGLE, plant, work)
    kernels.wheels(SINGLE, plant, work)


def contact_forces(simulator: Simulator, pose: dict[str, float], track: Track) -> Array:
    """What the wheels of the first wheelset, left and right, do in a pose: shape (rows, 2)."""
    plant, work = simulator.plant, simulator.work
    work.x[:] = 0.0
    work.x[simulator.model.multibody.wheelset_dofs[0]] = list(pose.values())
    rail = work.rail.reshape(-1, WHEELSETS)
    rail[:] = 0.0
    rail[kernels.SLOPE + kernels.ALIGNMENT, 0] = track.yaw
    rail[kernels.CROSS_LEVEL, 0] = track.cant
    touch(plant, work)
    return work.lane_out.reshape(-1, 2, WHEELSETS)[:, :, 0]


@pytest.mark.parametrize("pair", [TREAD, FLANGE], ids=["tread", "flange"])
@pytest.mark.parametrize(
    ("y", "roll", "yaw", "track"),
    [
        (0.0, 0.0, 0.0, Track()),
        (3e-3, 0.0, 0.0, Track()),
        (1e-3, 1e-3, 0.0, Track()),
        (2e-3, -2e-3, 0.0, Track()),
        (2e-3, 10e-3, 0.0, Track(cant=10e-3)),
        (-2e-3, 0.0, 10e-3, Track()),
        (0.0, 0.0, 15e-3, Track()),
        (2e-3, 0.0, 4e-3, Track(yaw=-6e-3)),
    ],
)
def test_forces_are_the_gradient_of_the_gap(
    simulators: dict[Pair, Simulator], pair: Pair, y: float, roll: float, yaw: float, track: Track
) -> None:
    """Lateral force, roll and yaw moment over the vertical force, in poses with a wheel at its static depth.

    Left out, and so allowed for: roll over the track moves a contact (the rail head's radius times roll); a
    rail at an angle has a force along the track.
    """
    centred = dict.fromkeys(OUT, 0.0)
    slope = abs(pair.cone)
    for wheel, side in enumerate((1.0, -1.0)):
        pose = centred | {"y": y - RADIUS * roll, "roll": roll, "yaw": yaw}
        pose["z"] = gap(lowest_point(centred, side, Track(), pair), centred, side, Track(), pair)
        pose["z"] -= gap(lowest_point(pose, side, track, pair), pose | {"z": 0.0}, side, track, pair)
        expected = gradient(pose, side, track, pair)
        out = contact_forces(simulators[pair], pose, track)
        force = {k: out[row, wheel] / out[FORCE_Z, wheel] for k, row in OUT.items()}
        tilt = abs(roll - track.cant)
        assert out[FORCE_Z, wheel] == pytest.approx(LOAD, rel=0.015)
        assert force["y"] == pytest.approx(
            expected["y"], abs=2e-5 + 2e-4 * slope + (0.02 + 0.11 * slope) * tilt
        )
        assert force["roll"] == pytest.approx(expected["roll"], abs=1e-4 + 2e-4 * slope + pair.crown * tilt)
        assert force["pitch"] == pytest.approx(expected["pitch"], abs=1e-8)
        assert force["yaw"] == pytest.approx(expected["yaw"], abs=1e-6 + 1e-5 * slope)
        assert force["x"] == pytest.approx(expected["x"], abs=1e-8 + 1.2 * slope * abs(track.yaw))
