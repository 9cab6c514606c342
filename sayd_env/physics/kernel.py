"""The one decorator of all compiled code, with a cache that notices every change of a kernel source."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config as numba_config


def source_hash(folder: Path) -> str:
    """Hash of all Python sources below a folder (16 hexadecimal digits), the numba version and the processor.

    Numba keys its cache by the file of the compiled function alone, so an edit of a function that this one
    calls would go unnoticed. A cache directory named by the hash of all kernel sources cannot be stale.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_directory() -> Path:
    """Directory of the compiled kernels: below SAYD_CACHE_DIR, or the user's cache directory."""
    root = os.environ.get("SAYD_CACHE_DIR")
    if root is None:
        root = os.path.join(os.environ.get("XDG_CACHE_HOME", os.path.expanduser("~/.cache")), "sayd")
    return Path(root) / f"kernels-{source_hash(Path(__file__).parent)}"


CACHE_DIRECTORY = cache_directory()


def kernel(function: Callable[..., Any] | None = None, *, parallel: bool = False, inline: bool = False) -> Any:
    """Compile a function: cached on disk, IEEE arithmetic (no fast-math), NumPy's division by zero.

    Parameters
    ----------
    function : callable
        The function; omit it to pass options.
    parallel : bool
        Allow `numba.prange` loops.
    inline : bool
        Merge the function into its callers, so that a loop that calls it can become vector instructions.
    """

    def compile_(f: Callable[..., Any]) -> Any:
        previous = numba_config.CACHE_DIR
        numba_config.CACHE_DIR = str(CACHE_DIRECTORY)
        try:
            return numba.njit(
                cache=True, error_model="numpy", nogil=True, parallel=parallel, forceinline=inline
            )(f)
        finally:
            numba_config.CACHE_DIR = previous

    return compile_ if function is None else compile_(function)
