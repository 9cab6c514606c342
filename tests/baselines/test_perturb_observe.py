"""Perturb and observe: its moves by hand, and its way to the minimum of a convex cost."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sayd_env import baselines

LIMIT = 5.44


def search(policy, features, observe, cost, seconds):
    """Commands of the front bogie after each second, on a plant with the cost J(V)."""
    action, state = policy.predict(observe(features, {}))
    commands = [float(action[0])]
    for _ in range(seconds):
        rms = LIMIT * math.sqrt(cost(commands[-1]))
        for _ in range(100):
            action, state = policy.predict(observe(features, {"acceleration_rms": rms}), state)
        commands.append(float(action[0]))
    return np.array(commands)


@pytest.fixture
def features(interface):
    return interface(observation="features")


def policy_of(features, **changes):
    settings = {"k_y": 1.0, "k_F": 0.0, "step": 0.1, "v_min": 0.0, "first_move": "close"} | changes
    return baselines.make("perturb-and-observe", features, **settings)


def test_the_direction_is_kept_while_the_cost_falls_and_turned_when_it_rises(features, observe):
    costs = iter([0.5, 0.4, 0.3, 0.35, 0.35, 0.4])
    commands = search(policy_of(features, initial=0.8), features, observe, lambda _: next(costs), 6)
    #       first, fell, fell, rose, stayed, rose
    assert commands == pytest.approx([0.8, 0.7, 0.6, 0.5, 0.6, 0.7, 0.6], abs=1e-6)


@pytest.mark.parametrize("start", [0.0, 0.05, 0.4, 1.0])
@pytest.mark.parametrize("first_move", ["close", "open"])
def test_it_finds_the_minimum_of_a_convex_cost(features, observe, start, first_move):
    policy = policy_of(features, initial=start, first_move=first_move, step=0.02)
    commands = search(policy, features, observe, lambda v: 0.1 + (v - 0.37) ** 2, 80)
    assert np.abs(commands[60:] - 0.37).max() <= 2 * 0.02 + 1e-6


@pytest.mark.parametrize(("slope", "end"), [(0.5, 0.03), (-0.5, 1.0)])
def test_it_stays_at_the_end_at_which_the_cost_is_lowest(features, observe, slope, end):
    policy = policy_of(features, initial=0.5, v_min=0.03, step=0.05)
    commands = search(policy, features, observe, lambda v: 1.0 + slope * v, 60)
    assert np.abs(commands[30:] - end).max() <= 2 * 0.05 + 1e-6
    assert commands.min() >= 0.03 - 1e-7
    assert commands.max() <= 1.0
