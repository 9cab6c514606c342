"""PPO of TorchRL on the batch of `gymnasium.make_vec`.

    pip install torchrl
    python examples/ppo_torchrl.py --steps 40000

A single environment is `GymEnv(ID, **KEYWORDS)`, processes of it are `ParallelEnv(n, lambda: GymEnv(...))`.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from judge import GAMMA, ID, KEYWORDS, mean_cost, parsed
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import GymWrapper
from torchrl.modules import MLP, IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

VEHICLES, ROLLOUT, EPOCHS, MINIBATCH = 16, 128, 10, 64


def train(steps: int) -> nn.Module:
    """Train for a number of steps of all vehicles together."""
    torch.manual_seed(0)
    env = GymWrapper(gym.make_vec(ID, num_envs=VEHICLES, autoreset_mode=AutoresetMode.DISABLED, **KEYWORDS))
    size, actions = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    body = {"num_cells": [64, 64], "activation_class": nn.Tanh}
    mean = MLP(size, actions, **body)
    nn.init.orthogonal_(mean[-1].weight, 0.01)
    network = nn.Sequential(mean, AddStateIndependentNormalScale(actions))
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=["observation"], out_keys=["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(MLP(size, 1, **body), in_keys=["observation"])
    advantage = GAE(gamma=GAMMA, lmbda=0.95, value_network=critic)
    losses = ClipPPOLoss(actor, critic, entropy_bonus=False, critic_coeff=0.5, normalize_advantage=True)
    losses.make_value_estimator(gamma=GAMMA)
    optimizer = torch.optim.Adam(losses.parameters(), lr=3e-4)
    frames = ROLLOUT * VEHICLES
    collector = Collector(
        env,
        actor,
        frames_per_batch=frames,
        total_frames=max(steps // frames, 1) * frames,
        auto_register_policy_transforms=True,
    )
    for batch in collector:
        with torch.no_grad():
            advantage(batch)
        samples = batch.reshape(-1)
        for _ in range(EPOCHS):
            for rows in torch.randperm(frames).split(MINIBATCH):
                parts = losses(samples[rows])
                loss = parts["loss_objective"] + parts["loss_critic"]
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(losses.parameters(), 0.5)
                optimizer.step()
    collector.shutdown()
    return mean


def main(steps: int, episodes: int) -> float:
    """Train, and return the mean J of what was learned."""
    torch.set_num_threads(1)
    mean = train(steps)

    def act(observation: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return mean(torch.as_tensor(observation)).numpy()

    return mean_cost(act, episodes)


if __name__ == "__main__":
    print(f"J = {main(**parsed(__doc__)):.4f}")
