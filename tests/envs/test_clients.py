"""Clients take the environments as they are: Gymnasium's wrappers, copies, workers, pictures, TorchRL."""

from __future__ import annotations

import copy
import gc
import importlib
import json
import math
import pickle
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.error import InvalidAction
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.wrappers import vector as vector_wrappers

from sayd_env.config import ConfigError
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv
from sayd_env.physics.kernel_cache import numba_config

ID = "SAYD/Nominal-v1"
STEPS = 20
"""Of an episode of the quick environments."""
GYMNASIUMS_OWN = {"episode", "_episode", "final_info", "final_obs", "statistics"}
FIERCE = {"track": "german_low", "track_scale": 5.0, "speed_kmh": 450.0, "friction": 0.6}
INFOS = [{"info": "basic"}, {"info": "full"}, {"info": "full", "damper": "passive"}]
MODES = list(AutoresetMode)
needs_threads = pytest.mark.skipif(numba_config.NUMBA_NUM_THREADS < 2, reason="needs two threads")


@pytest.fixture(autouse=True)
def no_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def half(env: Any) -> Any:
    return np.full(env.action_space.shape, 0.5, np.float32)


def form(info: dict[str, Any]) -> dict[str, Any]:
    """Keys, types and shapes."""
    return {key: (type(value), np.shape(value)) for key, value in info.items()}


# Info


@pytest.mark.parametrize("keywords", INFOS, ids=str)
def test_infos_have_one_form(keywords: dict[str, Any], quick_faults: str) -> None:
    env = gym.make("SAYD/Faults-v1", environment=quick_faults, **keywords)
    infos = [env.reset(seed=1)[1]]
    for _ in range(2 * STEPS):
        *_, truncated, info = env.step(half(env))
        infos.append(info)
        infos += [env.reset()[1]] if truncated else []
    assert all(form(info) == form(infos[0]) for info in infos)
    assert not GYMNASIUMS_OWN & set(infos[0])
    assert infos[0]["cost_force"] == infos[0]["cost_acceleration"] == 0.0
    assert all(isinstance(json.loads(info["faults"]), list) for info in infos)


@pytest.mark.parametrize("keywords", INFOS, ids=str)
@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
def test_infos_of_a_batch_have_one_form(mode: AutoresetMode, keywords: Any, quick_faults: str) -> None:
    envs = SaydVectorEnv(quick_faults, num_envs=3, autoreset_mode=mode, **keywords)
    single = SaydEnv(quick_faults, **keywords).reset(seed=1)[1]
    first = envs.reset(seed=1)[1]
    types = {key: values.dtype for key, values in first.items()}
    assert {key for key in first if not key.startswith("_")} == set(single)
    assert not GYMNASIUMS_OWN & set(first)
    for _ in range(2 * STEPS):
        _, _, _, truncated, infos = envs.step(half(envs))
        last = infos.pop("final_info", None), infos.pop("_final_info", None)
        assert (last[0] is not None) == (mode is AutoresetMode.SAME_STEP and truncated.any())
        for each in (infos, last[0]):
            if each is not None:
                dtypes = {key: values.dtype for key, values in each.items() if "final_obs" not in key}
                assert dtypes == types
        assert all(infos["_" + key].all() for key in single)
        if truncated.any() and mode is AutoresetMode.DISABLED:
            assert form(envs.reset(options={"reset_mask": truncated})[1]) == form(first)


def test_an_ending_is_reported_in_the_same_form(quick: str) -> None:
    env = SaydEnv(quick, episode_s=5.0)
    for seed in range(20):
        info = before = env.reset(seed=seed, options=FIERCE)[1]
        ended = False
        while not ended:
            *_, ended, truncated, info = env.step(np.ones(2, np.float32))
            ended = ended or truncated
        assert form(info) == form(before)
        if info["ending"]:
            break
    assert info["ending"].startswith("derailment")
    assert info["error"] == ""


# Statistics


def test_statistics_of_one(quick: str) -> None:
    env = wrappers.RecordEpisodeStatistics(gym.make(ID, environment=quick))
    for seed in (1, None):
        env.reset(seed=seed)
        rewards = []
        for _ in range(STEPS):
            _, reward, _, _, info = env.step(half(env))
            rewards.append(float(reward))
        assert (info["episode"]["r"], info["episode"]["l"]) == (pytest.approx(sum(rewards)), STEPS)
    assert env.episode_count == 2


