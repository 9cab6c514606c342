"""How good is a policy: its J on a fixed list of scenarios, by the rollout evaluator."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from sayd_env.agents.config import EvaluationConfig, TrainConfig
from sayd_env.agents.policy_file import StoredPolicy

from sayd_env import baselines
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.keywords import configured
from sayd_env.envs.rollout import Policy, roll_out

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """One scenario."""

    speed_kmh: float
    wear: float
    seed: int


def cases(evaluation: EvaluationConfig) -> list[Case]:
    """All scenarios of an evaluation."""
    return [Case(*each) for each in product(evaluation.speeds_kmh, evaluation.wear, evaluation.seeds)]


class Judge:
    """Runs policies on the scenarios of a training's evaluation.

    What the list does not fix is drawn from each scenario's seed as the environment has it, the same for all
    policies.

    Parameters
    ----------
    config : TrainConfig

    Raises
    ------
    ConfigError
        Conditions that are not allowed.
    """

    def __init__(self, config: TrainConfig) -> None:
        settings = config.environment
        self._evaluation = config.evaluation
        self._threads = settings.threads
        self._keywords: dict[str, Any] = {
            "environment": settings.name,
            "reward": settings.reward,
            "episode_s": config.evaluation.episode_s,
        }
        self._learned: dict[str, Any] = {
            "valves": settings.valves,
            "observation": settings.observation,
            "history": settings.history,
            "control_period": settings.control_period,
        }
        self.cases = cases(config.evaluation)
        self._batch: EpisodeBatch | None = None

    def learned(self, policy: StoredPolicy) -> Array:
        """J of a learned policy in each scenario, with the charge for derailments."""
        if self._batch is None:
            self._batch = self._made(self._learned)
        return self._costs(self._batch, policy.bound(self._batch.interface))

    def reference(self, name: str) -> Array:
        """J of a controller of `baselines` in each scenario, on the signals and clock of the environment."""
        batch = self._made({"damper": "passive"} if name == "passive" else {})
        return self._costs(batch, baselines.make(name, batch.interface))

    def _made(self, keywords: dict[str, Any]) -> EpisodeBatch:
        config, scenario = configured(**self._keywords, **keywords)
        return EpisodeBatch(config, len(self.cases), scenario=scenario, num_threads=self._threads)

    def _costs(self, batch: EpisodeBatch, policy: Policy) -> Array:
        semi_active = isinstance(batch.scenario.damper, SaydDamperConfig)
        current = {"initial_current": self._evaluation.initial_current} if semi_active else {}
        episodes = [
            draw_episode(
                batch.config, case.seed, 0, {"speed_kmh": case.speed_kmh, "wear": case.wear} | current
            )
            for case in self.cases
        ]
        runs = roll_out(batch, policy, episodes, [batch.steps] * len(episodes))
        return np.array([run.episode_cost(batch.config, batch.scenario).total for run in runs])
