"""How much of a policy is luck? The same training with several seeds, each in a process of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from sayd_env.agents.config import MEANS, load_train, refuse_changes
from sayd_env.agents.table import Table as Growing
from sayd_env.config import ConfigError, DataError, StudyError
from sayd_env.config.errors import Interrupted
from sayd_env.config.palette import policy_style
from sayd_env.config.storage import reserved, uninterrupted, write_file
from sayd_env.report.columns import Column, Listing, Table
from sayd_env.report.figures import Plot, legend_below, panels
from sayd_env.runs.context import Progress, silent

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from sayd_env.agents.config import TrainConfig

CONFIG, LOG = "config.yaml", "output.txt"
PROGRAM = (sys.executable, "-m", "sayd_env")
POLL_SECONDS = 1.0
LAST_LINES = 3
"""Of a process that failed, in the message."""
SEEDS = (
    Column("seed", "seed"),
    Column("J", "best J", digits=5, best=True),
    Column("steps", "steps"),
    Column("minutes", "minutes", digits=1),
)
"""Of the printed table."""


@dataclass(frozen=True)
class SeedsResult:
    """What the trainings have come to."""

    algorithm: str
    folders: Mapping[int, Path]
    """Run of each seed."""
    evaluations: Mapping[int, list[dict[str, Any]]]
    criterion: str
    """Column by which policies were judged."""

    @property
    def best(self) -> dict[int, float]:
        """J of each seed's best policy."""
        return {seed: min(row[self.criterion] for row in rows) for seed, rows in self.evaluations.items()}

    def as_dict(self) -> dict[str, Any]:
        """Runs and J."""
        return {
            "algorithm": self.algorithm,
            "runs": {str(seed): str(folder) for seed, folder in self.folders.items()},
            "best_J": {str(seed): cost for seed, cost in self.best.items()},
            "mean_best_J": float(np.mean(list(self.best.values()))),
        }

    def tables(self) -> dict[str, Table]:
        """J over the steps, seed by seed."""
        rows = [
            [seed, r["steps"], r[self.criterion]] for seed, each in self.evaluations.items() for r in each
        ]
        return {"seeds": (("seed", "steps", "J"), rows)}

    def plots(self) -> dict[str, Plot]:
        """The learning curves."""
        return {"learning": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print each seed's best policy."""
        rows = [
            {"seed": seed, "J": self.best[seed], "steps": each[-1]["steps"]}
            | {"minutes": each[-1]["seconds"] / 60.0}
            for seed, each in self.evaluations.items()
        ]
        mean = float(np.mean(list(self.best.values())))
        Listing(f"{self.algorithm}: mean best J {mean:.5f}", SEEDS, rows).print(console, wide)

    def _draw(self, figure: Figure) -> None:
        (axes,) = panels(figure, 1, size=(8.0, 4.5))
        for seed, rows in self.evaluations.items():
            name = f"{self.algorithm}-s{seed}"
            millions = [r["steps"] / 1e6 for r in rows]
            costs = [r[self.criterion] for r in rows]
            axes.plot(millions, costs, label=name, markersize=4, **policy_style(name).drawn)
        axes.set(xlabel="steps (millions)", ylabel="J of the scenarios", title=self.algorithm)
        axes.set_ylim(bottom=0.0)
        legend_below(figure, axes)


def train_seeds(
    config: TrainConfig,
    seeds: Sequence[int],
    folder: Path,
    *,
    parallel: int,
    wandb: bool = False,
    progress: Progress = silent,
) -> SeedsResult:
    """Train with several seeds, some of them side by side.

    Each training is a process of its own with one thread of each kind, so that as many as there are cores do
    not get into each other's way. Runs that are there already go on, finished ones stay as they are: the same
    call takes up what was interrupted.

    Parameters
    ----------
    config : TrainConfig
        Of all; its seed does not count.
    folder : Path
        Gets a run ``sSEED`` for each.
    parallel : int
        Trainings side by side.
    wandb : bool
        As `sayd_env.studies.learning.train`.
    progress : Progress
        Gets the steps of all together, as they log them.

    Raises
    ------
    ConfigError
        A folder in which another process trains, that cannot be made, or with a run that began otherwise.
    StudyError
        A training has failed; the others went on to their end.
    Interrupted
        By Ctrl-C or SIGTERM, after all were saved.
    """
    runs = {seed: folder / f"s{seed}" for seed in seeds}
    with reserved(folder, "trains"):
        waiting = [_Process(config, seed, run, wandb=wandb) for seed, run in runs.items()]
        for each in waiting:
            each.refuse_changes()
        _run(waiting, parallel, config.total_steps * len(seeds), progress)
    found = {
        seed: Growing(run / "evaluations.csv", numbers=("steps", "J")).rows for seed, run in runs.items()
    }
    return SeedsResult(config.learning.algorithm, runs, found, MEANS[config.evaluation.criterion])


def _run(waiting: list[_Process], parallel: int, total: float, progress: Progress) -> None:
    """Run processes, so many at a time."""
    every = list(waiting)
    try:
        while any(not each.ended for each in every):
            running = sum(each.running for each in every)
            while waiting and running < parallel:
                waiting.pop(0).start()
                running += 1
            at_work = [str(each.seed) for each in every if each.running]
            what = f"steps, seed{'s' if len(at_work) > 1 else ''} {', '.join(at_work)}" if at_work else ""
            progress(sum(each.steps() for each in every), total, what)
            time.sleep(POLL_SECONDS)
    except BaseException as error:
        for each in every:
            each.interrupt()
        if not isinstance(error, KeyboardInterrupt | Interrupted):
            raise
        raise Interrupted("all trainings were saved; go on with the same command") from None
    progress(sum(each.steps() for each in every), total, "")  # what the last ones did since they were asked
    failed = [each for each in every if each.failed]
    if failed:
        raise StudyError("; ".join(each.complaint() for each in failed))


class _Process:
    """A training in a process of its own."""

    def __init__(self, config: TrainConfig, seed: int, folder: Path, *, wandb: bool) -> None:
        self.seed, self.folder = seed, folder
        self._config, self._wandb = config.model_copy(update={"seed": seed}), wandb
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def _has_begun(self) -> bool:
        """Whether its folder holds a run."""
        return (self.folder / CONFIG).is_file()

    @property
    def running(self) -> bool:
        """Whether it has begun and not ended."""
        return self._process is not None and self._process.poll() is None

    @property
    def ended(self) -> bool:
        """Whether it has ended."""
        return self._process is not None and self._process.poll() is not None

    @property
    def failed(self) -> bool:
        """Whether it has ended otherwise than well."""
        return self._process is not None and self._process.poll() not in (None, 0)

    def refuse_changes(self) -> None:
        """Refuse to go on with a run in its folder that began otherwise."""
        if self._has_begun:
            refuse_changes(load_train(str(self.folder / CONFIG)), self._config, str(self.folder))

    def start(self) -> None:
        """Begin, or go on with the run in its folder."""
        beside = self.folder.parent
        if self._has_begun:
            where = ["--resume", str(self.folder), "--set", f"total_steps={self._config.total_steps}"]
        else:
            content = yaml.safe_dump(self._config.model_dump(mode="json"), sort_keys=False)
            given = beside / f"{self.folder.name}.yaml"
            write_file(given, content.encode())
            where = ["--config", str(given), "--out", str(self.folder)]
        command = [*PROGRAM, "train", *where, "--workers", "1"]
        command += ["--wandb"] if self._wandb else []
        alone = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        with (beside / f"{self.folder.name}-{LOG}").open("ab") as log, uninterrupted():
            self._process = subprocess.Popen(
                command,
                env=os.environ | alone,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,  # Ctrl-C reaches this process alone, which then ends them in order
            )

    def steps(self) -> float:
        """Steps that its last evaluation has come to, or what it logged last."""
        return max(_last_steps(self.folder / name) for name in ("evaluations.csv", "progress.csv"))

    def interrupt(self) -> None:
        """Let it save and end."""
        if self._process is None or self._process.poll() is not None:
            return
        self._process.send_signal(signal.SIGTERM)
        self._process.wait()

    def complaint(self) -> str:
        """What it said last."""
        path = self.folder.parent / f"{self.folder.name}-{LOG}"
        last = path.read_text(errors="replace").strip().splitlines()[-LAST_LINES:]
        return (
            f"seed {self.seed}: {' '.join(line.strip() for line in last) or 'ended without a word'} ({path})"
        )


def _last_steps(path: Path) -> float:
    """Steps in the last row of a table of a run; 0 before there is one."""
    with contextlib.suppress(ConfigError, DataError, StudyError, IndexError):
        return float(Growing(path, numbers=("steps",)).rows[-1]["steps"])
    return 0.0
