"""What policies remember: averages by closed forms, mirrors, the same state in all forms of a policy."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.agents.bogie_encoding import BogieEncoding
from sayd_env.agents.config import EstimatorConfig, MemoryConfig, NetworkConfig, OutputConfig
from sayd_env.agents.memory import MEMORIES
from sayd_env.agents.policy_file import StoredPolicy, describe, read_policy, save_policy
from sayd_env.config import ConfigError, DataError
from sayd_env.config.learner import InputConfig
from sayd_env.envs.interface import Interface, RunIn
from sayd_env.envs.single import SaydEnv

UNIT = InputConfig(middle=0.0, half=1.0)
PERIOD, ROWS = 0.02, 3
COMMAND = OutputConfig(kind="command", middle=0.4, half=0.3)
ALL = MemoryConfig(times_s=(0.5, 4.0), inputs=dict.fromkeys(MEMORIES, UNIT))


@pytest.fixture(scope="module")
def interface() -> Interface:
    return SaydEnv(observation="history", history=ROWS, control_period=PERIOD).interface


def encoding_of(interface: Interface, memory: MemoryConfig = ALL) -> BogieEncoding:
    return BogieEncoding(interface, {"speed": UNIT}, 1e9, COMMAND, memory)


def moving(interface: Interface, names: dict[str, float], values: np.ndarray) -> np.ndarray:
    """Histories of a vehicle in which signals follow values, each by its factor."""
    rows = np.zeros((len(values), len(interface.signals)))
    for name, factor in names.items():
        rows[:, interface.index(name)] = factor * values
    padded = np.concatenate([np.repeat(rows[:1], ROWS - 1, axis=0), rows])
    return np.stack([padded[i : i + ROWS] for i in range(len(rows))])[:, None].astype(np.float32)


def numbers(encoding: BogieEncoding, seen: np.ndarray) -> dict[str, np.ndarray]:
    """What the rear bogie remembers in the end, over both times."""
    assert encoding.memory is not None
    state = np.zeros((1, encoding.memory_width))
    for each in seen:
        state = encoding.remember(state, each)
    found = encoding.memory.numbers(state)[1]
    return {name: found[:, i] for i, name in enumerate(encoding.memory.names)}


def test_a_constant_is_its_mean_from_the_first_period_on(interface: Interface) -> None:
    names = {f"lateral_acceleration.rear.{point}": 1.0 for point in ("leading", "trailing")}
    names["current.rear.left.upper"] = 4.0 * 0.3
    for periods in (1, 50):
        found = numbers(encoding_of(interface), moving(interface, names, np.full(periods, -0.5)))
        np.testing.assert_allclose(found["lateral_size"], 0.5, rtol=1e-9)
        np.testing.assert_allclose(found["current_mean"], -0.15, rtol=1e-6)
        np.testing.assert_allclose(found["lateral_level"], 0.0, atol=1e-6)


def test_a_sine_has_its_level_and_its_frequency(interface: Interface) -> None:
    """Over 4 s: A over the root of 2, and by the differences of samples sin(pi f T) / (pi T)."""
    frequency, amplitude, away = 4.0, 1.2e-3, 7e-3
    t = PERIOD * np.arange(2000)
    sides = {"left": 1.0, "right": -1.0}
    names = {f"stroke.rear.{side}.{level}": s for side, s in sides.items() for level in ("upper", "lower")}
    wave = away + amplitude * np.sin(2.0 * np.pi * frequency * t)
    found = numbers(encoding_of(interface), moving(interface, names, wave))
    expected = np.sin(np.pi * frequency * PERIOD) / (np.pi * PERIOD)
    assert found["yaw_stroke_level"][1] == pytest.approx(amplitude / np.sqrt(2.0), rel=0.02)
    assert found["frequency"][1] == pytest.approx(expected, rel=0.02)
    assert found["yaw_rate_level"][1] == pytest.approx(
        2.0 * np.pi * expected * amplitude / np.sqrt(2.0), rel=0.02
    )


def test_a_mean_follows_a_step_exponentially(interface: Interface) -> None:
    names = {"current.rear.left.upper": 4.0}
    before, after = 3000, 100
    found = numbers(encoding_of(interface), moving(interface, names, np.repeat([0.0, 1.0], [before, after])))
    times = np.array(ALL.times_s)
    np.testing.assert_allclose(found["current_mean"], 1.0 - np.exp(-after * PERIOD / times), rtol=1e-6)


def test_a_mirror_changes_nothing(interface: Interface, mirrored: Callable[[np.ndarray], np.ndarray]) -> None:
    encoding, random = encoding_of(interface), np.random.default_rng(0)
    block = random.normal(size=(30, 2, ROWS, len(interface.signals))).astype(np.float32)
    states = []
    for each in (block, mirrored(block)):
        state = np.zeros((2, encoding.memory_width))
        for seen in each:
            state = encoding.remember(state, seen)
        assert encoding.memory is not None
        states.append(encoding.memory.numbers(state))
    np.testing.assert_allclose(states[0], states[1], rtol=1e-5)


def test_a_vehicle_is_the_same_alone_and_among_others(interface: Interface) -> None:
    policy = policy_of(interface).bound(interface)
    seen = blocks(interface, 7, 12)
    together = state = None
    alone: list[Any] = [None] * 7
    for each in seen:
        together, state = policy.predict(each, state)
        for i in range(7):
            command, alone[i] = policy.predict(each[i], alone[i])
            np.testing.assert_array_equal(command, together[i])


def test_who_begins_has_forgotten(interface: Interface) -> None:
    policy = policy_of(interface).bound(interface)
    seen = blocks(interface, 2, 5)
    _, state = policy.predict(seen[0])
    begun, after = policy.predict(seen[1], state, np.array([True, False]))
    fresh, other = policy.predict(seen[1])
    np.testing.assert_array_equal(begun[0], fresh[0])
    np.testing.assert_array_equal(after[0], other[0])
    assert np.any(after[1] != other[1])
    with pytest.raises(ConfigError, match=r"a state of shape \(2, 3\); expected"):
        policy.predict(seen[1], np.zeros((2, 3)))


def test_an_output_holds(interface: Interface) -> None:
    policy = policy_of(interface, hold=4).bound(interface)
    state, commands = None, []
    for seen in blocks(interface, 3, 12):
        command, state = policy.predict(seen, state)
        commands.append(command)
    held = np.array(commands).reshape(3, 4, 3, 2)
    assert np.all(held == held[:, :1])
    assert np.all(np.ptp(held[:, 0], axis=0) > 0.0)


def test_a_run_in_leaves_the_memory_of_its_observations(interface: Interface) -> None:
    """The same averages as of a policy that was called all along, from where each vehicle's run-in begins."""
    policy = policy_of(interface).bound(interface)
    rows = np.random.default_rng(5).normal(size=(20, 2, len(interface.signals))).astype(np.float32)
    remembered = policy.state_after(RunIn(rows, np.array([0, 8])))
    for vehicle, first in enumerate((0, 8)):
        state = None
        for p in range(first + 1, 19):
            history = np.zeros((1, *interface.shape), np.float32)
            history[0, -2:] = rows[p - 1 : p + 1, vehicle]
            _, state = policy.predict(history, state)
        np.testing.assert_allclose(remembered[vehicle], state[0], rtol=1e-12)


