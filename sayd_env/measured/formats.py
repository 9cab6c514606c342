"""Recordings in the formats that measuring systems write: the columns of a file, and their values on demand.

Text tables are read by our own reader, MDF, TDMS, MATLAB and Parquet files by the libraries of these formats,
which the extra ``measured`` installs.
"""

from __future__ import annotations

import gc
import logging
import math
import re
import sys
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sayd_env.config.errors import ConfigError, DataError, SaydError
from sayd_env.config.files import MIB, read_bytes
from sayd_env.config.units import Array
from sayd_env.measured.dialect import is_clock_form
from sayd_env.measured.table import MISSING, TextTable, read_text_table
from sayd_env.measured.units import name_and_unit

LARGEST = 4096 * MIB
"""Most that a file of a measuring system may have; only the columns that are used are read of it."""
LARGEST_MATLAB = 512 * MIB
"""Most that a MATLAB file may have, which is read as a whole, and compressed as a rule."""
MOST_VALUES = 200_000_000
"""Most values of a channel, and of a MATLAB file, that are read: an hour has 4 million at 1 kHz."""
FORMATS = "text tables (.csv, .txt), MDF (.mf4, .mdf), TDMS, MATLAB (.mat) and Parquet"
EXTRA = "pip install 'sayd-env[measured]'"

CLOCKS = "hh:mm:ss.sss, yyyy-mm-dd hh:mm:ss.sss or dd.mm.yyyy hh:mm:ss.sss"
"""Layouts of times of day that text tables may have."""
_CLOCK = re.compile(
    r"(?:\d{4}-\d{1,2}-\d{1,2}[T ]+|\d{1,2}\.\d{1,2}\.\d{4} +)?"
    r"\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?(?:Z|[+-]\d{2}:?\d{2})?"
)
_LIKE_A_DATE = re.compile(r"\d{1,4}([-/.])\d{1,2}\1\d{1,4}\b|\d+:\d")
_GERMAN_DATE = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})")
_DAY = 86400.0


@dataclass(frozen=True)
class FileColumn:
    """A column or channel of a recording."""

    header: str
    """Its name in the file, which may hold a unit."""
    unit: str
    """Unit that the file gives apart from the name, "" for none."""
    count: int
    """Number of its values."""
    time: Callable[[], Array] | None = None
    """Its own times (s); None where it shares those of the file."""


@dataclass(frozen=True)
class Contents:
    """What is in the file of a recording."""

    source: str
    columns: tuple[FileColumn, ...]
    values: Callable[[Sequence[int]], list[Array]]
    """Values of columns by their places, NaN where a cell is empty."""
    where: Callable[[int, int], str]
    """Place of a column's value in the file, as a message begins."""
    rate: float | None = None
    """Samples per second (Hz), where the file states them apart."""
    notes: list[str] = field(default_factory=list)
    """How the file was read where that is not plain, and what a library found odd about it."""


@contextmanager
def opened(path: Path) -> Iterator[Contents]:
    """Open a recording by what stands at its beginning.

    Raises
    ------
    ConfigError
        The file cannot be read, is too large, or needs a library that is not installed.
    DataError
        Its content cannot be used.
    """
    start = read_bytes(path, "recording", LARGEST, 128)
    kind = next((each for each in _KINDS if start.startswith(each.mark)), None)
    if kind is None:
        with _text(path) as contents:
            yield contents
        return
    try:
        import_module(kind.library)
    except ModuleNotFoundError:
        raise ConfigError(f"{path}: {kind.name} files need {kind.library}: {EXTRA}") from None
    with _overheard(kind.library) as said, _refusals(path, kind.name), kind.reader(path) as contents:
        yield contents
        contents.notes.extend(dict.fromkeys(said))


@contextmanager
def _overheard(library: str) -> Iterator[list[str]]:
    """What a library would write on the screen: its warnings, and errors while it gives up a file."""
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage().strip())  # type: ignore[method-assign]
    root = library.partition(".")[0]
    loggers = [
        logging.getLogger(name) for name in [*logging.root.manager.loggerDict] if name.startswith(root)
    ]
    before = [(each, each.handlers, each.propagate) for each in loggers]
    unraisable = sys.unraisablehook
    try:
        for each in loggers:
            each.handlers, each.propagate = [handler], False
        sys.unraisablehook = lambda _: None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield said
    finally:
        sys.unraisablehook = unraisable
        for each, handlers, propagate in before:
            each.handlers, each.propagate = handlers, propagate