def statistics(envs: VectorEnv[Any, Any, Any]) -> list[tuple[Any, Any, Any]]:
    """What a training loop reads of ``infos["episode"]``, and the returns as they are, at each end."""
    envs = vector_wrappers.RecordEpisodeStatistics(envs)
    envs.reset(seed=1)
    found, total = [], np.zeros(2)
    for _ in range(2 * STEPS + 1):
        _, rewards, terminated, truncated, infos = envs.step(half(envs))
        total += rewards
        done = terminated | truncated
        assert ("episode" in infos) == done.any()
        if done.any():
            np.testing.assert_array_equal(infos["_episode"], done)
            found.append((infos["episode"]["r"], infos["episode"]["l"], total))
            total = np.zeros(2)
            if envs.metadata["autoreset_mode"] is AutoresetMode.DISABLED:
                envs.reset(options={"reset_mask": done})
    return found


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
def test_statistics_of_a_batch(mode: AutoresetMode, quick: str) -> None:
    found = statistics(SaydVectorEnv(quick, num_envs=2, autoreset_mode=mode))
    plain = statistics(gym.vector.SyncVectorEnv([partial(SaydEnv, quick)] * 2, autoreset_mode=mode))
    np.testing.assert_allclose(found, plain, rtol=1e-12)
    assert len(found) == 2
    if mode is not AutoresetMode.SAME_STEP:  # of which older versions of the wrapper leave a step out
        for returns, lengths, total in found:
            np.testing.assert_allclose(returns, total, rtol=1e-9)
            np.testing.assert_array_equal(lengths, STEPS)


@pytest.mark.parametrize("mode", MODES[:2], ids=lambda mode: mode.value)
def test_wrappers_that_keep_statistics_run(mode: AutoresetMode, quick: str) -> None:
    single = wrappers.NormalizeObservation(gym.make(ID, environment=quick))
    single = wrappers.NormalizeReward(wrappers.RecordEpisodeStatistics(single))
    native = gym.make_vec(ID, num_envs=2, environment=quick, autoreset_mode=mode)
    if mode is AutoresetMode.NEXT_STEP:  # the only one that this wrapper takes
        native = vector_wrappers.NormalizeObservation(native)
    batch = vector_wrappers.DictInfoToList(vector_wrappers.NormalizeReward(native))
    single.reset(seed=1)
    batch.reset(seed=1)
    for _ in range(STEPS):
        *_, info = single.step(half(single))
        *_, infos = batch.step(half(batch))
    assert info["episode"]["l"] == STEPS
    assert [each["episode_number"] for each in infos] == [0 if mode is AutoresetMode.NEXT_STEP else 1] * 2


# Keywords


@pytest.mark.parametrize("make", [SaydEnv, SaydVectorEnv, partial(gym.make, ID), partial(gym.make_vec, ID)])
@pytest.mark.parametrize("key", ["frame_skip", "pixels_only", "max_steps"])
def test_unknown_keywords_are_pythons_own_error(make: Callable[..., Any], key: str) -> None:
    """TorchRL gives keywords of its own and takes back those that this error names."""
    with pytest.raises(
        TypeError, match=rf"__init__\(\) got an unexpected keyword argument '{key}'"
    ) as caught:
        make(**{key: 1})
    assert "allowed: " in str(caught.value)
    with pytest.raises(ConfigError, match=r"did you mean 'episode_s'"):
        make(episode_z=1.0)


@pytest.mark.parametrize("mode", MODES, ids=lambda mode: mode.value)
def test_the_batch_says_how_it_resets(mode: AutoresetMode, quick: str) -> None:
    envs = SaydVectorEnv(quick, num_envs=2, autoreset_mode=mode)
    plain = gym.vector.SyncVectorEnv([partial(SaydEnv, quick)], autoreset_mode=mode)
    assert envs.autoreset_mode is plain.autoreset_mode is envs.metadata["autoreset_mode"] is mode


