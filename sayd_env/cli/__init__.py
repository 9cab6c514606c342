"""The command line, one command per study; the border at which every error becomes one message."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from io import TextIOWrapper
from itertools import pairwise
from typing import Any, NoReturn

from threadpoolctl import threadpool_limits

from sayd_env.config.errors import Interrupted, SaydError, StudyError, on_a_screen
from sayd_env.config.storage import ENDINGS

INPUT_ERROR = 2
FAILURE = 1
INTERRUPTED = 130
PATIENCE = 5.0
"""Seconds in which an interrupted process may clean up undisturbed."""
_interrupted_at: list[float] = []


def start() -> NoReturn:
    """``sayd`` as a process of its own.

    One that is interrupted ends at once: a compilation in another thread, which nothing can stop, would keep
    it alive for minutes. All that is to be saved or closed is by then.
    """
    for each in _endings():
        signal.signal(each, _interrupt)
    status = main()
    if status == INTERRUPTED:
        with suppress(OSError):  # nobody reads it
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)
    sys.exit(status)


def _endings() -> list[signal.Signals]:
    """Signals after which the process cleans up and ends; not those that whoever started it has it ignore."""
    return [each for each in ENDINGS if signal.getsignal(each) is not signal.SIG_IGN]


def _interrupt(*_: object) -> None:
    # One is enough: another one, as `timeout` and impatience send it, would break into what cleans up. But
    # where Python swallowed the first (in a finaliser), or cleaning up hangs, a later one ends the process.
    now = time.monotonic()
    if not _interrupted_at:
        _interrupted_at.append(now)
        raise KeyboardInterrupt
    if now > _interrupted_at[0] + PATIENCE:
        os._exit(INTERRUPTED)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``sayd``.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments without the program name; those of the process by default.

    Returns
    -------
    int
        Exit status: 0, 2 for bad input, 1 for a failed study or a defect, 130 when interrupted.
    """
    try:
        _prepare()
        status = _run(arguments)
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # The reader (head, less) has seen enough; the interpreter would complain when it flushes at exit.
        _drop_stdout()
        return FAILURE
    except OSError as error:
        _drop_stdout()
        _complain(f"error: {error.filename or 'standard output'}: {error.strerror or error}")
        return FAILURE
    except MemoryError:
        _complain("error: not enough memory; fewer workers or a shorter assessment.length need less")
        return FAILURE
    except Exception as error:
        # The last border: even a defect speaks in one line.
        if os.environ.get("SAYD_DEBUG"):
            traceback.print_exc()
        _complain(
            f"internal error: {type(error).__name__}: {str(error) or 'no message'}; please report it with "
            "the command (SAYD_DEBUG=1 shows where it happened)"
        )
        return FAILURE


def _prepare() -> None:
    # On matrices as small as ours BLAS threads only wait for each other, a hundred times as long as the work
    # takes when the cores are busy. The studies have threads of their own.
    threadpool_limits(1, "blas")  # NumPy's, which is loaded already
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # SciPy's, which is not
    # Matplotlib opens no window here, and cannot be imported with a backend that is not installed.
    os.environ.pop("MPLBACKEND", None)
    # A program whose standard streams are closed writes nowhere.
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115 - as long as the process
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    if isinstance(sys.stdout, TextIOWrapper):  # in another encoding than UTF-8 it lacks signs of our tables
        sys.stdout.reconfigure(errors="replace")


def _run(arguments: Sequence[str] | None) -> int:
    # Imported here so that an interrupt or a defect during the import is caught as well.
    import typer  # noqa: PLC0415
    from typer.exceptions import TyperException  # noqa: PLC0415

    from sayd_env.cli.app import app  # noqa: PLC0415
    from sayd_env.cli.output import typed  # noqa: PLC0415

    command = typer.main.get_command(app)
    typed[:] = sys.argv[1:] if arguments is None else arguments
    if (option := _without_a_path(typed)) is not None:
        _complain(f"error: {option}: found nothing; expected a path")
        return INPUT_ERROR
    verdicts = {
        Interrupted: ("interrupted; ", INTERRUPTED),
        StudyError: ("error: ", FAILURE),
        SaydError: ("error: ", INPUT_ERROR),
    }
    try:
        status = command.main(args=arguments, prog_name="sayd", standalone_mode=False)
    except SaydError as error:
        kind, status = next(verdict for type_, verdict in verdicts.items() if isinstance(error, type_))
        _complain(f"{kind}{error}")
        return status
    except TyperException as error:
        context = getattr(error, "ctx", None)
        hint = f" (see '{context.command_path} --help')" if context is not None else ""
        if reason := _reason(error).removesuffix("."):  # without arguments the help has been shown instead
            _complain(f"error: {reason}{hint}")
        return INPUT_ERROR
    except typer.Abort:
        return _interrupted()
    if status == INTERRUPTED:
        return _interrupted()
    return status if isinstance(status, int) else 0


def _without_a_path(arguments: Sequence[str]) -> str | None:
    """An option whose path is empty, which would be the working directory."""
    for option in ("--out", "--file", "-o"):
        if f"{option}=" in arguments or (option, "") in pairwise(arguments):
            return option
    return None


def _reason(error: Any) -> str:
    """What is wrong with an argument: after its option's name, what our parser or Typer says."""
    if getattr(error, "param", None) is None or type(error).__name__ != "BadParameter":
        return " ".join(error.format_message().split())  # lists of names have tabs
    return f"{error.param.opts[-1]} {error.message.removeprefix('Value error, ')}"


def _interrupted() -> int:
    _complain("interrupted; no result was written")
    return INTERRUPTED


def _complain(message: str) -> None:
    with suppress(OSError):  # nobody reads it
        print(f"sayd: {' '.join(on_a_screen(message).split())}", file=sys.stderr)


def _drop_stdout() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
