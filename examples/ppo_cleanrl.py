"""PPO in one file in the manner of CleanRL, on the batch of `gymnasium.make_vec`.

    pip install torch
    python examples/ppo_cleanrl.py --steps 40000

`judge.py` says what the task is and what the policy is worth.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from judge import GAMMA, ID, KEYWORDS, mean_cost, parsed
from torch import nn

VEHICLES, ROLLOUT, EPOCHS, MINIBATCH = 16, 128, 10, 64
RATE, LAMBDA, CLIP, VALUE, NORM = 3e-4, 0.95, 0.2, 0.5, 0.5


def layer(inputs: int, outputs: int, gain: float = np.sqrt(2.0)) -> nn.Linear:
    """A layer with orthogonal weights."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.constant_(made.bias, 0.0)
    return made


class Agent(nn.Module):
    """Mean, spread and value of a state."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        body = [[layer(inputs, 64), nn.Tanh(), layer(64, 64), nn.Tanh()] for _ in range(2)]
        self.mean = nn.Sequential(*body[0], layer(64, outputs, 0.01))
        self.critic = nn.Sequential(*body[1], layer(64, 1, 1.0))
        self.log_std = nn.Parameter(torch.zeros(outputs))

    def policy(self, seen: torch.Tensor) -> torch.distributions.Distribution:
        """Distribution of the actions, which the environment cuts off at -1 and 1."""
        spread = self.log_std.exp().expand(len(seen), -1)
        return torch.distributions.Independent(torch.distributions.Normal(self.mean(seen), spread), 1)

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        """Expected return."""
        return self.critic(seen).squeeze(-1)


def train(steps: int) -> Agent:
    """Train for a number of steps of all vehicles together."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    envs = gym.make_vec(ID, num_envs=VEHICLES, autoreset_mode=AutoresetMode.SAME_STEP, **KEYWORDS)
    size, actions = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
    agent = Agent(size, actions)
    optimizer = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    shape = (ROLLOUT, VEHICLES)
    states, taken = torch.zeros(*shape, size), torch.zeros(*shape, actions)
    logs, rewards, values, ends = (torch.zeros(shape) for _ in range(4))
    seen = torch.as_tensor(envs.reset(seed=0)[0])
    for _ in range(max(steps // (ROLLOUT * VEHICLES), 1)):
        with torch.no_grad():
            for t in range(ROLLOUT):
                policy = agent.policy(seen)
                states[t], taken[t] = seen, policy.sample()
                logs[t], values[t] = policy.log_prob(taken[t]), agent.value(seen)
                found, paid, terminated, truncated, info = envs.step(taken[t].numpy())
                rewards[t] = torch.as_tensor(paid)
                ends[t] = torch.as_tensor(terminated | truncated)
                for i in np.flatnonzero(truncated & ~terminated):  # cut off: it would have gone on
                    rewards[t, i] += GAMMA * agent.value(torch.as_tensor(info["final_obs"][i])[None])[0]
                seen = torch.as_tensor(found)
            advantages, last, ahead = torch.zeros(shape), torch.zeros(VEHICLES), agent.value(seen)
            for t in reversed(range(ROLLOUT)):
                going = 1.0 - ends[t]
                delta = rewards[t] + GAMMA * going * ahead - values[t]
                advantages[t] = last = delta + GAMMA * LAMBDA * going * last
                ahead = values[t]
        batch = [part.flatten(0, 1) for part in (states, taken, logs, advantages, advantages + values)]
        for _ in range(EPOCHS):
            for rows in torch.randperm(ROLLOUT * VEHICLES).split(MINIBATCH):
                state, action, log, advantage, target = (part[rows] for part in batch)
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                ratio = (agent.policy(state).log_prob(action) - log).exp()
                gain = torch.min(advantage * ratio, advantage * ratio.clamp(1.0 - CLIP, 1.0 + CLIP)).mean()
                loss = VALUE * (agent.value(state) - target).square().mean() - gain
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), NORM)
                optimizer.step()
    envs.close()
    return agent


def main(steps: int, episodes: int) -> float:
    """Train, and return the mean J of what was learned."""
    agent = train(steps)

    def act(observation: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return agent.mean(torch.as_tensor(observation)).numpy()

    return mean_cost(act, episodes)


if __name__ == "__main__":
    print(f"J = {main(**parsed(__doc__)):.4f}")
