"""Runs in one condition: policies, the best constant command, the best of each section, and the search."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sayd_env.config.base import is_multiple
from sayd_env.config.bound import BoundCondition, BoundConfig, ConstantSearch, SequenceSearch
from sayd_env.config.control import load_online
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import Array, Integers
from sayd_env.envs.draw import Episode, draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.keywords import configured
from sayd_env.envs.rollout import Rollout, roll_out
from sayd_env.physics.throttle import overlap
from sayd_env.runs.along import Trip
from sayd_env.runs.clairvoyant import Found, Replays, SequenceSearcher
from sayd_env.runs.context import RunSpec
from sayd_env.runs.controlled import refuse_divergence
from sayd_env.runs.policies import PolicySpec
from sayd_env.studies.adaptation import CLOSED, DIGITS, OPEN, halfway
from sayd_env.studies.hindsight import best_by_section

CONSTANT = "best constant"
"""The best constant command of a condition."""
SCHEDULE = "best by section"
"""The best constant command of each section of its line; of the whole, where there is but one."""


class Setup(NamedTuple):
    """An environment as its configuration and weights have it."""

    config: EnvironmentConfig
    scenario: Scenario


@dataclass(frozen=True, eq=False)
class Case:
    """A condition in its environment."""

    condition: BoundCondition
    semi_active: Setup
    passive: Setup
    initial_current: float

    @classmethod
    def of(cls, config: BoundConfig, condition: BoundCondition) -> Case:
        """A condition of a study.

        Raises
        ------
        ConfigError
            An environment that cannot be used, or conditions that are not allowed.
        """
        given: dict[str, Any] = {
            "environment": condition.environment or config.environment,
            "episode_s": condition.episode_s or config.episode_s,
            "reward": config.reward,
        }
        setups = [Setup(*configured(**given, damper=damper)) for damper in ("sayd", "passive")]
        case = cls(condition, setups[0], setups[1], config.initial_current)
        case.episode(setups[0])  # refused before any work
        return case

    def setup(self, policy: PolicySpec) -> Setup:
        """The environment that a policy needs."""
        own = self.passive if policy.needs.get("damper") == "passive" else self.semi_active
        return Setup(policy.environment(own.config), own.scenario)

    def episode(self, setup: Setup) -> Episode:
        """What the condition is in an environment."""
        valves = {"initial_current": self.initial_current} if setup.config.damper == "sayd" else {}
        options = self.condition.options | valves
        return draw_episode(setup.config, self.condition.seed, 0, options, setup.scenario)

    def inputs(self) -> Sequence[Any]:
        """What a run depends on; J is taken by the on-line filter."""
        setups = (*self.semi_active, *self.passive)
        return self.condition.model_dump(), *setups, self.initial_current, load_online()


@dataclass(frozen=True, eq=False)
class CandidateRun(RunSpec):
    """What a condition is run with before the search."""

    case: Case
    policies: tuple[PolicySpec, ...]
    constant: ConstantSearch

    def inputs(self) -> Sequence[Any]:
        """What the candidates depend on."""
        identities = [policy.identity() for policy in self.policies]
        return *self.case.inputs(), identities, self.constant.model_dump()


@dataclass(frozen=True)
class Candidates:
    """What p policies and c constant commands cost in a condition, with their n commands each."""

    J: Array
    """(p,) of the policies, with the charge for a derailment."""
    derailed: Array
    """(p,) 1 for a run that ended early, else 0."""
    actions: Array
    """(p, n, A) of the policies; NaN for other valves, a clock that does not fit, and behind an early end."""
    currents: Array
    """(c,) constant commands that were tried."""
    J_constant: Array
    """(c,) their J."""
    section_currents: Array
    """(s,) the best one of each section of the line; of the whole, where there is but one."""
    schedule: Array
    """(n,) these commands, control period by control period."""
    J_schedule: float

    @property
    def best(self) -> int:
        """Place of the best constant command."""
        return int(np.argmin(self.J_constant))

    def sequences(self) -> list[tuple[int, float, Array]]:
        """Commands that can be run as they are, the best first: place, J, commands of shape (n, A).

        The places are those of the policies, then those of the best constant command and the schedule.
        """
        shape = self.actions.shape[1:]
        known = [(i, float(self.J[i]), own) for i, own in enumerate(self.actions)]
        usable = [each for each in known if np.all(np.isfinite(each[2]))]
        constant = np.full(shape, self.currents[self.best])
        schedule = np.broadcast_to(self.schedule[:, None], shape).copy()
        usable.append((len(self.J), float(self.J_constant[self.best]), constant))
        if len(self.section_currents) > 1:
            usable.append((len(self.J) + 1, self.J_schedule, schedule))
        return sorted(usable, key=lambda each: each[1])


def candidates(runs: list[CandidateRun]) -> list[Candidates]:
    """Run the candidates of conditions.

    Raises
    ------
    ConfigError
        A policy that does not fit.
    StudyError
        A run that diverged, or one that ends in its run-in.
    """
    return [_candidates(run) for run in runs]


def _candidates(run: CandidateRun) -> Candidates:
    constants = _Constants(run.case, run.constant)
    constants.look()
    chosen, place = constants.by_section()
    schedule = np.array(chosen)[place]
    rollouts = [_rolled_out(run.case, policy) for policy in run.policies]
    setups = [run.case.setup(policy) for policy in run.policies]
    costs = [
        rollout.episode_cost(setup.config, setup.scenario).total
        for rollout, setup in zip(rollouts, setups, strict=True)
    ]
    currents = sorted(constants.costs)
    return Candidates(
        J=np.array(costs),
        derailed=np.array([float(rollout.ending is not None) for rollout in rollouts]),
        actions=np.array(
            [
                _commands(rollout, setup, constants.shape, run.case)
                for rollout, setup in zip(rollouts, setups, strict=True)
            ]
        ).reshape(-1, *constants.shape),
        currents=np.array(currents),
        J_constant=np.array([constants.J(current) for current in currents]),
        section_currents=np.array(chosen),
        schedule=schedule,
        J_schedule=constants.of(schedule) if len(chosen) > 1 else min(map(constants.J, currents)),
    )


def _rolled_out(case: Case, policy: PolicySpec) -> Rollout:
    setup = case.setup(policy)
    batch = EpisodeBatch(setup.config, 1, scenario=setup.scenario, num_threads=1)
    (rollout,) = roll_out(batch, policy.make(batch), [case.episode(setup)], [batch.steps])
    if rollout.ending is not None:
        refuse_divergence(rollout)
    return rollout


def _commands(rollout: Rollout, setup: Setup, shape: tuple[int, int], case: Case) -> Array:
    """Commands of a policy, NaN where they are not those of the search's valves and clock."""
    own = case.semi_active.config
    if any(getattr(setup.config, key) != getattr(own, key) for key in ("damper", "valves")):
        return np.full(shape, np.nan)
    return _held(rollout.actions.astype(np.float64), setup.config.control_period, own.control_period, shape)


