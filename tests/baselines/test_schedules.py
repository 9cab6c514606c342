"""Schedules over speed: interpolation in closed form, and the correction by what a bogie has measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sayd_env import baselines
from sayd_env.config import ConfigError
from sayd_env.envs.interface import Interface

Make = Callable[..., Interface]
Observe = Callable[..., Any]
TABLE = {"speeds_kmh": (180.0, 216.0, 360.0), "commands": (0.5, 0.3, 0.1)}


@pytest.mark.parametrize(
    ("speed", "command"),
    [
        (55.0, 0.4),  # 198 km/h, halfway from 180 to 216
        (60.0, 0.3),
        (90.0, 0.15),  # 324 km/h: three quarters of the way from 216 to 360
        (20.0, 0.5),
        (120.0, 0.1),
    ],
)
@pytest.mark.parametrize("kind", ["signals", "features"])
def test_commands_are_linear_between_speeds_and_constant_beyond(
    interface: Make, observe: Observe, speed: float, command: float, kind: str
) -> None:
    policy = baselines.make("speed-schedule", interface(observation=kind, valves="damper"), **TABLE)
    action, _ = policy.predict(observe(policy.interface, {"speed": speed}))
    assert action == pytest.approx(np.full(8, command), abs=1e-6)


def ride(policy: Any, seconds: int, readings: dict[str, float], observe: Observe) -> list[float]:
    """Commands of the front bogie after each second of constant features."""
    period = round(1.0 / policy.interface.control_period)
    seen = observe(policy.interface, readings)
    action, state = policy.predict(seen)
    found = [float(action[0])]
    for _ in range(seconds):
        for _ in range(period):
            action, state = policy.predict(seen, state)
        found.append(float(action[0]))
    return found


def balance(acceleration: float, force: float) -> float:
    """Logarithm of the parts of J with k_y = 1 and k_F = 0.5, limits 5.44 m/s2 and 12 kN."""
    return math.log((acceleration / 5.44) ** 2 / (0.5 * (force / 12e3) ** 2))


@pytest.fixture
def features(interface: Make) -> Interface:
    return interface(observation="features", control_period=0.1)


CORRECTED = {**TABLE, "balances": (-1.0, 0.0, 1.0), "v_min": 0.05, "v_max": 0.6}


def test_each_second_corrects_by_how_far_the_balance_is_off(features: Interface, observe: Observe) -> None:
    policy = baselines.make("hunting-schedule", features, gain=0.02, **CORRECTED)
    readings = {"speed": 90.0, "acceleration_rms": 0.4, "force_rms": 2e3}
    commands = ride(policy, 4, readings, observe)
    step = 0.02 * (balance(0.4, 2e3) - 0.75)  # at three quarters of the way from 0 to 1
    assert commands == pytest.approx([0.15 - k * step for k in range(5)], abs=1e-6)


def test_without_gain_it_is_the_speed_schedule(features: Interface, observe: Observe) -> None:
    plain = baselines.make("speed-schedule", features, **TABLE)
    policy = baselines.make("hunting-schedule", features, gain=0.0, **CORRECTED)
    readings = {"speed": 71.0, "acceleration_rms": 3.0, "force_rms": 1e3}
    assert ride(policy, 3, readings, observe) == ride(plain, 3, readings, observe)


def test_the_roughness_of_the_track_does_not_matter(features: Interface, observe: Observe) -> None:
    """Twice the acceleration and twice the force have the same ratio."""
    policy = baselines.make("hunting-schedule", features, gain=0.03, **CORRECTED)
    rough, smooth = (
        ride(policy, 5, {"speed": 80.0, "acceleration_rms": 0.4 * x, "force_rms": 1e3 * x}, observe)
        for x in (1.0, 2.0)
    )
    assert rough == pytest.approx(smooth, abs=1e-7)


def test_a_command_at_an_end_of_its_range_comes_back_at_once(features: Interface, observe: Observe) -> None:
    policy = baselines.make("hunting-schedule", features, gain=0.05, **CORRECTED)
    hunting = observe(policy.interface, {"speed": 90.0, "acceleration_rms": 5.0, "force_rms": 1e3})
    calm = observe(policy.interface, {"speed": 90.0, "acceleration_rms": 0.2, "force_rms": 4e3})
    action, state = policy.predict(hunting)
    for _ in range(200):
        action, state = policy.predict(hunting, state)
    assert action == pytest.approx(0.05, abs=1e-7)
    for _ in range(10):
        action, state = policy.predict(calm, state)
    assert action == pytest.approx(0.05 + 0.05 * (0.75 - balance(0.2, 4e3)), abs=1e-6)


def test_dead_pressures_count_with_the_largest_balance(features: Interface, observe: Observe) -> None:
    policy = baselines.make("hunting-schedule", features, gain=0.01, **CORRECTED)
    commands = ride(policy, 1, {"speed": 90.0, "acceleration_rms": 0.4}, observe)
    assert commands[1] == pytest.approx(0.15 - 0.01 * (5.0 - 0.75), abs=1e-6)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("speed-schedule", {"commands": (0.1, 0.2)}, "commands: found 2 values for 5 speeds"),
        ("speed-schedule", {"commands.5": 0.1}, "'commands.5': the list 'commands' has 5 values"),
        ("speed-schedule", {"commands.1": 1.2}, "commands.*1.2"),
        ("speed-schedule", {"speeds_kmh.1": 500.0}, "speeds_kmh must rise"),
        ("hunting-schedule", {"balances": (0.0,)}, "balances: found 1 values for 5 speeds"),
        ("hunting-schedule", {"v_min": 0.9}, "v_min 0.9 must be below v_max 0.8"),
        ("hunting-schedule", {"k_F": 0.0}, "k_y and k_F must be positive"),
    ],
)
def test_tables_that_cannot_be_are_refused(
    interface: Make, name: str, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as raised:
        baselines.make(name, interface(), **changes)
    assert "\n" not in str(raised.value)
