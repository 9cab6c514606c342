"""Finished runs on the disk, so that an interrupted study goes on where it stopped.

Each run is one file of NumPy arrays in a directory whose name holds a fingerprint of everything that the run
depends on: configuration, data files that it names, software. A run whose inputs changed is therefore not
found, and computed anew. What is found in a file but cannot be read as that run counts as not found.
"""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import io
import json
import re
import shutil
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from sayd_env.config.plain import jsonable
from sayd_env.report.files import ResultDirectory, versions

Record = TypeVar("Record")

_PACKAGE = Path(__file__).resolve().parents[1]
_SOURCES = (
    *("sayd_env/config", "sayd_env/physics", "sayd_env/stability", "sayd_env/envs"),
    *("baselines", "agents"),
)
_DIGITS = 16
_FINGERPRINT, _NAME = "_fingerprint", "_name"  # keys of a file that say which run it is


class RunStore(Generic[Record]):
    """Runs of one kind, from the same inputs, told apart by a name.

    Parameters
    ----------
    folder : Path
        Where stores lie; each has its directories ``GROUP-FINGERPRINT`` there.
    group : str
        Name of this store; what does not belong into a folder's name becomes ``_``.
    kind : type
        Dataclass of a run; its fields are arrays, numbers and texts.
    *inputs
        Everything else that a run depends on: models, mappings, numbers, texts. The content of a file that a
        text names counts, too.

    Raises
    ------
    ConfigError
        The folder cannot be written to.

    Notes
    -----
    Threads may share a store. Files are complete or absent. Without the folder all runs are computed again.
    """

    def __init__(self, folder: Path, group: str, kind: type[Record], *inputs: Any) -> None:
        # A learned policy is called what its file says; a folder's name is no place for all of that.
        self.folder, self.group, self.kind = folder, re.sub(r"[^\w.@=+-]", "_", group), kind
        self.fingerprint = fingerprint(*inputs, modules=_modules(kind))
        self._directory = ResultDirectory(folder / f"{self.group}-{self.fingerprint}")
        self._lock = threading.Lock()
        self.reused = 0
        """Runs that were taken from the disk."""

    def get(self, name: str) -> Record | None:
        """Return a finished run, or None.

        Parameters
        ----------
        name : str
            Name of the run: letters, digits and ``_.-=``.
        """
        content = _content(self._directory.path / f"{name}.npz")
        if content is None or (content.pop(_FINGERPRINT, None), content.pop(_NAME, None)) != (
            self.fingerprint,
            name,
        ):
            return None
        if set(content) != {field.name for field in dataclasses.fields(self.kind)}:  # type: ignore[arg-type]
            return None
        with self._lock:
            self.reused += 1
        return self.kind(**content)

    def put(self, name: str, run: Record) -> None:
        """Keep a finished run under a name.

        Raises
        ------
        ConfigError
            It cannot be written (a full disk, a removed directory).
        """
        stream = io.BytesIO()
        content: dict[str, Any] = {**vars(run), _FINGERPRINT: self.fingerprint, _NAME: name}
        np.savez_compressed(stream, **content)
        self._directory.write({f"{name}.npz": stream.getvalue()})

    def remembered(self, name: str, compute: Callable[[], Record]) -> Record:
        """Return a run, from the disk if it is there, else computed and kept."""
        found = self.get(name)
        if found is None:
            found = compute()
            self.put(name, found)
        return found

    def forget_former(self) -> None:
        """Remove what this group kept for other inputs; call it when the study is complete."""
        for path in self.folder.glob(f"{self.group}-*"):
            ending = path.name.removeprefix(f"{self.group}-")
            former = len(ending) == _DIGITS and set(ending) <= set("0123456789abcdef")
            if former and ending != self.fingerprint:
                shutil.rmtree(path, ignore_errors=True)


def fingerprint(*inputs: Any, modules: Iterable[Path] = ()) -> str:
    """Hash of a run's inputs and of the software that computes it (16 hexadecimal digits).

    Parameters
    ----------
    *inputs
        Values that `config.plain.jsonable` knows.
    modules : iterable of Path
        Source files to count beside those of the floors below the studies.

    Raises
    ------
    TypeError
        An input of another type.
    """
    plain = jsonable(inputs)
    digest = hashlib.sha256(json.dumps([plain, versions()], sort_keys=True).encode())
    for path in _named_files(plain):
        digest.update(path.read_bytes())
    root = _PACKAGE.parent
    sources = [path for folder in _SOURCES for path in sorted((root / folder).rglob("*.py"))]
    for path in sources:
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    for path in modules:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:_DIGITS]


def _modules(kind: type) -> list[Path]:
    """Sources of a dataclass and its bases; the functions that fill them stand beside them."""
    return [Path(inspect.getfile(base)) for base in kind.__mro__ if dataclasses.is_dataclass(base)]


def _named_files(value: Any) -> Iterator[Path]:
    """Files that exist under a text of nested data: a measured track, profile or throttle table."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list):
        for item in value:
            yield from _named_files(item)
    elif isinstance(value, str) and _is_file(value):
        yield Path(value)


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except (OSError, ValueError):  # too long for a name, or a character that no name has
        return False


def _content(path: Path) -> dict[str, Any] | None:
    """Arrays of a file by name, single values as Python's own; None for a file that cannot be read."""
    if not path.is_file():
        return None
    try:
        # From memory, because NumPy leaves the file open if it is no archive.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            return {name: value if value.ndim else value.item() for name, value in file.items()}
    except Exception:  # a damaged archive fails in many ways, and all of them mean: compute it again
        return None
