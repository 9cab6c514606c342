"""How good is a policy? J on a fixed list of scenarios, for training and tuning, one policy after another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from sayd_env.config import StudyError
from sayd_env.config.control import load_online
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import Array
from sayd_env.envs.cost import episode_cost
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch, EpisodeState
from sayd_env.envs.keywords import configured
from sayd_env.envs.loop import NOT_FINITE, RUNNING, TERMS
from sayd_env.envs.rollout import first_state
from sayd_env.runs.cache import fingerprint
from sayd_env.runs.executors import THREADS, ExecutorChoice, KeptExecutor, computed
from sayd_env.runs.policies import PolicySpec

MOST_PREPARED = 16
"""Lists of vehicles that a process keeps ready."""


@dataclass(frozen=True)
class PolicyCosts:
    """A policy on all scenarios."""

    costs: Array
    """J of each scenario, with the charge for a derailment."""
    derailed: int
    """Scenarios that ended early."""


class PolicyEvaluator:
    """Runs policies on the same scenarios: tracks, vehicles, sensors.

    A vehicle is built and run in once; each policy starts from a copy of its state. What a scenario leaves
    open is drawn from its seed as the environment has it.

    Parameters
    ----------
    environment : str
        Name or path of the environment. Each policy gets it with the signals, valves and clock that it needs.
    cases : sequence of mapping
        Of each scenario the ``seed`` and the options of its episode.
    episode_s : float
        Time over which J is taken, s.
    reward : str, optional
        Name of the weights of J; the study's by default.
    initial_current : float
        Valve command of the run-in, where the valves have one.
    executor : ExecutorChoice, optional
        Makes the runs in as many pieces as it has workers; threads of this process by default. The costs do
        not depend on it.
    kept : KeptExecutor, optional
        The executor of this choice, where it serves several policies.

    Raises
    ------
    ConfigError
        An environment that cannot be used.
    """

    def __init__(
        self,
        environment: str,
        cases: Sequence[Mapping[str, Any]],
        *,
        episode_s: float,
        reward: str | None = None,
        initial_current: float = 0.0,
        executor: ExecutorChoice | None = None,
        kept: KeptExecutor | None = None,
    ) -> None:
        self._environment: dict[str, Any] = {
            "environment": environment,
            "episode_s": episode_s,
            "reward": reward,
        }
        self._cases, self._current = [dict(case) for case in cases], initial_current
        self._executor, self._kept = executor or ExecutorChoice(), kept
        self._pieces: dict[str, list[_Piece]] = {}
        self._sayd = configured(**self._environment, damper="sayd")

    def inputs(self, policy: PolicySpec) -> tuple[Any, ...]:
        """What the costs of a policy depend on; J is taken by the on-line filter."""
        environment = self._configured(policy)
        return self._cases, self._current, *environment, load_online(), policy.identity()

    def costs(self, policy: PolicySpec) -> PolicyCosts:
        """J of a policy in each scenario.

        Raises
        ------
        ConfigError
            A policy that does not fit, or conditions that are not allowed.
        StudyError
            A run that diverged, or workers that were lost again and again.
        """
        work = [(piece, policy) for piece in self._split(policy)]
        results = dict(computed(_costs, work, self._executor, self._kept))
        found = [results[i] for i in range(len(work))]
        return PolicyCosts(
            np.concatenate([costs for costs, _ in found]), sum(derailed for _, derailed in found)
        )

    def _configured(self, policy: PolicySpec) -> tuple[EnvironmentConfig, Scenario]:
        """Environment and scenario as a policy needs them."""
        config, scenario = self._sayd
        if policy.needs.get("damper") == "passive":
            config, scenario = configured(**self._environment, damper="passive")
        return policy.environment(config), scenario

    def _split(self, policy: PolicySpec) -> list[_Piece]:
        """The scenarios in the environment that a policy needs, in pieces."""
        key = str(sorted(policy.needs.items()))
        if key not in self._pieces:
            config, scenario = self._configured(policy)
            alone = self._executor.kind in {"", THREADS}  # the batch has threads of its own
            count = 1 if alone else min(self._executor.count, len(self._cases))
            threads = self._executor.workers if alone else 1
            ends = [len(self._cases) * i // count for i in range(count + 1)]
            self._pieces[key] = [
                _Piece(config, scenario, self._cases[a:b], self._current, threads) for a, b in pairwise(ends)
            ]
        return self._pieces[key]


@dataclass(frozen=True, eq=False)
class _Piece:
    """Some scenarios in one environment."""

    config: EnvironmentConfig
    scenario: Scenario
    cases: Sequence[Mapping[str, Any]]
    initial_current: float
    threads: int | None


_prepared: dict[str, tuple[EpisodeBatch, list[EpisodeState]]] = {}


def _vehicles(piece: _Piece) -> tuple[EpisodeBatch, list[EpisodeState]]:
    """The vehicles of some scenarios at step 0; a process keeps the latest ones."""
    key = fingerprint(piece.config, piece.scenario, piece.cases, piece.initial_current, piece.threads)
    if key not in _prepared:
        while len(_prepared) >= MOST_PREPARED:
            del _prepared[next(iter(_prepared))]
        batch = EpisodeBatch(
            piece.config, len(piece.cases), scenario=piece.scenario, num_threads=piece.threads
        )
        semi_active = isinstance(piece.scenario.damper, SaydDamperConfig)
        current = {"initial_current": piece.initial_current} if semi_active else {}
        episodes = []
        for case in piece.cases:
            options = {name: value for name, value in case.items() if name != "seed"}
            episodes.append(draw_episode(piece.config, case["seed"], 0, options | current, piece.scenario))
        batch.reset(range(batch.count), episodes, keep_run_in=True)
        _prepared[key] = batch, [batch.get_state(i) for i in range(batch.count)]
    return _prepared[key]


def _costs(work: tuple[_Piece, PolicySpec]) -> tuple[Array, int]:
    """J of a policy in some scenarios, and how many of them ended early."""
    piece, policy = work
    batch, states = _vehicles(piece)
    batch.set_state(states)
    actor, terms = policy.make(batch), np.zeros((batch.steps, batch.count, TERMS))
    observation = batch.observations()
    state, start = first_state(actor, batch)
    for n in range(batch.steps):
        action, state = actor.predict(observation, state, start, deterministic=True)
        start[:] = False
        observation, _, _, _ = batch.step(action)
        terms[n] = batch.vehicles.terms
    ended, period = batch.vehicles.status != RUNNING, batch.config.control_period
    for case, status in zip(piece.cases, batch.vehicles.status, strict=True):
        if status == NOT_FINITE:
            raise StudyError(f"{policy.title}: the run of seed {case['seed']} diverged")
    costs = [
        episode_cost(
            terms[: batch.elapsed[i], i], period, piece.config, piece.scenario.cost, terminated=ended[i]
        )
        for i in range(batch.count)
    ]
    return np.array([cost.total for cost in costs]), int(np.count_nonzero(ended))
