"""Policies that Stable-Baselines3 saved command what its `predict` commands, and are never loaded unasked."""

from __future__ import annotations

import base64
import json
import os
import pickle
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

SB3 = pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
torch = pytest.importorskip("torch", reason="needs the extra 'train'")

from gymnasium.wrappers import FlattenObservation, RescaleAction  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

from sayd_env.agents.foreign import read_foreign  # noqa: E402
from sayd_env.agents.policy_file import load_policy  # noqa: E402
from sayd_env.cli import main  # noqa: E402
from sayd_env.config import ConfigError, DataError  # noqa: E402
from sayd_env.config.environment import load_environment  # noqa: E402
from sayd_env.envs.single import SaydEnv  # noqa: E402
from sayd_env.runs.policies import policy_spec  # noqa: E402

Saved = Callable[..., tuple[Path, Any]]


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """On busy cores torch's threads wait for each other, for seconds."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def saved(tmp_path: Path) -> Saved:
    """Maker of a file and its model, which has learned nothing."""

    def save(algorithm: Any, env: Any, **network: Any) -> tuple[Path, Any]:
        small = {"buffer_size": 10} if algorithm is SB3.SAC else {}
        model = algorithm(
            "MlpPolicy", env, seed=1, device="cpu", policy_kwargs={"net_arch": [8, 8]} | network, **small
        )
        for parameter in model.policy.parameters():  # new ones are too small to command anything
            torch.nn.init.normal_(parameter, std=0.3)
        path = tmp_path / "policy.zip"
        model.save(path)
        return path, model

    return save


def seen_by(env: Any) -> np.ndarray:
    """Observations of a vehicle, and small numbers, since raw signals drive a new network to its ends."""
    env.action_space.seed(0)
    real = [env.reset(seed=0)[0], *(env.step(env.action_space.sample())[0] for _ in range(9))]
    small = np.random.default_rng(0).normal(size=(10, *env.observation_space.shape))
    return np.concatenate([real, small]).astype(np.float32)


@pytest.mark.parametrize(
    ("algorithm", "keywords", "network"),
    [
        ("PPO", {}, {}),
        ("PPO", {"observation": "history", "history": 3, "valves": "damper"}, {"activation_fn": "ReLU"}),
        ("SAC", {"observation": "features", "valves": "vehicle"}, {}),
    ],
)
def test_commands_are_those_of_the_library(
    algorithm: str, keywords: dict[str, Any], network: dict[str, Any], saved: Saved, quick: str
) -> None:
    env = SaydEnv(quick, **keywords)
    network = {key: getattr(torch.nn, name) for key, name in network.items()}
    path, model = saved(getattr(SB3, algorithm), env, **network)
    stored = read_foreign(path, load_environment(quick), 0.05)
    description = stored.description
    assert description.observation == keywords.get("observation", "signals")
    assert (description.history, description.valves) == (env.interface.history, env.interface.valves)
    assert description.control_period == 0.05
    observations = seen_by(env)
    mine, _ = read_foreign(path, load_environment(quick)).bound(env.interface).predict(observations)
    theirs, _ = model.predict(observations, deterministic=True)
    assert mine == pytest.approx(theirs, abs=1e-5)
    assert np.ptp(mine) > 0.1  # so that a constant would not do


@pytest.mark.parametrize(("algorithm", "kind"), [("PPO", "features"), ("PPO", "history"), ("SAC", "signals")])
def test_what_has_learned_in_numbers_of_order_1_acts_in_si_units(
    algorithm: str, kind: str, saved: Saved, quick: str
) -> None:
    raw, env = SaydEnv(quick, observation=kind), SaydEnv(quick, observation=kind, scaled=True)
    path, model = saved(getattr(SB3, algorithm), FlattenObservation(env))
    policy = read_foreign(path, load_environment(quick)).bound(raw.interface)
    seen, learned = raw.reset(seed=1)[0], env.reset(seed=1)[0]
    found = []
    for _ in range(10):
        found.append(policy.predict(seen)[0])
        action, _ = model.predict(learned.ravel(), deterministic=True)
        np.testing.assert_allclose(found[-1], (action + 1.0) / 2.0, atol=1e-5)
        seen, learned = raw.step(found[-1])[0], env.step(action)[0]
    assert np.ptp(found) > 0.01


def test_a_history_may_be_flat(saved: Saved, quick: str) -> None:
    env = SaydEnv(quick, observation="history", history=3)
    path, model = saved(SB3.PPO, FlattenObservation(env))
    policy = read_foreign(path, load_environment(quick)).bound(env.interface)
    observations = seen_by(env)
    theirs, _ = model.predict(observations.reshape(len(observations), -1), deterministic=True)
    assert policy.predict(observations)[0] == pytest.approx(theirs, abs=1e-5)


def test_other_files_are_refused(saved: Saved, quick: str, tmp_path: Path) -> None:
    nominal, env = load_environment(quick), SaydEnv(quick)
    with pytest.raises(ConfigError, match=r"nothing.zip: no such"):
        read_foreign(tmp_path / "nothing.zip", nominal)
    with pytest.raises(ConfigError, match=r"policy.zip: is of another algorithm than PPO and SAC"):
        read_foreign(saved(SB3.A2C, env)[0], nominal)
    with pytest.raises(
        ConfigError, match=r"observations reach from -100 to 1.6e\+07, those of the environment from -5 to 5"
    ):
        read_foreign(saved(SB3.PPO, RescaleAction(env, np.float32(-1.0), np.float32(1.0)))[0], nominal)
    with pytest.raises(ConfigError, match=r"observations of shape \(3,\); expected 41 signals, 31 features"):
        read_foreign(saved(SB3.PPO, gym.make("Pendulum-v1"))[0], nominal)
    with pytest.raises(ConfigError, match="layers with Tanh or with ReLU"):
        read_foreign(saved(SB3.PPO, env, activation_fn=torch.nn.ELU)[0], nominal)
    path, _ = saved(SB3.PPO, env)
    with pytest.raises(ConfigError, match="control_period"):
        read_foreign(path, nominal, 0.03)
    content = path.read_bytes()
    for broken in (content[:2000], content[:5000] + b"x" + content[5001:], b""):
        path.write_bytes(broken)
        with pytest.raises(DataError, match=r"policy.zip: is damaged"):
            read_foreign(path, nominal)


@pytest.mark.parametrize("keywords", [{}, {"observation": "history", "history": 3}])
def test_statistics_of_observations_come_along(
    keywords: dict[str, Any], saved: Saved, quick: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A policy that has learned behind VecNormalize commands what both do together, clipped inputs too."""
    nominal = load_environment(quick)
    vector = VecNormalize(DummyVecEnv([lambda: SaydEnv(quick, **keywords)]), clip_obs=2.0)
    path, model = saved(SB3.PPO, vector)
    vector.reset()
    for _ in range(20):
        vector.step([vector.action_space.sample()])
    statistics = tmp_path / "my_vecnormalize_stats.pkl"
    vector.save(str(statistics))
    with pytest.raises(ConfigError, match=r"my_vecnormalize_stats.pkl beside it.*--vec-normalize"):
        read_foreign(path, nominal)
    statistics = statistics.rename(tmp_path / "stats.pkl")  # its content says what it is
    os.mkfifo(tmp_path / "a_pipe.pkl")
    (tmp_path / "a_folder.pkl").mkdir()
    with pytest.raises(ConfigError, match=r"stats.pkl beside it.*--vec-normalize"):
        read_foreign(path, nominal)
    env = SaydEnv(quick, **keywords)
    observations = seen_by(env)
    stored = read_foreign(path, nominal, statistics=statistics)
    mine, _ = stored.bound(env.interface).predict(observations)
    vector.training = False
    theirs, _ = model.predict(vector.normalize_obs(observations), deterministic=True)
    assert mine == pytest.approx(theirs, abs=1e-5)
    assert np.ptp(mine) > 0.1
    out = tmp_path / "out"
    options = ["--trust-pickles", "--vec-normalize", str(statistics), "--out", str(out)]
    assert main(["export", str(path), *options]) == 0
    again, _ = load_policy(out / "policy.npz", env.interface).predict(observations)
    np.testing.assert_array_equal(again, mine)
    capsys.readouterr()
    assert main(["export", str(path), *options[1:]]) == 2
    assert "--vec-normalize: is that of files of Stable-Baselines3: add" in capsys.readouterr().err
    assert main(["evaluate", "--policies", "mppt1", *options[:3]]) == 2
    assert (
        "--vec-normalize: is that of a file of Stable-Baselines3 (.zip); no policy" in capsys.readouterr().err
    )
    statistics.write_bytes(b"no pickle")
    with pytest.raises(DataError, match=r"is no VecNormalize that can be loaded"):
        read_foreign(path, nominal, statistics=statistics)
    other = VecNormalize(DummyVecEnv([lambda: SaydEnv(quick, observation="features")]))
    other.save(str(statistics))
    with pytest.raises(ConfigError, match=r"is of observations of shape \(31,\), those of the policy have"):
        read_foreign(path, nominal, statistics=statistics)