@contextmanager
def _refusals(path: Path, kind: str) -> Iterator[None]:
    """Errors of a library as ours: on a damaged file they are of any kind."""
    try:
        yield
    except (SaydError, MemoryError):
        raise
    except Exception as error:
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        # With its frames goes what the library has opened by half, while nobody hears it.
        cause: BaseException | None = error
        while cause is not None:
            traceback.clear_frames(cause.__traceback__)
            cause = cause.__context__
        gc.collect()
        raise DataError(f"{path}: cannot be read as a {kind} file ({reason[:200]})") from None


@contextmanager
def _text(path: Path) -> Iterator[Contents]:
    try:
        table = read_text_table(path, "recording", may_end_short=True)
    except ConfigError as error:
        if "is not a text file" in str(error):
            raise ConfigError(f"{path}: is in no format that is read: {FORMATS}") from None
        raise
    if not table.names:
        raise DataError(
            f"{table.no_header()}; expected a name and a unit for each of {table.head.width} columns, such as"
            " time_s, speed_kmh, bogie1_front_m_s2, wheelset1_kn"
        )
    if not len(table):
        raise DataError(
            f"{table.source}: line {table.head.line}: found a header and no rows of numbers below it;"
            " expected a recording of at least 500 m"
        )
    units = table.head.units or ("",) * len(table.names)
    names = [_without_form(name) for name in table.names]
    clocks = [k for k, unit in enumerate(units) if (not unit or is_clock_form(unit)) and _is_clock(table, k)]

    def values(places: Sequence[int]) -> list[Array]:
        plain = [k for k in places if k not in clocks]
        for k in plain:
            if _LIKE_A_DATE.match(table.first(k)):
                raise _no_time(table, 0, k, table.first(k))
        found = dict(zip(plain, table.numbers(plain, gaps=True).T, strict=True))
        return [found[k] if k in found else _seconds(table, k) for k in places]

    yield Contents(
        table.source,
        tuple(
            FileColumn(name, "s" if k in clocks else unit, len(table))
            for k, (name, unit) in enumerate(zip(names, units, strict=True))
        ),
        values,
        lambda place, row: table.where(row, place),
        notes=[*([] if table.encoding == "UTF-8" else [f"The text is {table.encoding}."]), *table.notes],
    )


def _without_form(header: str) -> str:
    """The name of a column without the form of its times of day: ``time [hh:mm:ss.sss]``."""
    name, unit = name_and_unit(header)
    return name if is_clock_form(unit) else header


def _is_clock(table: TextTable, column: int) -> bool:
    return _CLOCK.fullmatch(str(table.first(column))) is not None


def _seconds(table: TextTable, column: int) -> Array:
    """Seconds of a column of times of day, with or without date, from the first one."""
    cells = [_GERMAN_DATE.sub(r"\3-\2-\1", cell.replace(",", ".")) for cell in table.cells([column])[:, 0]]
    wrong = next((row for row, cell in enumerate(cells) if not _CLOCK.fullmatch(cell)), None)
    if wrong is None:
        with suppress(ValueError):
            return _since_first([cell.replace("T", " ") for cell in cells])
        wrong = 0
    raise _no_time(table, wrong, column, cells[wrong])


def _no_time(table: TextTable, row: int, column: int, cell: str) -> DataError:
    return DataError(
        f"{table.where(row, column)}: found '{cell[:40]}'; expected seconds, {CLOCKS}; or give the sampling"
        " rate (--sample-rate HZ), which stands above all times in the file"
    )


def _since_first(cells: list[str]) -> Array:
    import pandas as pd  # noqa: PLC0415 - every start of the simulator comes by here

    if "-" in cells[0]:
        stamps = pd.to_datetime(pd.Series(cells), format="ISO8601", utc=True)
        return np.asarray((stamps - stamps.iloc[0]) / pd.Timedelta(seconds=1), dtype=np.float64)
    day = np.asarray(pd.to_timedelta(pd.Series(cells)) / pd.Timedelta(seconds=1), dtype=np.float64)
    midnights = np.cumsum(np.diff(day, prepend=day[0]) < -0.5 * _DAY)
    return np.asarray(day - day[0] + _DAY * midnights)


