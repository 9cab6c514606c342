"""The archive of a policy file, whoever made it: limits come before reading, and nothing in it is run."""

from __future__ import annotations

import hashlib
import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config import DataError, files, parse_yaml
from sayd_env.config.explain import shown
from sayd_env.config.storage import uninterrupted

AnyArray = npt.NDArray[Any]
Arrays = Mapping[str, tuple[tuple[int, ...], str]]
"""Shape and type of each array."""

DESCRIPTION = "policy.yaml"
LARGEST = 256 * files.MIB
"""Bytes of a file."""
LONGEST_TEXT = 2**17
"""Bytes of a description."""
MOST_VALUES = 10_000
"""Values in a description, counted where they are referred to."""
_LARGEST_DIRECTORY = 2**16  # bytes of the list of members, which is read as a whole
_LARGEST_HEADER = 2**14  # bytes of an array beside its numbers
_END = struct.Struct("<4s4H2LH")  # the record with which an archive ends
_FIRST_DAY = (1980, 1, 1, 0, 0, 0)  # the same policy is the same file, whenever it is written
_BROKEN = (
    *(zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, RuntimeError),
    *(KeyError, ValueError, SyntaxError, tokenize.TokenError, MemoryError),
)
"""What the readers of the standard library and of NumPy raise about a damaged file."""


def read_bytes(path: Path) -> bytes:
    """Content of a file of limited size.

    Raises
    ------
    ConfigError
        There is no such file, it is too large, or it is no file but a device or a directory.
    """
    return files.read_bytes(path, "policy file", LARGEST)


def file_digest(path: Path | str) -> str:
    """SHA-256 of a file.

    Raises
    ------
    ConfigError
        As `read_bytes`.
    """
    return hashlib.sha256(read_bytes(Path(path))).hexdigest()


def shown_path(path: Path | str) -> str:
    """A path as a message shows it: as it is, unless a terminal would act on it or it is too long."""
    text = str(path)
    return text if text.isprintable() and len(text) < 1000 else shown(text)


@uninterrupted()
def pack(description: str, arrays: Mapping[str, AnyArray]) -> bytes:
    """Content of a policy file."""
    stream = io.BytesIO()
    np.savez(stream, **dict(arrays))  # type: ignore[arg-type] # no array is called allow_pickle
    with zipfile.ZipFile(stream, "a") as archive:
        archive.writestr(zipfile.ZipInfo(DESCRIPTION, _FIRST_DAY), description)
    return stream.getvalue()


class PolicyArchive:
    """A policy file that has been opened.

    Parameters
    ----------
    path : Path

    Raises
    ------
    ConfigError
        There is no such file.
    DataError
        It is damaged or no policy.
    """

    def __init__(self, path: Path) -> None:
        self._name = shown_path(path)
        content = read_bytes(path)
        try:
            mark, *_, directory, _, _ = _END.unpack(content[-_END.size :])
            if mark != b"PK\5\6" or directory > _LARGEST_DIRECTORY:
                raise ValueError
            self._archive = zipfile.ZipFile(io.BytesIO(content))
        except _BROKEN:
            raise self._damaged() from None
        self._members = {member.filename: member for member in self._archive.infolist()}

    def description(self) -> Any:
        """Content of the description.

        Raises
        ------
        DataError
            There is none, or it holds what no description does.
        ConfigError
            It is no YAML.
        """
        try:
            text = self._read(DESCRIPTION, LONGEST_TEXT).decode()
        except _BROKEN:
            raise self._damaged() from None
        where = f"{self._name}: {DESCRIPTION}"
        return _checked(parse_yaml(text, where), where)

    def optional(self, names: tuple[str, ...]) -> bool:
        """Whether the archive has arrays that it may have."""
        return any(f"{name}.npy" in self._members for name in names)

    def arrays(self, expected: Arrays) -> dict[str, AnyArray]:
        """The arrays, which are read-only.

        Raises
        ------
        DataError
            There are others, or numbers that are not finite.
        """
        allowed = {DESCRIPTION, *(f"{name}.npy" for name in expected)}
        for name in sorted(allowed ^ set(self._members)):
            problem = "lacks" if name in allowed else "holds"
            raise DataError(f"{self._name}: {problem} {shown(name)}, against its description")
        return {name: self._array(name, shape, kind) for name, (shape, kind) in expected.items()}

    def _array(self, name: str, shape: tuple[int, ...], kind: str) -> AnyArray:
        size = math.prod(shape) * np.dtype(kind).itemsize
        member = self._members[f"{name}.npy"]
        what = f"{self._name}: {name}: expected finite numbers of type {kind} and shape {shape}"
        if not size < member.file_size <= size + _LARGEST_HEADER:
            raise DataError(f"{what}, found {member.file_size} bytes")
        try:
            content = self._read(member.filename, size + _LARGEST_HEADER)
            stream = io.BytesIO(content)
            read_magic, read = np.lib.format.read_magic, np.lib.format.read_array_header_1_0
            if read_magic(stream) != (1, 0):
                raise ValueError
            found, is_fortran, dtype = read(stream)
            values = np.frombuffer(content, dtype, offset=stream.tell()) if dtype == kind else None
            if values is None or found != shape or not np.all(np.isfinite(values)):
                raise DataError(f"{what}, found {shown(dtype.name)} and {shown(found)}")
            return values.reshape(shape, order="F" if is_fortran else "C")
        except _BROKEN:
            raise self._damaged() from None

    def _read(self, name: str, largest: int) -> bytes:
        member = self._members[name]
        if member.file_size > largest or member.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            raise ValueError
        return self._archive.read(member)

    def _damaged(self) -> DataError:
        return DataError(
            f"{self._name}: is damaged or no policy; expected an archive of '{DESCRIPTION}' and weights, as "
            "'sayd train' and 'sayd export' write it"
        )


def _checked(content: Any, where: str) -> Any:
    """Refuse what a description does not hold: too many values, bytes, dates, numbers without end."""
    todo, count = [content], 0
    while todo:
        value = todo.pop()
        count += 1
        children = [*value, *value.values()] if isinstance(value, dict) else value
        if isinstance(value, dict | list):
            todo += children
        elif not (value is None or isinstance(value, str) or _is_number(value)):
            raise DataError(
                f"{where}: found {shown(value)}; expected text, finite numbers, true, false, null"
            )
        if count + len(todo) > MOST_VALUES:
            raise DataError(f"{where}: holds more than {MOST_VALUES} values")
    return content


def _is_number(value: Any) -> bool:
    return math.isfinite(value) if isinstance(value, float) else isinstance(value, int) and abs(value) < 2**63
