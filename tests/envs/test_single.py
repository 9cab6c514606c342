"""One vehicle: seeds and episodes, options, bad input, telemetry, how an episode ends."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import Error, ResetNeeded

from sayd_env.config import ConfigError
from sayd_env.envs.loop import NOT_FINITE
from sayd_env.envs.single import SaydEnv
from sayd_env.physics import sayd

HALF = np.full(2, 0.5, dtype=np.float32)
Step = tuple[Any, ...]


def run(env: gym.Env[Any, Any], steps: int, seed: int = 0) -> list[Step]:
    """Steps with the same random actions."""
    actions = np.random.default_rng(seed).random((steps, *env.action_space.shape), dtype=np.float32)
    return [env.step(action) for action in actions]


def assert_same(one: list[Step], other: list[Step]) -> None:
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:4] == b[1:4]


def test_same_seed_same_bits(quick_faults: str) -> None:
    runs = []
    for env in (SaydEnv(quick_faults), gym.make("SAYD/Faults-v1", environment=quick_faults)):
        observation, info = env.reset(seed=7)
        runs.append((observation, info, run(env, 20)))
    np.testing.assert_array_equal(runs[0][0], runs[1][0])
    np.testing.assert_equal(runs[0][1], runs[1][1])
    assert_same(runs[0][2], runs[1][2])


def test_different_seeds_different_observations(quick: str) -> None:
    env = SaydEnv(quick)
    seen = {env.reset(seed=seed)[0].tobytes() for seed in range(5)}
    assert len(seen) == 5


def test_episodes_of_a_seed_differ_and_do_not_depend_on_those_before(quick_faults: str) -> None:
    env, other = SaydEnv(quick_faults), SaydEnv(quick_faults)
    env.reset(seed=3)
    run(env, 20)
    env.reset()
    run(env, 5, seed=1)
    third, info = env.reset()
    other.reset(seed=3)
    other.reset()
    again, info_again = other.reset()
    np.testing.assert_array_equal(third, again)
    np.testing.assert_equal(info, info_again)
    assert (info["seed"], info["episode_number"]) == (3, 2)
    assert_same(run(env, 10), run(other, 10))
    assert not np.array_equal(third, other.reset(seed=3)[0])


def test_without_a_seed_one_is_drawn(quick: str) -> None:
    drawn = {SaydEnv(quick).reset()[1]["seed"] for _ in range(4)}
    assert len(drawn) == 4
    env = SaydEnv(quick)
    infos = [env.reset()[1] for _ in range(3)]
    assert len({info["seed"] for info in infos}) == 1
    assert [info["episode_number"] for info in infos] == [0, 1, 2]


def test_options_fix_an_episode(quick: str) -> None:
    env = SaydEnv(quick)
    fault = {"kind": "valve_stuck", "damper": "front.left.upper", "current": 1.0}
    options = {"speed_kmh": 300, "profile": "new", "friction": 0.3, "track": "china", "faults": [fault]}
    _, info = env.reset(seed=1, options=options)
    assert info["speed_kmh"] == pytest.approx(300.0)
    assert (info["wear"], info["friction"], info["track"]) == (0.0, 0.3, "china")
    assert json.loads(info["faults"]) == [fault | {"start_s": 0.0}]
    observation = [env.step(np.zeros(2, np.float32)) for _ in range(15)][-1][0]
    current = [env.interface.index(f"current.front.left.{place}") for place in ("upper", "lower")]
    assert observation[current].tolist() == [
        0.0,
        0.0,
    ]  # the coil knows nothing of it
    stuck, free = env.batch.vehicles.state.view(0).sayd.reshape(-1, 8)[sayd.CURRENT, :2]
    assert (stuck, free) == (pytest.approx(1.0, abs=1e-3), 0.0)
    assert observation[env.interface.index("speed")] == pytest.approx(300 / 3.6)
    assert env.reset()[1]["speed_kmh"] == pytest.approx(350.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sped_kmh": 300}, ("sped_kmh", "speed_kmh")),
        ({"speed_kmh": 900}, ("speed_kmh", "900")),
        ({"profile": "square"}, ("profile", "square", "new", "worn")),
        ({"track": "moon"}, ("moon", "german_low")),
        ({"faults": "all"}, ("faults", "all")),
    ],
)
def test_options_that_cannot_be_change_nothing(options: dict[str, Any], words: Any, quick: str) -> None:
    env = SaydEnv(quick)
    env.reset(seed=1)
    with pytest.raises(ConfigError) as caught:
        env.reset(options=options)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    env.step(HALF)
    assert env.reset()[1]["episode_number"] == 1


def test_bad_seeds_are_refused(quick: str) -> None:
    with pytest.raises((Error, ConfigError)):
        SaydEnv(quick).reset(seed=-1)


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (np.zeros(3, np.float32), ("shape (3,)", "(2,)")),
        (np.float32(0.5), ("shape ()", "(2,)")),
        (np.array([0.5, 1.5], np.float32), ("1.5", "0 to 1")),
        (np.array([-0.1, 0.5], np.float32), ("-0.1", "0 to 1")),
        (np.array([0.5, math.nan], np.float32), ("nan", "0 to 1")),
        (np.array([math.inf, 0.0], np.float32), ("inf", "0 to 1")),
        (np.array([1.0000011, 0.0]), ("found 1.0000011 at [0]", "0 to 1")),
        (np.array([0.5 + 0.1j, 0.0]), ("0.1j", "expected numbers of shape (2,)")),
        ("open", ("open",)),
        (None, ("action",)),
    ],
)
def test_bad_actions_are_refused_and_change_nothing(action: Any, words: Any, quick: str) -> None:
    env, other = SaydEnv(quick), SaydEnv(quick)
    env.reset(seed=1)
    other.reset(seed=1)
    with pytest.raises(ConfigError) as caught:
        env.step(action)
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert_same([env.step(HALF)], [other.step(HALF)])


def test_a_step_needs_an_episode(quick: str) -> None:
    env = SaydEnv(quick)
    with pytest.raises(ResetNeeded):
        env.step(HALF)
    env.reset(seed=1)
    steps = run(env, 20)
    assert [step[3] for step in steps] == [False] * 19 + [True]
    with pytest.raises(ResetNeeded):
        env.step(HALF)


def test_rewards_are_the_weighted_terms(quick: str) -> None:
    env = SaydEnv(quick, reward=(2.0, 3.0))
    env.reset(seed=1)
    for _, reward, _, _, info in run(env, 10):
        assert reward == pytest.approx(-2.0 * info["cost_acceleration"] - 3.0 * info["cost_force"], rel=1e-12)
        assert not {name for name in info if "force" in name or "valve" in name} - {"cost_force"}


def test_a_command_does_nothing_to_passive_dampers(quick: str) -> None:
    env = SaydEnv(quick, damper="passive", info="full")
    runs = []
    for value in (0.0, 1.0):
        env.reset(seed=1)
        runs.append([env.step(np.full(2, value, np.float32)) for _ in range(5)])
    for one, other in zip(*runs, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1] == other[1]
    observation, _, _, _, info = runs[0][-1]
    tank = env.batch.settings.tank_pressure
    pressures = [n for n, signal in enumerate(env.signals) if signal.name.startswith("pressure")]
    np.testing.assert_array_equal(observation[pressures], np.float32(tank))
    # What a damper takes in, force times velocity, is never negative.
    assert np.all(info["hydraulic_power"] >= 0.0)
    assert np.any(info["damper_force"] != 0.0)


def test_full_info_agrees_with_the_observation(quick: str) -> None:
    env = SaydEnv(quick, info="full", control_period=0.001, episode_s=0.1)
    env.reset(seed=1, options={"initial_current": 0.3})
    area = env.interface.damper.cylinder.area
    at = {name: env.interface.index(f"{name}.front.left.upper") for name in ("stroke", "current")}
    strokes, flows = [], []
    for observation, _, _, _, info in run(env, 60, seed=2):
        assert info["valve_current"][0] == pytest.approx(observation[at["current"]], abs=1e-6)
        strokes.append(float(observation[at["stroke"]]))
        flows.append(info["hydraulic_flow"][0])
        drop = observation[env.interface.index("pressure_b.front.left.upper")]
        drop -= observation[env.interface.index("pressure_a.front.left.upper")]
        assert info["hydraulic_power"][0] == pytest.approx(
            drop * info["hydraulic_flow"][0], rel=1e-2, abs=1e-2
        )
        lateral = info["wheel_lateral_force"].reshape(4, 2).sum(axis=1)
        np.testing.assert_allclose(info["track_shift_force"], lateral, rtol=1e-9, atol=1e-6)
        # Wang et al. (2022): an axle load of 150 kN at most.
        assert 350e3 < info["wheel_vertical_force"].sum() < 750e3
        assert info["limit_acceleration"] == pytest.approx(5.44)
    # The displaced volume is A times the change of the stroke; the trapezoidal rule errs by 1 % at 50 Hz.
    volume = 0.001 * (np.sum(flows) - 0.5 * (flows[0] + flows[-1]))
    assert volume == pytest.approx(area * (strokes[-1] - strokes[0]), abs=1e-5 * np.sum(np.abs(flows)))


DERAILING = {"speed_kmh": 450.0, "track": "german_low", "track_scale": 5.0, "friction": 0.6}
"""Irregularities five times those of a bad track."""


def test_the_rest_of_an_episode_is_charged_where_it_derails(quick: str) -> None:
    env = SaydEnv(quick, episode_s=20.0)
    for seed in range(20):
        env.reset(seed=seed, options=DERAILING)
        taken, ended = 0, False
        while not ended and taken < 600:
            _, reward, ended, _, info = env.step(np.ones(2, np.float32))
            taken += 1
        if ended and taken > 1:
            break
    else:
        pytest.fail("nothing derailed")
    assert info["ending"].startswith("derailment")
    remaining = 20.0 - taken * 0.01
    weights = env.batch.scenario.cost
    cost = weights.acceleration_weight * info["cost_acceleration"] + weights.force_weight * info["cost_force"]
    assert reward == pytest.approx(-cost - env.config.termination_cost * remaining, rel=1e-12)
    with pytest.raises(ResetNeeded):
        env.step(HALF)


def test_a_run_that_ends_before_step_0_is_charged_in_full() -> None:
    env = SaydEnv(episode_s=4.0)
    env.reset(seed=1, options=DERAILING | {"initial_current": 1.0})
    _, reward, ended, truncated, info = env.step(HALF)
    assert (ended, truncated) == (True, False)
    assert reward == -4.0 * env.config.termination_cost
    assert info["ending"]


def test_nothing_but_numbers_gets_out(quick: str) -> None:
    env = SaydEnv(quick, info="full", observation="history")
    env.reset(seed=1)
    before = run(env, 3)[-1][0]
    env.batch.vehicles.state.view(0).v[:] = math.nan
    observation, reward, ended, truncated, info = env.step(HALF)
    assert env.batch.vehicles.status[0] == NOT_FINITE
    assert (ended, truncated) == (True, False)
    np.testing.assert_array_equal(observation, before)
    assert math.isfinite(reward)
    assert "diverged" in info["error"]
    numbers = [value for value in info.values() if not isinstance(value, str)]
    assert all(np.all(np.isfinite(value)) for value in numbers)
    observation, _ = env.reset()
    assert np.all(np.isfinite(observation))


def test_without_a_run_in_an_episode_knows_nothing_of_the_one_before(quick: str, tmp_path: Path) -> None:
    path = tmp_path / "at_once.yaml"
    path.write_text(f"base: {quick}\nrun_in: 0.0\n")
    env = SaydEnv(str(path), observation="history", history=3)
    first, _ = env.reset(seed=1)
    run(env, 10)
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(again, first)
