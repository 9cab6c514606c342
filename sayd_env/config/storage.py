"""Files that are complete or not there: the one way in which anything is written."""

from __future__ import annotations

import os
import platform
import re
import secrets
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from sayd_env.config.errors import ConfigError, StudyError

fcntl: Any
try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


ENDINGS = [signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals by which users and systems ask a process to end; Windows has no SIGHUP."""


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let Ctrl-C, and what else asks the process to end and is handled by it, wait until the context ends.

    For what must not stop halfway: an archive that is left open complains by an error of its own, and the
    interrupt is lost.
    """
    caught: list[tuple[Any, ...]] = []

    def note(*received: Any) -> None:
        caught.append(received)

    handlers: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():  # no other thread handles signals
        known = {each: signal.getsignal(each) for each in ENDINGS}
        handlers = {each: handler for each, handler in known.items() if callable(handler)}
    for each in handlers:
        signal.signal(each, note)
    try:
        yield
    finally:
        for each, handler in handlers.items():
            signal.signal(each, handler)
        for number, frame in caught:
            handlers[number](number, frame)


def write_file(path: Path, content: bytes) -> None:
    """Write a file under another name, then give it its own.

    Raises
    ------
    StudyError
        It cannot be written, for example because the disk is full. A former file is still there.
    """
    write_files(path.parent, {path.name: content})


def write_files(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    """Write several files: all of them are complete on the disk before the first gets its name.

    Parameters
    ----------
    folder : Path
        Made if need be.
    contents : mapping
        Content by file name; the files get their names in this order.

    Raises
    ------
    StudyError
        One of them cannot be written. Former files are still there.
    """
    temporaries = {name: _temporary(folder / name) for name in contents}
    try:
        with reported(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for name, temporary in temporaries.items():
                _write_synced(temporary, contents[name])
            for name, temporary in temporaries.items():
                os.replace(temporary, folder / name)
    finally:
        for temporary in temporaries.values():
            with suppress(OSError):  # what was reported above says more
                temporary.unlink(missing_ok=True)
    return [folder / name for name in contents]


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a name beside a file, under which it grows until it is complete and replaces it.

    The file's folder is made if need be.

    Raises
    ------
    StudyError
        It cannot be written. A former file is still there.
    """
    temporary = _temporary(path)
    try:
        with reported(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            _sync(temporary)
            os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_folder(path: Path, fill: Callable[[Path], None]) -> None:
    """Fill a folder under another name, then give it its own; nothing may have this name yet.

    Parameters
    ----------
    path : Path
    fill : callable
        Writes the files into the folder that it is given.

    Raises
    ------
    StudyError
        It cannot be written, for example because the disk is full. Nothing is left behind then.
    """
    temporary = _temporary(path)
    try:
        with reported(path):
            temporary.mkdir()
            fill(temporary)
            for file in temporary.iterdir():
                _sync(file)
            os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def try_to_write(folder: Path) -> None:
    """Find out whether files can be written into a folder, or where it would be made; nothing is left behind.

    Raises
    ------
    OSError, ValueError
        As the system says it.
    """
    while not _is_there(folder):
        folder = folder.parent
    tempfile.TemporaryFile(dir=folder).close()


def _is_there(path: Path) -> bool:
    try:
        path.lstat()
    except FileNotFoundError:
        return path == path.parent
    return True


def remove_leftovers(folder: Path) -> None:
    """Remove what processes of this machine had not finished when they were killed.

    Whatever is written does this first, once in a process for each folder: see `_temporary`.
    """
    for path in folder.glob(f".*.{_MACHINE}.*.tmp"):
        if _is_alive(*path.name.removesuffix(".tmp").split(".")[-2:]):
            continue
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


@contextmanager
def reserved(folder: Path, work: str) -> Iterator[None]:
    """Keep a folder, which is made if need be, for one process and work, which ends with the process at most.

    The lock is one of the operating system on the folder, and leaves nothing behind. Windows has none of this
    kind: there nobody is kept out.

    Raises
    ------
    ConfigError
        Another process works there, or the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = None if fcntl is None else os.open(folder, os.O_RDONLY)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{folder}: cannot be made ({getattr(error, 'strerror', None) or error})") from None
    if descriptor is None:
        yield
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                f"{folder}: another process {work} here; wait for its end, or take another folder"
            ) from None
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(descriptor)


@contextmanager
def reported(path: Path) -> Iterator[None]:
    """Turn the system's refusal to write into a `StudyError` that names the path."""
    try:
        yield
    except (OSError, RuntimeError) as error:  # torch reports a full disk by a RuntimeError
        reason = error.strerror if isinstance(error, OSError) else None
        raise StudyError(f"{path}: cannot be written ({reason or error})") from None


_MACHINE = re.sub(r"\W", "_", platform.node())
"""Several machines may write into one folder."""


_START = secrets.token_hex(4)
"""Several processes may have one number: in a container that is started again, each has that of the last."""


def _temporary(path: Path) -> Path:
    _remove_leftovers_once(path.parent)
    return path.with_name(f".{path.name}.{_MACHINE}.{_START}.{os.getpid()}.tmp")


_remove_leftovers_once = cache(remove_leftovers)


def _is_alive(start: str, process: str) -> bool:
    if process == str(os.getpid()):
        return start == _START
    if fcntl is None:  # Windows would end the process that is asked
        return True
    try:
        os.kill(int(process), 0)
    except (ValueError, OverflowError, ProcessLookupError):
        return False
    except PermissionError:  # somebody else's
        return True
    return True


def _sync(path: Path) -> None:
    with path.open("r+b") as stream:  # Windows syncs only what may be written
        os.fsync(stream.fileno())


def _write_synced(path: Path, content: bytes) -> None:
    with path.open("wb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())
