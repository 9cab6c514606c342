"""What the environments of one vehicle and of many share: episodes by seeds, pictures, saved states."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from gymnasium import error, spaces
from gymnasium.envs.registration import EnvSpec

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.explain import shown
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch, EpisodeState, OutOfRange, checked_actions
from sayd_env.envs.info import episode_info, period_info, vehicle_info
from sayd_env.envs.interface import Interface, Signal
from sayd_env.envs.keywords import (
    INFOS,
    RENDER_MODES,
    Keywords,
    checked_choice,
    checked_flag,
    configured,
    refuse_unknown,
)
from sayd_env.envs.loop import LOG
from sayd_env.envs.recorder import Recorder
from sayd_env.envs.scaled import LearnersView, ordinary_costs
from sayd_env.envs.sliding_rms import SlidingRms
from sayd_env.envs.trace import SPEED

SEEDS = 2**31
"""Seeds that are drawn, where none is given, are below it."""
KEYWORDS = ("environment", *Keywords.__annotations__, "scaled", "info", "render_mode")
"""Keywords of both environments."""


class InvalidAction(ConfigError, error.InvalidAction):
    """An action that an environment refuses."""


class EpisodeSpec(EnvSpec):
    """Gymnasium's specification of an environment that truncates its episodes itself.

    `TimeLimit` writes its own limit into a copy: it counts where it is the shorter one.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        own = self.__dict__.get("max_episode_steps")
        both = name == "max_episode_steps" and own is not None and value is not None
        super().__setattr__(name, min(own, value) if both else value)


@dataclass(frozen=True, eq=False)
class EnvironmentState:
    """All of an environment at an instant. It can be pickled, and set any number of times."""

    vehicles: tuple[EpisodeState, ...]
    seeds: tuple[int | None, ...]
    numbers: tuple[int, ...]
    sliding: tuple[SlidingRms | None, ...]
    over: Flags
    """Vehicles whose episode has ended."""
    random: np.random.Generator | None
    random_seed: int | None


