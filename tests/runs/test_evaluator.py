"""J of policies on a list of scenarios: that of the rollouts, whoever computes it and what ran before."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.config import StudyError
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.keywords import configured
from sayd_env.envs.rollout import roll_out
from sayd_env.runs import evaluator as module
from sayd_env.runs.evaluator import PolicyEvaluator
from sayd_env.runs.executors import ExecutorChoice
from sayd_env.runs.policies import policy_spec

CASES = [
    {"speed_kmh": 300.0, "wear": 0.5, "friction": 0.3, "seed": 9000},
    {"speed_kmh": 480.0, "wear": 1.0, "friction": 0.5, "seed": 9001},
    {"speed_kmh": 200.0, "wear": 0.0, "friction": 0.4, "seed": 9002},
]


@pytest.fixture
def quick(tmp_path: Path) -> str:
    """The environment with everything drawn and a run-in of 20 m."""
    path = tmp_path / "quick.yaml"
    path.write_text("base: randomized\nrun_in: 20.0\n")
    return str(path)


@pytest.mark.parametrize("name", ["constant:0.42", "mppt2", "ppo", "passive"])
def test_j_is_that_of_the_rollouts(name: str, quick: str) -> None:
    """Signals, run-in and clock are those that the policy needs; a derailment is charged."""
    spec = policy_spec(name)
    damper = "passive" if name == "passive" else "sayd"
    config, scenario = configured(quick, episode_s=2.0, reward="mppt2", damper=damper)
    config = spec.environment(config)
    batch = EpisodeBatch(config, 3, scenario=scenario, num_threads=1)
    current = {} if name == "passive" else {"initial_current": 0.2}
    episodes = [
        draw_episode(config, case["seed"], 0, {k: v for k, v in case.items() if k != "seed"} | current)
        for case in CASES
    ]
    runs = roll_out(batch, spec.make(batch), episodes, [batch.steps] * 3)
    expected = [run.episode_cost(config, scenario).total for run in runs]
    evaluator = PolicyEvaluator(quick, CASES, episode_s=2.0, initial_current=0.2, workers=1)
    found = evaluator.costs(spec)
    np.testing.assert_array_equal(found.costs, expected)
    assert found.derailed == sum(run.ending is not None for run in runs)


def test_costs_depend_on_neither_workers_nor_policies_before(quick: str) -> None:
    specs = [policy_spec(name) for name in ("mppt2", "ppo-s1", "constant:0.6")]
    keywords: dict[str, Any] = {"episode_s": 1.0}
    evaluator = PolicyEvaluator(quick, CASES, **keywords, workers=1)
    first = [evaluator.costs(spec).costs for spec in specs]
    again = [evaluator.costs(spec).costs for spec in reversed(specs)]
    np.testing.assert_array_equal(first, again[::-1])
    module._prepared.clear()
    assert len({tuple(costs) for costs in first}) == 3
    with ExecutorChoice("processes", workers=2).open(2) as executor:
        parallel = PolicyEvaluator(quick, CASES, **keywords, executor=executor, workers=2)
        np.testing.assert_array_equal([parallel.costs(spec).costs for spec in specs], first)
    assert not module._prepared  # nothing was run here


class Broken(Executor):
    """An executor whose workers have ended."""

    def submit(self, *_: Any, **__: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_exception(BrokenExecutor("killed"))
        return future


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(module, "MOST_PREPARED", 2)
    module._prepared.clear()
    yield
    module._prepared.clear()


def test_a_lost_worker_is_reported_in_one_message(quick: str) -> None:
    evaluator = PolicyEvaluator(quick, CASES, episode_s=1.0, executor=Broken(), workers=2)
    with pytest.raises(StudyError, match=r"mppt2: a worker has ended \(killed\); the same command goes on"):
        evaluator.costs(policy_spec("mppt2"))


@pytest.mark.usefixtures("few")
def test_a_process_keeps_few_vehicles(quick: str) -> None:
    for speed in (100.0, 110.0, 120.0):
        case = {"speed_kmh": speed, "seed": 1}
        PolicyEvaluator(quick, [case], episode_s=0.1, workers=1).costs(policy_spec("constant:0.5"))
    assert len(module._prepared) == 2
