"""Arrays that take long to make, kept on disk beside the compiled kernels by what they are made from."""

from __future__ import annotations

import contextlib
import hashlib
import io
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from sayd_env.config.errors import StudyError
from sayd_env.config.storage import remove_leftovers, write_file
from sayd_env.config.units import Array
from sayd_env.config.user_cache import cache_folder
from sayd_env.physics.kernel import COMPILES


def cached_array(name: str, content: Iterable[bytes], length: int, make: Callable[[], Array]) -> Array:
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
        there is no place to write, or that runs kernels without compilation.
    """
    folder = cache_folder()
    if folder is None:
        return make()
    digest = hashlib.sha256()
    for part in content:
        digest.update(part)
    remove_leftovers(folder)
    file = folder / f"{name}-{digest.hexdigest()[:16]}.npy"
    found = stored_array(file, length)
    if found is None:
        found = make()
        if COMPILES:  # what Python makes of the same source differs in its last bits
            with contextlib.suppress(StudyError):  # a full disk: the next process makes it again
                write_file(file, _with_checksum(found))
    return found


def stored_array(file: Path, length: int) -> Array | None:
    """The array in a file, whose last number is the checksum of the others; None if there is no good one."""
    try:
        content = np.load(io.BytesIO(file.read_bytes()), allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    if content.shape != (length + 1,) or content.dtype != np.float64:
        return None
    values = content[:-1].copy()
    return values if content[-1] == _checksum(values) else None


def _with_checksum(values: Array) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.append(values, _checksum(values)))
    return stream.getvalue()


def _checksum(values: Array) -> float:
    return float(zlib.crc32(values.tobytes()))
