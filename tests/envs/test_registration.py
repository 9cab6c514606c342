"""Ids, what importing costs, keywords by way of `gymnasium.make`, and the documentation page."""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from sayd_env.baselines import interface_of
from sayd_env.config import ConfigError
from sayd_env.config.environment import load_environment
from sayd_env.envs.registration import IDS, VERSION, register_environments
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv


def run(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_importing_loads_nothing_slow() -> None:
    code = (
        "import sys, sayd_env;"
        "slow = {'numba', 'scipy', 'torch', 'pydantic', 'yaml', 'matplotlib', 'ray', 'distributed'};"
        "slow |= {f'sayd_env.{name}' for name in ('agents', 'baselines', 'physics', 'runs')};"
        "print(sorted(slow & set(sys.modules)))"
    )
    assert run(code) == "[]"


@pytest.mark.parametrize(
    "before",
    [
        "import gymnasium, sayd_env",
        "import sayd_env, gymnasium",
        "import sayd_env, gymnasium.spaces",
        "import sayd_env, importlib.util; importlib.util.find_spec('gymnasium')",
    ],
)
def test_the_order_of_imports_does_not_matter(before: str) -> None:
    code = f"{before}; import gymnasium; print(sum(i.startswith('SAYD/') for i in gymnasium.registry))"
    assert run(code) == str(len(IDS)) == "4"


def test_registering_again_changes_nothing() -> None:
    before = {name: gym.spec(name) for name in IDS}
    register_environments()  # a warning of Gymnasium's would be an error here
    assert all(gym.spec(name) is spec for name, spec in before.items())
    assert all(gym.spec(name).max_episode_steps is None for name in IDS)


def test_the_module_can_stand_before_the_id() -> None:
    code = "import gymnasium; print(gymnasium.make('sayd_env:SAYD/Nominal-v1').unwrapped.interface.valves)"
    assert run(code) == "bogie"


@pytest.mark.parametrize("make", [gym.make, partial(gym.make_vec, num_envs=2), interface_of])
@pytest.mark.parametrize("name", [name for name in IDS if name.endswith(f"-v{VERSION}")])
@pytest.mark.parametrize("module", ["", "sayd_env:"])
@pytest.mark.filterwarnings("ignore:.*is out of date:DeprecationWarning")
def test_an_older_version_is_refused_by_the_name_of_the_new_one(make: Any, name: str, module: str) -> None:
    older = name.replace(f"-v{VERSION}", f"-v{VERSION - 1}")
    with pytest.raises((gym.error.DeprecatedEnv, ConfigError), match=rf"use `{name}` instead"):
        make(module + older)


@pytest.mark.parametrize("name", IDS)
def test_ids_make_their_environments(name: str) -> None:
    single, vector = gym.make(name), gym.make_vec(name, num_envs=2)
    assert isinstance(single.unwrapped, SaydEnv)
    assert isinstance(vector, SaydVectorEnv)
    assert single.unwrapped.config == vector.config
    assert (single.unwrapped.config.faults is not None) == (name == "SAYD/Faults-v1")
    assert vector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert single.unwrapped.spec is not None
    assert gym.make(single.unwrapped.spec).unwrapped.config == single.unwrapped.config


def test_a_given_limit_of_steps_counts(quick: str) -> None:
    single = gym.make("SAYD/Nominal-v1", environment=quick, max_episode_steps=3)
    vector = gym.make_vec("SAYD/Nominal-v1", num_envs=2, environment=quick, max_episode_steps=3)
    single.reset(seed=1)
    vector.reset(seed=1)
    ends = [single.step(np.zeros(2, np.float32))[3] for _ in range(3)]
    assert ends == [False, False, True]
    both = [vector.step(np.zeros((2, 2), np.float32))[3].tolist() for _ in range(3)]
    assert both == [[False] * 2, [False] * 2, [True] * 2]


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"control_period": 0.015}, ("control_period", "0.015", "divides a second")),
        ({"control_period": 0.0125}, ("control_period", "0.0125")),
        ({"control_period": 0.0}, ("control_period", "0.0")),
        ({"control_period": float("nan")}, ("control_period", "nan")),
        ({"control_period": 0.02, "episode_s": 0.05}, ("episode_s", "0.05", "0.02")),
        ({"valves": "axle"}, ("valves", "axle", "bogie", "damper", "vehicle")),
        ({"observation": "state"}, ("observation", "state", "signals", "history", "features")),
        ({"history": 0}, ("history", "0")),
        ({"damper": "none"}, ("damper", "none", "sayd", "passive")),
        ({"reward": "mppt3"}, ("reward", "mppt3", "mppt1", "mppt2")),
        ({"reward": (0.0, 0.0)}, ("reward", "(0.0, 0.0)")),
        ({"reward": (1.0, -1.0)}, ("reward", "-1.0")),
        ({"reward": {"k_y": 1.0}}, ("reward", "k_F")),
        ({"sensors": "perfect"}, ("perfect", "ideal", "realistic")),
        ({"sensors": 3}, ("sensors", "3")),
        ({"speed_kmh": -5}, ("speed_kmh: found -5; expected a number from 30 to 500 km/h",)),
        ({"speed_kmh": "350"}, ("speed_kmh: found '350'; expected a number from 30 to 500 km/h",)),
        ({"environment": "moon"}, ("moon", "nominal", "randomized", "faults")),
        ({"environment": 1}, ("environment", "1")),
        ({"info": "much"}, ("info", "much", "none", "basic", "full")),
        ({"settings": "friction=0.3"}, ("settings", "friction=0.3", "key=value")),
        ({"settings": ["frictoin=0.3"]}, ("settings: unknown key 'frictoin', did you mean 'friction'",)),
        ({"settings": ["friction"]}, ("settings friction: expected key=value",)),
        ({"settings": ["friction=9"]}, ("settings: friction: found 9",)),
        ({"settings": ["damper=passive"]}, ("settings", "passive")),
        ({"epsiode_s": 1.0}, ("epsiode_s", "episode_s")),
    ],
)
def test_keywords_that_cannot_be_are_refused(keywords: dict[str, Any], words: tuple[str, ...]) -> None:
    for make in (gym.make, gym.make_vec):
        with pytest.raises(ConfigError) as caught:
            make("SAYD/Nominal-v1", **keywords)
        assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"num_envs": 0}, ("num_envs: found 0; expected a whole number from 1 to 65536",)),
        ({"num_envs": -1}, ("num_envs: found -1; expected a whole number from 1 to 65536",)),
        ({"num_threads": 0}, ("num_threads: found 0; expected a whole number of 1",)),
        ({"num_threads": 1000}, ("num_threads: found 1000; expected a whole number from 1 to",)),
        ({"autoreset_mode": "never"}, ("autoreset_mode", "never", "NextStep", "SameStep", "Disabled")),
        ({"max_episode_steps": 0}, ("max_episode_steps", "0")),
        ({"num_env": 3}, ("num_env", "num_envs")),
    ],
)
def test_keywords_of_the_batch_are_checked(keywords: dict[str, Any], words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as caught:
        SaydVectorEnv(**keywords)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_a_history_that_no_observation_has_is_refused() -> None:
    with pytest.raises(ConfigError, match="history: has no effect on observation='signals'"):
        SaydEnv(history=3)
    usual = load_environment().history
    assert SaydEnv(history=usual).observation_space == SaydEnv().observation_space


def test_keywords_do_what_they_say(quick: str) -> None:
    env = SaydEnv(
        quick,
        damper="sayd",
        valves="damper",
        observation="history",
        history=3,
        reward=(2.0, 0.25),
        control_period=0.02,
        episode_s=0.4,
        sensors="realistic",
        speed_kmh=200.0,
        settings=("friction=0.3", "wear=0.5", "track=china"),
    )
    assert env.action_space.shape == (8,)
    assert env.observation_space.shape == (3, 41)
    assert env.interface.control_period == 0.02
    assert env.metadata["render_fps"] == 50
    cost = env.batch.scenario.cost
    assert (cost.acceleration_weight, cost.force_weight) == (2.0, 0.25)
    _, info = env.reset(seed=1)
    assert info["speed_kmh"] == pytest.approx(200.0)
    assert info["friction"] == 0.3
    assert env.batch.steps == 20


def test_settings_win_over_draws(quick_faults: str) -> None:
    env = SaydEnv(quick_faults, settings=("friction=0.31", "wear=0.25"))
    for _ in range(3):
        info = env.reset()[1]
        assert (info["friction"], info["wear"]) == (0.31, 0.25)


def test_weights_by_name() -> None:
    study = SaydEnv().batch.scenario.cost
    one, two = SaydEnv(reward="mppt1").batch.scenario.cost, SaydEnv(reward="mppt2").batch.scenario.cost
    assert (one.acceleration_weight, one.force_weight) == (1.0, 0.0)
    assert two == study


@pytest.mark.parametrize("kind", ["signals", "history", "features"])
def test_passive_and_semi_active_vehicle_have_the_same_spaces(kind: str) -> None:
    sayd, passive = SaydEnv(observation=kind), SaydEnv(observation=kind, damper="passive")
    assert passive.observation_space == sayd.observation_space
    assert passive.action_space == sayd.action_space
    assert passive.signals == sayd.signals


def test_space_holds_the_ranges_of_the_signals() -> None:
    env = SaydEnv()
    assert len(env.signals) == 41
    np.testing.assert_array_equal(env.observation_space.low, np.float32([s.low for s in env.signals]))
    np.testing.assert_array_equal(env.observation_space.high, np.float32([s.high for s in env.signals]))
