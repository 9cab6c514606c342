"""The batch environment as a learner sees it: encoded observations, outputs from -1 to 1, scaled rewards."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor

from agents.config import TrainConfig
from agents.encoding import Encoding, Observation
from agents.sb3_vec import SaydVecEnv, Step

SEEDS_APART = 1_000_000
"""Seeds of a training begin here, those of evaluations and comparisons lie below."""
SEEDS_OF_A_LIFE = 4096
"""Seeds from one start of a training to the next: as many as there may be lanes."""
LIVES = SEEDS_APART // SEEDS_OF_A_LIFE


class EncodedVecEnv(VecEnvWrapper):
    """Vehicles whose observations are encoded for a network and whose actions are its outputs.

    Parameters
    ----------
    venv : VecEnv
        Vehicles with observations in SI units, actions from 0 to 1 and rewards as the environment gives them.
    encoding : Encoding
    reward_factor : float
        What the rewards are multiplied with.
    """

    def __init__(self, venv: VecEnv, encoding: Encoding, reward_factor: float) -> None:
        super().__init__(
            venv,
            Box(-encoding.clip, encoding.clip, (encoding.size,), np.float32),
            Box(-1.0, 1.0, (encoding.actions,), np.float32),
        )
        self._encoding = encoding
        self._factor = np.float32(reward_factor)
        self._seen: Observation = np.zeros(0, np.float32)

    def reset(self) -> Observation:
        """Begin an episode in every lane."""
        self._seen = self.venv.reset()
        return self._encoding.encode(self._seen)

    def step_async(self, actions: npt.NDArray[np.float32]) -> None:
        """Turn outputs of the network to valve commands."""
        self.venv.step_async(self._encoding.decode(actions, self._seen))

    def step_wait(self) -> Step:
        """Hold the commands for one control period."""
        self._seen, rewards, dones, infos = self.venv.step_wait()
        for i in np.flatnonzero(dones):
            infos[i]["terminal_observation"] = self._encoding.encode(infos[i]["terminal_observation"][None])[
                0
            ]
        return self._encoding.encode(self._seen), rewards * self._factor, dones, infos


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
        num_envs=settings.lanes, num_threads=settings.threads, **environment_keywords(config)
    )
    encoding = Encoding(vehicles.interface, config.inputs, config.clip, config.output)
    # The monitor stands below: it adds up what the environment gives, minus J.
    factor = config.reward_scale / settings.control_period
    return EncodedVecEnv(VecMonitor(vehicles), encoding, factor), encoding


def seed_lanes(env: EncodedVecEnv, seed: int, life: int) -> None:
    """Seed the lanes of a training.

    Parameters
    ----------
    env : EncodedVecEnv
    seed : int
        Of the training.
    life : int
        How often the training was resumed: each time its episodes are others.
    """
    env.seed((seed + 1) * SEEDS_APART + (life % LIVES) * SEEDS_OF_A_LIFE)