@pytest.mark.parametrize("kind", [SaydEnv, SaydVectorEnv])
@pytest.mark.filterwarnings("error")
def test_closing_what_was_never_made(kind: Any) -> None:
    with pytest.raises(ConfigError):
        kind(valves="axle")
    gc.collect()
    kind.__new__(kind).close()


# Actions


@pytest.mark.parametrize("kind", [SaydEnv, SaydVectorEnv])
@pytest.mark.parametrize("value", [-0.001, 1.001, np.nan, np.inf])
def test_refused_actions_are_gymnasiums_own_error(kind: Any, value: float, quick: str) -> None:
    env = kind(quick)
    env.reset(seed=1)
    with pytest.raises(InvalidAction, match=r"action: found .* expected finite") as caught:
        env.step(half(env) * 0 + value)
    assert isinstance(caught.value, ConfigError)
    assert ("ClipAction" in str(caught.value)) is not math.isnan(value)  # nothing cuts off what is no number


def test_clip_action_lets_all_pass(quick: str) -> None:
    env = wrappers.ClipAction(SaydEnv(quick, info="full"))
    envs = vector_wrappers.ClipAction(SaydVectorEnv(quick, num_envs=2))
    for each in (env, envs):
        each.reset(seed=1)
    envs.step(np.full((2, 2), -3.0, np.float32))
    assert set(env.step(np.array([7.0, -7.0], np.float32))[4]["valve_command"]) == {0.0, 1.0}


@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.7), (-0.3, 1.1), (-1.0, 0.3), (-2.0, 7.0), (0.1, 0.4)])
def test_rescaled_actions_may_round(low: float, high: float, quick: str) -> None:
    scaled = wrappers.RescaleAction(SaydEnv(quick, info="full"), np.float32(low), np.float32(high))
    scaled.reset(seed=1)
    for bound, command in ((scaled.action_space.low, 0.0), (scaled.action_space.high, 1.0)):
        asked = scaled.step(bound)[4]["valve_command"]
        np.testing.assert_allclose(asked, command, atol=1e-6, rtol=0)
        assert 0.0 <= asked.min() <= asked.max() <= 1.0


def test_rounding_is_cut_off_and_more_is_refused(quick: str) -> None:
    env = SaydEnv(quick, info="full")
    env.reset(seed=1)
    asked = env.step(np.array([1.0 + 1e-6, -1e-6]))[4]["valve_command"]
    assert sorted(set(asked.tolist())) == [0.0, 1.0]
    for value in (1.0 + 2e-6, -2e-6):
        with pytest.raises(InvalidAction):
            env.step(np.array([value, 0.5]))


# Length of an episode


@pytest.mark.parametrize(
    ("keywords", "steps"),
    [
        ({}, STEPS),
        ({"episode_s": 0.1}, 10),
        ({"control_period": 0.02, "episode_s": 0.5}, 25),
        ({"max_episode_steps": 3}, 3),
        ({"max_episode_steps": 1000}, STEPS),
        ({"max_episode_steps": -1}, STEPS),
    ],
    ids=str,
)
def test_the_length_of_an_episode_is_stated(keywords: dict[str, Any], steps: int, quick: str) -> None:
    made = gym.make(ID, environment=quick, **keywords)
    again = gym.make(made.spec) if made.spec is not None else made
    for env in (made, again):
        assert env.spec is not None
        assert env.spec.max_episode_steps == steps
        aware = wrappers.TimeAwareObservation(env, flatten=False, normalize_time=True)
        aware.reset(seed=1)
        truncated, taken = False, 0
        while not truncated:
            observation, _, _, truncated, _ = aware.step(half(aware))
            taken += 1
        assert (taken, observation["time"]) == (steps, 1.0)
    batch = gym.make_vec(ID, num_envs=2, environment=quick, **keywords)
    assert batch.spec is not None
    assert batch.spec.max_episode_steps == steps


def test_an_environment_made_by_its_class_states_its_length_too(quick: str) -> None:
    env = SaydEnv(quick, valves="damper", episode_s=0.1)
    assert env.spec is not None
    assert wrappers.TimeAwareObservation(env).max_timesteps == 10
    again = gym.make(env.spec).unwrapped
    assert isinstance(again, SaydEnv)
    assert again.config == env.config
    json.loads(env.spec.to_json())


