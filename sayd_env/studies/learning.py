"""How well does a policy learn to control the valves? Training, as a result to keep and to look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.agents.pretrained.curves import draw_gains
from sayd_env.config import ConfigError
from sayd_env.config.software import provenance
from sayd_env.report.columns import Column, Listing
from sayd_env.report.figures import Plot, label, legend_below, panels
from sayd_env.report.files import Result
from sayd_env.runs.context import Progress, silent
from sayd_env.runs.executors import ExecutorChoice, KeptExecutor

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.agents.config import TrainConfig
    from sayd_env.agents.policy_file import StoredPolicy
    from sayd_env.agents.training import Evaluator, StopRule, Trained
    from sayd_env.config.units import Array
    from sayd_env.runs.policies import ForeignReader

EXTRA = "needs torch and Stable-Baselines3: install them with pip install 'sayd-env[train]'"


@dataclass(frozen=True)
class TrainResult(Result):
    """What a training has come to."""

    trained: Trained

    @property
    def _column(self) -> str:
        """Of the mean by which policies were judged."""
        from sayd_env.agents.config import MEANS  # noqa: PLC0415 - keeps the import of studies light

        return MEANS[self.trained.config.evaluation.criterion]

    def as_dict(self) -> dict[str, Any]:
        """Return what scripts read."""
        done = self.trained
        return {
            "algorithm": done.config.learning.algorithm,
            "run": str(done.folder),
            "steps": done.steps,
            "seconds": done.seconds,
            "best_J": done.best,
            "references": {row["policy"]: row[self._column] for row in done.references},
            "evaluations": done.evaluations,
        }

    def plots(self) -> Mapping[str, Plot]:
        """Return the learning curve."""
        return {"learning": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print how good the best policy is beside the references."""
        done = self.trained
        rows = [{"policy": "best policy", "J": done.best}]
        rows += [{"policy": row["policy"], "J": row[self._column]} for row in done.references]
        mean = done.config.evaluation.criterion
        kind = "mean" if mean == "mean" else f"{mean} mean of"
        title = f"{done.steps} steps in {done.seconds / 60:.1f} minutes; {kind} J of the scenarios"
        columns = (Column("policy", "policy"), Column("J", "J", digits=4, best=True))
        Listing(title, columns, rows).print(console, wide)

    def _draw(self, figure: Figure) -> None:
        done = self.trained
        (axes,) = panels(figure, 1, size=(8.0, 4.5))
        column = self._column
        course = [row["steps"] for row in done.evaluations], [row[column] for row in done.evaluations]
        name = f"{done.config.learning.algorithm}-s{done.config.seed}"
        draw_gains(axes, {name: course}, {label(row["policy"]): row[column] for row in done.references})
        axes.set_title(name)
        legend_below(figure, axes)


