"""The task of all examples, and what a policy is worth there: its mean J over episodes that none trains on.

    python examples/judge.py            # J of controllers that do not learn

The examples need nothing of this file but the task's name and keywords.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

from sayd_env import baselines
from sayd_env.config.environment import charge_a_second

ID = "sayd_env:SAYD/Randomized-v1"
"""The part before the colon is imported first, also in a client's worker processes."""
FEATURES: dict[str, Any] = {"observation": "features", "control_period": 0.05}
"""The inputs of the paper's controllers, 20 commands a second."""
KEYWORDS: dict[str, Any] = {**FEATURES, "scaled": True}
"""As learners need them: numbers of order 1."""
GAMMA = 0.98
"""Discount of a step: 1/e after 2.5 s, since hunting builds up in seconds."""
SEED, EPISODES = 9_000_000, 32

Act = Callable[[np.ndarray], Any]


def mean_cost(act: Act, episodes: int = EPISODES, env_id: str = ID, **keywords: Any) -> float:
    """Mean J over episodes of 20 s.

    Parameters
    ----------
    act : callable
        Gives actions, shape (episodes, 2), of observations, with `KEYWORDS` of shape (episodes, 31).
    episodes : int
    env_id : str
        The task.
    **keywords
        Of the environment, `KEYWORDS` if there are none.
    """
    env = gym.make_vec(env_id, num_envs=episodes, **(keywords or KEYWORDS))
    observation, _ = env.reset(seed=SEED)
    config, weights = env.unwrapped.config, env.unwrapped.batch.scenario.cost
    cost, running = np.zeros(episodes), np.ones(episodes, dtype=bool)
    steps = round(config.episode_s / config.control_period)
    for left in reversed(range(steps)):
        observation, _, terminated, _, info = env.step(np.asarray(act(observation), np.float32))
        squares = (info["cost_acceleration"], info["cost_force"])
        cost[running] += (weights.acceleration_weight * squares[0] + weights.force_weight * squares[1])[
            running
        ]
        # What a derailed run is charged for the time that is left, as its reward is.
        cost[running & terminated] += charge_a_second(config, weights) * left * config.control_period
        running &= ~terminated
    env.close()
    return float(cost.mean() / config.episode_s)


def controller(name: str, env_id: str = ID, **keywords: Any) -> Act:
    """A controller that does not learn, for environments with these keywords, else with `FEATURES`."""
    policy, memory = baselines.make(name, gym.make(env_id, **(keywords or FEATURES))), None

    def act(observation: np.ndarray) -> np.ndarray:
        nonlocal memory
        action, memory = policy.predict(observation, memory)
        return np.asarray(action)

    return act


def parsed(about: str | None) -> dict[str, int]:
    """Arguments of an example's `main`, from its command line."""
    parser = argparse.ArgumentParser(description=(about or "").splitlines()[0])
    for name, default, what in (
        ("--steps", 40_000, "of all vehicles together"),
        ("--episodes", EPISODES, "in which it is judged"),
    ):
        parser.add_argument(name, type=int, default=default, help=f"{what} (default: {default})")
    return vars(parser.parse_args())


if __name__ == "__main__":
    for name in ("constant:0", "constant:0.2", "constant:0.5", "mppt2"):
        print(f"{name}: J = {mean_cost(controller(name), **FEATURES):.4f}")
