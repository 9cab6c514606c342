"""Eight semi-active dampers in the vehicle: energy balance, time step, symmetry, commands, batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sayd_env.config import ConfigError
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.track import CHANNELS
from sayd_env.physics import sayd
from sayd_env.physics import step as kernels
from sayd_env.physics.batch import BatchSimulator
from sayd_env.physics.kernel import kernel
from sayd_env.physics.linear import modes
from sayd_env.physics.plant import LANES, Plant, Work
from sayd_env.physics.rows import SINGLE
from sayd_env.physics.simulator import Simulator, VehicleModel

SPEED = 350.0 / 3.6
SHORT = ["assessment.run_in=100", "assessment.length=500", "damper=sayd-estimate"]


def scenario(*overrides: str) -> Scenario:
    return load_scenario("estimates", [*SHORT, *overrides])


@pytest.fixture(scope="module")
def model() -> VehicleModel:
    return VehicleModel(scenario())


@kernel
def forces_of_dampers(plant: Plant, work: Work) -> None:
    _, first, end, _, _ = kernels.sections(SINGLE, plant, work)
    work.x[:first] = 0.0
    work.x[end:] = 0.0
    work.f[:] = 0.0
    kernels.forces(SINGLE, plant, work)


def test_reactions_act_at_both_ends(model: VehicleModel) -> None:
    """-F_1 along the bogie's connection vector, -F_2 along the carbody's, by the assembled model's rows."""
    simulator = Simulator(model, SPEED, 1)
    simulator.advance(400)
    plant, state, work = simulator.plant, simulator.state, simulator.work
    forces_of_dampers(plant, work)
    f, forces = work.f, state.sayd.reshape(-1, LANES)
    assert np.min(np.abs(forces[sayd.FORCE_1])) > 1.0
    rows = enumerate(model.multibody.yaw_dampers)
    parts = [-b * forces[sayd.FORCE_1, k] - c * forces[sayd.FORCE_2, k] for k, (_, b, c) in rows]
    np.testing.assert_allclose(f, np.sum(parts, axis=0), atol=1e-9)


def rms_after(overrides: list[str], seconds: float) -> np.ndarray:
    simulator = Simulator(VehicleModel(scenario(*overrides)), SPEED, 1)
    run = simulator.advance(round(seconds * 1000))
    signals = np.hstack([run.acceleration, run.track_shift, run.damper_force])
    return np.sqrt(np.mean(signals[500:] ** 2, axis=0))


@pytest.mark.parametrize("current", [0.05, 0.3])
def test_result_does_not_depend_on_the_steps(current: float) -> None:
    """Half and a quarter of both time steps: signals' RMS within 1 % and closer together, as of order 2."""
    settings = [
        [f"damper.current={current}", f"numerics.step={h}", f"damper.step={0.5 * h}"]
        for h in (5e-4, 2.5e-4, 1.25e-4)
    ]
    whole, half, quarter = (rms_after(s, 2.0) for s in settings)
    assert np.max(np.abs(whole / quarter - 1.0)) < 0.01
    assert np.mean(np.abs(half / quarter - 1.0)) < 0.5 * np.mean(np.abs(whole / quarter - 1.0))


def test_mirrored_track_gives_mirrored_forces(model: VehicleModel) -> None:
    track = model.realisation(5)
    sign = np.where(np.isin(CHANNELS, ("alignment", "cross_level")), -1.0, 1.0)
    mirrored = replace(track, coefficients=track.coefficients * sign)
    one, two = (Simulator(model, SPEED, track=t).advance(600) for t in (track, mirrored))
    np.testing.assert_allclose(two.acceleration, -one.acceleration, atol=1e-6)
    names = [name for name, _, _ in model.multibody.yaw_dampers]
    swap = [names.index(_other_side(name)) for name in names]
    np.testing.assert_allclose(two.damper_force[:, swap], one.damper_force, atol=0.1)


def _other_side(name: str) -> str:
    return name.replace("left", "right") if "left" in name else name.replace("right", "left")


