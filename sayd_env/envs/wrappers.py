"""Wrappers: observations mapped to -1 to 1 by the sensors' ranges, and stacks of past observations.

For a stack of the last observations of any kind, Gymnasium's own wrapper serves and is offered here as
`HistoryStack`: it repeats the first observation at a reset, as ``observation="history"`` does.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.wrappers import FrameStackObservation as HistoryStack

from sayd_env.config import ConfigError
from sayd_env.config.units import Array32
from sayd_env.envs.scaled import Scaling

__all__ = ["HistoryStack", "NormalizeSignals", "NormalizeVectorSignals"]


def _ranges(space: Any) -> tuple[Scaling, Any]:
    """The map of a box to the range -1 to 1, and the box of what it gives."""
    if not isinstance(space, Box) or not space.is_bounded():
        raise ConfigError(f"NormalizeSignals: found the space {space}; expected a Box with finite bounds")
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    half = 0.5 * (high - low)
    scaling = Scaling(0.5 * (low + high), np.where(half > 0.0, half, 1.0), 1.0)
    return scaling, Box(-1.0, 1.0, space.shape, dtype=np.float32)


class NormalizeSignals(gym.ObservationWrapper[Array32, Array32, Array32], RecordConstructorArgs):
    """Map the range of every signal to -1 to 1.

    The ranges are those of the sensors, so the map is fixed: no statistics, the same for all policies.

    Parameters
    ----------
    env : gymnasium.Env
        An environment whose observations are a `Box` with finite bounds.

    Raises
    ------
    ConfigError
        Another observation space.
    """

    def __init__(self, env: gym.Env[Array32, Array32]) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._scaling, self.observation_space = _ranges(env.observation_space)

    def observation(self, observation: Array32) -> Array32:
        """Map one observation."""
        return self._scaling(observation)


class NormalizeVectorSignals(VectorWrapper, RecordConstructorArgs):
    """`NormalizeSignals` for vector environments in any autoreset mode; ``final_obs`` is mapped too."""

    def __init__(self, env: VectorEnv[Array32, Array32, npt.NDArray[Any]]) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self._scaling, self.observation_space = _ranges(env.observation_space)
        self._single, self.single_observation_space = _ranges(env.single_observation_space)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset all vehicles."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return self._scaling(observations), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step all vehicles."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        if "final_obs" in infos:
            final = infos["final_obs"]
            for i in np.flatnonzero(infos["_final_obs"]):
                final[i] = self._single(final[i])
        return self._scaling(observations), rewards, terminated, truncated, infos
