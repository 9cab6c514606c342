"""J of policies on a list of scenarios: that of the rollouts, whoever computes it and what ran before."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.keywords import configured
from sayd_env.envs.rollout import roll_out
from sayd_env.runs import evaluator as module
from sayd_env.runs.cache import fingerprint
from sayd_env.runs.evaluator import PolicyEvaluator
from sayd_env.runs.executors import ExecutorChoice, KeptExecutor
from sayd_env.runs.policies import policy_spec

ONE = ExecutorChoice(workers=1)
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


@pytest.mark.usefixtures("ready")
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
    evaluator = PolicyEvaluator(quick, CASES, episode_s=2.0, initial_current=0.2, executor=ONE)
    found = evaluator.costs(spec)
    np.testing.assert_array_equal(found.costs, expected)
    assert found.derailed == sum(run.ending is not None for run in runs)


@pytest.mark.usefixtures("ready")
def test_costs_depend_on_neither_workers_nor_policies_before(quick: str) -> None:
    specs = [policy_spec(name) for name in ("mppt2", "ppo-s1", "constant:0.6")]
    keywords: dict[str, Any] = {"episode_s": 1.0}
    evaluator = PolicyEvaluator(quick, CASES, **keywords, executor=ONE)
    first = [evaluator.costs(spec).costs for spec in specs]
    again = [evaluator.costs(spec).costs for spec in reversed(specs)]
    np.testing.assert_array_equal(first, again[::-1])
    module._prepared.clear()
    assert len({tuple(costs) for costs in first}) == 3
    choice = ExecutorChoice("processes", workers=2)
    with KeptExecutor(choice) as kept:
        parallel = PolicyEvaluator(quick, CASES, **keywords, executor=choice, kept=kept)
        np.testing.assert_array_equal([parallel.costs(spec).costs for spec in specs], first)
    assert not module._prepared  # nothing was run here


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(module, "MOST_PREPARED", 2)
    module._prepared.clear()
    yield
    module._prepared.clear()


def test_a_lost_worker_costs_nothing_but_time(quick: str) -> None:
    spec = policy_spec("mppt2")
    expected = PolicyEvaluator(quick, CASES, episode_s=1.0, executor=ONE).costs(spec).costs
    choice = ExecutorChoice("processes", workers=2)
    with KeptExecutor(choice) as kept:
        evaluator = PolicyEvaluator(quick, CASES, episode_s=1.0, executor=choice, kept=kept)
        before = set(multiprocessing.active_children())
        evaluator.costs(spec)
        for process in set(multiprocessing.active_children()) - before:
            process.kill()
        np.testing.assert_array_equal(evaluator.costs(spec).costs, expected)


def test_the_costs_of_the_passive_vehicle_depend_on_its_dampers(
    quick: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    passive, mppt2 = policy_spec("passive"), policy_spec("mppt2")

    def keys() -> list[str]:
        evaluator = PolicyEvaluator(quick, CASES, episode_s=1.0)
        return [fingerprint(*evaluator.inputs(spec)) for spec in (passive, mppt2)]

    before = keys()
    made = module.configured

    def softer(**keywords: Any) -> Any:
        config, scenario = made(**keywords)
        if scenario.damper.type != "passive":
            return config, scenario
        damper = scenario.damper.model_copy(update={"series_stiffness": 1e6})
        return config, scenario.model_copy(update={"damper": damper})

    monkeypatch.setattr(module, "configured", softer)
    after = keys()
    assert after[0] != before[0]
    assert after[1] == before[1]


@pytest.mark.usefixtures("few")
def test_a_process_keeps_few_vehicles(quick: str) -> None:
    for speed in (100.0, 110.0, 120.0):
        case = {"speed_kmh": speed, "seed": 1}
        PolicyEvaluator(quick, [case], episode_s=0.1, executor=ONE).costs(policy_spec("constant:0.5"))
    assert len(module._prepared) == 2
