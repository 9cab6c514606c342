"""The batch of vehicles as a vector environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from sayd_env.config import ConfigError
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.environment import SEEDS
from sayd_env.envs.interface import Interface
from sayd_env.envs.loop import BOGIES, COST_ACCELERATION, COST_FORCE
from sayd_env.envs.vector import SaydVectorEnv

Step = tuple[Array32, Array32, Flags, list[dict[str, Any]]]


class SaydVecEnv(VecEnv):
    """Many vehicles for algorithms of Stable-Baselines3, one compiled call for a step of all.

    Environment i gives the same bits as `DummyVecEnv` with the environment of one vehicle. `seed(s)` gives it
    the seed s + i at the next reset; without, it goes on with the next episode of its own.

    Parameters
    ----------
    environment : str
        A packaged environment (``nominal``, ``randomized``, ``faults``) or a path to a YAML file.
    num_envs : int
        Number of vehicles.
    **keywords
        Of `SaydVectorEnv`, except the autoreset mode, which Stable-Baselines3 prescribes.

    Raises
    ------
    ConfigError
        A keyword, an option or an action that cannot be used; the message names it and what is allowed.
    """

    def __init__(self, environment: str = "nominal", num_envs: int = 1, **keywords: Any) -> None:
        if "autoreset_mode" in keywords:
            raise ConfigError("autoreset_mode: Stable-Baselines3 prescribes 'SameStep'; leave it out")
        self.vector = SaydVectorEnv(
            environment, num_envs=num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **keywords
        )
        self._begun = False
        self._actions: Any = None
        super().__init__(num_envs, self.vector.single_observation_space, self.vector.single_action_space)
        self.metadata["render_fps"] = self.vector.metadata["render_fps"]

    @property
    def interface(self) -> Interface:
        """What a policy may know of the environment."""
        return self.vector.interface

    def reset(self) -> Array32:
        """Begin an episode of every vehicle, with the seeds and options that were set for it."""
        first, others = self._options[0], self._options[1:]
        if all(options == first for options in others):
            observations, infos = self.vector.reset(seed=self._seeds, options=dict(first))
            reported = rows(infos, self.num_envs)
        else:
            observations, reported = self._reset_apart()
        self.reset_infos = reported
        self._begun = True
        self._reset_seeds()
        self._reset_options()
        return observations

    def _reset_apart(self) -> tuple[Array32, list[dict[str, Any]]]:
        """Reset vehicle after vehicle, because their options differ."""
        seeds = list(self._seeds)
        if not self._begun:  # all vehicles must be there before one of them can be reset alone
            seeds = [int(np.random.default_rng().integers(SEEDS)) if s is None else s for s in seeds]
            self.vector.reset(seed=seeds)
        observations, reported = np.empty(0, np.float32), []
        for i in range(self.num_envs):
            alone = [seed if vehicle == i else None for vehicle, seed in enumerate(seeds)]
            options = self._options[i] | {"reset_mask": np.arange(self.num_envs) == i}
            observations, infos = self.vector.reset(seed=alone, options=options)
            reported.append(rows(infos, self.num_envs)[i])
        return observations, reported

    def step_async(self, actions: Array32) -> None:
        """Keep the valve commands for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Step:
        """Hold the valve commands for one control period; vehicles that end begin their next episode."""
        observations, rewards, terminated, truncated, batched = self.vector.step(self._actions)
        last, final_info = batched.pop("final_obs", None), batched.pop("final_info", {})
        dones = terminated | truncated
        infos = rows(batched, self.num_envs)
        if last is not None:
            finals = rows(final_info, self.num_envs)
            for i in map(int, np.flatnonzero(dones)):
                self.reset_infos[i], infos[i] = infos[i], finals[i] | {"terminal_observation": last[i]}
        for info, cut in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            info["TimeLimit.truncated"] = cut
        return observations, rewards.astype(np.float32), dones, infos

    def bogie_costs(self) -> Array:
        """Share of the last period in the J of each bogie, shape (num_envs, 2), weighted as the reward."""
        batch = self.vector.batch
        cost, terms = batch.scenario.cost, batch.vehicles.terms
        acceleration = terms[:, COST_ACCELERATION : COST_ACCELERATION + BOGIES]
        force = terms[:, COST_FORCE : COST_FORCE + BOGIES]
        costs: Array = cost.acceleration_weight * acceleration + cost.force_weight * force
        return costs

    def close(self) -> None:
        """Close the window, if there is one."""
        if hasattr(self, "vector"):  # making it may have failed
            self.vector.close()

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """A picture of each vehicle."""
        pictures = self.vector.render()
        return (None,) * self.num_envs if pictures is None else tuple(pictures)

    def render(self, mode: str | None = None) -> npt.NDArray[np.uint8] | None:
        """The vehicles' pictures as one; None in a window, which shows the first vehicle."""
        if self.render_mode == "human" and mode in {None, "human"}:
            self.vector.render()
            return None
        picture: npt.NDArray[np.uint8] | None = super().render(mode)
        return picture

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the environment, once for each vehicle."""
        return [getattr(self.vector, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment: of all vehicles, which are one object.

        Raises
        ------
        ConfigError
            Only some vehicles are meant.
        """
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ConfigError(f"{attr_name}: the vehicles are one object; set it for all of them")
        setattr(self.vector, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> Any:
        """Refuse to call a method of one vehicle, because the vehicles are one object.

        Raises
        ------
        ConfigError
            Always.
        """
        raise ConfigError(
            f"{method_name}: the vehicles are one object without methods of their own; call those of `vector`"
        )

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """Nothing lies around a vehicle."""
        return [False] * len(list(self._get_indices(indices)))


def rows(batched: dict[str, Any], count: int) -> list[dict[str, Any]]:
    """The info of each vehicle from Gymnasium's form: an array for each key with a mask ``_key``.

    Parameters
    ----------
    batched : dict
        Info of a vector environment.
    count : int
        Number of vehicles.
    """
    columns = {key: values for key, values in batched.items() if not key.startswith("_")}
    of_all = {
        key: _of_vehicles(values, count)
        for key, values in columns.items()
        if np.count_nonzero(batched["_" + key]) == count
    }
    infos = [dict(zip(of_all, each, strict=True)) for each in zip(*of_all.values(), strict=True)]
    infos = infos or [{} for _ in range(count)]
    for key in columns.keys() - of_all.keys():
        some = _of_vehicles(columns[key], count)
        for i in np.flatnonzero(batched["_" + key]).tolist():
            infos[i][key] = some[i]
    return infos


def _of_vehicles(values: Any, count: int) -> Sequence[Any]:
    """A key's values vehicle by vehicle: numbers as Python's own, arrays as rows."""
    if isinstance(values, dict):
        return rows(values, count)
    return values.tolist() if values.ndim == 1 else values  # type: ignore[no-any-return]