# Copies


COPIES: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "deepcopy": copy.deepcopy,
}


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("mode", ["rgb_array", "human"])
@pytest.mark.parametrize("kind", [SaydEnv, SaydVectorEnv])
def test_what_has_rendered_can_be_copied(kind: Any, mode: str, way: str, quick: str) -> None:
    pytest.importorskip("pygame", reason="needs the extra 'render'")
    env = kind(quick, render_mode=mode)
    env.reset(seed=1)
    env.step(half(env))
    picture = env.render()
    other = COPIES[way](env)
    np.testing.assert_array_equal(other.render(), picture)
    np.testing.assert_array_equal(other.step(half(env))[0], env.step(half(env))[0])
    np.testing.assert_array_equal(other.render(), env.render())
    for each in (other, env):
        each.close()


def signatures() -> dict[tuple[str, str], int]:
    """Number of types for which each kernel has been compiled."""
    modules = [module for name, module in sys.modules.items() if name.startswith("sayd_env")]
    return {
        (kernel.__module__, kernel.__qualname__): len(kernel.signatures)
        for module in modules
        for kernel in vars(module).values()
        if hasattr(kernel, "signatures") and not isinstance(kernel, type)
    }


@pytest.mark.parametrize("way", COPIES)
@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=needs_threads)])
def test_copies_use_the_kernels_that_there_are(threads: int, way: str, quick: str) -> None:
    for keywords in ({"num_envs": 1}, {"num_envs": 6, "info": "full", "observation": "features"}):
        envs = SaydVectorEnv(quick, num_threads=threads, **keywords)
        envs.reset(seed=1)
        envs.step(half(envs))
        before = signatures()
        assert sum(before.values()) > 0
        other = COPIES[way](envs)
        other.step(half(envs))
        other.set_state(COPIES[way](envs.get_state()))
        other.step(half(envs))
        other.reset(seed=2)
        other.step(half(envs))
        assert signatures() == before


# Workers


FORK = """
import sys
from functools import partial
import gymnasium as gym, numpy as np
from gymnasium.vector import AsyncVectorEnv
from sayd_env.envs.vector import SaydVectorEnv

class First(gym.Env):
    "The first vehicle of a batch."
    def __init__(self, threads):
        self.batch = SaydVectorEnv(sys.argv[1], num_envs=2, num_threads=threads)
        self.observation_space, self.action_space = (
            self.batch.single_observation_space, self.batch.single_action_space)
    def reset(self, seed=None, options=None):
        return self.batch.reset(seed=seed)[0][0], {}
    def step(self, action):
        observation, reward, terminated, truncated, _ = self.batch.step(np.stack([action, action]))
        return observation[0], reward[0], terminated[0], truncated[0], {}

here = First(2)
here.reset(seed=1)
here.step(np.zeros(2, np.float32))
workers = AsyncVectorEnv([partial(First, int(sys.argv[2]))] * 2, context="fork", shared_memory=False)
try:
    observation, _ = workers.reset(seed=[1, 2])
    np.testing.assert_array_equal(observation[0], here.reset(seed=1)[0])
    print("done")
finally:
    workers.close(terminate=True)
"""


@needs_threads
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="fork is the way of Linux")
@pytest.mark.parametrize("threads", [1, 2])
def test_a_fork_after_threads_says_what_to_do(threads: int, quick: str) -> None:
    command = [sys.executable, "-c", FORK, quick, str(threads)]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=240)
    if threads == 1:
        assert done.stdout.strip() == "done", done.stderr
    else:
        assert done.returncode == 1
        last = done.stderr.strip().splitlines()[-1]
        assert "ConfigError" in last
        assert "'forkserver' or 'spawn'" in last
        assert "num_threads=1" in last


# Pictures


@pytest.mark.parametrize("period", [0.01, 0.05])
def test_pictures_have_the_rate_of_the_steps(period: float, quick: str) -> None:
    for env in (
        gym.make(ID, environment=quick, control_period=period),
        gym.make_vec(ID, num_envs=2, environment=quick, control_period=period),
    ):
        assert env.metadata["render_fps"] == round(1.0 / period)


