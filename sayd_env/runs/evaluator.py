"""Policies on the scenarios of a tuning, one after another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sayd_env.config import StudyError
from sayd_env.config.control import load_online
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.tuning import TuningConfig
from sayd_env.config.units import Array
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch, EpisodeState
from sayd_env.envs.keywords import configured
from sayd_env.envs.loop import NOT_FINITE, RUNNING
from sayd_env.envs.rollout import first_state
from sayd_env.runs.policies import PASSIVE, PolicySpec


@dataclass(frozen=True)
class Costs:
    """A policy on all scenarios."""

    costs: Array
    """J of each scenario, with the charge for a derailment."""
    derailed: int
    """Scenarios that ended early."""


class Proving:
    """The vehicles of a tuning's scenarios, ready for one policy after another.

    All policies meet the same tracks, vehicles and sensors. A vehicle is built and run in once; each policy
    starts from a copy of its state.

    Parameters
    ----------
    settings : TuningConfig
    workers : int, optional
        Threads; all cores by default. The costs do not depend on it.

    Raises
    ------
    ConfigError
        An environment that cannot be used.
    """

    def __init__(self, settings: TuningConfig, workers: int | None = None) -> None:
        self._settings = settings
        self._workers = workers
        self._ready: dict[str, tuple[EpisodeBatch, list[EpisodeState]]] = {}
        self.environment, self.scenario = self._configured("sayd")

    def _configured(self, damper: str) -> tuple[EnvironmentConfig, Scenario]:
        settings = self._settings
        return configured(settings.environment, damper=damper, episode_s=settings.episode_s, reward="mppt2")

    def inputs(self) -> tuple[Any, ...]:
        """What the costs depend on beside the policy; J is taken by the on-line filter."""
        settings = self._settings
        what = settings.model_dump(include={"episode_s", "initial_current", "scenarios"})
        return what, self.environment, self.scenario, load_online()

    def costs(self, policy: PolicySpec) -> Costs:
        """J of a policy in each scenario.

        J is minus the mean reward per second of the episode: by the on-line filter, with the charge for a
        derailment.

        Raises
        ------
        ConfigError
            A policy that does not fit, or conditions that are not allowed.
        StudyError
            A run that diverged.
        """
        batch, states = self._fleet("passive" if policy.name == PASSIVE else "sayd")
        batch.set_state(states)
        actor, total = policy.make(batch), np.zeros(batch.count)
        observation = batch.observations()
        state, start = first_state(actor, batch)
        for _ in range(batch.steps):
            action, state = actor.predict(observation, state, start, deterministic=True)
            start[:] = False
            observation, rewards, _, _ = batch.step(action)
            total -= rewards
        self._refuse_diverged(policy, batch)
        derailed = int(np.count_nonzero(batch.vehicles.status != RUNNING))
        return Costs(total / batch.config.episode_s, derailed)

    def _refuse_diverged(self, policy: PolicySpec, batch: EpisodeBatch) -> None:
        for i in np.flatnonzero(batch.vehicles.status == NOT_FINITE):
            seed = self._settings.scenarios[int(i)].seed
            raise StudyError(f"{policy.title}: the run of seed {seed} diverged")

    def _fleet(self, damper: str) -> tuple[EpisodeBatch, list[EpisodeState]]:
        if damper not in self._ready:
            config, scenario = self._configured(damper)
            cases = self._settings.scenarios
            batch = EpisodeBatch(config, len(cases), scenario=scenario, num_threads=self._workers)
            semi_active = isinstance(scenario.damper, SaydDamperConfig)
            current = {"initial_current": self._settings.initial_current} if semi_active else {}
            episodes = [
                draw_episode(config, case.seed, 0, case.model_dump(exclude={"seed"}) | current)
                for case in cases
            ]
            batch.reset(range(batch.count), episodes, listen=True)
            self._ready[damper] = batch, [batch.get_state(i) for i in range(batch.count)]
        return self._ready[damper]
