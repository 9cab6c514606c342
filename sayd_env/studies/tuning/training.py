"""Which settings does a training learn best with? A search by Optuna over short trainings, resumable."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import getitem
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import yaml

from sayd_env.agents.config import TrainConfig, load_train
from sayd_env.agents.search_config import RangeConfig, SearchConfig
from sayd_env.config import ConfigError, validate
from sayd_env.config.errors import Interrupted, StudyError
from sayd_env.config.loader import apply_overrides
from sayd_env.config.software import git_state
from sayd_env.config.storage import reserved, write_file
from sayd_env.report.columns import Column, Listing, Table
from sayd_env.report.figures import Plot, panels
from sayd_env.runs.context import Progress, silent
from sayd_env.runs.executors import ExecutorChoice
from sayd_env.studies.learning import EXTRA, train
from sayd_env.studies.seeds import train_seeds

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

JOURNAL, TRIALS, FINALISTS, SETTINGS = "study.journal", "trials", "finalists", "search.yaml"
"""Files of a search: what Optuna keeps, the trainings, those repeated, what was asked for."""
DONE = ("complete", "pruned")
TRIED = (
    Column("trial", "trial"),
    Column("state", "state"),
    Column("J", "J", digits=5, best=True),
    Column("mean", "of all seeds", digits=5, best=True),
    Column("steps", "steps"),
    Column("settings", "settings"),
)
"""Of the printed table."""


@dataclass(frozen=True)
class Trial:
    """A training of the search."""

    number: int
    state: str
    """``complete``, ``pruned`` where it was given up, ``failed``."""
    settings: Mapping[str, Any]
    cost: float | None
    """J of its best policy; None if it has none."""
    steps: int
    simulated_s: float
    """Driven by its vehicles, without evaluations."""
    repeated: tuple[float, ...] = ()
    """J with the further training seeds of a finalist."""

    @property
    def mean(self) -> float | None:
        """J of a finalist over all of its training seeds."""
        return fmean((self.cost or 0.0, *self.repeated)) if self.repeated else None


@dataclass(frozen=True)
class SearchResult:
    """All trials, and the training that they recommend."""

    algorithm: str
    search: SearchConfig
    base: TrainConfig
    trials: list[Trial]
    commit: str | None
    command: str

    @property
    def best(self) -> Trial:
        """The finalist with the lowest mean J; without finalists the complete trial with the lowest J.

        Raises
        ------
        StudyError
            There is none.
        """
        found = _by_cost(self.trials)
        if not found:
            raise StudyError("no trial has come to its end")
        return min(found, key=lambda trial: trial.mean or math.inf) if found[0].repeated else found[0]

    @property
    def simulated_s(self) -> float:
        """Driven by the vehicles of all trials and of what was repeated (s)."""
        return sum(trial.simulated_s * (1 + len(trial.repeated)) for trial in self.trials)

    def as_dict(self) -> dict[str, Any]:
        """Settings, J, and the budget."""
        return {
            "algorithm": self.algorithm,
            "settings": self.best.settings,
            "best_J": self.best.cost,
            "mean_J": self.best.mean,
            "finalists": {
                str(trial.number): [trial.cost, *trial.repeated] for trial in self.trials if trial.repeated
            },
            "trials": len(self.trials),
            "given_up": sum(trial.state == "pruned" for trial in self.trials),
            "simulated_s": self.simulated_s,
        }

    def tables(self) -> dict[str, Table]:
        """The trials."""
        names = list(self.search.ranges)
        rows = [
            [t.number, t.state, t.cost, t.mean, t.steps, t.simulated_s]
            + [_text(t.settings.get(n)) for n in names]
            for t in self.trials
        ]
        return {"trials": (("trial", "state", "J", "mean_J", "steps", "simulated_s", *names), rows)}

    def plots(self) -> dict[str, Plot]:
        """J of the trials."""
        return {"search": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the best trials and the budget."""
        done = sorted(
            (t for t in self.trials if t.cost is not None), key=lambda t: (t.mean or math.inf, t.cost)
        )
        rows = [
            {"trial": t.number, "state": t.state, "J": t.cost, "mean": t.mean, "steps": t.steps}
            | {"settings": ", ".join(f"{k.rpartition('.')[2]}={_text(v)}" for k, v in t.settings.items())}
            for t in done[:10]
        ]
        given_up = sum(t.state == "pruned" for t in self.trials)
        title = (
            f"{self.algorithm}: {len(self.trials)} trials, {given_up} given up; their vehicles drove "
            f"{self.simulated_s:.0f} s"
        )
        Listing(title, TRIED, rows).print(console, wide)

    def training_file(self) -> str:
        """Text of a training: the base with the settings that were found."""
        content = _with_settings(self.base, self.best.settings).model_dump(mode="json")
        head = [
            f"# {self.algorithm} with settings that `sayd tune` has found.",
            f"# command: {self.command}; commit: {self.commit}; {len(self.trials)} trials of "
            f"{self.search.total_steps} steps, {self.simulated_s:.0f} s driven; J {self._reached()}",
        ]
        return "\n".join(head) + "\n" + yaml.safe_dump(content, sort_keys=False, allow_unicode=True)

    def _reached(self) -> str:
        """J of the best, in words."""
        mean = self.best.mean
        seeds = "" if mean is None else f", {mean:.6g} in the mean of {1 + len(self.best.repeated)} seeds"
        return f"{self.best.cost:.6g}{seeds}"

    def _draw(self, figure: Figure) -> None:
        (axes,) = panels(figure, 1, size=(6.0, 4.2))
        for state, marker in (("complete", "o"), ("pruned", "x")):
            shown = [(t.number, t.cost) for t in self.trials if t.state == state and t.cost is not None]
            axes.plot([number for number, _ in shown], [cost for _, cost in shown], marker, label=state)
        again = [(t.number, cost) for t in self.trials for cost in t.repeated]
        axes.plot([number for number, _ in again], [cost for _, cost in again], "_", label="other seeds")
        axes.set(xlabel="trial", ylabel="J of the best policy")
        axes.legend()


