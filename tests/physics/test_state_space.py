"""State space: rigid motions, symmetry, static gains, delays, responses in simulation, files."""

from __future__ import annotations

import builtins
import io
import math
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from sayd_env.config import ConfigError
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array, ComplexArray
from sayd_env.physics import sayd
from sayd_env.physics.equivalent_damper import STATES, equivalent_slope
from sayd_env.physics.linear import (
    Linearisation,
    OperatingPoint,
    equivalent,
    equivalent_plant,
    linearise,
    rates_of,
)
from sayd_env.physics.plant import LANES
from sayd_env.physics.simulator import Simulator, Telemetry, VehicleModel
from sayd_env.physics.state_space import (
    StateSpace,
    irregularity_columns,
    state_space_of,
    wheelset_delays,
)
from sayd_env.physics.track.realisation import TrackRealisation
from sayd_env.physics.track.spline import interpolation_coefficients

SPEED = 250.0 / 3.6
FREQUENCY = 4.0
STROKE_SPEED = 10e-3
SHIFT = 3e-3
CURRENT = 0.3


def vehicle(damper: str) -> VehicleModel:
    """New wheels: far from hunting, so that what a track forces comes to rest."""
    return VehicleModel(load_scenario("estimates", [f"damper={damper}", "wear=0.0"]))


@pytest.fixture(scope="module", params=["passive-estimate", "sayd-estimate"])
def model(request: pytest.FixtureRequest) -> VehicleModel:
    return vehicle(request.param)


@pytest.fixture(scope="module")
def steady(model: VehicleModel) -> Linearisation:
    current = None if isinstance(model.scenario.damper, PassiveDamperConfig) else CURRENT
    return equivalent(model, OperatingPoint(SPEED, SHIFT, STROKE_SPEED, current, FREQUENCY))


@pytest.fixture(scope="module")
def system(model: VehicleModel, steady: Linearisation) -> StateSpace:
    return state_space_of(model, steady)


def rigid(model: VehicleModel, steady: Linearisation, q: Array, v: Array) -> Array:
    """State in which dampers go along with a motion of the whole vehicle."""
    body, n = model.multibody, model.multibody.n
    x = np.zeros(len(steady.matrix))
    x[:n], x[n : 2 * n] = q, v
    if steady.sayd is not None:
        states = x[2 * n + len(model.dampers) :].reshape(len(body.yaw_dampers), -1)
        for row, (_, bogie, _) in zip(states, body.yaw_dampers, strict=True):
            row[STATES.index("rod")], row[STATES.index("rod_rate")] = bogie @ q, bogie @ v
    return x


@pytest.mark.parametrize("motion", ["aside", "up", "at an angle"])
def test_the_vehicle_follows_a_track_that_lies_elsewhere(
    model: VehicleModel, steady: Linearisation, motion: str
) -> None:
    """As a rigid body, without forces: track shifted, lifted, and turned, on which it runs off at V."""
    body, n = model.multibody, model.multibody.n
    moved: dict[str, Any] = {
        "aside": lambda i: {"y": 1.0},
        "up": lambda i: {"z": 1.0},
        "at an angle": lambda i: {"y": i.position[0], "x": -i.position[1], "yaw": 1.0},
    }
    q, v, w = np.zeros(n), np.zeros(n), np.zeros((2, len(CHANNELS), len(body.wheelset_x)))
    for i in body.instances.values():
        for dof, value in moved[motion](i).items():
            if dof in i.columns:
                q[i.columns[dof]] = value
        if motion == "at an angle" and "y" in i.columns:
            v[i.columns["y"]] = SPEED
    w[0, 1 if motion == "up" else 0] = body.wheelset_x if motion == "at an angle" else 1.0
    w[1, 0] = SPEED if motion == "at an angle" else 0.0
    value, rate = irregularity_columns(model, steady)
    x = rigid(model, steady, q, v)
    found = steady.matrix @ x
    found[: len(value)] += value @ w[0].ravel() + rate @ w[1].ravel()
    scale = np.max(np.abs(steady.matrix) @ np.abs(x))
    assert found == pytest.approx(rigid(model, steady, v, np.zeros(n)), abs=1e-10 * scale)


def test_left_and_right_mirror_each_other(system: StateSpace) -> None:
    def mirrored(name: str) -> str:
        swap = {"left": "right", "right": "left"}
        return ".".join(swap.get(part, part) for part in name.split("."))

    h = system.response([1.0, 5.0])
    odd = ("alignment", "cross_level", "lateral_acceleration")
    for i, source in enumerate(system.inputs):
        for o, sensor in enumerate(system.outputs):
            sign = math.prod(-1.0 if name.startswith(odd) else 1.0 for name in (source, sensor))
            other = h[:, system.outputs.index(mirrored(sensor)), system.inputs.index(mirrored(source))]
            largest = np.max(np.abs(h[:, o]))
            assert sign * h[:, o, i] == pytest.approx(other, abs=1e-6 * largest), (source, sensor)


