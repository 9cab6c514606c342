"""The compiled kernels on the disk, under a hash that every change of their sources changes."""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, config

from sayd_env.config.software import FLOORS
from sayd_env.config.user_cache import cache_folder, report_once

_PHYSICS = "sayd_env.physics"
_DECORATOR = re.compile(rb"^from sayd_env\.physics\.kernel import ", re.MULTILINE)
_IMPORT = re.compile(rb"^from (sayd_env[\w.]*) import (\([^)]*\)|.*)", re.MULTILINE)
_HOUR = 3600.0
numba_config: Any = config  # its settings are made at run time
_FunctionCache: Any = caching.FunctionCache  # without annotations
_NullCache: Any = caching.NullCache


def kernel_sources() -> dict[str, bytes]:
    """Sources that compiled code depends on, by module.

    These are the physics and all modules that import the decorator; then the modules that they import whole
    or whose constants (names in capitals) they import, for kernels take over constants; and so on.
    They are found where Python finds them: in a checkout some packages are elsewhere than in a wheel.
    """
    modules, found = _modules(), {}
    ahead = [name for name, source in modules.items() if _PHYSICS in name or _DECORATOR.search(source)]
    while ahead:
        name = ahead.pop()
        if name in modules and name not in found:
            found[name] = modules[name]
            ahead += _origins(modules[name])
    return dict(sorted(found.items()))


def source_hash() -> str:
    """Hash of all kernels' sources and of the numba version (16 hexadecimal digits).

    Numba keys its cache by the file of the compiled function alone, so an edit of a function that this one
    calls would go unnoticed. A folder named by the hash of all sources cannot be stale. (The processor is
    part of Numba's own index.)
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for name, source in kernel_sources().items():
        digest.update(f"{name}\0{len(source)}\0".encode())
        digest.update(source)
    return digest.hexdigest()[:16]


def _modules() -> dict[str, bytes]:
    found = {}
    for floor in FLOORS:
        spec = importlib.util.find_spec(f"sayd_env.{floor}")
        for place in (spec and spec.submodule_search_locations) or ():
            for path in Path(place).rglob("*.py"):
                parts = path.relative_to(place).with_suffix("").parts
                found[".".join(("sayd_env", floor, *parts)).removesuffix(".__init__")] = path.read_bytes()
    return found


def _origins(source: bytes) -> Iterator[str]:
    """Modules whose constants a module imports at its top level; other names that it imports may be some."""
    for module, names in _IMPORT.findall(source):
        for name in re.findall(rb"\w+", names):
            yield module.decode() if name.isupper() else f"{module.decode()}.{name.decode()}"


def kernel_folder() -> Path | None:
    """Folder of the compiled kernels, freed of what processes that were killed had not finished."""
    folder = cache_folder(f"kernels-{source_hash()}")
    if folder is not None:
        for path in folder.glob("*/*.tmp.*"):  # Numba's writer is done with them in less than a second
            with contextlib.suppress(OSError):
                if time.time() - path.stat().st_mtime > _HOUR:
                    path.unlink()
    return folder


def kernel_cache(function: Callable[..., Any], folder: Path | None) -> Any:
    """Numba's cache of a function in a folder; one that keeps nothing where the folder cannot serve.

    Left to itself Numba would go on to ``__pycache__``, whose code is not keyed by the hash of all sources.
    """
    before = numba_config.CACHE_DIR, numba_config.CACHE_LOCATOR_CLASSES
    try:
        numba_config.CACHE_DIR, numba_config.CACHE_LOCATOR_CLASSES = str(folder), "UserProvidedCacheLocator"
        return _NullCache() if folder is None else _TolerantCache(function)
    except RuntimeError:  # somebody else's subfolder
        report_once(f"{folder}: cannot be written everywhere; some kernels are compiled anew in each process")
        return _NullCache()
    finally:
        numba_config.CACHE_DIR, numba_config.CACHE_LOCATOR_CLASSES = before


class _TolerantCache(_FunctionCache):  # type: ignore[misc]
    """What cannot be read is compiled anew, and what cannot be written is not kept."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # a damaged file can raise anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        with contextlib.suppress(OSError):
            super().save_overload(sig, data)