@contextmanager
def _mdf(path: Path) -> Iterator[Contents]:
    file = import_module("asammdf").MDF(path)
    try:
        found = [
            (group, index, channel, int(each.channel_group.cycles_nr))
            for group, each in enumerate(file.groups)
            for index, channel in enumerate(each.channels)
            if index != file.masters_db.get(group)
        ]

        def signal(place: int) -> Any:
            group, index, _, _ = found[place]
            return file.get(group=group, index=index, ignore_invalidation_bits=True)

        def values(place: int) -> Array:
            group, index, _, _ = found[place]
            # Samples that the system has marked as invalid are none; the library would leave them out.
            got = file.get(group=group, index=index, ignore_invalidation_bits=True)
            lost = getattr(got, "invalidation_bits", None)
            numbers = _numeric(path, got.name, got.samples)
            return numbers if lost is None else np.where(np.asarray(lost, dtype=bool), np.nan, numbers)

        names = _distinct([(str(group + 1), channel.name) for group, _, channel, _ in found])
        columns = tuple(
            FileColumn(names[place], _mdf_unit(file, group, index), count, time=_times_of(signal, place))
            for place, (group, index, _, count) in enumerate(found)
        )
        yield _of_channels(path, columns, values)
    finally:
        file.close()


def _mdf_unit(file: Any, group: int, index: int) -> str:
    """Unit of a channel; that of version 3 stands in its conversion."""
    return str(file.get_channel_unit(group=group, index=index) or "")


def _times_of(signal: Callable[[int], Any], place: int) -> Callable[[], Array]:
    return lambda: np.asarray(signal(place).timestamps, dtype=np.float64)


@contextmanager
def _tdms(path: Path) -> Iterator[Contents]:
    with import_module("nptdms").TdmsFile.open(path) as file:
        found = [channel for group in file.groups() for channel in group.channels()]
        names = _distinct([(channel.group_name, channel.name) for channel in found])
        begun = [each.properties.get("wf_start_time") for each in found]
        first = min((each for each in begun if each is not None), default=None)
        late = [0.0 if each is None else float((each - first) / np.timedelta64(1, "s")) for each in begun]
        columns = tuple(map(_tdms_column, names, found, late))
        yield _of_channels(path, columns, lambda k: _numeric(path, found[k].name, found[k][:]))


def _tdms_column(name: str, channel: Any, late: float) -> FileColumn:
    """A channel that begins so much later (s) than the first one of the file."""
    about: Mapping[str, Any] = channel.properties
    unit = str(about.get("unit_string") or about.get("NI_UnitDescription") or "")
    count, step = len(channel), float(about.get("wf_increment") or 0.0)
    if not step:
        return FileColumn(name, unit, count)
    start = late + float(about.get("wf_start_offset") or 0.0)
    return FileColumn(name, unit, count, time=lambda: start + step * np.arange(count, dtype=np.float64))


def _distinct(names: Sequence[tuple[str, str]]) -> list[str]:
    """Names of channels; those that several groups have come with their group in front."""
    count = Counter(name for _, name in names)
    return [f"{group}/{name}" if count[name] > 1 else name for group, name in names]


@contextmanager
def _parquet(path: Path) -> Iterator[Contents]:
    with import_module("pyarrow.parquet").ParquetFile(path) as file:
        fields = [each for each in file.schema_arrow if not each.name.startswith("__index_level")]
        clocks = [str(each.type).startswith(("timestamp", "duration", "time")) for each in fields]

        def values(place: int) -> Array:
            name = fields[place].name
            got = file.read(columns=[name]).column(0)
            if not clocks[place]:
                return _numeric(path, name, got.to_pandas().to_numpy())
            if str(fields[place].type).startswith(("time32", "time64")):
                return _since_first([str(each) for each in got.to_pylist()])
            ticks = got.to_pandas()
            return np.asarray((ticks - ticks.iloc[0]) / np.timedelta64(1, "s"), dtype=np.float64)

        about = [{k.lower(): v for k, v in (each.metadata or {}).items()} for each in fields]
        units = [(each.get(b"unit") or each.get(b"units") or b"").decode() for each in about]
        columns = tuple(
            FileColumn(each.name, "s" if clock else unit, file.metadata.num_rows)
            for each, clock, unit in zip(fields, clocks, units, strict=True)
        )
        yield _of_channels(path, columns, values)


def _of_channels(path: Path, columns: tuple[FileColumn, ...], values: Callable[[int], Array]) -> Contents:
    return Contents(
        str(path),
        columns,
        lambda places: [values(k) for k in places],
        lambda place, row: f"{path}: channel '{columns[place].header}': sample {row + 1}",
    )


def _numeric(path: Path, name: str, values: Any) -> Array:
    found = np.asarray(values)
    if found.dtype == object:
        found = np.array([np.nan if str(each).strip().lower() in MISSING else each for each in found])
    if found.ndim != 1 or found.dtype.kind not in "fiu":
        raise DataError(f"{path}: channel '{name}': holds no numbers, or several in a sample")
    return found.astype(np.float64)


