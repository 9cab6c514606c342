"""The errors that speak to the user: which file, which key, what was found, what is allowed."""

from __future__ import annotations


class SaydError(Exception):
    """Bad input. The message stands alone: the command line prints it and exits with status 2."""


class ConfigError(SaydError):
    """A configuration file, key or value that cannot be used."""


class DataError(SaydError):
    """A data file (profile, irregularity, signal, damper table) that cannot be used."""


class StudyError(SaydError):
    """A study that ran but failed; the command line exits with status 1."""


class Interrupted(SaydError):
    """Work that was interrupted and has kept what it had; the message says how to go on."""
