"""Saved states go on bit for bit; environments can be pickled."""

from __future__ import annotations

import pickle
from typing import Any

import cloudpickle
import numpy as np
import pytest

from sayd_env.config import ConfigError
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv


def run(env: Any, steps: int, seed: int = 0) -> list[Any]:
    """Steps with random actions; episodes of a single environment follow one another."""
    found = []
    actions = np.random.default_rng(seed).random((steps, *env.action_space.shape), dtype=np.float32)
    for action in actions:
        found.append(env.step(action))
        if isinstance(env, SaydEnv) and (found[-1][2] or found[-1][3]):
            found.append((*env.reset(), 0, 0, {}))
    return found


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, list | tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, dict):
        assert set(one) == set(other)
        for key in one:
            assert_same(one[key], other[key])
    else:
        np.testing.assert_array_equal(one, other)


def make(kind: Any, environment: str, **keywords: Any) -> Any:
    more = {"num_envs": 3} if kind is SaydVectorEnv else {}
    return kind(environment, info="full", observation="history", **more, **keywords)


@pytest.mark.parametrize("kind", [SaydEnv, SaydVectorEnv])
def test_a_state_goes_on_bit_for_bit(kind: Any, quick_faults: str) -> None:
    env = make(kind, quick_faults)
    env.reset(seed=4)
    run(env, 7)
    state = env.get_state()
    expected = run(env, 40, seed=1)  # over two resets, noise and faults included
    env.set_state(state)
    assert_same(run(env, 40, seed=1), expected)
    run(env, 3)
    env.set_state(state)  # it is still what it was
    assert_same(run(env, 40, seed=1), expected)
    fresh = make(kind, quick_faults)
    fresh.set_state(pickle.loads(pickle.dumps(state)))
    assert_same(run(fresh, 40, seed=1), expected)


def test_a_state_holds_its_faults(quick: str) -> None:
    lost = {"kind": "damper_lost", "damper": "front.left.upper", "start_s": 0.05}
    dead = {"kind": "sensor_dead", "signal": "speed", "start_s": 0.1}
    for damper in ("sayd", "passive"):
        env = SaydEnv(quick, damper=damper)
        env.reset(seed=1, options={"faults": [lost, dead]})
        run(env, 2)
        state = env.get_state()
        expected = run(env, 15, seed=1)
        speed = env.interface.index("speed")
        assert (expected[0][0][speed] > 90, expected[-1][0][speed]) == (True, 0.0)
        env.set_state(state)
        assert_same(run(env, 15, seed=1), expected)
        later = env.get_state()
        env.set_state(state)
        env.set_state(later)
        assert_same(run(env, 3, seed=2), run(_copy(env, later), 3, seed=2))


def _copy(env: SaydEnv, state: Any) -> SaydEnv:
    other = cloudpickle.loads(cloudpickle.dumps(env))
    other.set_state(state)
    return other


def test_two_environments_do_not_share_a_state(quick_faults: str) -> None:
    one, two = SaydEnv(quick_faults), SaydEnv(quick_faults)
    one.reset(seed=9)
    two.reset(seed=8)
    two.set_state(one.get_state())
    run(two, 10, seed=3)
    alone = SaydEnv(quick_faults)
    alone.reset(seed=9)
    assert_same(run(one, 10), run(alone, 10))


@pytest.mark.parametrize("kind", [SaydEnv, SaydVectorEnv])
def test_environments_can_be_pickled(kind: Any, quick_faults: str) -> None:
    env = make(kind, quick_faults)
    fresh = cloudpickle.loads(cloudpickle.dumps(env))
    assert_same(fresh.reset(seed=1), env.reset(seed=1))
    run(env, 5)
    copy = cloudpickle.loads(cloudpickle.dumps(env))
    assert_same(run(copy, 30, seed=1), run(env, 30, seed=1))


def test_an_ended_episode_stays_ended(quick: str) -> None:
    env = SaydEnv(quick)
    env.reset(seed=1)
    for _ in range(20):
        env.step(np.zeros(2, np.float32))
    other = SaydEnv(quick)
    other.set_state(env.get_state())
    assert other.reset()[1]["episode_number"] == 1


def test_states_of_other_environments_are_refused(quick: str, quick_faults: str) -> None:
    env, other = SaydEnv(quick), SaydEnv(quick_faults)
    env.reset(seed=1)
    with pytest.raises(ConfigError, match="another environment"):
        other.set_state(env.get_state())
    with pytest.raises(ConfigError, match="1 vehicles; expected 2"):
        SaydVectorEnv(quick, num_envs=2).set_state(env.get_state())
    for changed in ({"reward": (0.0, 100.0)}, {"settings": ["friction=0.2"]}):
        with pytest.raises(ConfigError, match=r"another environment; .*settings and reward"):
            SaydEnv(quick, **changed).set_state(env.get_state())
    with pytest.raises(ConfigError, match=r'without the sliding RMS that info="full" gives'):
        SaydEnv(quick, info="full").set_state(env.get_state())
    for kind in (SaydEnv, SaydVectorEnv):
        for bad in ({}, None, env.get_state().vehicles):
            with pytest.raises(ConfigError, match=r"state: found .*; expected what get_state has returned"):
                make(kind, quick).set_state(bad)
    with pytest.raises(ConfigError, match="reset"):
        SaydEnv(quick).get_state()
