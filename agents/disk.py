"""Files and folders that are complete or not there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from sayd_env.config import ConfigError, StudyError


def write_file(path: Path, content: bytes) -> None:
    """Write a file under another name, then give it its own.

    Raises
    ------
    StudyError
        It cannot be written, for example because the disk is full. What was there is there still.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise StudyError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
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
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.mkdir()
        fill(temporary)
        for file in temporary.iterdir():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
        os.replace(temporary, path)
    except (OSError, RuntimeError) as error:  # torch tells of a full disk by a RuntimeError
        reason = error.strerror if isinstance(error, OSError) else None
        raise StudyError(f"{path}: cannot be written ({reason or error})") from None
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def remove_leftovers(folder: Path) -> None:
    """Remove what a run that was killed had not finished."""
    for path in folder.glob(".*.tmp"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def new_folder(folder: Path) -> None:
    """Make a folder for a new run.

    Raises
    ------
    ConfigError
        It is there already and not empty, or cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        occupied = any(folder.iterdir())
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made ({error.strerror or error})") from None
    if occupied:
        raise ConfigError(f"{folder}: is not empty; take another folder, or go on with that run by --resume")