def search(
    algorithm: str,
    settings: SearchConfig,
    folder: Path,
    *,
    seed: int = 0,
    command: str = "",
    executor: ExecutorChoice | None = None,
    progress: Progress = silent,
) -> SearchResult:
    """Look for the settings with which a training comes to the lowest J.

    Trials are trainings of fewer steps on the training's own environments, judged on its own evaluation
    scenarios. One that is worse than the median of the others at the same step is given up. All is kept in
    the folder: an interrupted search goes on with the trial that was under way, from the beginning of it.
    The first trial has the settings of the training itself, where the ranges hold them.

    Of many single trainings the best one is lucky, too. So the best trials, and the one with the training's
    own settings, are repeated with further training seeds; the lowest mean wins.

    Parameters
    ----------
    algorithm : str
        Of the training.
    seed : int
        Of the search.
    command : str
        How to repeat it.
    executor : ExecutorChoice, optional
        Makes the runs of evaluations.
    progress : Progress
        Gets the steps of all trials together.

    Raises
    ------
    ConfigError
        Optuna, torch or Stable-Baselines3 are not installed; a training of another algorithm, a setting that
        it does not have; a folder of another search, or in which another process searches.
    StudyError
        A file cannot be written, or no trial came to its end.
    Interrupted
        By Ctrl-C or SIGTERM; what was done is kept.
    """
    base = load_train(settings.training, _shortened(settings))
    if base.learning.algorithm != algorithm:
        raise ConfigError(
            f"tune {algorithm}: the training '{settings.training}' is one of {base.learning.algorithm}"
        )
    for name, each in settings.ranges.items():  # refused before the first trial
        ends = each.choices or (_typed(each, each.low), _typed(each, each.high))
        for value in ends:
            _with_settings(base, {name: value})
    with reserved(folder, "searches"):
        _check_folder(folder, settings, seed, base)
        run = _Search(base, settings, folder, executor or ExecutorChoice(), progress, seed)
        run.run()
        trials = run.repeated(run.trials())
    whole = load_train(settings.training)
    return SearchResult(algorithm, settings, whole, trials, git_state()[0], command)


def _with_settings(base: TrainConfig, found: Mapping[str, Any]) -> TrainConfig:
    """A training with other settings; one that it does not have, and a value not allowed, are refused."""
    assignments = [f"{key}={json.dumps(value)}" for key, value in found.items()]
    content = apply_overrides(base.model_dump(mode="json"), assignments, "ranges")
    return validate(TrainConfig, content, "ranges")


