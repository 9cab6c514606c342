"""The batch environment as a learner sees it: encoded observations, outputs from -1 to 1, scaled rewards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor

from sayd_env.agents.bogie_encoding import make_encoding
from sayd_env.agents.config import TrainConfig
from sayd_env.agents.encoding import Encoding
from sayd_env.agents.sb3_vec import SaydVecEnv, Step
from sayd_env.config.units import Array
from sayd_env.envs.scaled import Observation, ordinary_costs

Numbers = Callable[[], Array]

SEEDS_APART = 1_000_000
"""Seeds of a training begin here, those of evaluations and comparisons lie below."""
SEEDS_OF_A_START = 4096
"""Seeds from one start of a training to the next: as many as there may be environments."""
STARTS = SEEDS_APART // SEEDS_OF_A_START


class EncodedVecEnv(VecEnvWrapper):
    """Networks at work: encoded observations, actions that are a network's outputs, scaled rewards.

    A vehicle has one network or, in the view of a bogie, two; then vehicle i has the rows 2 i and 2 i + 1,
    and each is paid for its own bogie.

    Parameters
    ----------
    venv : VecEnv
        Vehicles with observations in SI units, actions from 0 to 1 and rewards as the environment gives them.
    encoding : Encoding
    factors : callable
        Gives what each vehicle's rewards are multiplied with in its episode, shape (N).
    costs : callable, optional
        Gives the share of the last period in the J of each bogie, shape (N, 2).
    """

    def __init__(
        self, venv: VecEnv, encoding: Encoding, factors: Numbers, costs: Numbers | None = None
    ) -> None:
        super().__init__(venv)
        VecEnv.__init__(
            self,
            venv.num_envs * encoding.units,
            Box(-encoding.clip, encoding.clip, (encoding.size,), np.float32),
            Box(-1.0, 1.0, (encoding.actions,), np.float32),
        )
        self._encoding = encoding
        self._factors, self._factor = factors, np.ones(venv.num_envs)
        self._costs = costs
        self._seen: Observation = np.zeros(0, np.float32)

    def reset(self) -> Observation:
        """Begin an episode of every vehicle."""
        self._seen = self.venv.reset()
        self._factor = self._factors()
        return self._encoding.encode(self._seen)

    def step_async(self, actions: npt.NDArray[np.float32]) -> None:
        """Turn outputs of the network to valve commands."""
        self.venv.step_async(self._encoding.decode(actions, self._seen))

    def step_wait(self) -> Step:
        """Hold the commands for one control period."""
        self._seen, rewards, dones, infos = self.venv.step_wait()
        units = self._encoding.units
        each = [info for info in infos for _ in range(units)] if units > 1 else infos
        for i in np.flatnonzero(dones):
            last = self._encoding.encode(infos[i]["terminal_observation"][None])
            for j in range(units):
                each[i * units + j] = infos[i] | {"terminal_observation": last[j]}
        paid = (self._paid(rewards, dones) * self._factor[:, None]).astype(np.float32).reshape(-1)
        if dones.any():
            self._factor = self._factors()
        return self._encoding.encode(self._seen), paid, np.repeat(dones, units), each

    def _paid(self, rewards: npt.NDArray[np.float32], dones: npt.NDArray[np.bool_]) -> Array:
        """Rewards of the networks, shape (N, units): their mean over a vehicle is the vehicle's."""
        if self._costs is None or self._encoding.units == 1:
            return np.repeat(rewards[:, None].astype(np.float64), self._encoding.units, axis=1)
        costs = self._costs()
        apart = costs - costs.mean(axis=1, keepdims=True)
        apart[dones] = 0.0  # these costs are of the next episode already
        paid: Array = rewards[:, None] - apart
        return paid


def environment_keywords(config: TrainConfig) -> dict[str, Any]:
    """Keywords of the environment in which a policy learns."""
    settings = config.environment
    return {
        "environment": settings.name,
        "valves": settings.valves,
        "observation": settings.observation,
        "history": settings.history,
        "control_period": settings.control_period,
        "episode_s": settings.episode_s,
        "reward": settings.reward,
    }


def make_learning_env(config: TrainConfig) -> tuple[EncodedVecEnv, Encoding]:
    """The environment of a training, and the encoding between it and the network.

    Raises
    ------
    ConfigError
        Keywords, inputs or outputs that do not fit the environment.
    """
    settings = config.environment
    vehicles = SaydVecEnv(
        num_envs=settings.vehicles, num_threads=settings.threads, **environment_keywords(config)
    )
    encoding = make_encoding(vehicles.interface, config.view, config.inputs, config.clip, config.output)

    def factors() -> Array:
        per_second = config.reward_scale / settings.control_period
        return per_second / ordinary_costs(vehicles.vector.batch)

    # The monitor is below: it adds up what the environment gives, minus J.
    return EncodedVecEnv(VecMonitor(vehicles), encoding, factors, vehicles.bogie_costs), encoding


def seed_environments(env: EncodedVecEnv, seed: int, restarts: int) -> None:
    """Seed the environments of a training.

    Parameters
    ----------
    env : EncodedVecEnv
    seed : int
        Of the training.
    restarts : int
        How often the training was resumed: each time its episodes are others.
    """
    env.seed((seed + 1) * SEEDS_APART + (restarts % STARTS) * SEEDS_OF_A_START)