class Evil:
    """What a file can do to whoever loads it."""

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("done"),)


def test_nothing_is_loaded_unasked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same file that does something when it is trusted does nothing before."""
    monkeypatch.chdir(tmp_path)
    pickled = base64.b64encode(pickle.dumps(Evil())).decode()
    data = {
        "policy_class": {":serialized:": pickled, "__module__": "stable_baselines3.common.policies"},
        "clip_range": 0.2,
        "n_epochs": 1,
    }
    with zipfile.ZipFile("evil.zip", "w") as archive:
        archive.writestr("data", json.dumps(data))
    with pytest.raises(ConfigError, match=r"can run any code while it is loaded.*--trust-pickles"):
        policy_spec("evil.zip")
    assert main(["export", "evil.zip"]) == 2
    assert main(["evaluate", "--policies", "evil.zip", "--json"]) == 2
    assert not Path("done").exists()
    with pytest.raises(DataError, match=r"cannot load it"):
        read_foreign("evil.zip", load_environment())
    assert Path("done").exists()


def test_an_export_holds_no_code(
    saved: Saved, quick: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    env = SaydEnv(quick)
    path, model = saved(SB3.SAC, env)
    assert main(["export", str(path), "--out", str(tmp_path / "out"), "--trained-period", "0.01"]) == 2
    assert "add --trust-pickles" in capsys.readouterr().err
    assert main(["export", str(path), "--out", str(tmp_path / "out"), "--trust-pickles"]) == 0
    policy = load_policy(tmp_path / "out" / "policy.npz", env.interface)
    observations = seen_by(env)
    theirs, _ = model.predict(observations, deterministic=True)
    assert policy.predict(observations)[0] == pytest.approx(theirs, abs=1e-5)
