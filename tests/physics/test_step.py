"""The compiled step: determinism, symmetry, equilibrium, unilateral contact and friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import CHANNELS
from sayd_env.physics import step as kernels
from sayd_env.physics.contact import creep
from sayd_env.physics.plant import (
    FORCE_X,
    FORCE_Y,
    FORCE_Z,
    LANES,
    NORMAL,
    POWER_SLIP,
    ROWS_OUT,
    WHEELSETS,
)
from sayd_env.physics.simulator import Simulator, Telemetry, VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.runs.executors import ExecutorChoice
from sayd_env.runs.passive import sweep

SPEED = 300.0 / 3.6


@pytest.fixture(scope="module")
def model() -> VehicleModel:
    """The packaged vehicle on a short run."""
    return VehicleModel(load_scenario("estimates", ["assessment.run_in=100", "assessment.length=500"]))


def signals(run: Telemetry) -> np.ndarray:
    """Everything that a run recorded, side by side."""
    return np.hstack([run.acceleration, run.track_shift, run.damper_force, run.wheel_vertical, run.motion])


def test_same_seed_same_bits(model: VehicleModel) -> None:
    """Two runs of a seed agree to the last bit, in one piece or in many; another seed differs."""
    whole = Simulator(model, SPEED, 3).advance(600, wheels=True, motion=True)
    pieces = Simulator(model, SPEED, 3)
    parts = [signals(pieces.advance(n, wheels=True, motion=True)) for n in (1, 99, 500)]
    np.testing.assert_array_equal(signals(whole), np.vstack(parts))
    other = Simulator(model, SPEED, 4).advance(600, wheels=True, motion=True)
    assert np.max(np.abs(other.track_shift - whole.track_shift)) > 100.0


def test_threads_do_not_matter(model: VehicleModel) -> None:
    """A sweep with one worker and with more gives the same bits, whatever runs side by side."""
    one, two = (
        sweep(model.scenario, [80.0, 97.0], [0, 1], RunContext(ExecutorChoice(workers=n))) for n in (1, 4)
    )
    for name in ("frequency", "frequency_force", "acceleration", "track_shift"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_mirror_symmetry(model: VehicleModel) -> None:
    """On the mirrored track (alignment and cross-level reversed) everything lateral is reversed."""
    track = model.realisation(5)
    sign = np.where(np.isin(CHANNELS, ("alignment", "cross_level")), -1.0, 1.0)
    mirrored = replace(track, coefficients=track.coefficients * sign)
    one, two = (Simulator(model, SPEED, track=t).advance(2000, wheels=True) for t in (track, mirrored))
    for name, size in (("acceleration", 1.0), ("track_shift", 1e4)):
        np.testing.assert_allclose(getattr(two, name), -getattr(one, name), atol=1e-6 * size)
    swapped = one.wheel_vertical.reshape(-1, 4, 2)[:, :, ::-1].reshape(-1, 8)
    np.testing.assert_allclose(two.wheel_vertical, swapped, atol=0.1)


def test_rest_on_even_track() -> None:
    """On even track nothing swings: the wheels keep an eighth of the weight, nothing moves sideways."""
    still = VehicleModel(load_scenario(overrides=["track=smooth"]))
    run = Simulator(still, 250.0 / 3.6).advance(2000, wheels=True)
    weight = still.multibody.total_mass * 9.81
    assert np.max(np.abs(run.acceleration)) < 1e-6
    assert np.max(np.abs(run.track_shift)) < 0.1
    np.testing.assert_allclose(run.wheel_vertical, weight / 8.0, rtol=5e-3)
    np.testing.assert_allclose(run.wheel_vertical[-500:].sum(axis=1), weight, rtol=1e-5)


def test_loss_of_contact() -> None:
    """A hump that no wheel can follow: the force is zero in the air, never negative, and the run goes on."""
    hump = ["track=defect", "track.irregularity.channel=vertical", "track.irregularity.amplitude=0.01"]
    hump += ["track.irregularity.length=3.0", "track.irregularity.position=20.0", "numerics.step=2.5e-4"]
    simulator = Simulator(VehicleModel(load_scenario(overrides=hump)), SPEED)
    lanes = []
    for _ in range(4000):
        kernels.step(simulator.plant, simulator.state, simulator.work)
        lanes.append(simulator.work.lane_out.copy())
    out = np.array(lanes).reshape(-1, ROWS_OUT, LANES)
    normal = out[:, NORMAL]
    assert np.all(np.isfinite(out))
    assert np.min(normal) == 0.0
    in_air = normal == 0.0
    assert np.all(in_air.any(axis=0))
    for force in (FORCE_X, FORCE_Y, FORCE_Z, POWER_SLIP):
        assert np.all(out[:, force][in_air] == 0.0)
    np.testing.assert_allclose(out[-200:, FORCE_Z].sum(axis=1).mean(), 600e3, rtol=0.05)


@pytest.mark.parametrize("friction", [0.1, 0.35])
def test_friction_limits_every_wheel(friction: float) -> None:
    """Coulomb: the resultant of a wheel lies within the friction cone, |F|^2 <= N^2 (1 + mu^2).

    The creep law's own forces keep to it exactly; sliding wheels reach it. Without cross-level the track
    plane is level to 1e-4, so N stands perpendicular to the creep forces but for 1e-4 N, or 1e-4 / mu of the
    limit.
    """
    overrides = [f"friction={friction}", "track=german_high", "track.irregularity.levels.cross_level=0"]
    simulator = Simulator(VehicleModel(load_scenario(overrides=overrides)), 380.0 / 3.6, 2)
    used, creep_used = [], []
    for _ in range(6000):
        kernels.step(simulator.plant, simulator.state, simulator.work)
        bound = simulator.work.creep_in.reshape(creep.ROWS_IN, LANES)[creep.BOUND]
        forces = simulator.work.creep_out.reshape(creep.ROWS_OUT, LANES)
        creep_used.append(np.hypot(forces[creep.FX], forces[creep.FY]) / np.maximum(bound, 1.0))
        out = simulator.work.lane_out.reshape(ROWS_OUT, LANES)
        force = np.linalg.norm(out[[FORCE_X, FORCE_Y, FORCE_Z]], axis=0)
        normal = out[NORMAL]
        used.append(np.sqrt(np.maximum(force**2 - normal**2, 0.0)) / np.maximum(friction * normal, 1.0))
    assert np.max(creep_used) <= 1.0 + 1e-12
    assert np.max(used) <= 1.0 + 1e-4 / friction
    assert np.max(used) > 0.5  # the limit is near


def test_vehicle_with_one_bogie() -> None:
    """Fewer wheelsets than there is room for: the wheels that are not there stay without force."""
    overrides = ["vehicle.sets.bogie={front: {origin: [0, 0, 0]}}", "vehicle.bodies.carbody.mass=25000"]
    model = VehicleModel(load_scenario(overrides=overrides))
    simulator = Simulator(model, SPEED, 1)
    run = simulator.advance(2000, wheels=True)
    assert model.multibody.n == 6 + 6 + 2 * 6 + 4 + 2 * 3
    assert run.acceleration.shape == run.track_shift.shape == (2000, 2)
    assert run.damper_force.shape == (2000, 4)
    assert np.all(simulator.work.lane_out.reshape(-1, 2, WHEELSETS)[:, :, 2:] == 0.0)
    weight = model.multibody.total_mass * 9.81
    np.testing.assert_allclose(run.wheel_vertical[500:].sum(axis=1).mean(), weight, rtol=0.02)
