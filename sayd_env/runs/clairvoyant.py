"""A controller that knows the future: search over command sequences on the true simulator and its track.

A model-predictive controller whose model is the simulator itself, set back to the present state, and whose
forecast of the track is the track. It cannot be built; what it reaches says what is left for those that can.
The cost is the environment's own: minus its rewards, so filter, weights and charge for a derailment have no
second definition here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.base import is_multiple
from sayd_env.config.bound import SequenceSearch
from sayd_env.config.conditions import Line
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import Array
from sayd_env.envs.draw import Episode
from sayd_env.envs.episode_batch import EpisodeBatch, EpisodeState, checked_actions
from sayd_env.envs.loop import RUNNING

LEAST_SPREAD = 0.1
"""The spread of the sequences does not shrink below this share of what it began with."""
FINEST = 0.1
"""Changes of an iteration differ in size: from the spread down to this share of it."""


class Replays:
    """Vehicles that go on from one state, each with a sequence of commands of its own.

    A vehicle's results are the same bits alone and beside others: what a sequence costs here it costs
    wherever it is run from this state.

    Parameters
    ----------
    scenario : Scenario
        With the dampers that the environment needs.
    count : int
        Vehicles side by side.

    Attributes
    ----------
    seconds : float
        Simulated time of all vehicles so far, s.
    """

    def __init__(self, config: EnvironmentConfig, scenario: Scenario, count: int) -> None:
        # Nobody observes: the simplest observation is enough.
        self._config = config.model_copy(update={"observation": "signals"})
        self._batch = EpisodeBatch(self._config, count, scenario=scenario, num_threads=1)
        self.seconds = 0.0

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (n, A) of the commands of an episode."""
        return self._batch.steps, self._batch.interface.actions

    @property
    def line(self) -> Line | None:
        """What changes along the way of the episode that has begun; None where nothing does."""
        return self._batch.lines[0]

    def begin(self, episode: Episode) -> EpisodeState:
        """State at step 0 of an episode, behind its run-in; its sensors have no noise, which nobody reads.

        Raises
        ------
        ConfigError
            An episode that cannot be.
        StudyError
            It ends in the run-in: there is nothing to control.
        """
        batch = self._batch
        batch.reset(range(batch.count), [episode] * batch.count)
        if batch.vehicles.status[0] != RUNNING:
            raise StudyError(f"the run of seed {episode.seed} ended before step 0: {batch.ending(0)}")
        return self.state(0)

    def state(self, i: int) -> EpisodeState:
        """State of a vehicle after the last sequences."""
        state = self._batch.get_state(i)
        return replace(state, vehicle=replace(state.vehicle, noise=None))

    def costs(self, state: EpisodeState, sequences: Array) -> Array:
        """Run sequences of commands from a state on.

        Parameters
        ----------
        state : EpisodeState
            From `begin` or `state` of replays of the same environment.
        sequences : ndarray, shape (k, n, A)
            Commands of k vehicles, at most as many as there are, for n control periods.

        Returns
        -------
        ndarray, shape (k, n)
            What each control period adds to J times the length of the episode, s. The charge for a
            derailment, that of the whole rest of the episode, is in the period in which it happens.

        Raises
        ------
        ConfigError
            A command that is not a number from 0 to 1.
        """
        batch, (count, periods, actions) = self._batch, sequences.shape
        batch.set_state([state] * batch.count)
        active = np.arange(batch.count) < count
        commands = np.zeros((batch.count, periods, actions))
        commands[:count] = checked_actions(sequences, sequences.shape)
        costs = np.empty((count, periods))
        for p in range(periods):
            _, rewards, _, _ = batch.step(commands[:, p], active=None if count == batch.count else active)
            costs[:, p] = -rewards[:count]
        self.seconds += count * periods * self._config.control_period
        return costs


@dataclass(frozen=True)
class Found:
    """What a search has come to."""

    commands: Array
    """(n, A) of each control period."""
    J: float
    """Of the episode with these commands."""
    changes: int
    """Decisions at which another sequence was better than the plan, in all passes."""
    decisions: int
    """How many there were."""
    seconds: float
    """Simulated time, s."""


