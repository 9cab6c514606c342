"""What the network of a bogie sees: calculated by hand from the signals, and the same in a mirror."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest

from sayd_env import baselines
from sayd_env.agents.bogie_encoding import BogieEncoding
from sayd_env.agents.config import InputConfig, OutputConfig
from sayd_env.config import ConfigError
from sayd_env.envs.interface import Interface
from sayd_env.envs.single import SaydEnv

ROWS, PERIOD = 3, 0.02
UNIT = InputConfig(middle=0.0, half=1.0)
COMMAND = OutputConfig(kind="command", middle=0.4, half=0.2)


@pytest.fixture(scope="module")
def interface() -> Interface:
    return SaydEnv(observation="history", history=ROWS, control_period=PERIOD).interface


def signals(interface: Interface, rows: list[dict[str, float]]) -> np.ndarray:
    block = np.zeros((1, ROWS, len(interface.signals)), np.float32)
    for row, values in enumerate(rows):
        for name, value in values.items():
            block[0, row, interface.index(name)] = value
    return block


def test_quantities_by_hand(interface: Interface) -> None:
    area = interface.damper.cylinder.area
    wanted = ("yaw_force", "push_force", "force_level", "lateral", "yawing", "current", "speed", "place")
    encoding = BogieEncoding(interface, dict.fromkeys(wanted, UNIT), 1e9, COMMAND)
    newest = {
        "pressure_a.rear.left.upper": 3e6,
        "pressure_b.rear.left.lower": 1e6,
        "pressure_b.rear.right.upper": 4e6,
        "lateral_acceleration.rear.leading": 3.0,
        "lateral_acceleration.rear.trailing": 1.0,
        "current.rear.left.upper": 0.4,
        "speed": 90.0,
    }
    front, rear = encoding.encode(signals(interface, [{}, {}, newest]))
    # forces of the rear bogie: 3, -1 left, -4, 0 right (times A and a million)
    expected = {
        "yaw_force": 1e6 * area * 0.5 * (1.0 - -2.0),
        "push_force": 1e6 * area * -0.5,
        "force_level": 1e6 * area * 2.0,
        "lateral": 2.0,
        "yawing": 1.0,
        "current": 0.1,
    }
    rows = np.array([value for value in expected.values()])
    np.testing.assert_allclose(rear[:18].reshape(6, ROWS)[:, -1], rows, rtol=1e-6)
    np.testing.assert_array_equal(rear[:18].reshape(6, ROWS)[:, :-1], 0.0)
    np.testing.assert_array_equal(rear[18:], [90.0, 1.0])
    np.testing.assert_array_equal(front, [0.0] * 18 + [90.0, -1.0])
    assert set(newest) < set(encoding.sensors)
    assert not [name for name in encoding.sensors if name.startswith(("stroke", "longitudinal"))]


def test_rates_are_differences_of_rows(interface: Interface) -> None:
    encoding = BogieEncoding(interface, {"yaw_rate": UNIT, "push_rate": UNIT}, 1e9, COMMAND)
    strokes = [
        {
            f"stroke.front.{side}.{level}": value
            for side, level in product(("left", "right"), ("upper", "lower"))
            for value in [left if side == "left" else right]
        }
        for left, right in ((0.001, 0.0), (0.003, 0.001), (0.002, 0.004))
    ]
    front, rear = encoding.encode(signals(interface, strokes))
    left, right = np.array([0.002, -0.001]) / PERIOD, np.array([0.001, 0.003]) / PERIOD
    np.testing.assert_allclose(front, [*(0.5 * (left - right)), *(0.5 * (left + right))], rtol=1e-4)
    np.testing.assert_array_equal(rear, 0.0)


def test_the_stroke_is_seen_without_its_mean(interface: Interface) -> None:
    encoding = BogieEncoding(interface, {"yaw_stroke": UNIT}, 1e9, COMMAND)
    strokes = [{"stroke.rear.right.upper": value} for value in (0.004, 0.012, 0.008)]
    front, rear = encoding.encode(signals(interface, strokes))
    np.testing.assert_allclose(rear, [0.001, -0.001, 0.0], atol=1e-9)  # minus a quarter of what exceeds 8 mm
    np.testing.assert_array_equal(front, 0.0)


def test_a_mirror_changes_nothing(interface: Interface, mirrored: Callable[[np.ndarray], np.ndarray]) -> None:
    names = (
        "yaw_force",
        "push_force",
        "force_level",
        "lateral",
        "yawing",
        "yaw_rate",
        "push_rate",
        "yaw_stroke",
    )
    encoding = BogieEncoding(interface, dict.fromkeys(names, UNIT), 1e9, COMMAND)
    random = np.random.default_rng(0)
    block = random.normal(size=(20, ROWS, len(interface.signals))).astype(np.float32)
    one, other = encoding.encode(block), encoding.encode(mirrored(block))
    np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)
    newest_yaw_force, older_yaw_force = one[:, ROWS - 2], one[:, 0]  # two rows with rates
    assert np.all(newest_yaw_force >= 0.0)
    assert np.any(older_yaw_force < 0.0)


def test_outputs_become_commands_of_both_bogies(interface: Interface) -> None:
    encoding = BogieEncoding(interface, {"speed": UNIT}, 1.0, COMMAND)
    seen = np.zeros((2, *interface.shape), np.float32)
    found = encoding.decode(np.array([[-1.0], [0.5], [0.0], [9.0]]), seen)
    np.testing.assert_allclose(found, [[0.2, 0.5], [0.4, 0.6]], atol=1e-7)
    wide = OutputConfig(kind="command", middle=0.9, half=0.5)
    assert BogieEncoding(interface, {"speed": UNIT}, 1.0, wide).decode(np.ones((2, 1)), seen[:1]).max() == 1.0


def test_an_output_of_zero_is_the_command_of_its_schedule(interface: Interface) -> None:
    controller = baselines.make("speed-schedule", interface)
    output = OutputConfig(kind="command", schedule="speed-schedule", half=0.1)
    encoding = BogieEncoding(interface, {"speed": UNIT}, 1.0, output)
    seen = np.zeros((5, *interface.shape), np.float32)
    place = [signal.name for signal in interface.signals].index("speed")
    seen[:, -1, place] = [0.0, 60.0, 80.0, 100.0, 130.0]
    expected, _ = controller.predict(seen)
    np.testing.assert_allclose(encoding.decode(np.zeros((10, 1)), seen), expected, atol=1e-7)
    assert BogieEncoding(interface, {"lateral": UNIT}, 1.0, output).sensors[-1] == "speed"
    above = encoding.decode(np.tile([[0.0], [1.0]], (5, 1)), seen)
    np.testing.assert_allclose(above - expected, np.tile([0.0, 0.1], (5, 1)), atol=1e-7)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"kind": "command", "rate": 2.0}, "rate: has no effect with kind 'command'"),
        ({"kind": "change", "half": 0.3}, "half: has no effect with kind 'change'"),
        ({"kind": "change", "middle": 0.3}, "middle: has no effect with kind 'change'"),
        (
            {"kind": "command", "schedule": "speed-schedule", "middle": 0.3},
            "middle: has no effect with a schedule",
        ),
    ],
)
def test_what_would_have_no_effect_is_refused(keywords: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        OutputConfig(**keywords)
    # Files of policies name every default.
    OutputConfig(**OutputConfig(kind=keywords["kind"]).model_dump())


def test_a_schedule_is_one_of_speed() -> None:
    with pytest.raises(ValueError, match="'mppt2' is no speed-schedule"):
        OutputConfig(kind="command", schedule="mppt2")


@pytest.mark.parametrize(
    ("keywords", "inputs", "output", "message"),
    [
        ({}, {"yaw_forse": UNIT}, COMMAND, "did you mean 'yaw_force'"),
        ({}, {"lateral": InputConfig(middle=1.0, half=1.0)}, COMMAND, "inputs.lateral.middle: must be 0"),
        (
            {},
            {"speed": InputConfig(scale="log", middle=1.0, half=1.0)},
            COMMAND,
            "takes 'linear', found 'log'",
        ),
        ({"observation": "signals"}, {"yaw_rate": UNIT}, COMMAND, "needs a history of 2 rows"),
        ({"observation": "features"}, {"speed": UNIT}, COMMAND, "found 'features'"),
        ({"valves": "damper"}, {"speed": UNIT}, COMMAND, "needs valves 'bogie', found 'damper'"),
        ({"damper": "passive"}, {"speed": UNIT}, COMMAND, "needs semi-active dampers"),
        ({}, {"speed": UNIT}, OutputConfig(kind="change"), "takes 'command', found 'change'"),
    ],
)
def test_what_does_not_fit_is_refused(
    keywords: dict[str, Any], inputs: dict[str, InputConfig], output: OutputConfig, message: str
) -> None:
    usual = {} if "observation" in keywords else {"observation": "history", "history": ROWS}
    interface = SaydEnv(**usual | keywords).interface
    with pytest.raises(ConfigError, match=message):
        BogieEncoding(interface, inputs, 1.0, output)
