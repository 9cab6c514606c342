"""Normalised signals and stacks of them."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from sayd_env.config import ConfigError
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv
from sayd_env.envs.wrappers import HistoryStack, NormalizeSignals, NormalizeVectorSignals


@pytest.mark.parametrize("kind", ["signals", "history", "features"])
def test_ranges_become_minus_one_to_one(kind: str, quick: str) -> None:
    env, raw = NormalizeSignals(SaydEnv(quick, observation=kind)), SaydEnv(quick, observation=kind)
    assert env.observation_space.shape == raw.observation_space.shape
    low, high = env.observation_space.low, env.observation_space.high
    assert (low.min(), low.max(), high.min(), high.max()) == (-1, -1, 1, 1)
    space: Any = raw.observation_space
    np.testing.assert_array_equal(env.observation(space.low), low)
    np.testing.assert_array_equal(env.observation(space.high), high)
    seen, expected = env.reset(seed=1)[0], raw.reset(seed=1)[0]
    span = space.high.astype(float) - space.low
    back = space.low + (seen.astype(float) + 1.0) / 2.0 * span
    np.testing.assert_allclose(back, expected, atol=1e-6 * span.max(), rtol=0)


def test_normalised_signals_pass_the_checker(quick: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = NormalizeSignals(gym.make("SAYD/Nominal-v1", environment=quick))
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_env(env)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_the_batch_is_mapped_alike(mode: str, quick: str) -> None:
    env = NormalizeVectorSignals(SaydVectorEnv(quick, num_envs=2, autoreset_mode=mode))
    single = NormalizeSignals(SaydEnv(quick))
    np.testing.assert_array_equal(env.reset(seed=1)[0][1], single.reset(seed=2)[0])
    action = np.full((2, 2), 0.5, np.float32)
    for _ in range(20):
        observation, _, _, truncated, infos = env.step(action)
        expected = single.step(action[0])[0]
        seen = infos.get("final_obs", observation)
        np.testing.assert_array_equal(seen[1], expected)
    assert truncated.all()


def test_gymnasium_stacks_as_the_history_does(quick: str) -> None:
    stacked, history = HistoryStack(SaydEnv(quick), 4), SaydEnv(quick, observation="history", history=4)
    assert stacked.observation_space == history.observation_space
    np.testing.assert_array_equal(stacked.reset(seed=1)[0], history.reset(seed=1)[0])
    for action in np.random.default_rng(0).random((6, 2), dtype=np.float32):
        np.testing.assert_array_equal(stacked.step(action)[0], history.step(action)[0])


def test_unbounded_observations_are_refused() -> None:
    with pytest.raises(ConfigError, match="finite bounds"):
        NormalizeSignals(gym.make("CartPole-v1"))
