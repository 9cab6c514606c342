"""Time histories as files: CSV, Parquet, MATLAB's ``.mat`` and MDF 4.

CSV, Parquet and MATLAB have the unit in the name of each column, Parquet in the field's metadata, too, and
MDF beside the name. All hold the numbers as they are, none is rounded.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from sayd_env.config.errors import ConfigError
from sayd_env.config.storage import replacing
from sayd_env.config.units import Array

FORMATS = {"csv": ".csv", "parquet": ".parquet", "mat": ".mat", "mf4": ".mf4"}
"""Ending of the files by format."""


class FileSignal(NamedTuple):
    """A signal of a file."""

    name: str
    unit: str
    """``m/s2``; "-" where there is none."""
    full_name: str
    """Name with the unit."""
    values: Array
    """(t,)."""


def checked_format(kind: str, option: str = "--format") -> str:
    """Refuse what is no format, or one whose library is missing.

    Raises
    ------
    ConfigError
        Naming what is allowed, or what to install.
    """
    if kind not in FORMATS:
        raise ConfigError(f"{option} {kind}: unknown format; expected {', '.join(FORMATS)}")
    if kind in _LIBRARIES:
        _library(kind, option)
    return kind


def write_history(
    path: Path, kind: str, time: Array, signals: list[FileSignal], about: Mapping[str, str]
) -> None:
    """Write signals into one file, under another name until it is complete.

    Parameters
    ----------
    path : Path
    kind : str
        One of `FORMATS`.
    time : ndarray, shape (t,)
        s, rising.
    signals : list of FileSignal
    about : mapping
        What Parquet and MDF say of the file.

    Raises
    ------
    ConfigError
        The format's library is missing.
    StudyError
        The file cannot be written.
    """
    every = [FileSignal("time", "s", "time_s", time), *signals]
    with replacing(path) as temporary, temporary.open("wb+") as stream:
        _WRITERS[kind](stream, every, about)


def _write_csv(stream: BinaryIO, signals: list[FileSignal], about: Mapping[str, str]) -> None:
    import pandas  # noqa: PLC0415 - slow to import

    table = pandas.DataFrame({signal.full_name: signal.values for signal in signals})
    table.to_csv(stream, index=False, lineterminator="\n")


def _write_parquet(stream: BinaryIO, signals: list[FileSignal], about: Mapping[str, str]) -> None:
    arrow = _library("parquet")
    fields = [
        arrow.field(signal.full_name, arrow.float64(), metadata={"unit": signal.unit}) for signal in signals
    ]
    table = arrow.table(
        [signal.values for signal in signals], schema=arrow.schema(fields, metadata=dict(about))
    )
    import_module("pyarrow.parquet").write_table(table, stream)


def _write_mat(stream: BinaryIO, signals: list[FileSignal], about: Mapping[str, str]) -> None:
    from scipy.io import savemat  # noqa: PLC0415 - slow to import

    # A variable of MATLAB is letters, digits and underscores.
    named = {re.sub(r"\W", "_", signal.full_name): signal.values for signal in signals}
    savemat(stream, named, oned_as="column", do_compression=True)


def _write_mf4(stream: BinaryIO, signals: list[FileSignal], about: Mapping[str, str]) -> None:
    library = _library("mf4")
    time, *others = signals
    with warnings.catch_warnings(), library.MDF(version="4.10") as file:
        warnings.simplefilter("ignore")
        file.append(
            [
                library.Signal(
                    signal.values, time.values, name=signal.name, unit=signal.unit.replace("-", "")
                )
                for signal in others
            ],
            common_timebase=True,
        )
        file.header.comment = "; ".join(f"{key}: {value}" for key, value in about.items())
        file.save(stream, overwrite=True)


_LIBRARIES = {"parquet": "pyarrow", "mf4": "asammdf"}
_WRITERS: Mapping[str, Callable[[BinaryIO, list[FileSignal], Mapping[str, str]], None]] = {
    "csv": _write_csv,
    "parquet": _write_parquet,
    "mat": _write_mat,
    "mf4": _write_mf4,
}


def _library(kind: str, option: str = "--format") -> Any:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return import_module(_LIBRARIES[kind])
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"{option}: needs {_LIBRARIES[kind]}: install it with pip install 'sayd-env[measured]' "
            f"(no module '{error.name}')"
        ) from None
