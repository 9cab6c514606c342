"""The batch: each vehicle is the single environment bit for bit, in every autoreset mode."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from sayd_env.config import ConfigError
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv
from sayd_env.physics.kernel_cache import numba_config

THREADS = [n for n in (1, 2) if n <= numba_config.NUMBA_NUM_THREADS]
MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]


def actions_of(env: Any, steps: int, seed: int = 0) -> Any:
    return np.random.default_rng(seed).random((steps, *env.action_space.shape), dtype=np.float32)


def assert_same(one: Any, other: Any) -> None:
    """Equal infos, whatever the order of their keys."""
    if isinstance(one, dict):
        assert set(one) == set(other)
        for key, value in one.items():
            assert_same(value, other[key])
    elif isinstance(one, np.ndarray) and one.dtype == object:
        assert isinstance(other, np.ndarray)
        assert one.shape == other.shape
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
@pytest.mark.parametrize("count", [1, 3, 8])
def test_vehicles_equal_single_environments(count: int, mode: Any, quick_faults: str) -> None:
    # Two resets; speeds, noise and faults differ from vehicle to vehicle.
    makers = [lambda: SaydEnv(quick_faults, observation="history")] * count
    singles = SyncVectorEnv(makers, autoreset_mode=mode)
    actions = actions_of(singles, 50)
    expected = [singles.reset(seed=5), *(singles.step(each) for each in actions)]
    for threads in THREADS:
        vector = SaydVectorEnv(
            quick_faults, num_envs=count, num_threads=threads, autoreset_mode=mode, observation="history"
        )
        found = [vector.reset(seed=5), *(vector.step(each) for each in actions)]
        for one, other in zip(found, expected, strict=True):
            for part, same in zip(one, other, strict=True):
                assert_same(part, same)


def test_full_infos_equal_those_of_single_environments(quick: str) -> None:
    for mode in MODES:
        vector = SaydVectorEnv(quick, num_envs=2, info="full", autoreset_mode=mode)
        singles = SyncVectorEnv([lambda: SaydEnv(quick, info="full")] * 2, autoreset_mode=mode)
        vector.reset(seed=[3, 9])
        singles.reset(seed=[3, 9])
        for actions in actions_of(vector, 23):
            for one, other in zip(vector.step(actions), singles.step(actions), strict=True):
                assert_same(one, other)


def test_vehicles_that_end_at_different_times_equal_single_environments(quick: str) -> None:
    options = {"track": "german_low", "track_scale": 5.0, "speed_kmh": 450.0, "friction": 0.6}
    for mode in MODES:
        vector = SaydVectorEnv(quick, num_envs=4, episode_s=1.0, autoreset_mode=mode)
        singles = SyncVectorEnv([lambda: SaydEnv(quick, episode_s=1.0)] * 4, autoreset_mode=mode)
        vector.reset(seed=1, options=options)
        singles.reset(seed=1, options=options)
        ended = []
        for actions in actions_of(vector, 120):
            found, expected = vector.step(actions), singles.step(actions)
            for one, other in zip(found, expected, strict=True):
                assert_same(one, other)
            ended.append(int(found[2].sum()))
        assert sum(ended) > 1
        assert max(ended) < 4


def test_make_vec_gives_the_batch_and_the_workers_of_gymnasium_the_same(quick: str) -> None:
    batch = gym.make_vec("SAYD/Nominal-v1", num_envs=2, environment=quick)
    plain = gym.make_vec("SAYD/Nominal-v1", num_envs=2, environment=quick, vectorization_mode="sync")
    assert isinstance(batch, SaydVectorEnv)
    assert batch.observation_space == plain.observation_space
    assert batch.action_space == plain.action_space
    np.testing.assert_array_equal(batch.reset(seed=1)[0], plain.reset(seed=1)[0])


@pytest.mark.parametrize(("count", "loop"), [(1, (False, False, True)), (8, (True, True, False))])
def test_on_one_thread_groups_and_vehicles_alone_have_a_loop_each(
    count: int, loop: tuple[bool, ...], quick: str
) -> None:
    """What does not run needs no code; by which of groups, their members and vehicles alone a loop takes."""
    env = SaydVectorEnv(quick, num_envs=count, num_threads=1)
    env.reset(seed=[0] * count)
    env.step(np.full((count, 2), 0.3, np.float32))
    assert list(env.batch.vehicles._loops) == [loop]


def test_disabled_autoreset_waits_for_the_mask(quick: str) -> None:
    vector = SaydVectorEnv(quick, num_envs=3, autoreset_mode="Disabled")
    single = SaydEnv(quick)
    vector.reset(seed=1)
    single.reset(seed=2)
    for actions in actions_of(vector, 20):
        truncated = vector.step(actions)[3]
    assert truncated.all()
    with pytest.raises(ResetNeeded, match=r"0, 1, 2"):
        vector.step(actions)
    _, infos = vector.reset(options={"reset_mask": np.array([False, True, False])})
    assert infos["_seed"].tolist() == [False, True, False]
    assert (infos["seed"][1], infos["episode_number"][1]) == (2, 1)
    with pytest.raises(ResetNeeded, match=r"0, 2"):
        vector.step(actions)
    with pytest.raises(ConfigError, match="reset_mask"):
        vector.reset(options={"reset_mask": [True]})


def test_bad_input_is_refused(quick: str) -> None:
    vector = SaydVectorEnv(quick, num_envs=2)
    good = np.zeros((2, 2), np.float32)
    with pytest.raises(ResetNeeded):
        vector.step(good)
    with pytest.raises(ConfigError, match="first reset"):
        vector.reset(options={"reset_mask": np.array([True, False])})
    for seed in ([1], -1, "one", 1.5, 2**70):
        with pytest.raises(ConfigError, match="seed"):
            vector.reset(seed=seed)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="sped"):
        vector.reset(options={"sped": 1})
    vector.reset(seed=1)
    with pytest.raises(ConfigError, match=r"\(2, 2\)"):
        vector.step(np.zeros(2, np.float32))
    with pytest.raises(ConfigError, match=r"nan at \[1, 0\]"):
        vector.step(np.array([[0.0, 0.0], [np.nan, 0.0]], np.float32))


def test_every_call_returns_new_arrays(quick: str) -> None:
    vector = SaydVectorEnv(quick, num_envs=2)
    vector.reset(seed=1)
    kept = [vector.step(actions) for actions in actions_of(vector, 2)]
    for one, other in zip(kept[0][:4], kept[1][:4], strict=True):
        assert not np.shares_memory(one, other)
    for key, value in kept[0][4].items():
        assert not np.shares_memory(value, kept[1][4][key])


def test_attributes_are_given_for_each_vehicle(quick: str) -> None:
    vector = SaydVectorEnv(quick, num_envs=3)
    assert vector.get_attr("interface") == (vector.interface,) * 3
    assert vector.unwrapped.signals == SaydEnv(quick).signals
