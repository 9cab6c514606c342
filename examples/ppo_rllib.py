"""PPO of RLlib, as it comes, on `gymnasium.make`.

    pip install 'ray[rllib]' torch
    python examples/ppo_rllib.py --steps 40000

`judge.py` says what the task is and what the policy is worth.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import ray
import torch
from judge import GAMMA, ID, KEYWORDS, mean_cost, parsed
from ray.rllib.algorithms.ppo import PPO, PPOConfig
from ray.rllib.core.columns import Columns
from ray.tune.registry import register_env

VEHICLES, ROLLOUT = 16, 128


def train(steps: int) -> PPO:
    """Train for a number of steps of all vehicles together."""
    register_env("sayd", lambda keywords: gym.make(ID, **keywords))
    config = (
        PPOConfig()
        .environment("sayd", env_config=KEYWORDS)
        .env_runners(num_env_runners=0, num_envs_per_env_runner=VEHICLES)
        .training(
            gamma=GAMMA,
            lambda_=0.95,
            lr=3e-4,
            train_batch_size_per_learner=ROLLOUT * VEHICLES,
            minibatch_size=64,
            num_epochs=10,
            clip_param=0.2,
            vf_loss_coeff=0.5,
            vf_clip_param=float("inf"),
            use_kl_loss=False,
            grad_clip=0.5,
        )
        .rl_module(
            model_config={
                "fcnet_hiddens": [64, 64],
                "fcnet_activation": "tanh",
                "vf_share_layers": False,
                "free_log_std": True,
            }
        )
        .debugging(seed=0)
    )
    algorithm = config.build_algo()
    for _ in range(max(steps // (ROLLOUT * VEHICLES), 1)):
        algorithm.train()
    return algorithm


def main(steps: int, episodes: int) -> float:
    """Train, and return the mean J of what was learned."""
    torch.set_num_threads(1)
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        module = train(steps).get_module()

        def act(observation: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                outputs = module.forward_inference({Columns.OBS: torch.as_tensor(observation)})
            return outputs[Columns.ACTION_DIST_INPUTS][:, :2].numpy()  # means, then spreads

        return mean_cost(act, episodes)
    finally:
        ray.shutdown()


if __name__ == "__main__":
    print(f"J = {main(**parsed(__doc__)):.4f}")
