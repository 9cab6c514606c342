"""The batch for Stable-Baselines3: what `DummyVecEnv` gives, and the cost of the rollout evaluator."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

SB3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.monitor import Monitor  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecVideoRecorder  # noqa: E402

from sayd_env import baselines  # noqa: E402
from sayd_env.agents.sb3_vec import SaydVecEnv  # noqa: E402
from sayd_env.config import ConfigError  # noqa: E402
from sayd_env.config.environment import load_environment  # noqa: E402
from sayd_env.envs.draw import draw_episode  # noqa: E402
from sayd_env.envs.episode_batch import EpisodeBatch  # noqa: E402
from sayd_env.envs.rollout import roll_out  # noqa: E402
from sayd_env.envs.single import SaydEnv  # noqa: E402

FIERCE = {"track": "german_low", "track_scale": 5.0, "speed_kmh": 450.0, "friction": 0.6}


def assert_same(one: Any, other: Any) -> None:
    """Equal to the last bit, whatever the order of keys."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert set(one) == set(other)
        for key, value in one.items():
            assert_same(value, other[key])
    elif isinstance(one, list | tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


def compare(batch: SaydVecEnv, plain: DummyVecEnv, steps: int) -> list[int]:
    """Run both with the same actions; return the number of vehicles that ended in each step."""
    assert batch.observation_space == plain.observation_space
    assert batch.action_space == plain.action_space
    assert_same(batch.reset(), plain.reset())
    assert_same(batch.reset_infos, plain.reset_infos)
    random, ended = np.random.default_rng(3), []
    for _ in range(steps):
        actions = random.random((plain.num_envs, *plain.action_space.shape), dtype=np.float32)
        found, expected = batch.step(actions), plain.step(actions)
        assert_same(found, expected)
        assert_same(batch.reset_infos, plain.reset_infos)
        ended.append(int(np.count_nonzero(expected[2])))
    return ended


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("info", ["basic", "full"])
def test_a_rollout_equals_that_of_dummy_vec_env(count: int, info: str, quick_faults: str) -> None:
    keywords: dict[str, Any] = {"observation": "history", "valves": "damper", "info": info}
    batch = SaydVecEnv(quick_faults, count, **keywords)
    plain = DummyVecEnv([lambda: SaydEnv(quick_faults, **keywords)] * count)
    for vector in (batch, plain):
        vector.seed(11)
    assert sum(compare(batch, plain, 45)) == 2 * count  # episodes of 20 steps
    assert sum(compare(batch, plain, 3)) == 0  # a reset without a seed: each vehicle's next episode


def test_vehicles_that_derail_equal_those_of_dummy_vec_env(quick: str) -> None:
    batch = SaydVecEnv(quick, 4, episode_s=1.0)
    plain = DummyVecEnv([lambda: SaydEnv(quick, episode_s=1.0)] * 4)
    for vector in (batch, plain):
        vector.seed(1)
        vector.set_options(FIERCE)
    ended = compare(batch, plain, 120)
    assert sum(ended) >= 4
    assert 1 <= max(ended) < 4  # not all at once


@pytest.mark.parametrize("begun", [False, True])
def test_each_vehicle_may_have_options_of_its_own(begun: bool, quick: str) -> None:
    batch, plain = SaydVecEnv(quick, 3), DummyVecEnv([lambda: SaydEnv(quick)] * 3)
    for vector in (batch, plain):
        if begun:
            vector.seed(8)
            vector.reset()
        vector.seed(4)
        vector.set_options([{"speed_kmh": 300.0}, {}, {"wear": 0.5}])
    compare(batch, plain, 2)
    assert [info["speed_kmh"] for info in batch.reset_infos] == pytest.approx([300.0, 350.0, 350.0])


def test_the_end_by_time_is_told_from_a_derailment(quick: str) -> None:
    batch = SaydVecEnv(quick, 4, episode_s=1.0)
    batch.seed(1)
    batch.set_options(FIERCE)
    batch.reset()
    cut = {True: 0, False: 0}
    for _ in range(100):
        _, _, dones, infos = batch.step(np.zeros((4, 2), np.float32))
        for info in (infos[i] for i in np.flatnonzero(dones)):
            cut[info["TimeLimit.truncated"]] += 1
            assert bool(info["ending"]) != info["TimeLimit.truncated"]
            assert info["terminal_observation"].shape == batch.observation_space.shape
    assert cut[False] > 0


def test_attributes_are_given_for_each_vehicle(quick: str) -> None:
    batch = SaydVecEnv(quick, 3)
    assert batch.get_attr("interface", [0, 2]) == [batch.interface] * 2
    assert not batch.has_attr("no_such_thing")
    assert batch.env_is_wrapped(Monitor) == [False] * 3
    batch.set_attr("note", 1)
    assert batch.get_attr("note") == [1] * 3
    with pytest.raises(ConfigError, match="one object"):
        batch.set_attr("note", 1, [0])
    with pytest.raises(ConfigError, match="one object"):
        batch.env_method("reset")
    with pytest.raises(ConfigError, match="autoreset_mode"):
        SaydVecEnv(quick, autoreset_mode="NextStep")
    with pytest.raises(ConfigError, match="sped"):
        SaydVecEnv(quick, sped=3)


def test_pictures_are_those_of_dummy_vec_env(quick: str) -> None:
    pytest.importorskip("pygame", reason="needs the extra 'render'")
    keywords: dict[str, Any] = {"render_mode": "rgb_array", "control_period": 0.02}
    batch = SaydVecEnv(quick, 3, **keywords)
    plain = DummyVecEnv([lambda: SaydEnv(quick, **keywords)] * 3)
    for vector in (batch, plain):
        vector.seed(1)
        vector.reset()
        vector.step(np.full((3, 2), 0.5, np.float32))
    np.testing.assert_array_equal(batch.get_images(), plain.get_images())
    np.testing.assert_array_equal(batch.render(), plain.render())
    other = pickle.loads(pickle.dumps(batch))
    np.testing.assert_array_equal(other.render(), batch.render())
    for vector in (batch, other):
        vector.close()


def test_a_window_shows_the_first_vehicle(quick: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pygame", reason="needs the extra 'render'")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    batch = SaydVecEnv(quick, 2, render_mode="human")
    batch.reset()
    assert batch.render() is None
    batch.close()


def test_videos_have_the_rate_of_the_steps(quick: str, tmp_path: Path) -> None:
    moviepy = pytest.importorskip("moviepy", reason="the recorder needs moviepy")
    batch = SaydVecEnv(quick, 2, render_mode="rgb_array", control_period=0.02)
    assert batch.metadata["render_fps"] == 50
    recorder = VecVideoRecorder(batch, str(tmp_path), lambda step: step == 0, video_length=10)
    recorder.reset()
    for _ in range(12):
        recorder.step(np.full((2, 2), 0.5, np.float32))
    recorder.close()
    (file,) = tmp_path.glob("*.mp4")
    clip = moviepy.VideoFileClip(str(file))
    assert clip.fps == 50
    clip.close()


def test_closing_what_was_never_made() -> None:
    with pytest.raises(ConfigError):
        SaydVecEnv(valves="axle")
    SaydVecEnv.__new__(SaydVecEnv).close()


def test_time_features_know_the_length_of_an_episode(quick: str) -> None:
    wrappers = pytest.importorskip("sb3_contrib.common.wrappers", reason="needs sb3-contrib")
    for env in (gym.make("SAYD/Nominal-v1", environment=quick), SaydEnv(quick)):
        aware = wrappers.TimeFeatureWrapper(env)
        aware.reset(seed=1)
        left = [aware.step(np.zeros(2, np.float32))[0][-1] for _ in range(20)]
        np.testing.assert_allclose(left, 1.0 - np.arange(1, 21) / 20, atol=1e-6)


def cost_of_the_evaluator(environment: str, policy: str, seed: int) -> float:
    """J of an episode by the rollout evaluator."""
    config = load_environment(environment)
    batch = EpisodeBatch(config, 1)
    (run,) = roll_out(
        batch, baselines.make(policy, batch.interface), [draw_episode(config, seed, 0)], [batch.steps]
    )
    cost = batch.scenario.cost
    return float(np.dot([cost.acceleration_weight, cost.force_weight], run.cost()))


@pytest.mark.parametrize("policy", ["mppt2", "skyhook-onoff"])
def test_evaluate_policy_gives_the_cost_of_the_evaluator(policy: str, two_seconds: str) -> None:
    expected = -cost_of_the_evaluator(two_seconds, policy, seed=5)
    assert expected < -1e-3  # else it would be no test
    single = Monitor(SaydEnv(two_seconds))
    vehicles = {"single": DummyVecEnv([lambda: single]), "batch": VecMonitor(SaydVecEnv(two_seconds, 1))}
    for name, env in vehicles.items():
        env.seed(5)
        controller = baselines.make(policy, single if name == "single" else env)
        mean, spread = evaluate_policy(controller, env, n_eval_episodes=1)
        assert (mean / 2.0, spread) == (pytest.approx(expected, abs=1e-5), 0.0), name


def test_evaluate_policy_takes_a_single_environment_as_it_is(two_seconds: str) -> None:
    env = Monitor(SaydEnv(two_seconds))
    env.reset(seed=5)
    mean, _ = evaluate_policy(baselines.make("mppt2", env), env, n_eval_episodes=1)
    # evaluate_policy resets without a seed: this is episode 1 of seed 5.
    single = SaydEnv(two_seconds)
    single.reset(seed=5)
    observation, _ = single.reset()
    controller, state, total, over = baselines.make("mppt2", single), None, 0.0, False
    while not over:
        action, state = controller.predict(observation, state)
        observation, reward, _, over, _ = single.step(action)
        total += float(reward)
    assert mean == pytest.approx(total, abs=1e-6)
