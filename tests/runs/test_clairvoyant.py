"""Search over command sequences: what a sequence costs is what it costs in the environment, bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.config import ConfigError
from sayd_env.config.bound import SequenceSearch
from sayd_env.envs.cost import episode_cost
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.keywords import configured
from sayd_env.envs.loop import TERMS
from sayd_env.envs.single import SaydEnv
from sayd_env.runs.clairvoyant import Replays, SequenceSearcher

STUDY = "base: estimates\ndamper: sayd-estimate\n"
ENVIRONMENT = "base: {base}\nstudy: {study}\nrun_in: 20.0\nepisode_s: 1.0\n"
LINE = """
sections:
  - {name: straight, length: 30.0, speed_kmh: 250.0}
  - {name: curve, length: 300.0, speed_kmh: 250.0, radius: 3000.0, turn: left, transition: 40.0}
"""
SETTINGS: dict[str, Any] = {
    "samples": 6,
    "iterations": 2,
    "passes": 1,
    "replan_s": 0.2,
    "window_s": 0.2,
    "horizon_s": 0.4,
    "knots_s": (0.1, 0.05),
    "spread": 0.3,
    "elite": 0.5,
    "seed": 0,
}
OPTIONS = {"speed_kmh": 350.0}


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of an environment of uncalibrated parts, with noisy sensors and episodes of a second."""
    folder = tmp_path_factory.mktemp("toy")
    (folder / "study.yaml").write_text(STUDY)
    (folder / "line.yaml").write_text(LINE)
    path = folder / "toy.yaml"
    path.write_text(ENVIRONMENT.format(base="randomized", study="study.yaml"))
    return str(path)


def searched(toy: str, plan: float, **changes: Any) -> Any:
    config, scenario = configured(toy)
    searcher = SequenceSearcher(config, scenario, SequenceSearch.model_validate(SETTINGS | changes))
    return searcher.search(draw_episode(config, 3, 0, OPTIONS), np.full((100, 2), plan))


@pytest.mark.parametrize("line", [False, True])
@pytest.mark.parametrize("count", [1, 6])
def test_set_back_it_goes_on_with_the_same_bits(toy: str, count: int, line: bool) -> None:
    """Alone and in a group, on straight track and into a curve, after vehicles have run on elsewhere."""
    config, scenario = configured(toy)
    options = {"line": str(Path(toy).with_name("line.yaml"))} if line else OPTIONS
    replays = Replays(config, scenario, count)
    start = replays.begin(draw_episode(config, 3, 0, options))
    sequences = np.random.default_rng(0).random((count, 60, 2))
    whole = replays.costs(start, sequences)
    assert np.array_equal(whole[:, :20], replays.costs(start, sequences[:, :20]))
    states = [replays.state(i) for i in range(count)]
    for i, state in enumerate(states):
        rest = np.broadcast_to(sequences[i, 20:], (count, 40, 2))
        assert np.array_equal(replays.costs(state, rest), np.broadcast_to(whole[i, 20:], (count, 40)))


def test_what_is_found_costs_the_same_in_the_environment(toy: str) -> None:
    """J of the search is minus the mean reward of `SaydEnv`, noise and all, and that of the cost's terms."""
    found = searched(toy, 1.0)
    assert found.changes > 0
    env = SaydEnv(toy, observation="features")
    env.reset(seed=3, options=OPTIONS)
    terms, total = np.zeros((100, TERMS)), 0.0
    for n, command in enumerate(found.commands):
        total += float(env.step(command)[1])
        terms[n] = env.batch.vehicles.terms[0]
    cost = found.J
    assert cost == pytest.approx(-total / env.config.episode_s, rel=1e-12)
    of_terms = episode_cost(terms, 0.01, env.config, env.batch.scenario.cost, terminated=False)
    assert cost == pytest.approx(of_terms.total, rel=1e-12)


def test_without_spread_the_plan_stays(toy: str) -> None:
    found = searched(toy, 0.37, spread=0.0, passes=2)
    assert np.array_equal(found.commands, np.full((100, 2), 0.37))
    assert (found.changes, found.decisions) == (0, 5)


def test_it_is_never_worse_than_its_plan_and_draws_from_its_seed(toy: str) -> None:
    config, scenario = configured(toy)
    replays = Replays(config, scenario, 1)
    start = replays.begin(draw_episode(config, 3, 0, OPTIONS))
    for current in (0.0, 1.0):
        of_plan = float(replays.costs(start, np.full((1, 100, 2), current)).sum())
        found = searched(toy, current, passes=2)
        assert of_plan >= found.J
        assert np.array_equal(found.commands, searched(toy, current, passes=2).commands)


def test_times_are_whole_control_periods(toy: str) -> None:
    with pytest.raises(ConfigError, match=r"search.replan_s: found 0.205 s; expected a multiple of 0.01 s"):
        searched(toy, 0.5, replan_s=0.205, window_s=0.3)
    with pytest.raises(ValueError, match=r"window_s \(0.2 s\) and horizon_s \(0.1 s\) must not fall"):
        SequenceSearch.model_validate(SETTINGS | {"horizon_s": 0.1})