def _held(actions: Array, period: float, by: float, shape: tuple[int, int]) -> Array:
    """Commands of a period (s) by a clock of shorter ones; NaN behind the last, and where it does not fit."""
    found = np.full(shape, np.nan)
    if is_multiple(period, by):
        every = np.repeat(actions, round(period / by), axis=0)[: shape[0]]
        found[: len(every)] = every
    return found


class _Constants:
    """Constant commands in a condition: each is run once."""

    def __init__(self, case: Case, settings: ConstantSearch) -> None:
        config, scenario = case.semi_active
        assert isinstance(scenario.damper, SaydDamperConfig)  # the environment is one with valves
        self._settings, self._seconds = settings, config.episode_s
        self._closed = overlap(scenario.damper.throttle)
        self._replays = Replays(config, scenario, settings.abreast)
        episode = case.episode(case.semi_active)
        self._start = self._replays.begin(episode)
        self.shape = self._replays.shape
        line, times = self._replays.line, (np.arange(self.shape[0]) + 0.5) * config.control_period
        self._place = (
            np.zeros(self.shape[0], dtype=np.int64)
            if line is None
            else Trip(line, episode.speed).sections(times)
        )
        self._sections = int(self._place.max()) + 1  # those that the episode reaches
        self.costs: dict[float, Array] = {}
        """(n,) what each control period of a command adds to J times the episode's length, s."""

    def J(self, current: float) -> float:
        """J of a command that has been tried."""
        return float(self.costs[current].sum()) / self._seconds

    def of(self, commands: Array) -> float:
        """J of a sequence of commands for all valves, shape (n,)."""
        sequence = np.broadcast_to(commands[None, :, None], (1, *self.shape))
        return float(self._replays.costs(self._start, sequence).sum()) / self._seconds

    def look(self) -> None:
        """Look for the best command: all over the range, then between the neighbours of the best so far."""
        first = np.linspace(self._closed, OPEN, self._settings.abreast - 1)
        self._try([CLOSED, *first])
        for _ in range(self._settings.rounds - 1):
            currents = sorted(self.costs)
            best = int(np.argmin([self.J(current) for current in currents]))
            low, high = currents[max(best - 1, 0)], currents[min(best + 1, len(currents) - 1)]
            low = max(low, min(self._closed, high))  # up to there all commands act as one
            self._try(np.linspace(low, high, self._settings.abreast + 2)[1:-1])
        for _ in range(self._settings.refinements if self._sections > 1 else 0):
            tried = list(self.costs)
            self._try(
                [new for each in set(self.by_section()[0]) for new in halfway(each, tried, self._closed)]
            )

    def by_section(self) -> tuple[list[float], Integers]:
        """The best command of each section, and the section of each control period."""
        sections = {
            current: np.asarray(np.bincount(self._place, costs, self._sections), dtype=np.float64)
            for current, costs in self.costs.items()
        }
        return best_by_section(sections), self._place

    def _try(self, currents: Iterable[float]) -> None:
        """Run commands that have not been run before."""
        new = sorted({round(float(current), DIGITS) for current in currents} - set(self.costs))
        for first in range(0, len(new), self._settings.abreast):
            some = new[first : first + self._settings.abreast]
            sequences = np.broadcast_to(np.array(some)[:, None, None], (len(some), *self.shape))
            self.costs.update(zip(some, self._replays.costs(self._start, sequences), strict=True))


@dataclass(frozen=True, eq=False)
class SearchRun(RunSpec):
    """A search in a condition, from its candidates."""

    origin: CandidateRun
    settings: SequenceSearch
    plan: Array
    """(n, A) commands with which it starts."""
    guesses: tuple[Array, ...]
    """Others, likewise."""

    def inputs(self) -> Sequence[Any]:
        """What the search depends on; the candidates follow from their own inputs."""
        return *self.origin.inputs(), self.settings.model_dump()


def searches(runs: list[SearchRun]) -> list[Found]:
    """Search in conditions.

    Raises
    ------
    ConfigError
        Times of the search that do not fit the environment's clock.
    StudyError
        A condition that ends in its run-in.
    """
    return [_searched(run) for run in runs]


def _searched(run: SearchRun) -> Found:
    case = run.origin.case
    searcher = SequenceSearcher(*case.semi_active, run.settings)
    return searcher.search(case.episode(case.semi_active), run.plan, run.guesses)
