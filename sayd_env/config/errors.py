"""The errors that speak to the user: which file, which key, what was found, what is allowed."""

from __future__ import annotations

from itertools import accumulate

LONGEST_LINE, MOST_LINES, MOST_CHARACTERS = 1200, 22, 1900
"""What fits on a screen of 80 by 24."""


class SaydError(Exception):
    """Bad input. The message stands alone: the command line prints it and exits with status 2.

    It may quote what a user has given: control characters are escaped, a long line loses its middle. (Who
    passes an error on from a worker may give the error itself in place of its message.)
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(on_a_screen(str(message)))


def on_a_screen(message: str) -> str:
    """A message as a terminal takes it: control characters escaped, and no more than a screen holds of it."""
    lines = [_shortened(printable(_shortened(line))) for line in message.split("\n")]
    ends = accumulate(len(line) + 1 for line in lines)
    fitting = min(sum(end <= MOST_CHARACTERS for end in ends), MOST_LINES)
    if fitting < len(lines):
        kept = max(fitting - 1, 1)
        lines[kept:] = [f"... and {len(lines) - kept} lines more"]
    return "\n".join(lines)


def printable(text: str) -> str:
    """Text without what a terminal would act on, or could not show: it is escaped."""
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in text)


def _shortened(line: str) -> str:
    half = (LONGEST_LINE - 5) // 2
    return line if len(line) <= LONGEST_LINE else f"{line[:half]} ... {line[-half:]}"


class ConfigError(SaydError):
    """A configuration file, key or value that cannot be used."""


class DataError(SaydError):
    """A data file (profile, irregularity, signal, damper table) that cannot be used."""


class StudyError(SaydError):
    """A study that ran but failed; the command line exits with status 1."""


class Diverged(StudyError):
    """A simulation whose numbers did not stay finite or within the model."""


class Interrupted(SaydError):
    """Work that was interrupted and has kept what it had; the message says how to go on."""
