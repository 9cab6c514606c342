"""How fast one vehicle steps, on the processor's clock: what other programs take does not count."""

from __future__ import annotations

import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytestmark = pytest.mark.timing

STEPS = 500


def cpu_time(env: Any) -> float:
    """Least time of a step of several runs, s."""
    actions = np.random.default_rng(0).random((STEPS, 2), dtype=np.float32)
    best = float("inf")
    for _ in range(5):
        env.reset(seed=1)
        start = time.process_time()
        for action in actions:
            env.step(action)
        best = min(best, (time.process_time() - start) / STEPS)
    return best


def test_a_single_environment_steps_fast_enough() -> None:
    assert 1.0 / cpu_time(gym.make("SAYD/Nominal-v0")) > 4000


def test_python_takes_less_than_30_us_of_a_step() -> None:
    env = gym.make("SAYD/Nominal-v0")
    env.reset(seed=1)
    lanes = env.unwrapped.fleet.lanes  # type: ignore[attr-defined]
    action = np.full(2, 0.5, dtype=np.float32)
    env.step(action)
    lanes._compiled = lambda *arguments: None
    best = float("inf")
    for _ in range(5):
        start = time.process_time()
        for _ in range(300):
            env.step(action)
        best = min(best, (time.process_time() - start) / 300)
    assert best < 30e-6
