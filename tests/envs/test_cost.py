"""One J of an episode: rewards, batch, rollouts and the evaluators of tuning and training all give the same.

The expected number is written out here from the unweighted squares that `info` gives of each step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env import baselines
from sayd_env.agents.config import load_train
from sayd_env.config.environment import load_environment
from sayd_env.envs.cost import episode_cost
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.loop import COST_ACCELERATION, COST_FORCE, TERMS
from sayd_env.envs.rollout import roll_out
from sayd_env.envs.single import SaydEnv
from sayd_env.envs.vector import SaydVectorEnv
from sayd_env.runs.evaluator import PolicyEvaluator
from sayd_env.runs.policies import policy_spec
from sayd_env.studies.learning import policy_evaluator

SECONDS, J_TERM, POLICY, SEED = 2.0, 7.0, "constant:0.3", 5
CONDITIONS = {"speed_kmh": 350.0, "wear": 1.0, "initial_current": 0.2}
ENVIRONMENT = """
base: nominal
study: {study}
run_in: 20.0
episode_s: {seconds}
termination_cost: {j_term}
derailment: {{quotient: {quotient}, averaging: 0.5}}
"""


def environment_file(folder: Path, force_weight: float, quotient: float) -> str:
    study, path = folder / "study.yaml", folder / "environment.yaml"
    study.write_text(f"base: estimates\nset: {{cost.force_weight: {force_weight}}}\n")
    path.write_text(ENVIRONMENT.format(study=study, seconds=SECONDS, j_term=J_TERM, quotient=quotient))
    return str(path)


def j_of_the_environment(name: str, force_weight: float) -> tuple[float, float, int]:
    """Minus the reward per second; J from the squares in `info`; control periods that were run."""
    env = SaydEnv(name)
    observation, _ = env.reset(seed=SEED, options=CONDITIONS)
    policy, state, rewards, squares, over = baselines.make(POLICY, env), None, [], [], False
    while not over:
        action, state = policy.predict(observation, state)
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        squares.append((info["cost_acceleration"], info["cost_force"]))
        over = terminated or truncated
    acceleration, force = np.sum(squares, axis=0)
    left = SECONDS - 0.01 * len(rewards) if terminated else 0.0
    charge = J_TERM * max(1.0, force_weight / 0.5) * left
    return -sum(rewards) / SECONDS, (acceleration + force_weight * force + charge) / SECONDS, len(rewards)


@pytest.mark.parametrize("ends_early", [False, True])
@pytest.mark.parametrize("force_weight", [0.5, 1.0, 2.0])
def test_all_give_the_same_j(force_weight: float, ends_early: bool, tmp_path: Path) -> None:
    name = environment_file(tmp_path, force_weight, 0.09 if ends_early else 5.0)
    j, expected, taken = j_of_the_environment(name, force_weight)
    assert (0 < taken < 200) == ends_early
    assert j == pytest.approx(expected, rel=1e-12)

    vector = SaydVectorEnv(name, num_envs=2, autoreset_mode="Disabled")
    vector.reset(seed=[SEED, SEED], options=CONDITIONS)
    total = sum(vector.step(np.full((2, 2), 0.3, np.float32))[1][0] for _ in range(taken))
    assert -total / SECONDS == pytest.approx(expected, rel=1e-12)

    config = load_environment(name)
    batch = EpisodeBatch(config, 1, num_threads=1)
    episodes = [draw_episode(config, SEED, 0, CONDITIONS)]
    (run,) = roll_out(batch, baselines.make(POLICY, batch.interface), episodes, [batch.steps])
    assert run.episode_cost(config, batch.scenario).total == pytest.approx(expected, rel=1e-12)

    case = {"speed_kmh": 350.0, "wear": 1.0, "friction": batch.scenario.friction, "seed": SEED}
    found = PolicyEvaluator(name, [case], episode_s=SECONDS, initial_current=0.2).costs(policy_spec(POLICY))
    assert (float(found.costs[0]), found.derailed) == (pytest.approx(expected, rel=1e-12), int(ends_early))

    evaluation = {
        "episode_s": SECONDS,
        "initial_current": 0.2,
        "speeds_kmh": [350.0],
        "wear": [1.0],
        "seeds": [SEED],
        "beside_seeds": [],
    }
    training = [
        *(f"environment.name={name}", "environment.reward=null"),  # the study's weights
        *(f"evaluation.{key}={value}" for key, value in evaluation.items()),
    ]
    assert policy_evaluator(load_train("ppo", training))(POLICY) == pytest.approx([expected], rel=1e-12)


def test_a_run_shorter_than_the_episode_counts_with_its_whole_seconds() -> None:
    """2.5 s of J = 3 + 0.5 * 4 that nothing ended, of an episode of 20 s: J is that of two seconds."""
    config = load_environment()
    cost = EpisodeBatch(config, 1).scenario.cost
    terms = np.zeros((250, TERMS))
    terms[:, COST_ACCELERATION : COST_ACCELERATION + 2] = 0.03
    terms[:, COST_FORCE : COST_FORCE + 2] = 0.04
    terms[200:] = 1e3
    found = episode_cost(terms, 0.01, config, cost, terminated=False)
    assert (found.acceleration, found.force) == (pytest.approx(3.0), pytest.approx(4.0))
    assert found.total == pytest.approx(5.0)


def test_a_run_that_ended_before_step_0_costs_j_term() -> None:
    config = load_environment()
    cost = EpisodeBatch(config, 1).scenario.cost
    found = episode_cost(np.zeros((0, TERMS)), 0.01, config, cost, terminated=True)
    assert found.total == config.termination_cost * max(cost.acceleration_weight, 2.0 * cost.force_weight)
