"""The errors that speak to the user: which file, which key, what was found, what is allowed."""

from __future__ import annotations

LONGEST_LINE, MOST_LINES = 1200, 30
"""What fits on a screen."""


class SaydError(Exception):
    """Bad input. The message stands alone: the command line prints it and exits with status 2.

    It may quote what a user has given: control characters are escaped, a long line loses its middle. (Who
    passes an error on from a worker may give the error itself in place of its message.)
    """

    def __init__(self, message: object = "") -> None:
        lines = [_printable(line) for line in str(message).split("\n")]
        if len(lines) > MOST_LINES:
            lines[MOST_LINES - 1 :] = [f"... and {len(lines) - MOST_LINES + 1} lines more"]
        super().__init__("\n".join(lines))


def _printable(line: str) -> str:
    if len(line) > LONGEST_LINE:
        half = (LONGEST_LINE - 5) // 2
        line = f"{line[:half]} ... {line[-half:]}"
    return "".join(sign if sign.isprintable() else repr(sign)[1:-1] for sign in line)


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
