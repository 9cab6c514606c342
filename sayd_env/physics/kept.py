"""Arrays that take long to make, kept on disk beside the compiled kernels by what they are made from."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sayd_env.physics.kernel import CACHE_DIRECTORY

Array = NDArray[np.float64]


def kept(name: str, content: Iterable[bytes], length: int, make: Callable[[], Array]) -> Array:
    """Return a flat array, from the disk if it has been made before.

    Parameters
    ----------
    name : str
        What it is; the file's name begins with it.
    content : iterable of bytes
        All that it is made from, the sources that make it included.
    length : int
        Number of its elements.
    make : callable
        Makes it. It is called where there is no file, where the file is damaged, and in every process where
        there is no place to write.
    """
    digest = hashlib.sha256()
    for part in content:
        digest.update(part)
    file = CACHE_DIRECTORY.parent / f"{name}-{digest.hexdigest()[:16]}.npy"
    found = stored(file, length)
    if found is None:
        found = make()
        _store(file, found)
    return found


def stored(file: Path, length: int) -> Array | None:
    """The array in a file, whose last number is the checksum of the others; None if there is no good one."""
    try:
        content = np.load(io.BytesIO(file.read_bytes()), allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    if content.shape != (length + 1,) or content.dtype != np.float64:
        return None
    values = content[:-1].copy()
    return values if content[-1] == _checksum(values) else None


def _store(file: Path, values: Array) -> None:
    """Write the array in one move, so that another process finds all of it or nothing."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as temporary:
            try:
                np.save(temporary, np.append(values, _checksum(values)))
                os.replace(temporary.name, file)
            finally:
                Path(temporary.name).unlink(missing_ok=True)
    except OSError:
        return  # no place to write: the next process makes it again


def _checksum(values: Array) -> float:
    return float(zlib.crc32(values.tobytes()))
