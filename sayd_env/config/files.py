"""Files of a user as bytes: regular files of a limited size, refused before they are read."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from sayd_env.config.errors import ConfigError

MIB = 2**20


def read_bytes(path: Path, what: str, largest: int) -> bytes:
    """Content of a regular file.

    Parameters
    ----------
    path : Path
        The file. A pipe or a device is not opened for reading: it might never end, or never begin.
    what : str
        What it should be, for messages.
    largest : int
        Most bytes that are read.

    Raises
    ------
    ConfigError
        There is no such file, it is a directory, a pipe or a device, cannot be read, or is too large.
    """
    try:
        # Without waiting: to open a pipe for reading otherwise lasts until somebody writes to it.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(descriptor, "rb") as file:
            kind = os.fstat(descriptor).st_mode
            if stat.S_ISREG(kind):
                content = file.read(largest + 1)  # a file under /proc has no size before it is read
            elif not stat.S_ISDIR(kind):
                raise ConfigError(f"{path}: is a device or a pipe, expected a {what}")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such {what}") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a directory, expected a {what}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:  # a NUL or half of a surrogate pair
        raise ConfigError(f"{path}: is not a valid file name") from None
    if len(content) > largest:
        raise ConfigError(f"{path}: is larger than {largest // MIB} MiB, the most that is read of a {what}")
    return content
