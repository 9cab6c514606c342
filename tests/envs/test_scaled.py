"""Environments for learners: the same episodes in numbers of order 1."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from sayd_env import baselines
from sayd_env.config import ConfigError
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv

KINDS = ["signals", "history", "features"]


@pytest.mark.parametrize("kind", KINDS)
def test_it_passes_the_checker(kind: str, quick_faults: str) -> None:
    env = gym.make("SAYD/Faults-v1", environment=quick_faults, scaled=True, observation=kind)
    check_env(env.unwrapped, skip_render_check=True)


def test_it_is_the_same_episode_in_other_units(quick_faults: str) -> None:
    """The maps of configs/learner/scaled.yaml, written out."""
    raw, env = SaydEnv(quick_faults), SaydEnv(quick_faults, scaled=True)
    names = [signal.name.partition(".")[0] for signal in raw.signals]
    halves = {"lateral_acceleration": 3.0, "longitudinal_acceleration": 2.0, "stroke": 0.0015, "current": 0.5}
    halves |= {"pressure_a": 1e6, "pressure_b": 1e6, "speed": 16.0}
    middles = {"pressure_a": 1e6, "pressure_b": 1e6, "current": 0.5, "speed": 80.0}
    middle = np.array([middles.get(name, 0.0) for name in names])
    half = np.array([halves[name] for name in names])
    seen, info = raw.reset(seed=3)
    np.testing.assert_allclose(env.reset(seed=3)[0], np.clip((seen - middle) / half, -5, 5), atol=1e-6)
    level = raw.batch.episodes[0].track_scale  # type: ignore[union-attr]
    ordinary = 0.0135 * (info["speed_kmh"] / 3.6 / 80.0) ** 2.5 * ((level or 0.57) / 0.57) ** 2
    # Halves of these are exact: a last bit more could take a sensor over one of its steps.
    for action in np.random.default_rng(0).integers(-64, 65, (20, 2)) / np.float32(64.0):
        seen, reward, *ends, _ = raw.step((action + 1.0) / 2.0)
        found, scaled, *scaled_ends, _ = env.step(action)
        np.testing.assert_allclose(found, np.clip((seen - middle) / half, -5, 5), atol=1e-5)
        assert scaled == pytest.approx(float(reward) / ordinary, rel=1e-5)
        assert scaled_ends == ends


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_batch_gives_the_same_bits(mode: str, kind: str, quick_faults: str) -> None:
    keywords: dict[str, Any] = {"scaled": True, "observation": kind}
    batch = SaydVectorEnv(quick_faults, num_envs=2, autoreset_mode=mode, **keywords)
    single = SaydEnv(quick_faults, **keywords)
    assert batch.single_observation_space == single.observation_space
    assert batch.single_action_space == single.action_space
    np.testing.assert_array_equal(batch.reset(seed=1)[0][1], single.reset(seed=2)[0])
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (20, 2, 2)).astype(np.float32)
    for action in actions:
        observation, rewards, _, truncated, infos = batch.step(action)
        expected, reward, *_ = single.step(action[1])
        np.testing.assert_array_equal(infos.get("final_obs", observation)[1], expected)
        assert rewards[1] == reward
    assert truncated.all()
    if mode == "NextStep":
        observation = batch.step(actions[0])[0]
    np.testing.assert_array_equal(observation[1], single.reset()[0])
    # Of the next episode, in its own multiples.
    assert batch.step(actions[1])[1][1] == single.step(actions[1][1])[1]


def test_a_saved_state_brings_its_multiples(quick_faults: str) -> None:
    env = SaydEnv(quick_faults, scaled=True)
    env.reset(seed=3)
    state, action = env.get_state(), np.zeros(2, np.float32)
    expected = env.step(action)
    env.reset(seed=4)
    env.set_state(state)
    found = env.step(action)
    np.testing.assert_array_equal(found[0], expected[0])
    assert found[1] == expected[1]


def test_actions_beyond_the_ends_are_the_ends(quick: str) -> None:
    """A Gaussian policy's samples are not bounded."""
    env = SaydEnv(quick, scaled=True)
    found = []
    for action in ([3.0, -7.5], [1.0, -1.0]):
        env.reset(seed=1)
        found.append(env.step(np.array(action, np.float32))[:2])
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == found[1][1]
    for wrong in (np.array([np.nan, 0.0]), np.array([np.inf, 0.0]), np.zeros(3), None):
        with pytest.raises(Exception, match="action: found"):
            env.step(wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["constant:0.3", "mppt2"])
def test_controllers_refuse_it(name: str, quick: str) -> None:
    with pytest.raises(ConfigError, match="without scaled=True"):
        baselines.make(name, SaydEnv(quick, scaled=True))
    with pytest.raises(ConfigError, match=r"scaled: found 'yes'; expected True or False"):
        SaydEnv(quick, scaled="yes")  # type: ignore[arg-type]
