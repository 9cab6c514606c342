"""Rates of training from a clock that only the fake environment and the fake learner move."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sayd_env.agents.config import load_train
from sayd_env.studies.bench import spread as bench_spread
from sayd_env.studies.bench import training as bench_training
from sayd_env.studies.bench.spread import Effort
from sayd_env.studies.bench.training import Learner, measure_training

VEHICLES, NETWORKS, EPISODE = 4, 2, 100


class Clock:
    """A clock that is moved by hand."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now


class Environment:
    """2 ms for a step, 50 ms for one in which episodes end, 40 ms for a reset."""

    num_envs = VEHICLES * NETWORKS
    action_space = SimpleNamespace(shape=(1,))

    def __init__(self, clock: Clock) -> None:
        self.clock, self.steps = clock, 0

    def reset(self) -> None:
        self.clock.now += 40e-3

    def step(self, actions: np.ndarray) -> tuple[Any, ...]:
        assert actions.shape == (self.num_envs, 1)
        self.steps += 1
        ends = self.steps % 7 == 0
        self.clock.now += 50e-3 if ends else 2e-3
        return None, None, np.full(self.num_envs, ends), None


class Model:
    """A learner that takes 3 ms beside each step of the environment, and goes in tens of them."""

    def __init__(self, clock: Clock, env: Environment) -> None:
        self.clock, self.env, self.num_timesteps = clock, env, 0

    def learn(self, steps: int, **_: Any) -> None:
        if self.num_timesteps == 0:
            self.env.reset()
        goal = self.num_timesteps + steps
        while self.num_timesteps < goal:
            for _ in range(10):
                self.env.step(np.zeros((self.env.num_envs, 1)))
                self.clock.now += 3e-3
                self.num_timesteps += self.env.num_envs


@pytest.fixture
def learner(monkeypatch: pytest.MonkeyPatch) -> Learner:
    clock = Clock()
    monkeypatch.setattr(bench_training, "time", clock)
    monkeypatch.setattr(bench_spread, "time", clock)
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(set_num_threads=lambda n: None))
    env = Environment(clock)
    return Learner(env, Model(clock, env), VEHICLES, EPISODE)


def test_rates_are_those_over_whole_episodes(learner: Learner) -> None:
    """A step of 4 vehicles is 2 ms, its part of a reset 40 / 100 ms, the learner's 3 ms."""
    for _ in range(3):  # where episodes end in the window does not show
        expected = {"ppo": VEHICLES / 5.4e-3, "ppo_share": 2.4 / 5.4}
        assert learner.rate(60, 1, "ppo") == pytest.approx(expected)
    assert learner.random_steps(60) == pytest.approx(VEHICLES / 2.4e-3)


def test_torch_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    done: list[None] = []
    assert measure_training(Effort(training_rounds=3), 2, lambda: done.append(None)) is None
    assert len(done) == 3


def test_the_packaged_trainings_are_measured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Both algorithms, made small, with the library itself."""
    torch = pytest.importorskip("torch", reason="needs the extra 'train'")
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    (tmp_path / "quick.yaml").write_text("base: nominal\nrun_in: 20.0\n")
    small = [f"environment.name={tmp_path / 'quick.yaml'}", "environment.vehicles=2", "environment.threads=1"]
    small += ["environment.beside=[]", "evaluation.beside_seeds=[]"]
    of = {
        "ppo": ["learning.n_steps=16", "learning.batch_size=32", "learning.n_epochs=1"],
        "sac": ["learning.learning_starts=0", "learning.batch_size=8", "learning.buffer_size=200"],
    }
    monkeypatch.setattr(bench_training, "_config", lambda name, threads: load_train(name, small + of[name]))
    before = torch.get_num_threads()
    found = measure_training(Effort(training_rounds=1, training_steps=32), 1)
    assert found is not None
    assert torch.get_num_threads() == before
    assert list(found.rates) == ["environment", "ppo", "sac", "ppo_uncapped", "sac_uncapped"]
    assert all(rate.spread.minimum > 0.0 for rate in found.rates.values())
    assert all(0.0 < share < 1.0 for share in found.environment_share.values())
    assert found.as_dict()["vehicles"] == {"environment": 2, "ppo": 2, "sac": 2}