def test_a_batch_gives_a_picture_for_each_vehicle(quick: str) -> None:
    pytest.importorskip("pygame", reason="needs the extra 'render'")
    envs = SaydVectorEnv(quick, num_envs=3, render_mode="rgb_array")
    envs.reset(seed=1)
    singles = [SaydEnv(quick, render_mode="rgb_array") for _ in range(3)]
    for i, single in enumerate(singles):
        single.reset(seed=1 + i)
    for _ in range(3):
        envs.step(half(envs))
        expected = [single.step(half(single)) and single.render() for single in singles]
    pictures = envs.render()
    assert isinstance(pictures, tuple)
    np.testing.assert_array_equal(pictures, expected)
    envs.close()


one_and_a_batch = pytest.mark.parametrize(
    ("make", "package"),
    [(gym.make, wrappers), (partial(gym.make_vec, num_envs=3), vector_wrappers)],
    ids=["one", "batch"],
)


@one_and_a_batch
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_videos(make: Callable[..., Any], package: Any, quick: str, tmp_path: Path) -> None:
    moviepy = pytest.importorskip("moviepy", reason="Gymnasium's recorder needs moviepy")
    pytest.importorskip("pygame", reason="needs the extra 'render'")
    if not hasattr(package, "RecordVideo"):
        pytest.skip("this version of Gymnasium records no batch")
    env = package.RecordVideo(make(ID, environment=quick, render_mode="rgb_array"), str(tmp_path / "videos"))
    env.reset(seed=1)
    for _ in range(STEPS):
        env.step(half(env))
    env.close()
    (file,) = tmp_path.glob("videos/*.mp4")
    clip = moviepy.VideoFileClip(str(file))
    assert (clip.fps, clip.duration) == (100, pytest.approx(STEPS / 100, abs=0.011))
    clip.close()


@one_and_a_batch
def test_human_rendering(make: Callable[..., Any], package: Any, quick: str) -> None:
    pytest.importorskip("pygame", reason="needs the extra 'render'")
    if package is vector_wrappers:
        pytest.importorskip("cv2", reason="needs the extra 'clients'")
    env = package.HumanRendering(make(ID, environment=quick, render_mode="rgb_array"))
    env.reset(seed=1)
    env.step(half(env))
    env.close()


# TorchRL


@pytest.fixture
def torchrl() -> Any:
    pytest.importorskip("torchrl", reason="needs the extra 'clients'", exc_type=ImportError)
    return importlib.import_module("torchrl.envs")


def assert_two_episodes(env: Any, vehicles: tuple[int, ...]) -> None:
    """TorchRL's own check, and a rollout over the end of an episode."""
    env.check_env_specs()
    seen = env.rollout(STEPS + 1, break_when_any_done=False)
    env.close()
    assert seen["observation"].shape[:-1] == (*vehicles, STEPS + 1)
    assert seen["observation"].isfinite().all()
    ended = seen["next", "truncated"][..., 0].numpy()
    assert (ended == (np.arange(STEPS + 1) == STEPS - 1)).all()


@pytest.mark.parametrize("scaled", [False, True])
def test_torchrl_makes_one_by_its_id(scaled: bool, quick: str, torchrl: Any) -> None:
    env = torchrl.GymEnv(f"sayd_env:{ID}", environment=quick, scaled=scaled)
    assert_two_episodes(env, ())


@pytest.mark.parametrize(("mode", "info"), [("Disabled", "full"), ("SameStep", "none")])
def test_torchrl_wraps_a_batch(mode: str, info: str, quick: str, torchrl: Any) -> None:
    batch = gym.make_vec(ID, num_envs=2, environment=quick, autoreset_mode=AutoresetMode(mode), info=info)
    assert_two_episodes(torchrl.GymWrapper(batch), (2,))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["ParallelEnv", "num_envs"])
def test_torchrl_runs_several_in_processes(way: str, quick: str, torchrl: Any) -> None:
    make = partial(torchrl.GymEnv, f"sayd_env:{ID}", environment=quick, info="none")
    assert_two_episodes(torchrl.ParallelEnv(2, make) if way == "ParallelEnv" else make(num_envs=2), (2,))
