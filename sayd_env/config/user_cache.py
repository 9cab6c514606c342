"""Where this user's compiled kernels and long-made arrays are kept from one process to the next."""

from __future__ import annotations

import contextlib
import logging
import os
import stat
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from sayd_env.config.errors import on_a_screen


def cache_folder(name: str = "") -> Path | None:
    """Folder of this name that can be written, made if need be; None if there is no place for one.

    Tried are the directory that SAYD_CACHE_DIR names, the user's cache directory (XDG_CACHE_HOME or
    ``~/.cache``), and a directory among the temporary files that belongs to this user alone. One line in the
    log reports a SAYD_CACHE_DIR that cannot serve, and of no place at all.
    """
    for place in _places():
        if _is_writable(place / name):
            return place / name
    report_once("no cache directory can be written, set SAYD_CACHE_DIR: each process compiles anew")
    return None


def _places() -> Iterator[Path]:
    given = os.environ.get("SAYD_CACHE_DIR", "").strip()
    if given:
        yield Path(given).absolute()
        # The caller would not ask again if the first place had been usable.
        report_once(f"SAYD_CACHE_DIR: {given} cannot be written; another cache directory serves")
    base = os.environ.get("XDG_CACHE_HOME", "")
    with contextlib.suppress(RuntimeError):  # a user without a home
        yield (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "sayd"
    own = _own_temporary()
    if own is not None:
        yield own


def _own_temporary() -> Path | None:
    """Directory among the temporary files into which nobody else can put compiled code."""
    if not hasattr(os, "getuid"):  # Windows, where each user has temporary files of his own
        return Path(tempfile.gettempdir()) / "sayd"
    user = os.getuid()
    try:
        folder = Path(tempfile.gettempdir()) / f"sayd-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    private = stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & 0o077
    return folder if private else None


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True


@cache
def report_once(line: str) -> None:
    """Log a message once in a process; where none is set up, it appears on standard error."""
    logging.getLogger("sayd_env").warning("%s", on_a_screen(line))
