"""Training: a learner on the batch environment, evaluated on a list of scenarios, safe against interruptions.

A run is a folder::

    config.yaml       everything that was chosen
    run.yaml          command, versions and inputs of each start
    progress.csv      what the algorithm reports, and tensorboard/ the same
    evaluations.csv   J in each scenario while it learned
    references.csv    J of the controllers to compare with
    best.npz          policy with the lowest J, in the mean of `evaluation.criterion` (`agents.policy_file`)
    last.npz          policy of the last checkpoint
    checkpoints/      from which a killed run goes on

All files are complete or not there. A resumed run goes on from its last checkpoint with the same weights,
optimiser, replayed steps and random numbers of the learner; its vehicles begin new episodes, and the former
rollouts that an estimator keeps are gathered anew.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat

from sayd_env.agents.config import MEANS, TrainConfig, load_train, refuse_changes
from sayd_env.agents.learner import (
    TrainingProgress,
    estimator_layers,
    load_model,
    make_model,
    policy_layers,
    save_model,
)
from sayd_env.agents.learning_env import environment_keywords, make_learning_env, seed_environments
from sayd_env.agents.policy_file import StoredPolicy, describe, read_policy, save_policy
from sayd_env.agents.table import Table
from sayd_env.agents.wandb_log import WandbWriter, service
from sayd_env.config import ConfigError, DataError, parse_yaml, read_text
from sayd_env.config.errors import Interrupted
from sayd_env.config.explain import shown
from sayd_env.config.files import MIB
from sayd_env.config.storage import remove_leftovers, reserved, write_files
from sayd_env.config.units import Array
from sayd_env.envs.cost import mean_cost
from sayd_env.envs.keywords import configured
from sayd_env.envs.registration import VERSION

CONFIG, RUN, BEST, LAST, CHECKPOINTS = "config.yaml", "run.yaml", "best.npz", "last.npz", "checkpoints"
LIBRARIES = ("torch", "stable_baselines3", "gymnasium", "numpy")
REPORT_SECONDS = 0.5
LOGS = 10
"""Entries of the log from one checkpoint to the next."""

Report = Callable[[float, float, str], None]
StopRule = Callable[[int, float], bool]
"""Gets steps and J of each evaluation, and says whether to stop there."""
Evaluator = Callable[[StoredPolicy | str], Array]
"""Gives J of a policy, or of that of a name, in each of `EvaluationConfig.cases`."""


@dataclass(frozen=True)
class Trained:
    """What a training has come to."""

    folder: Path
    config: TrainConfig
    steps: int
    seconds: float
    best: float
    """J of the best policy over the scenarios, in the mean by which it is judged."""
    evaluations: list[dict[str, Any]]
    references: list[dict[str, Any]]


def train(
    config: TrainConfig,
    folder: Path,
    evaluator: Evaluator,
    *,
    resume: bool = False,
    about: Mapping[str, Any] | None = None,
    progress: Report | None = None,
    stop_rule: StopRule | None = None,
    wandb: bool = False,
) -> Trained:
    """Train a policy.

    Parameters
    ----------
    config : TrainConfig
    folder : Path
        Where the run lives: a new or empty folder, or with `resume` one of a run.
    evaluator : callable
        Evaluates the policy as it is, and references, on the scenarios of the configuration.
    resume : bool
        Go on with a run from its last checkpoint.
    about : mapping, optional
        Command line, versions and the like, to be written into the run.
    progress : callable, optional
        Gets the steps done, the steps in all, and how things go.
    stop_rule : callable, optional
        Gets steps and J of each evaluation, in the mean by which policies are judged; the training stops
        where it returns True.
    wandb : bool
        Log at Weights & Biases as well.

    Raises
    ------
    ConfigError
        A configuration that does not fit, a folder that is not empty or in which another process trains, a
        run whose configuration is another.
    DataError
        A damaged checkpoint or table.
    StudyError
        A file cannot be written; the last checkpoint stays.
    Interrupted
        By Ctrl-C or SIGTERM, after all was saved.
    """
    if wandb:
        service()  # refused before there is a folder
    torch.set_num_threads(config.torch_threads)
    with reserved(folder, "trains"):
        run = _Run(config, folder, evaluator, resume=resume, about=dict(about or {}))
        run.stop_rule = stop_rule
        try:
            run.learn(progress or _silent, wandb=wandb)
        except KeyboardInterrupt:
            run.keep()
            raise Interrupted(
                f"saved at step {run.steps} of {config.total_steps}; go on with --resume {folder}"
            ) from None
        return run.outcome()


def environment_digest(config: TrainConfig) -> str:
    """Hash of environment and scenario, with all numbers that stand behind their names, and their version."""
    every = [environment_keywords(config, beside) for beside in (None, *config.environment.beside)]
    parts = [part.model_dump(mode="json") for keywords in every for part in configured(**keywords)]
    return hashlib.sha256(json.dumps([VERSION, *parts], sort_keys=True).encode()).hexdigest()


def _silent(done: float, total: float, what: str) -> None:
    """Report nothing."""


class _Run:
    """A run in its folder."""

    def __init__(
        self,
        config: TrainConfig,
        folder: Path,
        evaluator: Evaluator,
        *,
        resume: bool,
        about: dict[str, Any],
    ) -> None:
        self.config, self.folder, self.evaluator = config, folder, evaluator
        self.digest = environment_digest(config)
        starts = _starts(config, folder, self.digest) if resume else []
        self.env, self.encoding = make_learning_env(config)
        self.model = make_model(config, self.env)
        _make_folders(folder, resume=resume)
        self.origin = TrainingProgress(0, 0, len(starts), 0.0)
        found = _checkpoints(folder)
        if found:
            stored = load_model(found[-1], self.model)
            self.origin = TrainingProgress(stored.steps, stored.updates, len(starts), stored.seconds)
        self.steps, self.clock = self.origin.steps, time.monotonic()
        seed_environments(self.env, config.seed, self.origin.restarts)
        self.model.action_space.seed(config.seed + self.origin.restarts)
        self.evaluations = Table(folder / "evaluations.csv", numbers=("steps", "J"), until=self.steps)
        self.log = Table(folder / "progress.csv", numbers=("steps",), until=self.steps)
        for table in (self.evaluations, self.log):
            if table.rows:
                table.save()  # without the rows behind the checkpoint: they are made again
        self.references = Table(folder / "references.csv", numbers=("J",), texts=("policy",))
        self.best = _cost_of(folder / BEST)
        self.about = about | {"libraries": {name: metadata.version(name) for name in LIBRARIES}}
        start = {"begun": datetime.now(UTC).isoformat(timespec="seconds"), "step": self.steps} | self.about
        self.starts = [*starts, start]
        self.stop_rule: StopRule | None = None
        self.stopped = False
        text = {"environment_sha256": self.digest, "starts": self.starts}
        write_files(folder, {CONFIG: _yaml(config.model_dump(mode="json")), RUN: _yaml(text)})

    def learn(self, report: Report, *, wandb: bool) -> None:
        """Run what is left of the training."""
        writers: list[KVWriter] = [_Writer(self.log)]
        if find_spec("tensorboard"):
            writers.append(TensorBoardOutputFormat(str(self.folder / "tensorboard")))
        if wandb:
            content = self.config.model_dump(mode="json")
            writers.append(WandbWriter(self.folder, str(self.starts[0].get("begun")), content))
        self.model.set_logger(Logger(str(self.folder), writers))
        if not self.references.rows:
            for name in self.config.evaluation.references:
                report(self.steps, self.config.total_steps, f"evaluating {name}")
                self.references.add({"policy": name} | self._row(self.evaluator(name)))
            self.references.save()
        try:
            left = self.config.total_steps - self.steps
            if left > 0:
                self.model.learn(left, _Callback(self, report), log_interval=None, reset_num_timesteps=False)
            elif self.evaluated != self.steps:  # it was interrupted in its last evaluation
                self.evaluate()
            self.keep()
        finally:
            self.model.logger.close()
            self.env.close()

    @property
    def evaluated(self) -> int:
        """Steps at its last evaluation; -1 before the first."""
        return int(self.evaluations.rows[-1]["steps"]) if self.evaluations.rows else -1

    def progress(self) -> TrainingProgress:
        """How far it has come."""
        seconds = self.origin.seconds + time.monotonic() - self.clock
        return TrainingProgress(self.steps, self.model._n_updates, self.origin.restarts, seconds)

    def evaluate(self) -> None:
        """Evaluate the policy as it is, and keep it if it is the best."""
        now, policy = self.progress(), self._policy(None)
        costs = self.evaluator(policy)
        row = {"steps": now.steps, "seconds": round(now.seconds, 1)} | self._row(costs)
        self.evaluations.add(row)
        for name in MEANS.values():
            self.model.logger.record(f"evaluation/{name}", row[name])
        judged = row[MEANS[self.config.evaluation.criterion]]
        if judged < self.best:
            self.keep()  # a run that is killed goes on from here, and not from before its best policy
            save_policy(self.folder / BEST, self._policy(row["J"], judged))
            self.best = judged
        self.evaluations.save()
        self.stopped = self.stop_rule is not None and self.stop_rule(now.steps, judged)

    def keep(self) -> None:
        """Write a checkpoint, unless there is one of this step."""
        path = self.folder / CHECKPOINTS / f"{self.steps:012d}"
        if not path.exists():
            save_model(path, self.model, self.progress())
            save_policy(self.folder / LAST, self._policy(None))
        for old in _checkpoints(self.folder)[: -self.config.checkpoint.keep]:
            shutil.rmtree(old, ignore_errors=True)

    def outcome(self) -> Trained:
        """What it has come to."""
        now = self.progress()
        return Trained(
            self.folder,
            self.config,
            now.steps,
            now.seconds,
            self.best,
            self.evaluations.rows,
            self.references.rows,
        )

    def _row(self, costs: Array) -> dict[str, float]:
        settings = self.config.evaluation
        names = [f"J_{c['speed_kmh']:g}_kmh_wear_{c['wear']:g}_seed_{c['seed']}" for c in settings.cases]
        for each in self.config.environment.beside:
            names += [f"J_{each.title}_seed_{seed}" for seed in settings.beside_seeds]
        means = {
            MEANS["mean"]: mean_cost(costs, "arithmetic"),
            MEANS["geometric"]: mean_cost(costs, "geometric"),
        }
        return means | dict(zip(names, map(float, costs), strict=True))

    def _policy(self, cost: float | None, judged: float | None = None) -> StoredPolicy:
        layers, squash = policy_layers(self.model)
        config, now = self.config, self.progress()
        made = {
            "steps": now.steps,
            "seconds": round(now.seconds, 1),
            "J": cost,
            "judged": judged,
            "environment_version": VERSION,
            "environment_sha256": self.digest,
            "config": config.model_dump(mode="json"),
            **self.about,
        }
        description = describe(
            self.encoding.interface,
            name=f"{config.learning.algorithm}-s{config.seed}",
            view=config.view,
            inputs=config.inputs,
            memory=config.memory,
            clip=config.clip,
            output=config.output,
            network=config.network,
            estimate=config.estimator,
            squash=squash,
            made=made,
        )
        return StoredPolicy(description, layers, estimator=estimator_layers(self.model))


class _Callback(BaseCallback):
    """Evaluations, checkpoints and logs between the rollouts, where the learner is at rest."""

    def __init__(self, run: _Run, report: Report) -> None:
        super().__init__()
        self._run, self._report = run, report
        checkpoint = run.config.checkpoint.every
        self._every = (max(checkpoint // LOGS, 1), run.config.evaluation.every, checkpoint)
        # A run that was interrupted in an evaluation has its checkpoint at the same step.
        done = (run.steps, max(run.evaluated, 0), run.steps)
        self._next = [(steps // each + 1) * each for steps, each in zip(done, self._every, strict=True)]
        self._fresh, self._reported = True, 0.0
        self._rollout: Any = None

    def _on_rollout_start(self) -> None:
        run = self._run
        run.steps = self.model.num_timesteps
        if self._fresh and not run.evaluations.rows:  # what it is worth before it has learned anything
            run.evaluate()
        self._fresh = False
        self._estimate()
        self._due()

    def _on_rollout_end(self) -> None:
        if self.model.estimating is not None and isinstance(self.model, PPO):
            self._rollout = self.model.rollout_buffer.observations  # the next rollout gets arrays of its own

    def _estimate(self) -> None:
        """Let the estimator learn between rollouts, where it changes no probability that was noted."""
        model: Any = self.model
        if model.estimating is None:
            return
        if self._rollout is not None:
            errors = model.estimating.pass_over(self._rollout.reshape(-1, self._rollout.shape[-1]))
            self._rollout = None
        elif isinstance(model, SAC) and model.num_timesteps > model.learning_starts:
            every = [model.replay_buffer.sample(model.batch_size) for _ in range(model.gradient_steps)]
            errors = model.estimating.named([model.estimating.update(each.observations) for each in every])
        else:
            return
        for name, error in errors.items():
            model.logger.record_mean(name, error)

    def _on_training_end(self) -> None:
        run = self._run
        run.steps = self.model.num_timesteps
        if not run.stopped and run.evaluated != run.steps:
            run.evaluate()
        self.model.dump_logs()

    def _due(self) -> None:
        run = self._run
        for i, (every, work) in enumerate(
            zip(self._every, (self.model.dump_logs, run.evaluate, run.keep), strict=True)
        ):
            if run.steps >= self._next[i]:
                work()
                self._next[i] = (run.steps // every + 1) * every

    def _on_step(self) -> bool:
        now = time.monotonic()
        if now > self._reported + REPORT_SECONDS:
            self._reported = now
            best = f"best J {self._run.best:.4f}" if np.isfinite(self._run.best) else ""
            self._report(self.model.num_timesteps, self._run.config.total_steps, best)
        return not self._run.stopped


class _Writer(KVWriter):
    """The learner's log as a table."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0) -> None:
        """Add a row and write the table."""
        numbers = {key: value for key, value in sorted(key_values.items()) if isinstance(value, float | int)}
        self._table.add({"steps": step} | numbers)
        self._table.save()

    def close(self) -> None:
        """Nothing is left open."""