def _shortened(settings: SearchConfig) -> list[str]:
    steps = settings.total_steps
    return [f"total_steps={steps}", f"seed={settings.training_seed}", "evaluation.references=[]"]


def _check_folder(folder: Path, settings: SearchConfig, seed: int, base: TrainConfig) -> None:
    """Refuse to go on with another search, or with one of a training or an environment that has changed."""
    from sayd_env.agents.training import environment_digest  # noqa: PLC0415 - imports torch

    asked = {"seed": seed} | settings.model_dump(mode="json")
    asked |= {"base": base.model_dump(mode="json"), "environment": environment_digest(base)}
    text = yaml.safe_dump(asked, sort_keys=False, allow_unicode=True)
    path = folder / SETTINGS
    if path.exists():
        if path.read_bytes() != text.encode():
            raise ConfigError(f"{folder}: holds another search; take another --out, or the same settings")
        return
    write_file(path, text.encode())


class _Search:
    """A search under way."""

    def __init__(
        self,
        base: TrainConfig,
        settings: SearchConfig,
        folder: Path,
        executor: ExecutorChoice,
        progress: Progress,
        seed: int,
    ) -> None:
        try:
            import optuna  # noqa: PLC0415 - an extra
            from optuna.storages import JournalStorage  # noqa: PLC0415
            from optuna.storages.journal import JournalFileBackend  # noqa: PLC0415
        except ModuleNotFoundError as error:
            raise ConfigError(f"tune {EXTRA} (no module '{error.name}')") from None
        self.base, self.settings, self.folder = base, settings, folder
        self.executor, self.progress = executor, progress
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.optuna = optuna
        storage = JournalStorage(JournalFileBackend(str(folder / JOURNAL)))
        self.study = optuna.create_study(storage=storage, study_name="search", load_if_exists=True)
        self._take_up()
        # A resumed search must not draw again what it has drawn.
        drawn = len(self.study.get_trials(deepcopy=False))
        if drawn == 0:
            self._enqueue_own()
        self.study.sampler = optuna.samplers.TPESampler(
            # A prime far above the number of trials: seeds of resumed searches do not meet.
            seed=(seed + 7919 * drawn) % 2**32,
            n_startup_trials=settings.random_trials,
        )
        self.study.pruner = optuna.pruners.MedianPruner(
            n_startup_trials=settings.random_trials // 2,
            n_warmup_steps=int(settings.give_up_after * settings.total_steps),
        )

    def _take_up(self) -> None:
        """Do again what was under way when the search was interrupted."""
        states = self.optuna.trial.TrialState
        for trial in self.study.get_trials(states=(states.RUNNING,)):
            self.study.tell(trial.number, state=states.FAIL)
            self.study.enqueue_trial(trial.params)

    def _enqueue_own(self) -> None:
        """Try the training's own settings first."""
        content = self.base.model_dump(mode="json")
        own = {name: reduce(getitem, name.split("."), content) for name in self.settings.ranges}
        if all(each.holds(own[name]) for name, each in self.settings.ranges.items()):
            # As the range writes it: 0 and 0.0 are equal, their texts are not.
            choices = {
                name: json.dumps(next(choice for choice in each.choices if choice == own[name]))
                for name, each in self.settings.ranges.items()
                if each.choices
            }
            self.study.enqueue_trial(own | choices)

    def run(self) -> None:
        """Make the trials that are left."""
        states = self.optuna.trial.TrialState
        while True:
            done = len(self.study.get_trials(deepcopy=False, states=(states.COMPLETE, states.PRUNED)))
            if done >= self.settings.trials:
                return
            trial = self.study.ask()
            try:
                self._run(trial, done)
            except (KeyboardInterrupt, Interrupted):
                raise Interrupted(
                    f"{done} of {self.settings.trials} trials are done; go on with the same command"
                ) from None
            except Exception:  # not to be done again: it would fail again
                self.study.tell(trial, state=states.FAIL)
                raise

    def _run(self, trial: Any, number: int) -> None:
        """One trial, with so many before it."""
        found = {name: self._suggest(trial, name, each) for name, each in self.settings.ranges.items()}
        config, steps = _with_settings(self.base, found), self.settings.total_steps
        every = config.evaluation.every
        folder = self.folder / TRIALS / f"{trial.number:04d}"
        shutil.rmtree(folder, ignore_errors=True)

        def stop_rule(step: int, cost: float) -> bool:
            trial.report(cost, step // every * every)  # trials are compared at the same step
            return bool(trial.should_prune())

        def report(done: float, total: float, what: str = "") -> None:
            self._report(number * steps + done, f"trial {number + 1}, {what}")

        trained = train(config, folder, executor=self.executor, progress=report, stop_rule=stop_rule).trained
        given_up = trained.steps < config.total_steps
        driven = config.vehicle_seconds(trained.steps)
        for name, value in {"cost": trained.best, "steps": trained.steps, "driven": driven}.items():
            trial.set_user_attr(name, value)
        shutil.rmtree(folder / "checkpoints", ignore_errors=True)  # replayed steps take much room
        states = self.optuna.trial.TrialState
        if given_up:
            self.study.tell(trial, state=states.PRUNED)
        else:
            self.study.tell(trial, trained.best)

    def _report(self, done: float, what: str) -> None:
        """Report steps of all that can be: trials, and finalists with the training's own settings."""
        settings = self.settings
        trainings = settings.trials + (settings.finalists + 1) * len(settings.finalist_seeds)
        self.progress(done, trainings * settings.total_steps, what)

    def repeated(self, trials: list[Trial]) -> list[Trial]:
        """The trials, the best and the training's own settings repeated with further training seeds."""
        found = {trial.number: trial for trial in trials}
        for k, trial in enumerate(self._finalists(trials)):
            found[trial.number] = replace(trial, repeated=self._again(trial, k))
        return list(found.values())

    def _finalists(self, trials: list[Trial]) -> list[Trial]:
        if not self.settings.finalist_seeds:
            return []
        complete = _by_cost(trials)
        own = [trial for trial in complete if _with_settings(self.base, trial.settings) == self.base]
        return list({trial.number: trial for trial in [*complete[: self.settings.finalists], *own]}.values())

    def _again(self, trial: Trial, number: int) -> tuple[float, ...]:
        """J of a finalist with each of the further seeds, with so many finalists before it."""
        seeds = self.settings.finalist_seeds
        before = (self.settings.trials + number * len(seeds)) * self.settings.total_steps
        result = train_seeds(
            _with_settings(self.base, trial.settings),
            seeds,
            self.folder / FINALISTS / f"{trial.number:04d}",
            parallel=self.executor.count,
            progress=lambda done, total, what="": self._report(
                before + done, f"trial {trial.number + 1} again, {what}"
            ),
        )
        return tuple(result.best.values())

    def _suggest(self, trial: Any, name: str, each: RangeConfig) -> Any:
        if each.choices:  # Optuna keeps texts and numbers alone
            return json.loads(trial.suggest_categorical(name, [json.dumps(c) for c in each.choices]))
        if each.whole:
            return trial.suggest_int(name, _typed(each, each.low), _typed(each, each.high), log=each.log)
        return trial.suggest_float(name, each.low, each.high, log=each.log)

    def trials(self) -> list[Trial]:
        """All of them, but those that failed."""
        found = []
        for trial in self.study.get_trials(deepcopy=False):
            state, attributes = trial.state.name.lower(), trial.user_attrs
            if state in DONE:
                ranges = self.settings.ranges
                settings = {
                    name: json.loads(value) if ranges[name].choices else value
                    for name, value in trial.params.items()
                }
                found.append(
                    Trial(
                        trial.number,
                        state,
                        settings,
                        attributes["cost"],
                        attributes["steps"],
                        attributes["driven"],
                    )
                )
        return found


def _by_cost(trials: Sequence[Trial]) -> list[Trial]:
    """The complete ones, the lowest J first."""
    found = [trial for trial in trials if trial.state == "complete" and trial.cost is not None]
    return sorted(found, key=lambda trial: trial.cost or 0.0)


def _typed(each: RangeConfig, value: float | None) -> Any:
    assert value is not None  # the schema has made sure
    return int(value) if each.whole else value


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else json.dumps(value)