class SequenceSearcher:
    """Cross-entropy method on sequences of commands, with a receding horizon.

    At each decision the simulator runs sequences from the present state over the horizon. A sequence is the
    plan with a change: straight lines between knots, for each command one, over the window with which the
    horizon begins. Behind it the plan goes on as it is, so that what a change excites, above all hunting,
    which grows more slowly than the force falls, has time to cost. The best sequence becomes the plan, never
    a worse one; the spread of the changes is that of the best ones of the iteration before.

    Raises
    ------
    ConfigError
        A time of the settings that is no whole number of control periods.
    """

    def __init__(self, config: EnvironmentConfig, scenario: Scenario, settings: SequenceSearch) -> None:
        check_times(settings, config.control_period)
        self._settings, self._period, self._seconds = settings, config.control_period, config.episode_s
        self._replays = Replays(config, scenario, settings.samples)
        self._one = Replays(config, scenario, 1)

    def search(self, episode: Episode, plan: Array, guesses: Sequence[Array] = ()) -> Found:
        """Look for a better sequence of commands than a plan.

        Parameters
        ----------
        plan : ndarray, shape (n, A)
            Commands of each control period of the episode.
        guesses : sequence of ndarray, each of shape (n, A)
            Other sequences, which are tried at each decision; more than half the samples are not.

        Raises
        ------
        ConfigError
            An episode that cannot be, a command that is not a number from 0 to 1.
        """
        start = self._one.begin(episode)
        random = np.random.default_rng([self._settings.seed, episode.seed, episode.number])
        least = float(self._one.costs(start, plan[None]).sum())
        changes = decisions = 0
        for _ in range(self._settings.passes):
            found = plan.copy()
            cost, changed, decided = self._pass(start, found, guesses, random)
            changes, decisions = changes + changed, decisions + decided
            if not cost < least:
                break
            plan, least = found, cost
        seconds = self._replays.seconds + self._one.seconds
        return Found(plan, least / self._seconds, changes, decisions, seconds)

    def _pass(
        self, state: EpisodeState, plan: Array, guesses: Sequence[Array], random: np.random.Generator
    ) -> tuple[float, int, int]:
        """Improve a plan in place, decision by decision; returns its cost, changes and decisions."""
        horizon, step = round(self._settings.horizon_s / self._period), self._replan
        costs, changes, starts = np.empty(len(plan)), 0, range(0, len(plan), step)
        for p in starts:
            ahead = slice(p, p + horizon)
            others = [guess[ahead] for guess in guesses]
            better = self._decide(state, plan[ahead], others, random)
            changes += not np.array_equal(better, plan[ahead])
            plan[ahead] = better
            costs[p : p + step] = self._one.costs(state, plan[None, p : p + step])[0]
            state = self._one.state(0)
        return float(costs.sum()), changes, len(starts)

    @property
    def _replan(self) -> int:
        """Control periods between decisions."""
        return round(self._settings.replan_s / self._period)

    def _decide(
        self, state: EpisodeState, plan: Array, guesses: Sequence[Array], random: np.random.Generator
    ) -> Array:
        """The best sequence over the horizon, by the cost over all of it."""
        s, best, count = self._settings, plan, self._settings.samples
        bases = {knots: self._basis(knots, len(plan)) for knots in s.knots_s}
        spreads = {
            knots: np.full((basis.shape[1], plan.shape[1]), s.spread) for knots, basis in bases.items()
        }
        sizes = np.geomspace(1.0, FINEST, count)[:, None, None]
        window = self._window(len(plan))
        others = [np.concatenate([guess[:window], plan[window:]]) for guess in guesses][: count // 2]
        for i in range(s.iterations):
            knots = s.knots_s[i % len(s.knots_s)]
            basis, spread = bases[knots], spreads[knots]
            units = sizes * random.standard_normal((count, *spread.shape))
            changes = spread * units
            sequences = np.clip(best + basis @ changes, 0.0, 1.0)
            first = 1 + len(others)
            sequences[0], sequences[1:first] = best, np.reshape(others, (-1, *plan.shape))
            costs = self._replays.costs(state, sequences).sum(axis=1)
            order = np.argsort(costs[first:], kind="stable")[: max(2, round(s.elite * (count - first)))]
            learned = np.sqrt(np.mean(units[first:][order] ** 2, axis=0) / np.mean(units**2, axis=0))
            spreads[knots] = np.clip(learned * spread, LEAST_SPREAD * s.spread, s.spread)
            others = [np.clip(best + basis @ changes[first:][order].mean(axis=0), 0.0, 1.0)]
            best = sequences[int(np.argmin(costs))]  # the first of equal ones: the plan, if nothing is better
        return best

    def _window(self, periods: int) -> int:
        """Control periods over which the plan may change, of so many to the end of horizon or episode."""
        return min(round(self._settings.window_s / self._period), periods)

    def _basis(self, knots: float, periods: int) -> Array:
        """Changes of each control period by unit changes at the knots, shape (periods, knots).

        They end, with zero, at the end of the window.
        """
        window = self._window(periods)
        count = max(1, math.ceil(window * self._period / knots - 1e-9))
        places = np.linspace(0.0, window, count + 1)
        return np.stack(
            [np.interp(np.arange(periods), places, unit) for unit in np.eye(count + 1)[:-1]], axis=1
        )


def check_times(settings: SequenceSearch, period: float) -> None:
    """Refuse times of a search that are no whole numbers of control periods (s).

    Raises
    ------
    ConfigError
        There is one; the message names it.
    """
    for name in ("replan_s", "window_s", "horizon_s"):
        if not is_multiple(value := getattr(settings, name), period):
            raise ConfigError(f"search.{name}: found {value:g} s; expected a multiple of {period:g} s")