def blocks(interface: Interface, count: int, periods: int) -> np.ndarray:
    """Histories of vehicles, period by period, within the sensors' ranges."""
    random = np.random.default_rng(3)
    low = np.array([signal.low for signal in interface.signals])
    high = np.array([signal.high for signal in interface.signals])
    rows = low + random.random((periods + ROWS, count, len(low))) * (high - low)
    found = [rows[i : i + ROWS].swapaxes(0, 1) for i in range(periods)]
    return np.array(found, dtype=np.float32)


def policy_of(interface: Interface, hold: int = 1, activation: Any = "tanh") -> StoredPolicy:
    """A policy with random weights that remembers, estimates and holds."""
    random = np.random.default_rng(1)
    wide = {name: InputConfig(scale="log", middle=1.0, half=3.0) for name in MEMORIES}
    memory = MemoryConfig(times_s=(0.1, 0.5), inputs=wide)
    inputs = {"lateral": InputConfig(middle=0.0, half=30.0), "speed": InputConfig(middle=0.0, half=50.0)}
    output = OutputConfig(kind="command", middle=0.5, half=0.5, hold=hold)
    estimate = EstimatorConfig(conditions={"friction": UNIT, "wear": UNIT}, hidden=(5,))
    description = describe(
        interface,
        name="remembers",
        view="bogie",
        inputs=inputs,
        memory=memory,
        clip=5.0,
        output=output,
        network=NetworkConfig(hidden=(7,), activation=activation),
        estimate=estimate,
        squash="tanh",
    )
    size = StoredPolicy(description, ()).encoding(interface).size

    def layers(widths: list[int]) -> Any:
        return tuple(
            (random.normal(size=(b, a)).astype(np.float32) * a**-0.5, np.zeros(b, np.float32))
            for a, b in pairwise(widths)
        )

    return StoredPolicy(description, layers([size + 2, 7, 1]), estimator=layers([size, 5, 2]))