class Environment:
    """Vehicles that run episode after episode.

    Attributes
    ----------
    batch : EpisodeBatch
        The simulated vehicles behind the environment: what no train could measure.
    keeps_run_in : bool
        Keep what is observed in run-ins, see `EpisodeBatch.observed_run_in`: for policies that remember.
    """

    batch: EpisodeBatch
    keeps_run_in = False
    render_mode: str | None
    np_random: Any
    _np_random: np.random.Generator | None
    _np_random_seed: int | None
    _shape: tuple[int, ...]
    # What closing needs, also of an environment whose making failed.
    _renderer: Any = None
    _spec: EnvSpec | None = None

    def _make(
        self,
        count: int,
        environment: str,
        keywords: Keywords,
        scaled: bool,
        info: str,
        render_mode: str | None,
        num_threads: int | None,
        more: Sequence[str] = (),
    ) -> None:
        """Make the vehicles from an environment's keywords, of which it may have `more`."""
        refuse_unknown(f"{type(self).__name__}.__init__", keywords, (*KEYWORDS, *more))
        level = checked_choice("info", info, INFOS)
        self._full, self._silent = level == "full", level == "none"
        self.render_mode = checked_choice("render_mode", render_mode, (None, *RENDER_MODES))
        scales = checked_flag("scaled", scaled)
        config, scenario = configured(environment, **keywords)
        self.batch = EpisodeBatch(config, count, scenario=scenario, num_threads=num_threads)
        self._view = LearnersView(self.batch.interface) if scales else None
        self._ordinary = np.ones(count)
        self._over = np.ones(count, dtype=np.bool_)
        self._seeds: list[int | None] = [None] * count
        self._numbers = [0] * count
        self._sliding: list[SlidingRms | None] = [None] * count
        self._conditions: list[dict[str, Any]] = [{}] * count
        self._log = np.zeros((count, self.batch.settings.samples, LOG)) if self._full else None
        pictures = {None: 0, "human": 1}.get(render_mode, count)
        self._recorders = [Recorder(self.batch, i) for i in range(pictures)]

    def __getstate__(self) -> dict[str, Any]:
        """A copy draws with a renderer of its own."""
        return self.__dict__ | {"_renderer": None}

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium makes the environment, with the control periods of an episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            given = {part.name: getattr(spec, part.name) for part in fields(spec) if part.init}
            spec = EpisodeSpec(**given | {"max_episode_steps": self.batch.steps})
        self._spec = spec

    @property
    def config(self) -> EnvironmentConfig:
        """What the environment is."""
        return self.batch.config

    @property
    def interface(self) -> Interface:
        """What a policy may know of the environment."""
        own = self.batch.interface
        return own if self._view is None else dataclasses.replace(own, scaled=True)

    def _spaces(self) -> tuple[Any, Any]:
        """Spaces of one vehicle's observations and actions."""
        if self._view is not None:
            return self._view.observation_box, self._view.action_box
        return observation_box(self.batch.interface), action_box(self.batch.interface)

    def _observed(self) -> Array32:
        """What the vehicles observe now, shape (N, *obs)."""
        seen = self.batch.observations()
        return seen if self._view is None else self._view.observe(seen)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Name, unit and range of each number of a vehicle's observation."""
        return self.interface.signals

    def _begin(
        self, which: Sequence[int], seeds: Sequence[int | None], options: Mapping[str, Any] | None = None
    ) -> None:
        """Begin episodes.

        Parameters
        ----------
        which : sequence of int
            Vehicles that begin.
        seeds : sequence of int or None
            Each one's new seed, whose episode 0 begins; None for the next episode of the seed that it has.
        options : mapping, optional
            Of `reset`.

        Raises
        ------
        ConfigError
            Options that are not allowed; nothing has changed then.
        DataError
            A measured track or line that cannot be used; nor then.
        """
        chosen = []
        for i, seed in zip(which, seeds, strict=True):
            known = self._seeds[i]
            if seed is not None:
                chosen.append((seed, 0))
            elif known is not None:
                chosen.append((known, self._numbers[i] + 1))
            else:
                chosen.append((int(self.np_random.integers(SEEDS)), 0))
        episodes = [
            draw_episode(self.config, seed, number, options, self.batch.scenario) for seed, number in chosen
        ]
        rows = self.batch.reset(
            which, episodes, log=self._full, keep_run_in=self.keeps_run_in, whole_track=False
        )
        if self._view is not None:
            self._ordinary = ordinary_costs(self.batch)
        for i, (seed, number), before in zip(which, chosen, rows, strict=True):
            self._seeds[i], self._numbers[i], self._over[i] = seed, number, False
            self._conditions[i] = episode_info(self.batch, i)
            if self._full:
                self._sliding[i] = self._after_the_run_in(i, before)
        for recorder in self._recorders:
            if recorder.vehicle in which:
                recorder.begin()

    def _commands(self, actions: Any) -> Array:
        """Valve commands of actions.

        Raises
        ------
        InvalidAction
            They cannot be used.
        """
        try:
            given = actions if self._view is None else self._view.commands(actions, self._shape)
            return checked_actions(given, self._shape)
        except OutOfRange as refused:
            advice = "gymnasium.wrappers.ClipAction keeps actions in their range"
            raise InvalidAction(f"{refused}; {advice}") from None
        except ConfigError as refused:
            raise InvalidAction(str(refused)) from None

    def _after_the_run_in(self, i: int, rows: Array) -> SlidingRms:
        batch, episode = self.batch, self.batch.episodes[i]
        assert episode is not None  # it has begun just now
        band, assessment = batch.vehicles.band, batch.scenario.assessment
        line = batch.lines[i]
        slowest = episode.speed if line is None or line.slowest is None else line.slowest
        sliding = SlidingRms(band, assessment, slowest, batch.settings.sample_rate)
        if len(rows):
            sliding.run_in(rows, batch.vehicles.choice()[i], episode.speed)
        return sliding

    def _advance(self, actions: Array, active: Flags | None = None) -> tuple[Array32, Array, Flags, Flags]:
        """Run one control period, as `EpisodeBatch.step` does."""
        # f_0 moves at the end of a period: its samples were filtered in the bands before.
        choice = None if self._log is None else self.batch.vehicles.choice()
        result = self.batch.step(actions, log=self._log, active=active)
        for recorder in self._recorders:
            recorder.take()
        if self._log is not None and choice is not None:
            for i, sliding in enumerate(self._sliding):
                if sliding is not None and not result[2][i] and (active is None or active[i]):
                    speed = float(self.batch.vehicles.trace[i, -1, SPEED])
                    sliding.advance(self._log[i], choice[i], speed)
        if self._view is None:
            return result
        observations, rewards, terminated, truncated = result
        paid = self._view.rewards(rewards, self._ordinary)
        return self._view.observe(observations), paid, terminated, truncated

    def _info(self, i: int) -> dict[str, Any]:
        """Info of one vehicle, after a reset as after a step."""
        if self._silent:
            return {}
        info = period_info(self.batch, i)
        info.update(self._conditions[i])
        if self._full:
            info.update(self._full_info(i))
        return info

    def _full_info(self, i: int) -> dict[str, Any]:
        """Forces, valves and sliding RMS of a vehicle, with ``info="full"``."""
        sliding = self._sliding[i]
        return {} if sliding is None else vehicle_info(self.batch, i, sliding)

    def _pictures(self) -> tuple[Any, ...]:
        """A picture of each vehicle; None of the first one that a window shows."""
        if self._renderer is None:
            from sayd_env.envs.rendering import Renderer  # noqa: PLC0415 - Matplotlib's typeface takes its time

            self._renderer = Renderer(self._recorders[0], str(self.render_mode))
        return tuple(self._renderer.draw(recorder) for recorder in self._recorders)

    def _close_window(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def get_state(self) -> EnvironmentState:
        """All of the environment, as a copy: for search, model-predictive control and continuation."""
        return EnvironmentState(
            vehicles=tuple(self.batch.get_state(i) for i in range(self.batch.count)),
            seeds=tuple(self._seeds),
            numbers=tuple(self._numbers),
            sliding=tuple(copy.deepcopy(self._sliding)),
            over=self._over.copy(),
            random=copy.deepcopy(self._np_random),
            random_seed=self._np_random_seed,
        )

    def set_state(self, state: EnvironmentState) -> None:
        """Go back to a state of this environment or of one that was made alike.

        What follows is the same bits as what followed there.

        Raises
        ------
        ConfigError
            A state of another environment or of another number of vehicles, or something else.
        """
        if not isinstance(state, EnvironmentState):
            raise ConfigError(f"state: found {shown(state)}; expected what get_state has returned")
        if self._full and None in state.sliding:
            raise ConfigError('state: found one without the sliding RMS that info="full" gives')
        self.batch.set_state(state.vehicles)
        self._seeds, self._numbers = list(state.seeds), list(state.numbers)
        self._sliding = list(copy.deepcopy(state.sliding))
        self._over[:] = state.over
        if self._view is not None:
            self._ordinary = ordinary_costs(self.batch)
        self._np_random, self._np_random_seed = copy.deepcopy(state.random), state.random_seed
        self._conditions = [episode_info(self.batch, i) for i in range(self.batch.count)]
        for recorder in self._recorders:
            recorder.begin()


def observation_box(interface: Interface) -> Any:
    """Space of one observation: the ranges of its signals."""
    low = np.array([signal.low for signal in interface.signals], dtype=np.float32)
    high = np.array([signal.high for signal in interface.signals], dtype=np.float32)
    shape = interface.shape
    return spaces.Box(
        np.broadcast_to(low, shape).copy(), np.broadcast_to(high, shape).copy(), dtype=np.float32
    )


def action_box(interface: Interface) -> Any:
    """Space of one action: a valve command for each valve or group of valves."""
    return spaces.Box(0.0, 1.0, (interface.actions,), dtype=np.float32)