def test_static_gain_is_a_static_solution_of_the_compiled_forces(
    model: VehicleModel, steady: Linearisation, system: StateSpace
) -> None:
    """With a constant force on the bogie and the displacements that the gain tells, nothing accelerates."""
    body, n = model.multibody, model.multibody.n
    _, bogie, car = body.yaw_dampers[0]
    gain = -np.linalg.solve(system.a, system.b[:, 0])
    moved = np.zeros(2 * n + len(model.dampers))
    names = [*body.dof_names, *(f"{name}.rate" for name in body.dof_names)]
    for name, value in zip(system.states, gain, strict=True):
        if name in names:
            moved[names.index(name)] = value
    steadily = np.concatenate([steady.q, steady.v, np.zeros(len(model.dampers))])
    plant = equivalent_plant(model, SPEED, steady.track, steady.tables, steady.stroke)

    def accelerations(force: float, pushed: float) -> Array:
        loaded = plant._replace(load=plant.load + pushed * (car - bogie))
        return rates_of(loaded, model.work(), steadily + force * moved)[n : 2 * n]

    # Half the difference of both signs: the contact's height has a corner at the table's middle node.
    left = accelerations(1e-3, 1e-3) - accelerations(-1e-3, -1e-3)
    without = accelerations(1e-3, 0.0) - accelerations(-1e-3, 0.0)
    assert np.max(np.abs(left)) < 1e-4 * np.max(np.abs(without))


def test_delays_make_one_track_of_four(model: VehicleModel, system: StateSpace) -> None:
    places, delays = wheelset_delays(model, SPEED)
    assert places[0] == "front.leading"
    assert delays[1] == pytest.approx(2.5 / SPEED)  # the bogie's wheelbase
    one = system.delayed(places, delays, 20).select(CHANNELS)
    for f in (0.5, 4.0, 12.0):
        late = np.exp(-2j * np.pi * f * np.array(delays))
        for k, channel in enumerate(CHANNELS):
            each = system.select([f"{channel}.{place}" for place in places]).response([f])[0]
            expected = each @ late
            assert one.response([f])[0, :, k] == pytest.approx(
                expected, abs=1e-3 * np.max(np.abs(each), initial=1e-9)
            )
    with pytest.raises(ConfigError, match="order of a delay: found 0"):
        system.delayed(places, delays, 0)
    with pytest.raises(ConfigError, match="expected 4 numbers that rise from 0"):
        system.delayed(places, delays[::-1], 4)


def sine_track(amplitude: float) -> TrackRealisation:
    """A sine of alignment under the first wheelset, faded in over 100 m."""
    x = np.arange(-60.0, 700.0, 0.25)
    samples = np.zeros((len(x), len(CHANNELS)))
    faded = np.clip((x + 20.0) / 100.0, 0.0, 1.0)
    samples[:, 0] = amplitude * np.sin(2.0 * np.pi * FREQUENCY * x / SPEED) * faded
    return TrackRealisation(x[0], 0.25, 700.0, interpolation_coefficients(samples))


def forced(simulator: Simulator) -> tuple[Telemetry, ComplexArray]:
    """The last two seconds of eight, and what to multiply signals with for their complex amplitudes."""
    semi_active = simulator.state.sayd.size > 0
    if semi_active:
        rows = simulator.state.sayd.reshape(sayd.STATES, LANES)
        rows[sayd.CURRENT] = rows[sayd.COMMAND] = rows[sayd.COIL] = CURRENT
        simulator.state.sayd_line[:] = CURRENT
    simulator.advance(6000)
    telemetry = simulator.advance(2000, sayds=semi_active)
    return telemetry, 1e-3 * np.exp(-2j * np.pi * FREQUENCY * telemetry.time)


def response(model: VehicleModel, system: StateSpace) -> ComplexArray:
    """Of all outputs to the alignment of one track under the first wheelset at FREQUENCY."""
    places, delays = wheelset_delays(model, SPEED)
    each = system.select([f"alignment.{place}" for place in places]).response([FREQUENCY])[0]
    return np.asarray(each @ np.exp(-2j * np.pi * FREQUENCY * np.array(delays)))


def test_small_response_is_that_of_the_simulation(model: VehicleModel) -> None:
    """At rest: passive dampers with their first segment, semi-active ones held by friction."""
    tangent = linearise(model, SPEED, SHIFT)
    expected = response(model, state_space_of(model, tangent))
    amplitude = 1e-7
    simulator = Simulator(model, SPEED, track=sine_track(amplitude), table=tangent.tables[0])
    telemetry, turn = forced(simulator)
    found = turn @ telemetry.acceleration / (-1j * amplitude)  # a sine
    assert found == pytest.approx(expected[:4], rel=2e-3)


