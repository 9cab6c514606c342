"""Recordings of a real train: CSV files with units in their header."""

from __future__ import annotations

import enum
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from sayd_env.config import DataError, nearest, read_text
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.units import Array


class Quantity(enum.Enum):
    """What a channel measures."""

    ACCELERATION = "acceleration"
    """Lateral acceleration of the bogie frame above a wheelset (m/s2)."""
    TRACK_SHIFT_FORCE = "track_shift_force"
    """Sum of the guiding forces of one wheelset (N)."""


@dataclass(frozen=True)
class Channel:
    """One recorded quantity."""

    name: str
    """Name in the header, without the unit."""
    quantity: Quantity
    """Decides which limit applies."""


@dataclass(frozen=True)
class Recording:
    """Signals of a ride, uniformly sampled, in SI units."""

    sample_rate: float
    """Samples per second (Hz)."""
    speed: float | Array
    """Speed, constant or of each sample (m/s)."""
    channels: tuple[Channel, ...]
    """The columns of `signals`."""
    signals: Array
    """Shape (n, channels): m/s2 or N."""


class _Unit(NamedTuple):
    meaning: str
    factor: float


_UNITS = {
    "s": _Unit("time", 1.0),
    "ms": _Unit("time", 1e-3),
    "kmh": _Unit("speed", 1 / 3.6),
    "km_h": _Unit("speed", 1 / 3.6),
    "m_s": _Unit("speed", 1.0),
    "m_s2": _Unit("acceleration", 1.0),
    "g": _Unit("acceleration", 9.80665),
    "n": _Unit("track_shift_force", 1.0),
    "kn": _Unit("track_shift_force", 1e3),
}
_ALLOWED = "s or ms (time), kmh or m_s (speed), m_s2 or g (acceleration), n or kn (track shift force)"
# Nothing on rails is faster: a speed beyond it was given in another unit than its header says.
_FASTEST = 200.0
# Times are written with few digits, so steps scatter; a missing sample makes a step twice as long.
_STEP_SCATTER = 0.25


class _Column(NamedTuple):
    place: int
    header: str
    name: str
    unit: _Unit


class _Row(NamedTuple):
    line: int
    text: str


def read_recording(
    path: Path,
    settings: AssessmentConfig,
    *,
    speed: float | None = None,
    sample_rate: float | None = None,
    columns: Sequence[str] | None = None,
) -> Recording:
    """Read a recording.

    The file holds one header line and one line for each sample, separated by commas, semicolons or tabs;
    lines that start with ``#`` are comments. A column's unit stands at the end of its name or in brackets:
    ``time_s``, ``speed_kmh``, ``bogie1_front_m_s2``, ``wheelset1_kn``, ``bogie1 front [m/s^2]``. Columns of
    acceleration are lateral accelerations of the bogie frame above a wheelset, columns of force are track
    shift forces.

    Parameters
    ----------
    path : Path
        CSV file.
    settings : AssessmentConfig
        Gives the lowest sampling rate.
    speed : float, optional
        Constant speed (m/s) of a file without a speed column.
    sample_rate : float, optional
        Sampling rate (Hz); a time column is then not read.
    columns : sequence of str, optional
        Names of the channels to read (with or without their unit). By default all columns are read, and
        one that cannot be understood is an error.

    Raises
    ------
    DataError
        The content cannot be used: empty, not numeric, not finite, without units or with unknown ones, not
        uniform in time, sampled too slowly, without speed or without a channel.
    ConfigError
        The file cannot be read.
    """
    header, delimiter, rows = _split(path)
    found = _columns(path, header, columns, with_time=sample_rate is None)
    time, velocity, channels = _roles(path, found)
    table = _numbers(path, rows, delimiter, header, [c.place for c in found])
    values = {c.place: table[:, k] * c.unit.factor for k, c in enumerate(found)}
    rate = sample_rate if sample_rate is not None else _rate(path, time, values, rows)
    if not (math.isfinite(rate) and rate >= settings.minimum_sample_rate * (1 - 1e-6)):
        raise DataError(
            f"{path}: sampling rate {rate:.6g} Hz; expected {settings.minimum_sample_rate:g} Hz or more"
        )
    return Recording(
        sample_rate=rate,
        speed=_speed(path, velocity, speed, values, rows),
        channels=tuple(Channel(c.name, Quantity(c.unit.meaning)) for c in channels),
        signals=np.column_stack([values[c.place] for c in channels]),
    )