def _make_folders(folder: Path, *, resume: bool) -> None:
    """Make the folders of a run; refuse a new one in a folder that holds something."""
    try:
        remove_leftovers(folder)
        remove_leftovers(folder / CHECKPOINTS)
        # A run that was killed before it had written anything leaves the empty folder of its checkpoints.
        if not resume and any(path.name != CHECKPOINTS or any(path.iterdir()) for path in folder.iterdir()):
            raise ConfigError(
                f"{folder}: is not empty; take another folder, or go on with that run by --resume"
            )
        (folder / CHECKPOINTS).mkdir(exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made ({error.strerror or error})") from None


def _starts(config: TrainConfig, folder: Path, digest: str) -> list[dict[str, Any]]:
    """Former starts of a run; refuse to go on with another configuration."""
    for name in (CONFIG, RUN):
        if not (folder / name).is_file():
            raise ConfigError(f"--resume {folder}: holds no run of 'sayd train' (no {name})")
    refuse_changes(load_train(str(folder / CONFIG)), config, f"--resume {folder}")
    run = parse_yaml(read_text(folder / RUN, largest=MIB), str(folder / RUN))
    starts = run.get("starts") if isinstance(run, dict) else None
    if not isinstance(starts, list) or not all(isinstance(start, dict) for start in starts):
        raise DataError(f"{folder / RUN}: is damaged; expected the starts of the run")
    if run.get("environment_sha256") != digest:
        raise ConfigError(
            f"--resume {folder}: the environment '{config.environment.name}', or the study behind it, is "
            "another one than when the run began; start a new run"
        )
    return starts


def _checkpoints(folder: Path) -> list[Path]:
    """Checkpoints of a run, the newest last."""
    return sorted(path for path in (folder / CHECKPOINTS).glob("[0-9]*") if path.is_dir())


def _cost_of(path: Path) -> float:
    """J of the best policy so far, in the mean by which it was judged; infinite if there is none.

    Raises
    ------
    DataError
        The file is damaged, or does not say.
    """
    if not path.is_file():
        return float("inf")
    found = read_policy(path).made("judged")
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise DataError(f"{path}: made.judged: found {shown(found)}; expected J of the best policy of a run")
    return float(found)


def _yaml(content: Any) -> bytes:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True).encode()
