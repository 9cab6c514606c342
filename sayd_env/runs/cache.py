"""Finished runs on the disk, so that an interrupted study goes on where it stopped and none is made twice.

Each run is one file of NumPy arrays. Its folder holds the fingerprint of all sources that can change a run,
its name the fingerprint of everything else that the run depends on: a run whose inputs or whose software have
changed is not found, and computed anew. What is found but cannot be read counts as not found. Several
machines may share a folder.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import shutil
import time
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sayd_env.config.files import named_files
from sayd_env.config.plain import jsonable
from sayd_env.config.software import source_fingerprint
from sayd_env.config.storage import remove_leftovers, uninterrupted, write_file

Record = TypeVar("Record")
_DAY = 86400.0
_KEY = "_key"
"""Name under which a file says which run it is."""


class RunCache:
    """Records of runs by the fingerprints of their inputs.

    Parameters
    ----------
    folder : Path, optional
        Where they outlive the process; without, they are kept in memory alone.

    Attributes
    ----------
    reused : int
        Runs that were found on the disk.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._parent = folder
        self._folder = None if folder is None else folder / source_fingerprint()
        self._memory: dict[str, Any] = {}
        self.reused = 0

    def get(self, key: str, kind: type[Record]) -> Record | None:
        """Return a finished run, or None.

        Parameters
        ----------
        key : str
            From `fingerprint`.
        kind : type
            Dataclass of its record, whose fields are arrays, numbers, texts and None.
        """
        if isinstance(known := self._memory.get(key), kind):
            return known
        content = None if self._folder is None else _content(self._folder / f"{key}.npz")
        names = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
        if content is None or content.pop(_KEY, None) != key or not set(content) <= names:
            return None
        self.reused += 1
        record = self._memory[key] = kind(**dict.fromkeys(names) | content)
        return record

    @uninterrupted()
    def put(self, key: str, record: Any) -> None:
        """Keep the record of a finished run.

        Raises
        ------
        StudyError
            It cannot be written (a full disk, a removed directory).
        """
        self._memory[key] = record
        if self._folder is None:
            return
        stream = io.BytesIO()
        content: dict[str, Any] = {name: v for name, v in vars(record).items() if v is not None}
        np.savez_compressed(stream, **content | {_KEY: key})
        write_file(self._folder / f"{key}.npz", stream.getvalue())

    def forget_former(self) -> None:
        """Remove the runs of former software and unfinished files; call it when a study is complete.

        Other software's that were added to within a day stay: another machine may be at work on them.
        """
        if self._parent is None or self._folder is None or not self._folder.is_dir():
            return
        remove_leftovers(self._folder)
        for path in self._parent.iterdir():
            if path.name != self._folder.name and _is_fingerprint(path.name) and _is_old(path):
                shutil.rmtree(path, ignore_errors=True)


def fingerprint(*inputs: Any) -> str:
    """Hash of a run's inputs (16 hexadecimal digits).

    Parameters
    ----------
    *inputs
        Models, mappings, numbers, texts, whatever `jsonable` takes. The content of a file that a text names
        (a measured track, profile or throttle table) counts as well.

    Raises
    ------
    TypeError
        An input of another type.
    """
    plain = jsonable(inputs)
    digest = hashlib.sha256(json.dumps(plain, sort_keys=True).encode())
    for path in named_files(plain):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _is_fingerprint(name: str) -> bool:
    return len(name) == 16 and set(name) <= set("0123456789abcdef")


def _is_old(folder: Path) -> bool:
    with contextlib.suppress(OSError):  # another process has removed it
        return time.time() - folder.stat().st_mtime > _DAY
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