def test_commands_reach_the_valves_they_are_meant_for(model: VehicleModel) -> None:
    simulator = Simulator(model, SPEED, 1)
    wanted = np.linspace(0.0, 1.0, 8)
    simulator.command(wanted)
    run = simulator.advance(200, sayds=True)
    assert run.sayds.shape == (200, sayd.STATES, 8)
    np.testing.assert_allclose(run.sayds[-1, sayd.CURRENT], wanted, atol=1e-6)
    np.testing.assert_allclose(run.sayds[:, sayd.FORCE_1], run.damper_force)
    start = model.scenario.damper
    assert isinstance(start, SaydDamperConfig)
    delayed = round(start.valve.delay * 1000) - 1
    np.testing.assert_array_equal(run.sayds[:delayed, sayd.CURRENT], start.current)
    simulator.power(np.arange(8) % 2 == 0)
    run = simulator.advance(200, sayds=True)
    np.testing.assert_allclose(
        run.sayds[-1, sayd.CURRENT], np.where(np.arange(8) % 2, start.failsafe_current, wanted), atol=1e-6
    )


def test_an_open_valve_means_less_force(model: VehicleModel) -> None:
    rms = []
    for current in (0.0, 0.45, 1.0):
        simulator = Simulator(model, 160.0 / 3.6, 1)  # stable with any of them
        simulator.command(current)
        rms.append(np.sqrt(np.mean(simulator.advance(1500).damper_force ** 2)))
    assert rms[0] > rms[1] > rms[2]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.nan, "found nan, expected finite numbers from 0 to 1"),
        (np.inf, "found inf, expected"),
        (1.2, "found 1.2, expected"),
        ([0.0] * 7 + [-0.1], "found -0.1, expected"),
        ([0.5] * 3, r"found shape \(3,\), expected 8 values"),
    ],
)
def test_bad_commands_are_refused(model: VehicleModel, values: object, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Simulator(model, SPEED, 1).command(values)  # type: ignore[arg-type]


def test_a_passive_damper_has_no_valve() -> None:
    passive = VehicleModel(scenario("damper=passive-estimate"))
    simulator = Simulator(passive, SPEED, 1)
    with pytest.raises(ConfigError, match="has no valve"):
        simulator.command(0.5)
    assert simulator.advance(5, sayds=True).sayds.shape == (5, 0, 8)


def test_at_rest_the_linear_vehicle_has_the_mounts_as_springs() -> None:
    """Friction holds the pistons: the modes are those with Maxwell dampers too stiff to move."""
    free = ("damper.bogie_mount.damping=0.0", "damper.carbody_mount.damping=0.0")
    mounted = VehicleModel(scenario(*free))
    law = mounted.scenario.damper
    assert isinstance(law, SaydDamperConfig)
    series = 0.5 * law.bogie_mount.stiffness
    springs = (
        f"damper={{type: passive, name: springs, curve: [[0, 0], [1e-6, 1e6]], series_stiffness: {series}}}"
    )
    other = VehicleModel(scenario(springs))
    found, expected = (
        {mode.name: mode.frequency_hz for mode in modes(m, SPEED, 3e-3) if 0.1 < mode.frequency_hz < 8.0}
        for m in (mounted, other)
    )
    common = sorted(found.keys() & expected.keys())
    assert {"carbody yaw", "carbody lower sway", "bogie hunting in phase"} <= set(common)
    assert [found[name] for name in common] == pytest.approx([expected[name] for name in common], rel=1e-3)


def test_batch_gives_the_same_bits(model: VehicleModel) -> None:
    """Vehicles with different speeds, commands and valve delays, together and one by one."""
    slow = VehicleModel(scenario("damper.valve.delay=0.012", "damper.current=0.4"))
    fleet = [(model, SPEED), (slow, 300.0 / 3.6), (model, 280.0 / 3.6)]
    alone = [Simulator(m, v, 2).advance(300).damper_force for m, v in fleet]
    together = BatchSimulator([Simulator(m, v, 2) for m, v in fleet]).advance(300)
    for one, row in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, row[:, 8:])
