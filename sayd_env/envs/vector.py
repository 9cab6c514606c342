"""The Gymnasium environment of many vehicles: one compiled call for a step of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from sayd_env.config import ConfigError
from sayd_env.config.explain import shown
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.environment import KEYWORDS as OF_ONE
from sayd_env.envs.environment import Environment, EnvironmentState
from sayd_env.envs.info import period_infos
from sayd_env.envs.keywords import RENDER_MODES, Keywords
from sayd_env.envs.options import LARGEST, whole_number

OWN_KEYWORDS = ("num_envs", "num_threads", "autoreset_mode", "max_episode_steps")
KEYWORDS = (*OF_ONE, *OWN_KEYWORDS)
"""Keywords of `SaydVectorEnv`."""
MOST_ENVS = 65536


class SaydVectorEnv(Environment, VectorEnv[Array32, Array32, npt.NDArray[Any]]):
    """Many `SaydEnv` side by side; see there for actions, observations, reward and ends.

    Made by ``gymnasium.make_vec``. Environment i gives the same bits as a `SaydEnv` that is reset with the
    same seed, for any number of environments and threads. ``reset(seed=s)`` with a number s gives environment
    i the seed s + i, a list gives each its own. `info` has Gymnasium's form: an array for each key, and a
    mask ``_key``.

    Worker processes hardly pay for their messages here. If you need them: `AsyncVectorEnv` runs `SaydEnv`
    with any context. A batch inside a worker that was forked after several threads have run here needs
    ``num_threads=1``, since a fork does not copy threads; ``forkserver`` and ``spawn`` have no such limit.

    Parameters
    ----------
    environment, damper, ..., settings, scaled, info
        As in `SaydEnv`.
    num_envs : int
        Number of vehicles.
    num_threads : int, optional
        Threads of the compiled call; by default all cores, and 1 for a single vehicle.
    autoreset_mode : str or AutoresetMode
        What happens after the end of an episode. ``NextStep``: the next step ignores the vehicle's action,
        begins the next episode and gives its first observation, with reward 0. ``SameStep``: the same step
        does; the last observation and info are in ``final_obs`` and ``final_info``. ``Disabled``: the vehicle
        must be reset with ``reset(options={"reset_mask": ...})``. (Or the names of `AutoresetMode`.)
    max_episode_steps : int, optional
        Truncate after this many steps; for longer episodes set `episode_s`.
    render_mode : str, optional
        ``rgb_array``, a picture of each vehicle, or ``human``, a window that shows the first one.

    Raises
    ------
    ConfigError
        A keyword, an option or an action that cannot be used; see `SaydEnv`.
    gymnasium.error.ResetNeeded
        A step before the first reset, or with ``Disabled`` after the end of an episode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": list(RENDER_MODES),
        "render_fps": 100,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        environment: str = "nominal",
        *,
        num_envs: int = 1,
        scaled: bool = False,
        info: str = "basic",
        render_mode: str | None = None,
        num_threads: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        **keywords: Unpack[Keywords],
    ) -> None:
        self.autoreset_mode = _autoreset(autoreset_mode)
        self.num_envs = whole_number("num_envs", num_envs, 1, MOST_ENVS)
        threads = None if num_threads is None else whole_number("num_threads", num_threads, 1)
        self._make(self.num_envs, environment, keywords, scaled, info, render_mode, threads, OWN_KEYWORDS)
        # With -1, Gymnasium's clients ask for no limit of their own.
        limit = -1 if max_episode_steps is None else whole_number("max_episode_steps", max_episode_steps, -1)
        if limit != -1:
            self.batch.steps = min(self.batch.steps, whole_number("max_episode_steps", limit, 1))
        self._begun = False
        self.metadata = {
            **self.metadata,
            "render_fps": round(1.0 / self.config.control_period),
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space, self.single_action_space = self._spaces()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._shape = (self.num_envs, self.interface.actions)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array32, dict[str, Any]]:
        """Begin an episode in every vehicle.

        Parameters
        ----------
        seed : int or sequence of int or None, optional
            A number s gives environment i the seed s + i. One without a seed goes on with its next episode.
        options : dict, optional
            What to fix of the episodes, and ``reset_mask``, a bool for each vehicle: the others go on.

        Raises
        ------
        ConfigError
            Another number of seeds, an unknown option, a value that is not allowed, or one that the episode's
            line says itself.
        DataError
            A measured track or line that cannot be used.
        """
        seeds = self._given_seeds(seed)
        if isinstance(seed, int | np.integer):
            self._np_random, self._np_random_seed = seeding.np_random(int(seed))
        fixed = _mapping(options)
        which = self._masked(fixed.pop("reset_mask", None))
        self._begin(which, [seeds[i] for i in which], fixed)
        self._begun = True
        reported = np.zeros(self.num_envs, dtype=np.bool_)
        reported[which] = True
        if self.render_mode == "human":
            self.render()
        return self._observed(), self._infos(reported)

    def _given_seeds(self, seed: Any) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, list | tuple | range) or (isinstance(seed, np.ndarray) and seed.ndim == 1):
            if len(seed) != self.num_envs:
                raise ConfigError(
                    f"seed: found {len(seed)} seeds; expected {self.num_envs}, one for each vehicle"
                )
            return [None if each is None else whole_number("seed", each) for each in seed]
        first = whole_number("seed", seed, most=LARGEST - self.num_envs)
        return [first + i for i in range(self.num_envs)]

    def _masked(self, mask: Any) -> list[int]:
        """VehicleBatch that a reset concerns."""
        if mask is None:
            return list(range(self.num_envs))
        try:
            flags = np.asarray(mask)
        except ValueError:  # a list of lists of several lengths
            flags = np.empty(0)
        if flags.shape != (self.num_envs,) or flags.dtype != np.bool_ or not flags.any():
            raise ConfigError(
                f"options: reset_mask: found {shown(mask)}; expected a boolean for each of the "
                f"{self.num_envs} vehicles, one of them true"
            )
        if not self._begun and not flags.all():
            raise ConfigError("options: reset_mask: the first reset must be one of all vehicles")
        return [int(i) for i in np.flatnonzero(flags)]

    def step(self, actions: Array32) -> tuple[Array32, Array, Flags, Flags, dict[str, Any]]:
        """Hold valve commands for one control period.

        Parameters
        ----------
        actions : ndarray, shape (num_envs, A)
            Valve commands from 0 (closed) to 1 (open).

        Raises
        ------
        InvalidAction
            Actions of another shape, out of range by more than rounding (1e-6) or not finite.
        gymnasium.error.ResetNeeded
            No episode is running.
        """
        if not self._begun:
            raise ResetNeeded("no episode is running: call reset before step")
        values = self._commands(actions)
        over = np.flatnonzero(self._over)
        if over.size == 0:
            return self._run(values)
        if self.autoreset_mode is AutoresetMode.DISABLED:
            raise ResetNeeded(
                f"the episodes of the vehicles {over.tolist()} have ended: reset them with reset_mask"
            )
        which = over.tolist()
        self._begin(which, [None] * len(which))
        active = np.ones(self.num_envs, dtype=np.bool_)
        active[which] = False
        return self._run(values, active)

    def _run(
        self, values: Array, active: Flags | None = None
    ) -> tuple[Array32, Array, Flags, Flags, dict[str, Any]]:
        """Step the active vehicles; the others have just begun."""
        observations, rewards, terminated, truncated = self._advance(values, active)
        if active is not None:
            terminated &= active
            truncated &= active
        done = terminated | truncated
        which, last = np.flatnonzero(done).tolist(), {}
        if which and self.autoreset_mode is AutoresetMode.SAME_STEP:
            final = np.full(self.num_envs, None, dtype=object)
            for i in which:
                final[i] = observations[i].copy()
            last = {"final_obs": final, "final_info": self._infos(done)}
            last |= {"_" + key: done.copy() for key in last}
            self._begin(which, [None] * len(which))
            observations = self._observed()
        elif which:
            self._over[which] = True
        if self.render_mode == "human":
            self.render()
        infos = self._infos(np.ones(self.num_envs, dtype=np.bool_))
        return observations, rewards, terminated, truncated, infos | last

    def _begin(
        self, which: Sequence[int], seeds: Sequence[int | None], options: Mapping[str, Any] | None = None
    ) -> None:
        super()._begin(which, seeds, options)
        self._conditions_together = together(self._conditions)

    def _infos(self, reported: Flags) -> dict[str, Any]:
        """Info of these vehicles in Gymnasium's form, as `SaydEnv` gives it: new arrays."""
        if self._silent:
            return {}
        found = period_infos(self.batch)
        found |= {key: values.copy() for key, values in self._conditions_together.items()}
        if self._full:
            found |= together([self._full_info(i) for i in range(self.num_envs)])
        if not reported.all():
            for values in found.values():
                values[~reported] = None if values.dtype == object else 0
        return found | {"_" + key: reported.copy() for key in found}

    def render(self) -> Any:
        """Pictures of all vehicles: an array of shape (height, width, 3) for each, or None with ``human``."""
        if self.render_mode is None:
            gym.logger.warn("render() needs a render_mode: give make_vec render_mode='rgb_array' or 'human'")
            return None
        pictures = self._pictures()
        return None if self.render_mode == "human" else pictures

    def close_extras(self, **_: Any) -> None:
        """Close the window, if there is one."""
        self._close_window()

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of the environment, once for each vehicle, as `SyncVectorEnv.get_attr`."""
        return (getattr(self, name),) * self.num_envs

    def set_state(self, state: EnvironmentState) -> None:
        """Go back to a state, as `SaydEnv.set_state`."""
        super().set_state(state)
        self._conditions_together = together(self._conditions)
        self._begun = True


def together(infos: Sequence[Mapping[str, Any]]) -> dict[str, npt.NDArray[Any]]:
    """Infos of vehicles with the same keys as new arrays with a row for each; texts and lists are objects."""
    return {key: _column([info[key] for info in infos]) for key in infos[0]}


def _column(values: list[Any]) -> npt.NDArray[Any]:
    if isinstance(values[0], int | float | np.number | np.ndarray):
        return np.array(values)
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return column


def _mapping(options: Any) -> dict[str, Any]:
    if not isinstance(options, Mapping | None):
        raise ConfigError(f"options: found {shown(options)}; expected keys and values")
    return dict(options or {})


def _autoreset(mode: Any) -> AutoresetMode:
    for each in AutoresetMode if isinstance(mode, str | AutoresetMode) else ():
        if mode in (each, each.value, each.name):
            return each
    names = ", ".join(f"'{each.value}'" for each in AutoresetMode)
    raise ConfigError(f"autoreset_mode: found {shown(mode)}; expected one of {names}")
