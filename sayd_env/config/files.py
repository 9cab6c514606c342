"""Files of a user: regular files of a limited size, refused before anything is read of them."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from sayd_env.config.errors import ConfigError

MIB = 2**20


def named_files(value: Any) -> Iterator[Path]:
    """Files that texts among nested mappings and lists name."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from named_files(item)
    elif isinstance(value, str) and _is_file(value):
        yield Path(value)


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except (OSError, ValueError):  # too long for a name, or a character that no name has
        return False


def read_bytes(path: Path, what: str, largest: int, most: int | None = None) -> bytes:
    """Content of a regular file.

    Parameters
    ----------
    path : Path
        The file. A pipe or a device is not waited for: it might never begin, or never end.
    what : str
        What it should be, for messages.
    largest : int
        Most bytes that it may have.
    most : int, optional
        Bytes that are read of its beginning; all by default.

    Raises
    ------
    ConfigError
        There is no such file, it is a directory, a pipe or a device, cannot be read, or is too large.
    """
    try:
        # Without waiting: to open a pipe for reading otherwise lasts until somebody writes to it.
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(descriptor, "rb") as file:
            about = os.fstat(descriptor)
            if not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
                raise ConfigError(f"{path}: is a device or a pipe, expected a {what}")
            # A file under /proc has no size before it is read, and one that waits for more gives None.
            wanted = 0 if about.st_size > largest else largest + 1 if most is None else most
            # Python takes as much memory as is asked for, whatever there is.
            content = file.read(min(wanted, about.st_size + 1) if about.st_size else wanted) or b""
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such {what}") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a directory, expected a {what}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError:  # a NUL or half of a surrogate pair
        raise ConfigError(f"{path}: is not a valid file name") from None
    if max(about.st_size, len(content)) > largest:
        raise ConfigError(f"{path}: is larger than {largest // MIB} MiB, the most that is read of a {what}")
    return content
