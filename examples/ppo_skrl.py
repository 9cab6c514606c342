"""PPO of skrl on the batch of `gymnasium.make_vec`.

    pip install skrl torch
    python examples/ppo_skrl.py --steps 40000

`judge.py` says what the task is and what the policy is worth.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import torch
from judge import GAMMA, ID, KEYWORDS, mean_cost, parsed
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.trainers.torch import SequentialTrainer
from skrl.utils import set_seed
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

VEHICLES, ROLLOUT = 16, 128


def train(steps: int) -> PPO:
    """Train for a number of steps of all vehicles together."""
    set_seed(0)
    env = wrap_env(gym.make_vec(ID, num_envs=VEHICLES, **KEYWORDS), verbose=False)
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": "cpu"}
    body = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "tanh"}]
    models = {
        "policy": gaussian_model(network=body, output="ACTIONS", **spaces),
        "value": deterministic_model(network=body, output="ONE", **spaces),
    }
    agent = PPO(
        models=models,
        memory=RandomMemory(memory_size=ROLLOUT, num_envs=VEHICLES, device="cpu"),
        cfg={
            "rollouts": ROLLOUT,
            "learning_epochs": 10,
            "mini_batches": 32,
            "discount_factor": GAMMA,
            "learning_rate": 3e-4,
            "time_limit_bootstrap": True,
            "value_clip": 0.0,
            "value_loss_scale": 0.5,
            "value_preprocessor": RunningStandardScaler,
            "value_preprocessor_kwargs": {"size": 1, "device": "cpu"},
            "experiment": {"write_interval": 0, "checkpoint_interval": 0},
        },
        **spaces,
    )
    timesteps = max(steps // (ROLLOUT * VEHICLES), 1) * ROLLOUT
    trainer = SequentialTrainer(
        env=env, agents=agent, cfg={"timesteps": timesteps, "disable_progressbar": True, "headless": True}
    )
    trainer.train()
    return agent


def main(steps: int, episodes: int) -> float:
    """Train, and return the mean J of what was learned."""
    torch.set_num_threads(1)
    agent = train(steps)
    agent.enable_training_mode(False)

    def act(observation: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            _, outputs = agent.act(torch.as_tensor(observation), None, timestep=0, timesteps=0)
        return outputs["mean_actions"].numpy()

    return mean_cost(act, episodes)


if __name__ == "__main__":
    print(f"J = {main(**parsed(__doc__)):.4f}")
