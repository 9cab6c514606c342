"""Policies on the scenarios of a tuning, one after another, and a table of what came out that is not lost."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.control import load_controller, load_online
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.loader import read_text
from sayd_env.config.scenario import Scenario
from sayd_env.config.tuning import Gains, TuningConfig
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch, EpisodeState
from sayd_env.envs.keywords import configured
from sayd_env.envs.loop import NOT_FINITE, RUNNING
from sayd_env.envs.rollout import first_state
from sayd_env.report.files import ResultDirectory, csv_bytes
from sayd_env.runs.cache import fingerprint
from sayd_env.runs.policies import PASSIVE, PolicySpec

Array = npt.NDArray[np.float64]
KMH = 3.6


@dataclass(frozen=True)
class Evaluation:
    """A policy on all scenarios."""

    policy: str
    stage: str
    """What asked for it: ``reference``, ``search`` or ``polish``."""
    gains: Gains
    """What was tuned; empty for a reference."""
    costs: tuple[float, ...]
    """J of each scenario, with the charge for a derailment."""
    derailed: int
    """Scenarios that ended early."""

    @property
    def mean(self) -> float:
        """Mean of J."""
        return float(np.mean(self.costs))


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

    def costs(self, policy: PolicySpec) -> tuple[Array, int]:
        """J of a policy in each scenario, and how many of them ended early.

        J is minus the mean reward per second of the episode: by the on-line filter, with the charge for a
        derailment.

        Raises
        ------
        ConfigError
            A policy that does not fit, or conditions that are not allowed.
        StudyError
            A run that diverged.
        """
        batch, states = self._batch("passive" if policy.name == PASSIVE else "sayd")
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
        return total / batch.config.episode_s, int(np.count_nonzero(batch.vehicles.status != RUNNING))

    def _refuse_diverged(self, policy: PolicySpec, batch: EpisodeBatch) -> None:
        for i in np.flatnonzero(batch.vehicles.status == NOT_FINITE):
            seed = self._settings.scenarios[int(i)].seed
            raise StudyError(f"{policy.title}: the run of seed {seed} diverged")

    def _batch(self, damper: str) -> tuple[EpisodeBatch, list[EpisodeState]]:
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


def inputs_of(proving: Proving, settings: TuningConfig, policies: Sequence[PolicySpec]) -> str:
    """Fingerprint of all that the evaluations depend on beside the gains.

    Parameters
    ----------
    proving : Proving
    settings : TuningConfig
    policies : sequence of PolicySpec
        Policies whose parameters count.
    """
    what = settings.model_dump(include={"episode_s", "initial_current", "scenarios"})
    parameters = {
        spec.title: load_controller(spec.name, spec.parameters) if spec.stored is None else spec.parameters
        for spec in policies
    }
    modules = [Path(__file__)]
    online = load_online()  # J is taken by its filter
    return fingerprint(what, proving.environment, proving.scenario, parameters, online, modules=modules)


class Record:
    """Evaluations that survive an interruption: a CSV file, written anew after each, complete or not at all.

    Rows of other inputs (scenarios, software) are left out when it is read: they are computed again.

    Parameters
    ----------
    path : Path or None
        The file; None keeps nothing.
    inputs : str
        Fingerprint of what the evaluations depend on.
    gains : sequence of str
        Names of what is tuned.
    seeds : sequence of int
        Of the scenarios.

    Raises
    ------
    ConfigError
        The file cannot be read, or is no such table.
    """

    def __init__(self, path: Path | None, inputs: str, gains: Sequence[str], seeds: Sequence[int]) -> None:
        self._inputs, self._gains = inputs, tuple(gains)
        self._costs = tuple(f"J_{seed}" for seed in seeds)
        self._path = path
        self._directory = None if path is None else ResultDirectory(path.parent)
        self._known: dict[tuple[Any, ...], Evaluation] = {}
        if path is not None and path.is_file():
            self._read(path)

    @property
    def header(self) -> tuple[str, ...]:
        """Columns of the table."""
        return ("inputs", "policy", "stage", *self._gains, "J", "derailed", *self._costs)

    def __len__(self) -> int:
        """Evaluations that are known."""
        return len(self._known)

    def get(self, policy: str, gains: Gains) -> Evaluation | None:
        """Return what is known of a policy with some gains, or None."""
        return self._known.get(_key(policy, gains))

    def put(self, found: Evaluation) -> None:
        """Keep an evaluation.

        Raises
        ------
        ConfigError
            The file cannot be written.
        """
        self._known[_key(found.policy, found.gains)] = found
        if self._directory is not None and self._path is not None:
            self._directory.write({self._path.name: csv_bytes(self.header, self.rows())})

    def rows(self) -> list[list[Any]]:
        """All evaluations as rows of the table."""
        return [
            [self._inputs, e.policy, e.stage, *map(e.gains.get, self._gains), e.mean, e.derailed, *e.costs]
            for e in self._known.values()
        ]

    def _read(self, path: Path) -> None:
        lines = csv.DictReader(io.StringIO(read_text(path, "table of evaluations"), newline=""))
        try:
            rows, header = list(lines), set(lines.fieldnames or ())
        except csv.Error:
            rows, header = [], set()
        if not {"inputs", "policy", "stage", "derailed"} <= header:
            raise ConfigError(f"{path}: is no table of evaluations; choose another --out or remove it")
        for number, row in enumerate(rows, start=2):
            if row["inputs"] == self._inputs:
                found = self._evaluation(row, f"{path}: line {number}")
                self._known[_key(found.policy, found.gains)] = found

    def _evaluation(self, row: Mapping[str, Any], where: str) -> Evaluation:
        try:
            return Evaluation(
                policy=row["policy"],
                stage=row["stage"],
                gains={name: float(row[name]) for name in self._gains if row[name]},
                costs=tuple(float(row[name]) for name in self._costs),
                derailed=int(row["derailed"]),
            )
        except (KeyError, TypeError, ValueError):
            raise ConfigError(f"{where}: is no evaluation; remove the line") from None


def _key(policy: str, gains: Gains) -> tuple[Any, ...]:
    return policy, *sorted(gains.items())
