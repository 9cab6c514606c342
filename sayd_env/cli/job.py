"""One run of one command: where its result goes, how it reports progress, how it ends."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

if TYPE_CHECKING:
    from pydantic import BaseModel

    from sayd_env.report.files import Result
    from sayd_env.runs.context import Progress, RunContext

QUIET_SECONDS = 2.0
LINE_SECONDS = 10.0
PLAIN_WIDTH = 80


class Job:
    """A command's way out.

    Parameters
    ----------
    command : str
        The command's name; names the default directory.
    out : Path, optional
        Directory of the result, checked at once. Default: ``results/COMMAND``, or none at all with `as_json`.
    as_json : bool
        Print the result as JSON on standard output, and nothing else there.

    Raises
    ------
    ConfigError
        When the directory cannot be written to.
    """

    def __init__(self, command: str, out: Path | None, as_json: bool) -> None:
        from sayd_env.report.files import ResultDirectory  # noqa: PLC0415 - keeps --help fast

        self.command = command
        self.as_json = as_json
        self.console = _console(to_stderr=as_json)
        path = out if out is not None or as_json else Path("results") / command
        self.directory = None if path is None else ResultDirectory(path)

    def finish(
        self, result: Result, *, config: BaseModel | Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Store the result, then show it: JSON or the study's summary."""
        from sayd_env.report.files import document, json_text  # noqa: PLC0415

        content = document(result, config, seed, command_text())
        files = [] if self.directory is None else self.directory.save(result, content)
        result.summary(self.console)
        if self.directory is not None:
            names = ", ".join(path.name for path in files)
            self.console.print(
                f"{self.directory.path}: {names}", markup=False, highlight=False, soft_wrap=True
            )
        if self.as_json:
            sys.stdout.write(json_text(content))

    @contextmanager
    def runs(self, executor: str | None = None, workers: int | None = None) -> Iterator[RunContext]:
        """Give the study its executor, the cache in the result's directory and its progress.

        Raises
        ------
        Interrupted
            By Ctrl-C, where finished runs are kept.
        """
        from sayd_env.config.errors import Interrupted  # noqa: PLC0415 - keeps --help fast
        from sayd_env.runs.cache import RunCache  # noqa: PLC0415
        from sayd_env.runs.context import RunContext  # noqa: PLC0415
        from sayd_env.runs.executors import ExecutorChoice  # noqa: PLC0415

        folder = None if self.directory is None else self.directory.path / "runs"
        cache = RunCache(folder)
        try:
            with self.progress() as progress:
                yield RunContext(ExecutorChoice.parse(executor, workers), cache, progress)
        except KeyboardInterrupt:
            if folder is None:
                raise
            raise Interrupted(f"finished runs are in {folder}; the same command goes on") from None
        cache.forget_former()
        if cache.reused:
            self.console.print(f"{cache.reused} runs had been finished by an earlier start")

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Give the study a way to report progress: a bar on a terminal, else a line now and then.

        Both go to standard error, as does a word before and after the first start's compilation; a run that
        ends within two seconds shows no line.
        """
        from sayd_env.physics.kernel import announced_compilation  # noqa: PLC0415 - keeps --help fast

        errors = _console(to_stderr=True)

        def say(text: str) -> None:
            errors.print(f"sayd {self.command}: {text}", markup=False, highlight=False, soft_wrap=True)

        with announced_compilation(say):
            if errors.is_terminal:
                with self._bar(errors) as report:
                    yield report
            else:
                yield _Lines(self.command, errors)

    @contextmanager
    def _bar(self, errors: Console) -> Iterator[Progress]:
        from rich.progress import (  # noqa: PLC0415 - only a terminal needs it
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        columns = (
            TextColumn(self.command),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.description}", markup=False),
        )
        with Progress(*columns, console=errors, transient=True) as bar:
            task = bar.add_task("", total=None)

            def report(done: float, total: float, what: str = "") -> None:
                bar.update(task, completed=done, total=total, description=what)

            yield report


def command_text() -> str:
    """What was typed, as a shell would take it again."""
    return shlex.join(["sayd", *sys.argv[1:]])


class _Lines:
    """Progress for logs: nothing in the first two seconds, then at most one line in ten seconds."""

    def __init__(self, command: str, console: Console) -> None:
        self.command = command
        self.console = console
        self.next = time.monotonic() + QUIET_SECONDS

    def __call__(self, done: float, total: float, what: str = "") -> None:
        now = time.monotonic()
        if now < self.next:
            return
        self.next = now + LINE_SECONDS
        text = f"sayd {self.command}: {done:g} of {total:g} {what}".rstrip()
        self.console.print(text, markup=False, highlight=False, soft_wrap=True)


def _console(*, to_stderr: bool) -> Console:
    console = Console(stderr=to_stderr)
    # A file or a pipe has no width, whatever the environment says.
    return console if console.is_terminal else Console(stderr=to_stderr, width=PLAIN_WIDTH)