def _split(path: Path) -> tuple[list[str], str, list[_Row]]:
    text = read_text(path, "recording").removeprefix("\ufeff")
    rows = [
        _Row(number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not rows:
        raise DataError(f"{path}: is empty; expected a header line and samples")
    first = rows[0].text.rstrip()
    delimiter = max(",;\t", key=first.count)
    header = [name.strip().strip('"') for name in first.split(delimiter)]
    if all(_is_number(name) for name in header):
        raise DataError(
            f"{path}: line {rows[0].line}: found numbers; expected a header with units such as time_s,"
            " speed_kmh, bogie1_front_m_s2, wheelset1_kn"
        )
    if len(rows) < 3:
        raise DataError(f"{path}: {len(rows) - 1} samples; expected a recording of at least 500 m")
    return header, delimiter, rows[1:]


def _columns(
    path: Path, header: list[str], chosen: Sequence[str] | None, *, with_time: bool
) -> list[_Column]:
    repeated = {name for name in header if header.count(name) > 1}
    if repeated:
        raise DataError(f"{path}: column '{sorted(repeated)[0]}' appears twice")
    _check_chosen(path, header, chosen)
    result = []
    for index, name in enumerate(header):
        bare, unit = _parse(name)
        if _is_time(bare) and not with_time:
            continue
        role = _is_time(bare) or _is_speed(bare)
        if chosen is not None and not role and name not in chosen and bare not in chosen:
            continue
        if unit not in _UNITS:
            what = f"unit '{unit}'" if unit else "no unit"
            raise DataError(
                f"{path}: column '{name}': found {what}; allowed at the end of the name or in brackets:"
                f" {_ALLOWED}. Name the columns to read to leave others out"
            )
        column = _Column(index, name, bare, _UNITS[unit])
        _check_meaning(path, column)
        result.append(column)
    return result


def _check_chosen(path: Path, header: list[str], chosen: Sequence[str] | None) -> None:
    known = set(header) | {_parse(name)[0] for name in header}
    for name in chosen or ():
        if name not in known:
            raise DataError(
                f"{path}: no column '{name}'{nearest(name, sorted(known))}; the file has {', '.join(header)}"
            )


def _parse(header: str) -> tuple[str, str]:
    """Name and normalised unit of a column; the unit is "" where none is given."""
    bracket = re.fullmatch(r"(.*?)[\s_]*[\[(](.*)[\])]", header)
    if bracket:
        unit = bracket[2].strip().lower().replace("²", "2").replace("^", "").replace("/", "_")
        return bracket[1].strip(), unit
    lower = header.lower()
    for unit in sorted(_UNITS, key=len, reverse=True):
        if lower.endswith("_" + unit):
            return header[: -len(unit) - 1], unit
    name, _, last = header.rpartition("_")
    return (name, last.lower()) if name else (header, "")


def _is_time(name: str) -> bool:
    return name.lower() in ("time", "t")


def _is_speed(name: str) -> bool:
    return name.lower() in ("speed", "velocity", "v")


def _check_meaning(path: Path, column: _Column) -> None:
    meaning = column.unit.meaning
    expected = "time" if _is_time(column.name) else "speed" if _is_speed(column.name) else None
    if expected is None and meaning in ("time", "speed"):
        raise DataError(
            f"{path}: column '{column.header}': found a unit of {meaning}; a channel has one of m_s2, g, n,"
            " kn, and the columns of time and speed are called time and speed"
        )
    if expected is not None and meaning != expected:
        raise DataError(
            f"{path}: column '{column.header}': found a unit of {meaning.replace('_', ' ')};"
            f" expected one of {expected}"
        )


def _roles(path: Path, columns: list[_Column]) -> tuple[_Column | None, _Column | None, list[_Column]]:
    time = [c for c in columns if c.unit.meaning == "time"]
    speed = [c for c in columns if c.unit.meaning == "speed"]
    for group in (time, speed):
        if len(group) > 1:
            raise DataError(
                f"{path}: columns '{group[0].header}' and '{group[1].header}': expected one of them"
            )
    channels = [c for c in columns if c not in time and c not in speed]
    if not channels:
        raise DataError(
            f"{path}: no column to assess; expected accelerations (..._m_s2, ..._g) or track shift forces"
            " (..._n, ..._kn)"
        )
    return (time[0] if time else None), (speed[0] if speed else None), channels


def _numbers(path: Path, rows: list[_Row], delimiter: str, header: list[str], indices: list[int]) -> Array:
    for line, text in rows:
        cells = text.rstrip().removesuffix(delimiter).count(delimiter) + 1
        if cells != len(header):
            raise DataError(
                f"{path}: line {line}: found {cells} columns; the header has {len(header)}"
                " (numbers need a decimal point, not a comma)"
            )
    try:
        table = np.loadtxt(
            [row.text for row in rows],
            delimiter=delimiter,
            usecols=indices,
            ndmin=2,
            comments=None,
            quotechar='"',
        )
    except ValueError:
        _name_bad_cell(path, rows, delimiter, header, indices)
    if not np.isfinite(table).all():
        row, column = np.argwhere(~np.isfinite(table))[0]
        raise DataError(
            f"{path}: line {rows[row].line}: column '{header[indices[column]]}': found {table[row, column]};"
            " expected a finite number"
        )
    return table


def _name_bad_cell(
    path: Path, rows: list[_Row], delimiter: str, header: list[str], indices: list[int]
) -> NoReturn:
    for line, text in rows:
        cells = text.split(delimiter)
        for index in indices:
            if not _is_number(cells[index].strip().strip('"')):
                raise DataError(
                    f"{path}: line {line}: column '{header[index]}': found {cells[index].strip()!r};"
                    " expected a number with a decimal point"
                )
    raise DataError(f"{path}: cannot be read as a table separated by {delimiter!r}")


def _rate(path: Path, column: _Column | None, values: dict[int, Array], rows: list[_Row]) -> float:
    if column is None:
        raise DataError(f"{path}: no column time_s; add one or give the sampling rate")
    time = values[column.place]
    steps = np.diff(time)
    typical = float(np.median(steps))
    wrong = (steps <= 0) | (np.abs(steps - typical) > _STEP_SCATTER * abs(typical))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise DataError(
            f"{path}: line {rows[i + 1].line}: the time steps by {steps[i]:.6g} s; expected a uniform step,"
            f" here {typical:.6g} s"
        )
    return float((len(time) - 1) / (time[-1] - time[0]))


def _speed(
    path: Path, column: _Column | None, given: float | None, values: dict[int, Array], rows: list[_Row]
) -> float | Array:
    if column is not None and given is not None:
        raise DataError(f"{path}: has a column '{column.header}' and a given speed; use one of them")
    allowed = f"allowed: above 0 to {_FASTEST * 3.6:g} km/h"
    if given is not None:
        if not 0 < given <= _FASTEST:
            raise DataError(f"speed: found {given * 3.6:g} km/h; {allowed}")
        return given
    if column is None:
        raise DataError(f"{path}: no column speed_kmh or speed_m_s; add one or give the speed")
    speed = values[column.place]
    wrong = (speed <= 0) | (speed > _FASTEST)
    if wrong.any():
        i = int(np.argmax(wrong))
        raise DataError(
            f"{path}: line {rows[i].line}: speed {speed[i] * 3.6:g} km/h; {allowed}"
            " (is the unit in the header right? cut standstill off)"
        )
    return speed


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
