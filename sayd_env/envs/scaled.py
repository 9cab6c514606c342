"""The environment as learners like it: observations and rewards of order 1, actions from -1 to 1."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box

from sayd_env.config.errors import ConfigError
from sayd_env.config.learner import InputConfig, load_learner
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.interface import Interface
from sayd_env.envs.options import number_array

FLOOR = 1e-12
"""Smallest ratio of which a logarithm is taken."""


class Scaling:
    """A fixed map of numbers to order 1: (value - middle) / half, or ln(value / middle) / half.

    Parameters
    ----------
    middle : ndarray
        What becomes 0; so does NaN.
    half : ndarray
        What becomes 1.
    clip : float
        Results are cut off at plus and minus this.
    logarithmic : ndarray of bool, optional
        Where ln(value / middle) / half is taken.
    """

    def __init__(self, middle: Array, half: Array, clip: float, logarithmic: Flags | None = None) -> None:
        self.middle, self.clip = middle, clip
        self.per_half: Array = 1.0 / half
        self.logarithmic = np.zeros(middle.shape, np.bool_) if logarithmic is None else logarithmic

    @classmethod
    def of(cls, inputs: Iterable[InputConfig], clip: float) -> Scaling:
        """The map of n numbers, each as its configuration says."""
        each = [*inputs]
        logarithmic = np.array([item.scale == "log" for item in each], dtype=np.bool_)
        middle, half = (np.array([getattr(item, name) for item in each]) for name in ("middle", "half"))
        return cls(middle, half, clip, logarithmic)

    def __call__(self, values: npt.ArrayLike) -> Array32:
        """Map numbers, shape (..., n)."""
        seen = np.asarray(values, dtype=np.float64)
        seen = np.where(np.isnan(seen), self.middle, seen)
        apart = seen - self.middle
        if self.logarithmic.any():
            # The floor keeps the logarithm of a dead sensor finite; it lies far beyond the clip.
            ratio = np.maximum(seen / np.where(self.logarithmic, self.middle, 1.0), FLOOR)
            apart = np.where(self.logarithmic, np.log(ratio), apart)
        bounded: Array32 = np.clip(apart * self.per_half, -self.clip, self.clip).astype(np.float32)
        return bounded


class LearnersView:
    """Between the vehicles and a learner.

    Parameters
    ----------
    interface : Interface
        The environment's.
    """

    def __init__(self, interface: Interface) -> None:
        config = load_learner()
        self._worst = config.worst
        quantities = (signal.name.partition(".")[0] for signal in interface.signals)
        self.observe = Scaling.of((config.inputs[name] for name in quantities), config.clip)
        self.observation_box = Box(-config.clip, config.clip, interface.shape, np.float32)
        self.action_box = Box(-1.0, 1.0, (interface.actions,), np.float32)

    def rewards(self, rewards: Array, ordinary: Array) -> Array:
        """Rewards in multiples of ordinary J."""
        found: Array = np.maximum(rewards / ordinary, -self._worst)
        return found

    @staticmethod
    def commands(actions: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
        """Valve commands of actions, which are cut off at -1 and 1: a Gaussian policy's reach beyond.

        Raises
        ------
        ConfigError
            Other than finite numbers.
        """
        values = number_array("action", actions, shape)
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            place = tuple(int(i) for i in bad[0])
            raise ConfigError(
                f"action: found {float(values[place])!r} at {list(place)}; expected finite numbers, -1 to 1"
            )
        commands: Array = 0.5 + 0.5 * np.clip(values, -1.0, 1.0)
        return commands


def ordinary_costs(batch: EpisodeBatch) -> Array:
    """J of an ordinary policy at mean speed and track level of each vehicle, (count,); 1 before episodes."""
    begun = [i for i, episode in enumerate(batch.episodes) if episode is not None]
    costs, reference = np.ones(batch.count), load_learner().reward
    costs[begun] = reference.ordinary(map(batch.mean_speed, begun), map(batch.track_level, begun))
    return costs