def test_response_is_that_of_the_simulation_at_the_stated_amplitude(
    model: VehicleModel, steady: Linearisation, system: StateSpace
) -> None:
    """Non-linear contact, creep and dampers: what equivalent gains leave is within a tenth and 6 degrees."""
    expected = response(model, system)
    strokes = [k for k, name in enumerate(system.outputs) if name.startswith("stroke")]
    rates = 2.0 * np.pi * FREQUENCY * np.abs(expected[strokes])
    law = model.scenario.damper
    if isinstance(law, PassiveDamperConfig):
        # The viscous part's share of the damper's motion.
        slope = equivalent_slope(np.array(law.curve), STROKE_SPEED)
        rates /= abs(1.0 + 2j * np.pi * FREQUENCY * slope / law.series_stiffness)
    amplitude = STROKE_SPEED / math.sqrt(np.mean(rates**2) / 2.0)
    telemetry, turn = forced(Simulator(model, SPEED, track=sine_track(amplitude)))
    ratio = turn @ telemetry.acceleration / (-1j * amplitude) / expected[:4]
    assert np.abs(ratio) == pytest.approx(np.ones(4), abs=0.1)
    assert np.degrees(np.angle(ratio)) == pytest.approx(np.zeros(4), abs=6.0)
    if steady.sayd is not None:
        assert math.sqrt(np.mean(telemetry.sayds[:, sayd.STROKE_RATE] ** 2)) == pytest.approx(
            STROKE_SPEED, rel=0.1
        )
        stroke = turn @ telemetry.sayds[:, sayd.STROKE] / (-1j * amplitude) / expected[strokes]
        assert np.abs(stroke) == pytest.approx(np.ones(8), abs=0.1)


@pytest.mark.parametrize("damper", ["passive-estimate", "sayd-estimate"])
def test_outputs_have_their_names_where_a_side_has_one_damper(damper: str) -> None:
    """The left and the right mount of a frame differ by its yaw acceleration, times their distance."""
    model = VehicleModel(load_scenario("estimates", [f"damper={damper}", "vehicle.sets.pair={upper: {}}"]))
    current = CURRENT if damper.startswith("sayd") else None
    system = state_space_of(model, equivalent(model, OperatingPoint(SPEED, SHIFT, STROKE_SPEED, current)))
    assert len(system.c) == len(system.d) == len(system.outputs)
    left, right = (
        system.c[list(system.outputs).index(f"longitudinal_acceleration.front.{side}")]
        for side in ("left", "right")
    )
    (yaw,) = system.a[[name == "frame.front.yaw.rate" for name in system.states]]
    lever = (right - left) @ yaw / (yaw @ yaw)
    assert 2.0 < abs(lever) < 3.0
    np.testing.assert_allclose(right - left, lever * yaw, atol=1e-9 * np.max(np.abs(right)))


def test_names_have_units_and_reach_files(system: StateSpace) -> None:
    named = (*system.states, *system.inputs, *system.outputs)
    assert len(set(named)) == len(named)
    assert set(named) == set(system.units)
    numbers = np.load(io.BytesIO(system.npz()))
    cells = loadmat(io.BytesIO(system.mat()))
    for key, matrix in zip("ABCD", (system.a, system.b, system.c, system.d), strict=True):
        np.testing.assert_array_equal(numbers[key], matrix)
        np.testing.assert_array_equal(cells[key], matrix)
    for key in ("states", "inputs", "outputs"):
        assert tuple(numbers[key]) == getattr(system, key)
        assert tuple(cell[0] for cell in cells[key][:, 0]) == getattr(system, key)
    assert numbers["input_units"][0] == "N"


def test_python_control_has_the_same_response(system: StateSpace) -> None:
    pytest.importorskip("control", exc_type=ImportError)
    part = system.select(["force.front.left.upper"], ["lateral_acceleration.front.leading"])
    found = part.to_control()
    assert found.input_labels == ["force_front_left_upper"]
    assert complex(found(2j * np.pi * FREQUENCY)) == pytest.approx(
        complex(part.response([FREQUENCY])[0, 0, 0])
    )


def test_without_python_control_it_says_what_to_install(
    system: StateSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any, **more: Any) -> Any:
        if name == "control":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ConfigError, match=r"pip install 'sayd-env\[control\]'"):
        system.to_control()


def test_groups_of_inputs_and_names_that_there_are_not(system: StateSpace) -> None:
    pair = {"force.front.left.upper": 1.0, "force.front.right.upper": -1.0}
    both = system.combined({"turning": pair})
    one, other = (system.select([name]).response([3.0])[0, :, 0] for name in pair)
    assert both.response([3.0])[0, :, 0] == pytest.approx(one - other)
    with pytest.raises(ConfigError, match=r"no input .force\.front\.left\.uper., did you mean"):
        system.select(["force.front.left.uper"])


def test_at_rest_a_command_moves_nothing() -> None:
    model = vehicle("sayd-estimate")
    system = state_space_of(model, equivalent(model, OperatingPoint(SPEED, 0.0, 0.0)))
    commands = [name for name in system.inputs if name.startswith("command")]
    assert len(commands) == 8
    assert not np.any(system.select(commands).b)