def test_the_policy_is_its_formula(interface: Interface) -> None:
    """Estimates from the inputs, both through the network, written out."""
    stored = policy_of(interface)
    policy = stored.bound(interface)
    inputs = np.random.default_rng(0).normal(size=(6, policy.encoding.size)).astype(np.float32)
    (w0, b0), (w1, b1) = stored.estimator
    guessed = np.clip(np.tanh(inputs @ w0.T + b0) @ w1.T + b1, -5.0, 5.0)
    (v0, c0), (v1, c1) = stored.layers
    expected = np.tanh(np.tanh(np.concatenate([inputs, guessed], axis=1) @ v0.T + c0) @ v1.T + c1)
    np.testing.assert_allclose(policy.outputs(inputs), expected, rtol=1e-5, atol=1e-6)


def test_what_is_written_is_read(interface: Interface, tmp_path: Path) -> None:
    policy, path = policy_of(interface, hold=2), tmp_path / "policy.npz"
    save_policy(path, policy)
    found = read_policy(path)
    assert found.description == policy.description
    assert found.identity() == policy.identity()
    seen, states = blocks(interface, 3, 4), [None, None]
    for each in seen:
        one, states[0] = policy.bound(interface).predict(each, states[0])
        other, states[1] = found.bound(interface).predict(each, states[1])
        np.testing.assert_array_equal(one, other)
    save_policy(path, StoredPolicy(policy.description, policy.layers))
    with pytest.raises(DataError, match=r"lacks 'estimator_bias_0\.npy'"):
        read_policy(path)


@pytest.mark.parametrize(("hold", "activation"), [(1, "tanh"), (3, "relu")])
def test_onnx_gives_the_same_commands(
    hold: int, activation: str, interface: Interface, tmp_path: Path
) -> None:
    pytest.importorskip("onnx", reason="needs the extra 'onnx'")
    pytest.importorskip("onnxruntime", reason="needs the extra 'onnx'")
    from sayd_env.agents.export import export_onnx  # noqa: PLC0415
    from sayd_env.agents.onnx_policy import read_onnx  # noqa: PLC0415

    stored = policy_of(interface, hold, activation)
    export_onnx(stored, tmp_path / "policy.onnx")
    policy, model = stored.bound(interface), read_onnx(tmp_path / "policy.onnx").bound(interface)
    seen = blocks(interface, 4, 9)
    seen[2, 1, 0, 3] = np.nan
    rows = seen[:, :, -1]
    run_in = RunIn(rows, np.array([0, 0, 3, 5]))
    states = [policy.state_after(run_in), model.state_after(run_in)]
    np.testing.assert_allclose(states[0], states[1], rtol=1e-9, atol=1e-12)
    commands = []
    for each in seen:
        one, states[0] = policy.predict(each, states[0])
        other, states[1] = model.predict(each, states[1])
        np.testing.assert_allclose(one, other, atol=1e-6, rtol=0)
        commands.append(one)
    assert np.ptp(commands) > 0.1
    with pytest.raises(ConfigError, match=r"state: found .*; expected what the last call returned"):
        model.predict(seen[0], object())


def test_inputs_of_a_model_have_no_order(interface: Interface, tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx", reason="needs the extra 'onnx'")
    pytest.importorskip("onnxruntime", reason="needs the extra 'onnx'")
    from sayd_env.agents.export import export_onnx  # noqa: PLC0415
    from sayd_env.agents.onnx_policy import read_onnx  # noqa: PLC0415

    export_onnx(policy_of(interface, 1, "tanh"), tmp_path / "policy.onnx")
    model = onnx.load(tmp_path / "policy.onnx")
    inputs = [*model.graph.input]
    del model.graph.input[:]
    model.graph.input.extend(inputs[::-1])
    onnx.save(model, tmp_path / "turned.onnx")
    seen = blocks(interface, 1, 5)[0]
    first, other = (
        read_onnx(tmp_path / name).bound(interface).predict(seen)[0]
        for name in ("policy.onnx", "turned.onnx")
    )
    assert len(inputs) == 2
    np.testing.assert_array_equal(first, other)


@pytest.mark.parametrize(
    ("keywords", "memory", "message"),
    [
        ({"history": 1}, ALL, "memory: needs a history of 2 rows"),
        ({}, MemoryConfig(times_s=(1.0,), inputs={"frequencey": UNIT}), "did you mean 'frequency'"),
    ],
)
def test_what_cannot_be_remembered_is_refused(
    keywords: dict[str, Any], memory: MemoryConfig, message: str
) -> None:
    interface = SaydEnv(**{"observation": "history", "history": ROWS} | keywords).interface
    with pytest.raises(ConfigError, match=message):
        encoding_of(interface, memory)