@dataclass(frozen=True)
class ExportResult(Result):
    """Files of an exported policy."""

    policy: str
    files: list[Path]
    made: Mapping[str, Any]
    """Where the policy comes from."""

    def as_dict(self) -> dict[str, Any]:
        """Return what scripts read."""
        return {"policy": self.policy, "files": [str(file) for file in self.files], "made": self.made}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the files."""
        for file in self.files:
            console.print(str(file), markup=False, highlight=False, soft_wrap=True)


def require_training() -> None:
    """Refuse to train where torch or Stable-Baselines3 are missing.

    Raises
    ------
    ConfigError
        The message says how to install them.
    """
    for module in ("torch", "stable_baselines3"):
        if find_spec(module) is None:
            raise ConfigError(f"train {EXTRA} (no module '{module}')")


def train(
    config: TrainConfig,
    folder: Path,
    *,
    resume: bool = False,
    command: str | None = None,
    executor: ExecutorChoice | None = None,
    progress: Progress = silent,
    stop_rule: StopRule | None = None,
    wandb: bool = False,
) -> TrainResult:
    """Train a policy.

    Parameters
    ----------
    folder : Path
        Where the run lives.
    resume : bool
        Go on with the run in the folder.
    command : str, optional
        How to repeat it; the policy's file keeps it.
    executor : ExecutorChoice, optional
        Makes the runs of the evaluations; by default threads on all cores.
    progress : Progress
        Gets the steps.
    stop_rule, wandb
        As `agents.training.train`.

    Raises
    ------
    ConfigError
        Torch or Stable-Baselines3 are not installed, or as `agents.training.train`.
    DataError, StudyError, Interrupted
        As `agents.training.train`.
    """
    try:
        from sayd_env.agents.training import train as learn  # noqa: PLC0415 - imports torch, which may be missing
    except ModuleNotFoundError as error:
        raise ConfigError(f"train {EXTRA} (no module '{error.name}')") from None
    about = provenance(command)
    with KeptExecutor(executor or ExecutorChoice()) as kept:
        evaluator = policy_evaluator(config, kept)
        options: dict[str, Any] = {
            "about": about,
            "progress": progress,
            "stop_rule": stop_rule,
            "wandb": wandb,
        }
        return TrainResult(learn(config, folder, evaluator, resume=resume, **options))


def policy_evaluator(config: TrainConfig, kept: KeptExecutor | None = None) -> Evaluator:
    """What evaluates policies on the scenarios of a training.

    Parameters
    ----------
    kept : KeptExecutor, optional
        Makes the runs; without, threads of this process do.

    Raises
    ------
    ConfigError
        An environment that cannot be used.
    """
    from sayd_env.runs.evaluator import PolicyEvaluator  # noqa: PLC0415 - keeps the import of studies light
    from sayd_env.runs.policies import learned_spec, policy_spec  # noqa: PLC0415

    settings, environment = config.evaluation, config.environment
    lists = [(environment.name, settings.episode_s, settings.cases)]
    along = [{"seed": seed} for seed in settings.beside_seeds]
    lists += [(each.name, each.episode_s, along) for each in environment.beside if along]
    evaluators = [
        PolicyEvaluator(
            name,
            cases,
            episode_s=seconds,
            reward=environment.reward,
            initial_current=settings.initial_current,
            executor=None if kept is None else kept.choice,
            kept=kept,
        )
        for name, seconds, cases in lists
    ]

    def evaluate(policy: StoredPolicy | str) -> Array:
        spec = policy_spec(policy) if isinstance(policy, str) else learned_spec(policy)
        return np.concatenate([each.costs(spec).costs for each in evaluators])

    return evaluate


def read_source(source: Path, foreign: ForeignReader | None = None) -> StoredPolicy:
    """Read a learned policy: of a file, the best one of a run's folder, or a ready one by its name.

    Parameters
    ----------
    foreign : callable, optional
        What reads a file of Stable-Baselines3; without, it is refused.

    Raises
    ------
    ConfigError
        No policy there, one that has not been learned here, or a file that is not trusted.
    DataError
        A damaged file.
    """
    from sayd_env.runs.policies import policy_spec  # noqa: PLC0415 - keeps the import of studies light

    found = policy_spec(str(source / "best.npz" if source.is_dir() else source), foreign).learned
    if found is None:
        raise ConfigError(f"{source}: has no weights; expected a learned policy, its file or a run's folder")
    return found


def export(stored: StoredPolicy, target: Path, *, onnx: bool) -> ExportResult:
    """Write a learned policy for others to use.

    Parameters
    ----------
    stored : StoredPolicy
        Of `read_source`.
    target : Path
        Folder for the files.
    onnx : bool
        Write an ONNX model besides.

    Raises
    ------
    ConfigError
        A file that exists already, or onnx is not installed.
    StudyError
        A file cannot be written.
    """
    from sayd_env.agents.policy_file import save_policy  # noqa: PLC0415 - keeps the import of studies light

    name = stored.description.name
    files = [target / f"{name}.npz"]
    if onnx:
        files.append(target / f"{name}.onnx")
    for file in files:
        if file.exists():
            raise ConfigError(f"{file}: exists already; nothing was written. Take another --out")
    if onnx:
        try:
            from sayd_env.agents.export import export_onnx  # noqa: PLC0415 - imports onnx, which may be missing
        except ModuleNotFoundError as error:
            raise ConfigError(
                "export --onnx needs onnx: install it with pip install 'sayd-env[onnx]' "
                f"(no module '{error.name}')"
            ) from None
        export_onnx(stored, files[1])
    save_policy(files[0], stored)
    return ExportResult(name, files, stored.description.made)
