"""PPO of Stable-Baselines3, as it comes, on the batch as its `VecEnv`.

    pip install stable-baselines3
    python examples/ppo_sb3.py --steps 40000

A single environment, `gymnasium.make(ID, **KEYWORDS)`, goes into `PPO` as well.
"""

from __future__ import annotations

import numpy as np
import torch
from judge import GAMMA, KEYWORDS, mean_cost, parsed
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from sayd_env.agents.sb3_vec import SaydVecEnv


def train(steps: int) -> PPO:
    """Train for a number of steps of all 16 vehicles together."""
    env = VecMonitor(SaydVecEnv("randomized", num_envs=16, **KEYWORDS))
    model = PPO("MlpPolicy", env, n_steps=128, gamma=GAMMA, seed=0, device="cpu")
    return model.learn(steps)


def main(steps: int, episodes: int) -> float:
    """Train, and return the mean J of what was learned."""
    torch.set_num_threads(1)
    model = train(steps)

    def act(observation: np.ndarray) -> np.ndarray:
        return model.predict(observation, deterministic=True)[0]

    return mean_cost(act, episodes)


if __name__ == "__main__":
    print(f"J = {main(**parsed(__doc__)):.4f}")