# What people call the parts of a channel that is a structure in MATLAB.
_DATA = ("data", "values", "value", "samples", "signal", "y")
_TIMES = ("time", "t", "x", "timestamps")
_RATES = ("fs", "rate", "sample_rate", "samplerate", "sampling_rate", "sample_rate_hz", "fs_hz")
_NAMES = ("names", "name", "labels", "label", "channels", "columns", "header")
_UNIT = ("unit", "units")


@contextmanager
def _matlab(path: Path) -> Iterator[Contents]:
    read_bytes(path, "MATLAB file", LARGEST_MATLAB, 1)
    _check_declared(path)
    content = import_module("pymatreader").read_mat(str(path))
    own = {key: value for key, value in content.items() if not key.startswith("__")}
    found = list(_matlab_channels(own, ""))
    columns = tuple(column for column, _ in found)
    rate = _part(own, _RATES)
    contents = _of_channels(path, columns, lambda k: _numeric(path, columns[k].header, found[k][1]))
    yield replace(contents, rate=float(rate) if isinstance(rate, int | float) else None)


def _check_declared(path: Path) -> None:
    """Refuse a MATLAB file that declares more values than it could hold, before they are read."""
    try:
        sizes = [math.prod(shape) for _, shape, _ in import_module("scipy.io").whosmat(str(path))]
    except NotImplementedError:  # of version 7.3
        sizes = []
        with import_module("h5py").File(path) as file:
            file.visititems(lambda _, item: sizes.append(int(getattr(item, "size", 0))))
    if sum(sizes) > MOST_VALUES:
        raise DataError(f"{path}: declares {sum(sizes):.3g} values; at most {MOST_VALUES:.3g} are read")


def _matlab_channels(content: Mapping[str, Any], prefix: str) -> Iterator[tuple[FileColumn, Any]]:
    """Vectors, columns of matrices whose names stand beside them, and structures of data, unit and time."""
    names, units = _part(content, _NAMES), _part(content, _UNIT)
    for key, value in content.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, Mapping):
            channel = _matlab_structure(value, name)
            yield from _matlab_channels(value, name) if channel is None else [channel]
        elif isinstance(value, list) and value and all(isinstance(each, Mapping) for each in value):
            for number, each in enumerate(value, start=1):
                channel = _matlab_structure(each, f"{name}{number}")
                yield from _matlab_channels(each, f"{name}{number}") if channel is None else [channel]
        elif isinstance(value, np.ndarray) and value.ndim == 1 and value.size > 1:
            yield FileColumn(name, "", value.size), value
        elif isinstance(value, np.ndarray) and value.ndim == 2:
            for number, each in enumerate(value.T):
                named = names[number] if _fits(names, value) else f"{name}_{number + 1}"
                unit = units[number] if _fits(units, value) else ""
                yield FileColumn(str(named), str(unit), each.size), each


def _matlab_structure(content: Mapping[str, Any], name: str) -> tuple[FileColumn, Any] | None:
    """A channel that is a structure, None for any other one."""
    data = _part(content, _DATA)
    if not isinstance(data, np.ndarray) or data.ndim != 1:
        return None
    label, unit = _part(content, _NAMES), _part(content, _UNIT)
    times, rate = _part(content, _TIMES), _part(content, _RATES)
    own: Callable[[], Array] | None = None
    if isinstance(times, np.ndarray) and times.size == data.size:
        own = lambda: np.asarray(times, dtype=np.float64)  # noqa: E731 - one of two
    elif isinstance(rate, int | float) and rate > 0:
        own = lambda: np.arange(data.size, dtype=np.float64) / float(rate)  # noqa: E731
    return FileColumn(
        label if isinstance(label, str) else name, unit if isinstance(unit, str) else "", data.size, own
    ), data


def _part(content: Mapping[str, Any], names: Sequence[str]) -> Any:
    lower = {key.lower(): value for key, value in content.items()}
    return next((lower[name] for name in names if name in lower), None)


def _fits(names: Any, matrix: Any) -> bool:
    return isinstance(names, list) and len(names) == matrix.shape[1]


class _Kind(NamedTuple):
    """A format, which the first bytes of a file tell."""

    mark: bytes
    name: str
    library: str
    reader: Callable[[Path], AbstractContextManager[Contents]]


_KINDS = (
    _Kind(b"MDF ", "MDF", "asammdf", _mdf),
    _Kind(b"UnFinMF", "MDF", "asammdf", _mdf),
    _Kind(b"TDSm", "TDMS", "nptdms", _tdms),
    _Kind(b"PAR1", "Parquet", "pyarrow.parquet", _parquet),
    _Kind(b"MATLAB", "MATLAB", "pymatreader", _matlab),
)
