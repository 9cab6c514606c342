"""Where a command's result goes and how it reports progress."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel
from rich.console import Console

from sayd_env.config.errors import SaydError, printable

if TYPE_CHECKING:
    from sayd_env.report.files import Result
    from sayd_env.runs.context import Progress

RESULTS = Path("results")
QUIET_SECONDS = 2.0
LINE_SECONDS = 10.0
PLAIN_WIDTH = 80
WIDE_WIDTH = 160


class Output:
    """A command's way out.

    Parameters
    ----------
    command : str
        The command's name.
    folder : Path, optional
        Directory of the result, checked at once; without, nothing is stored.
    as_json : bool
        Print the result as JSON on standard output, and nothing else there.
    wide : bool
        Print all columns of the tables.

    Attributes
    ----------
    stored : bool
        Whether the result is in its directory.

    Raises
    ------
    ConfigError
        When the directory cannot be written to.
    """

    def __init__(self, command: str, folder: Path | None, *, as_json: bool, wide: bool) -> None:
        from sayd_env.report.files import ResultDirectory  # noqa: PLC0415 - keeps --help fast

        self.command = command
        self.as_json = as_json
        self.wide = wide
        self.console = _console(to_stderr=as_json, width=WIDE_WIDTH if wide else PLAIN_WIDTH)
        self.directory = None if folder is None else ResultDirectory(folder)
        self.stored = False

    def finish(self, result: Result, config: Any, seed: int | None, *, quick: bool) -> None:
        """Store the result, then show it: JSON or the study's summary."""
        from sayd_env.cli.options import notes_of  # noqa: PLC0415 - keeps --help fast
        from sayd_env.report.files import document, json_text  # noqa: PLC0415

        content = document(result, config, seed, command_text()) | ({"quick": True} if quick else {})
        with suppress(SaydError):  # a measured file that was taken away since: no reason to lose the result
            if notes := notes_of(dict(config) if isinstance(config, BaseModel | Mapping) else {}):
                content.setdefault("notes", notes)
        former = None if self.directory is None else self.directory.former_command()
        files = [] if self.directory is None else self.directory.save(result, content)
        self.stored = self.directory is not None
        result.summary(self.console, wide=self.wide)
        if quick:
            self.say("--quick: a look, not a result")
        if self.directory is not None:
            self.say(f"{self.directory.path}: {', '.join(path.name for path in files)}")
            if former not in (None, command_text()):
                self.say(f"{self.directory.path}: replaces the result of '{former}'")
        if self.as_json:
            sys.stdout.write(json_text(content | {"written": [path.name for path in files]}))

    def say(self, text: str) -> None:
        """Print a line as it is."""
        _line(self.console, text)

    @contextmanager
    def progress(self) -> Iterator[Progress]:
        """Give the study a way to report progress: a bar on a terminal, else a line now and then.

        Both go to standard error, as does a word before and after the first start's compilation; a run that
        ends within two seconds shows no line.
        """
        from sayd_env.physics.kernel import announced_compilation  # noqa: PLC0415 - keeps --help fast

        errors = _console(to_stderr=True)
        with announced_compilation(lambda text: _line(errors, f"sayd {self.command}: {text}")):
            if errors.is_terminal:
                with _bar(self.command, errors) as report:
                    yield report
            else:
                yield _Lines(self.command, errors)


typed: list[str] = []
"""Arguments of the command that runs; `main` sets them."""


def command_text() -> str:
    """What was typed, as a shell would take it again."""
    return shlex.join(["sayd", *typed])


@contextmanager
def _bar(command: str, console: Console) -> Iterator[Progress]:
    from rich import progress as bars  # noqa: PLC0415 - only a terminal needs it

    what = bars.TextColumn("{task.description}", markup=False)
    parts = (
        bars.BarColumn(),
        bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
        bars.TimeRemainingColumn(),
    )
    with bars.Progress(bars.TextColumn(command), *parts, what, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)

        def report(done: float, total: float, what: str = "") -> None:
            bar.update(task, completed=done, total=total, description=what)

        yield report


class _Lines:
    """Progress for logs: nothing in the first two seconds, then at most one line in ten seconds."""

    def __init__(self, command: str, console: Console) -> None:
        self.command = command
        self.console = console
        self.next = time.monotonic() + QUIET_SECONDS

    def __call__(self, done: float, total: float, what: str = "") -> None:
        now = time.monotonic()
        if now >= self.next:
            self.next = now + LINE_SECONDS
            _line(self.console, f"sayd {self.command}: {done:,.10g} of {total:,.10g} {what}".rstrip())


class _SafeConsole(Console):
    """A console on which a name that holds control characters, as those of files may, moves no cursor."""

    def print(self, *objects: Any, **options: Any) -> None:
        def safe(text: str) -> str:
            return "\n".join(map(printable, text.split("\n")))

        super().print(*(safe(each) if isinstance(each, str) else each for each in objects), **options)


def _line(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _console(*, to_stderr: bool, width: int = PLAIN_WIDTH) -> Console:
    console = _SafeConsole(stderr=to_stderr)
    # A file or a pipe has no width, whatever the environment says.
    return console if console.is_terminal else _SafeConsole(stderr=to_stderr, width=width)
