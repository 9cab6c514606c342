"""A batch under a user's hands: seeds and their episodes, what is told of them, saved states.

What the single and the vector environment share.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from sayd_env.config import ConfigError
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.explain import shown
from sayd_env.config.scenario import Scenario
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch, EpisodeState, Flags, Observation
from sayd_env.envs.info import vehicle_info
from sayd_env.envs.interface import Interface
from sayd_env.envs.loop import LOG
from sayd_env.envs.recorder import Recorder
from sayd_env.envs.sliding_rms import SlidingRms

Array = npt.NDArray[np.float64]

SEEDS = 2**31
"""Seeds that are drawn, where none is given, are below it."""


@dataclass(frozen=True, eq=False)
class EnvironmentState:
    """All of an environment at an instant. It can be pickled, and set any number of times."""

    vehicles: tuple[EpisodeState, ...]
    seeds: tuple[int | None, ...]
    numbers: tuple[int, ...]
    running: tuple[SlidingRms | None, ...]
    over: npt.NDArray[np.bool_]
    """Vehicles whose episode has ended."""
    random: np.random.Generator | None
    random_seed: int | None

    def generator(self) -> np.random.Generator | None:
        """A copy of the environment's own source of random numbers."""
        return copy.deepcopy(self.random)


class Session:
    """Vehicles that run episode after episode.

    Parameters
    ----------
    config : EnvironmentConfig
    scenario : Scenario
    count : int
        Number of vehicles.
    num_threads : int, optional
        As in `VehicleBatch`.
    full : bool
        Tell all of a vehicle.
    """

    def __init__(
        self,
        config: EnvironmentConfig,
        scenario: Scenario,
        count: int,
        *,
        num_threads: int | None = None,
        full: bool = False,
    ) -> None:
        self.batch = EpisodeBatch(config, count, scenario=scenario, num_threads=num_threads)
        self.over = np.ones(count, dtype=np.bool_)
        self.full = full
        self._seeds: list[int | None] = [None] * count
        self._numbers = [0] * count
        self._running: list[SlidingRms | None] = [None] * count
        self._log = np.zeros((count, self.batch.settings.samples, LOG)) if full else None
        self._recorder: Recorder | None = None

    def watch(self) -> Recorder:
        """Keep what pictures of the first vehicle show, from now on."""
        if self._recorder is None:
            self._recorder = Recorder(self.batch)
        return self._recorder

    def begin(
        self,
        which: Sequence[int],
        seeds: Sequence[int | None],
        draw_seed: Callable[[], int],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin episodes.

        Parameters
        ----------
        which : sequence of int
            Vehicles that begin.
        seeds : sequence of int or None
            Each one's new seed, whose episode 0 begins; None for the next episode of the seed that it has.
        draw_seed : callable
            Gives a seed to one that never had any.
        options : mapping, optional
            Of `reset`.

        Raises
        ------
        ConfigError
            Options that are not allowed; nothing has changed then.
        """
        batch, chosen = self.batch, []
        for i, seed in zip(which, seeds, strict=True):
            known = self._seeds[i]
            if seed is not None:
                chosen.append((seed, 0))
            elif known is not None:
                chosen.append((known, self._numbers[i] + 1))
            else:
                chosen.append((draw_seed(), 0))
        episodes = [draw_episode(batch.config, seed, number, options) for seed, number in chosen]
        rows = batch.reset(which, episodes, log=self.full)
        for i, (seed, number), before in zip(which, chosen, rows, strict=True):
            self._seeds[i], self._numbers[i], self.over[i] = seed, number, False
            if self.full:
                self._run_in(i, before)
        if self._recorder is not None and self._recorder.vehicle in which:
            self._recorder.begin()

    def step(self, actions: Array, active: Flags | None = None) -> tuple[Observation, Array, Flags, Flags]:
        """Run one control period, as `EpisodeBatch.step` does."""
        batch = self.batch
        # f_0 moves at the end of a period: its samples were filtered in the bands before.
        choice = self._choice() if self._log is not None else None
        result = batch.step(actions, log=self._log, active=active)
        if self._recorder is not None:
            self._recorder.take()
        if self._log is not None and choice is not None:
            for i, running in enumerate(self._running):
                if running is not None and not result[2][i] and (active is None or active[i]):
                    running.advance(self._log[i], choice[i])
        return result

    def _choice(self) -> npt.NDArray[np.int64]:
        """Indices of f_0 of each vehicle's bogies, a new array of shape (count, BOGIES)."""
        return self.batch.vehicles.choice()

    def _run_in(self, i: int, rows: Array) -> None:
        batch, episode = self.batch, self.batch.episodes[i]
        assert episode is not None  # it has begun just now
        band = batch.vehicles.band
        running = SlidingRms(band, batch.scenario.assessment, episode.speed, batch.settings.sample_rate)
        if len(rows):
            running.run_in(rows, self._choice()[i])
        self._running[i] = running

    def told(self, i: int) -> dict[str, Any]:
        """Forces, valves and running values of a vehicle, if all is to be told."""
        running = self._running[i]
        return {} if running is None else vehicle_info(self.batch, i, running)

    def get_state(self, random: np.random.Generator | None, random_seed: int | None) -> EnvironmentState:
        """All of the session, as copies."""
        return EnvironmentState(
            vehicles=tuple(self.batch.get_state(i) for i in range(self.batch.count)),
            seeds=tuple(self._seeds),
            numbers=tuple(self._numbers),
            running=tuple(copy.deepcopy(self._running)),
            over=self.over.copy(),
            random=copy.deepcopy(random),
            random_seed=random_seed,
        )

    def set_state(self, state: EnvironmentState) -> None:
        """Put the session back to a state.

        Raises
        ------
        ConfigError
            A state of another environment or of another number of vehicles, or something else.
        """
        if not isinstance(state, EnvironmentState):
            raise ConfigError(f"state: found {shown(state)}; expected what get_state has returned")
        self.batch.set_state(state.vehicles)
        self._seeds, self._numbers = list(state.seeds), list(state.numbers)
        self._running = list(copy.deepcopy(state.running))
        self.over[:] = state.over
        if self._recorder is not None:
            self._recorder.begin()


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
