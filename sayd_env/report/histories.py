"""Time histories as files: CSV, Parquet, MATLAB's ``.mat`` and MDF 4.

CSV, Parquet and MATLAB have the unit in the name of each column, Parquet in the field's metadata, too, and
MDF beside the name. All hold the numbers as they are, none is rounded.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

from sayd_env.config.errors import ConfigError
from sayd_env.config.storage import replacing
from sayd_env.config.units import Array
from sayd_env.runs.histories import HistorySignal

FORMATS = {"csv": ".csv", "parquet": ".parquet", "mat": ".mat", "mf4": ".mf4"}
"""Ending of the files by format."""


Columns: TypeAlias = Sequence[tuple[HistorySignal, Array]]
"""Signals and their values (t,)."""
_TIME = HistorySignal("time", "s", "", 0)


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


def write_history(path: Path, kind: str, time: Array, columns: Columns, about: Mapping[str, str]) -> None:
    """Write signals into one file, under another name until it is complete.

    Parameters
    ----------
    kind : str
        One of `FORMATS`.
    time : ndarray, shape (t,)
        s, rising.
    about : mapping
        What Parquet and MDF say of the file.

    Raises
    ------
    ConfigError
        The format's library is missing.
    StudyError
        The file cannot be written.
    """
    with replacing(path) as temporary, temporary.open("wb+") as stream:
        _WRITERS[kind](stream, [(_TIME, time), *columns], about)


def _write_csv(stream: BinaryIO, columns: Columns, about: Mapping[str, str]) -> None:
    import pandas  # noqa: PLC0415 - slow to import

    table = pandas.DataFrame({signal.full_name: values for signal, values in columns})
    table.to_csv(stream, index=False, lineterminator="\n")


def _write_parquet(stream: BinaryIO, columns: Columns, about: Mapping[str, str]) -> None:
    arrow = _library("parquet")
    fields = [
        arrow.field(signal.full_name, arrow.float64(), metadata={"unit": signal.unit})
        for signal, _ in columns
    ]
    table = arrow.table([values for _, values in columns], schema=arrow.schema(fields, metadata=dict(about)))
    import_module("pyarrow.parquet").write_table(table, stream)


def _write_mat(stream: BinaryIO, columns: Columns, about: Mapping[str, str]) -> None:
    from scipy.io import savemat  # noqa: PLC0415 - slow to import

    # A variable of MATLAB is letters, digits and underscores.
    named = {re.sub(r"\W", "_", signal.full_name): values for signal, values in columns}
    savemat(stream, named, oned_as="column", do_compression=True)


def _write_mf4(stream: BinaryIO, columns: Columns, about: Mapping[str, str]) -> None:
    library = _library("mf4")
    (_, time), *others = columns
    with warnings.catch_warnings(), library.MDF(version="4.10") as file:
        warnings.simplefilter("ignore")
        file.append(
            [
                library.Signal(values, time, name=signal.name, unit=signal.unit.replace("-", ""))
                for signal, values in others
            ],
            common_timebase=True,
        )
        file.header.comment = "; ".join(f"{key}: {value}" for key, value in about.items())
        file.save(stream, overwrite=True)


_LIBRARIES = {"parquet": "pyarrow", "mf4": "asammdf"}
_WRITERS: Mapping[str, Callable[[BinaryIO, Columns, Mapping[str, str]], None]] = {
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
