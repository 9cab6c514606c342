"""Recordings of a real train: which columns hold time, speed and signals, in SI units on one time grid."""

from __future__ import annotations

import enum
import re
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sayd_env.config import DataError, nearest
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.units import KMH, Array
from sayd_env.measured.formats import CLOCKS, MOST_VALUES, Contents, opened
from sayd_env.measured.sampling import Series, put_right, sampled
from sayd_env.measured.units import Unit, name_and_unit, unit_of


class Quantity(enum.Enum):
    """What a channel measures."""

    ACCELERATION = "acceleration"
    """Lateral acceleration of the bogie frame above a wheelset (m/s2)."""
    TRACK_SHIFT_FORCE = "track_shift_force"
    """Sum of the guiding forces of one wheelset (N)."""


_QUANTITIES = {"acceleration": Quantity.ACCELERATION, "force": Quantity.TRACK_SHIFT_FORCE}


@dataclass(frozen=True)
class Channel:
    """One recorded quantity."""

    name: str
    """Name in the header, without the unit."""
    quantity: Quantity
    """Decides which limit applies."""
    unit: str = ""
    """Unit in the file, as it was understood."""


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
    notes: tuple[str, ...] = ()
    """What was done to the data of the file."""


_ALLOWED = "s or ms (time), km/h or m/s (speed), m/s2 or g (acceleration), N or kN (track shift force)"
_TIME_WORDS = "time|zeit|uhrzeit|temps|heure|date|datum|elapsed|timestamp|time[ _]?stamp"
_TIME = re.compile(rf"(?:.*[./])?(?:t|{_TIME_WORDS})\b.*", re.IGNORECASE)
# These cannot be anything else, while "t oil" is a temperature.
_SURELY_TIME = re.compile(rf"(?:.*[./])?(?:t|{_TIME_WORDS})", re.IGNORECASE)
_SPEED = re.compile(r".*(?:speed|velocity|geschw|vitesse).*|(?:.*[./])?v(?:[ _-].*)?", re.IGNORECASE)
# The limit of acceleration is one of lateral ones on the bogie frame: names of others pass for none.
_ELSEWHERE = re.compile(
    r"vert|longit|l(?:ä|ae|a)ngs|(?<![a-z])hoch(?![a-z])|car[ _-]?body|kasten|caisse|axle[ _-]?box|lager"
    r"|bo[iî]te|essieu|(?<![a-z])(?:a|acc)?[ _.]?[xz](?![a-z])",
    re.IGNORECASE,
)
# The limit of force is one of the sum of both wheels' guiding forces Y.
_SUM = re.compile(
    r"(?:sum(?:me)?|somme|[Σ∑])[ _.]*(?:(?:of|der|des)[ _]+)?Y|Y[ _.]*(?:sum|somme)", re.IGNORECASE
)
_OTHER_FORCE = re.compile(
    r"(?<![a-z])[QY][lr]?(?![a-z])|wheel[ _-]?(?:load|force)|axle[ _-]?load|radlast|radkraft|damper|yaw"
    r"|d(?:ä|ae|a)mpfer|amortisseur|spring|feder|ressort|zug[ _-]?kraft|traction|coupler|brak|brems",
    re.IGNORECASE,
)
# A train moves far below these; what lies above is in another unit, or no measurement.
_LARGEST = {"acceleration": (1000.0, "1000 m/s2"), "force": (1e6, "1 MN")}
# What loggers write where they have no value, and how far above nearly all others it stands then.
_CODES = np.array([999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0])
_FAR, _NEARLY_ALL = 20.0, 0.999
# Nothing on rails is faster: a speed beyond it was given in another unit than its header says.
_FASTEST = 200.0
_FASTEST_RATE = 1e6
# No bogie frame is as calm for so long that its acceleration does not move.
_STILL = 1.0  # s


class _Column(NamedTuple):
    place: int
    header: str
    name: str
    unit: Unit


class _Roles(NamedTuple):
    time: _Column | None
    speed: _Column | None
    channels: list[_Column]


def read_recording(
    path: Path,
    settings: AssessmentConfig,
    *,
    speed: float | None = None,
    sample_rate: float | None = None,
    columns: Sequence[str] | None = None,
) -> Recording:
    """Read a recording: a text table, an MDF, TDMS, MATLAB or Parquet file.

    A column's unit stands in the file beside it, below its name, at the end of its name or in brackets:
    ``time_s``, ``speed_kmh``, ``bogie1_front_m_s2``, ``wheelset1_kn``, ``bogie1 front [m/s^2]``. Columns of
    acceleration are lateral accelerations of the bogie frame above a wheelset, columns of force are track
    shift forces; one whose name says otherwise is refused, unless `columns` has it.

    Parameters
    ----------
    path : Path
        The file; its format is found out from its content.
    settings : AssessmentConfig
        Gives the lowest sampling rate.
    speed : float, optional
        Constant speed (m/s) of a file without a speed column.
    sample_rate : float, optional
        Sampling rate (Hz); times in the file are then not read.
    columns : sequence of str, optional
        Names of the channels to read (with or without their unit), and of the speed where there are several.
        By default all columns are read, and one that cannot be understood is an error.

    Returns
    -------
    Recording
        Uniformly sampled, with notes on what was done for that.

    Raises
    ------
    DataError
        The content cannot be used: empty, not numeric, not finite, without units or with unknown ones, with
        gaps, sampled too slowly, without speed or without a channel.
    ConfigError
        The file cannot be read.
    """
    if sample_rate is not None and not 0 < sample_rate <= _FASTEST_RATE:
        raise DataError(f"sampling rate: found {sample_rate:g} Hz; allowed: above 0 to {_FASTEST_RATE:g} Hz")
    with opened(path) as contents:
        roles = _roles(contents, _columns(contents, columns, sample_rate is not None), columns)
        _check_speed_source(contents, roles, speed)
        used = [*roles.channels, *([roles.speed] if roles.speed else [])]
        series, timing = _series(contents, used, roles.time, sample_rate)
    count = len(roles.channels)
    along = series[count] if roles.speed else None
    result = sampled(series[:count], along, settings.minimum_sample_rate, contents.source)
    still = [
        note for each, column in zip(series, roles.channels, strict=False) for note in _still(each, column)
    ]
    return Recording(
        sample_rate=result.rate,
        speed=float(speed or 0.0) if result.speed is None else result.speed,
        channels=tuple(Channel(c.name, _QUANTITIES[c.unit.quantity], c.unit.name) for c in roles.channels),
        signals=result.signals,
        notes=(*contents.notes, *timing, *result.notes, *still, *_said(roles, speed)),
    )


def _columns(contents: Contents, chosen: Sequence[str] | None, rated: bool) -> list[_Column]:
    """Columns that are understood, those of time and speed included; given a rate, no times are needed."""
    parsed = [_parsed(contents, place) for place in range(len(contents.columns))]
    _check_names(contents, parsed, chosen)
    result = []
    for place, header, name, text in parsed:
        # An index that a program wrote in front of the columns has no name.
        if not header and place == 0:
            continue
        known = unit_of(text) if text else None
        wanted = chosen is None or header in chosen or name in chosen
        meaning = known.quantity if known else ""
        if known is None and chosen is None and _SURELY_TIME.fullmatch(name):
            if rated:
                continue
            found = f"unit {text!r}" if text else "no unit"
            raise DataError(
                f"{contents.source}: column '{header}': found {found} and no time of day; allowed: numbers"
                f" with s or ms in the header, or {CLOCKS}; or give the sampling rate (--sample-rate HZ),"
                " which stands above all times in the file"
            )
        if known is None or (wanted and meaning not in ("time", "speed", *_QUANTITIES)):
            if wanted:
                _refuse(contents, header or f"number {place + 1}", text, parsed)
            continue
        if wanted or (meaning == "time" and _TIME.fullmatch(name)) or meaning == "speed":
            result.append(_Column(place, header, name, known))
    return result


class _Parsed(NamedTuple):
    """What a header says."""

    place: int
    header: str
    name: str
    unit: str


def _parsed(contents: Contents, place: int) -> _Parsed:
    column = contents.columns[place]
    name, unit = name_and_unit(column.header)
    numbered = column.header.endswith(f"_{unit}") and len(unit) == 1 and not unit.islower()
    if column.unit and numbered and column.unit != unit:
        name, unit = column.header.strip(), ""  # acc_1 is a number and bus_A a letter, not a ratio and ampere
    if column.unit and unit and unit_of(column.unit) != unit_of(unit):
        raise DataError(
            f"{contents.source}: column '{column.header}': its name says {unit!r}, the file beside it or"
            f" below {column.unit!r}; expected one unit"
        )
    return _Parsed(place, column.header, name, column.unit or unit)


def _check_names(contents: Contents, parsed: Sequence[_Parsed], chosen: Sequence[str] | None) -> None:
    headers = [each.header for each in parsed]
    known = {*headers, *(each.name for each in parsed)} - {""}
    for name in chosen or ():
        if name not in known:
            listed = ", ".join(f"'{header}'" for header in headers[:20] if header)
            more = f" and {len(headers) - 20} more" if len(headers) > 20 else ""
            like = nearest(name, sorted(known))
            raise DataError(f"{contents.source}: no column '{name}'{like}; the file has {listed}{more}")
    for header in {each for each in headers if each and headers.count(each) > 1}:
        if chosen is None or header in chosen or name_and_unit(header)[0] in chosen:
            raise DataError(f"{contents.source}: column '{header}' appears twice")


def _refuse(contents: Contents, header: str, text: str, parsed: Sequence[_Parsed]) -> None:
    hint = _example(parsed)
    raise DataError(
        f"{contents.source}: column '{header}': found {f'unit {text!r}' if text else 'no unit'}; allowed, in"
        f" brackets, at the end of the name or in a row below it: {_ALLOWED}. Name the columns to read to"
        f" leave others out{hint}"
    )


def _example(parsed: Sequence[_Parsed]) -> str:
    usable = [
        each.name
        for each in parsed
        if (u := unit_of(each.unit)) and u.quantity in _QUANTITIES and not _other(each.name, u.quantity)
    ]
    shown = " ".join(f'--column "{name}"' for name in usable[:4])
    return f", for example {shown}" if usable else ""


def _other(name: str, quantity: str) -> str:
    """What in a name says that the limit of its quantity is not one of it, "" for nothing."""
    plain = unicodedata.normalize("NFC", name)
    found = (
        _ELSEWHERE.search(plain) if quantity == "acceleration" else _OTHER_FORCE.search(_SUM.sub("", plain))
    )
    return found[0] if found else ""


def _roles(contents: Contents, columns: list[_Column], chosen: Sequence[str] | None) -> _Roles:
    source = contents.source
    own = any(column.time is not None for column in contents.columns)
    times = [c for c in columns if c.unit.quantity == "time"]
    timed = [c for c in columns if _TIME.fullmatch(c.name)]
    for column in timed:
        if (
            column.unit.quantity != "time"
            and not _SPEED.fullmatch(column.name)
            and _SURELY_TIME.fullmatch(column.name)
        ):
            _wrong_unit(source, column, "time")
    for column in times:
        if column not in timed and not own:
            raise DataError(
                f"{source}: column '{column.header}': found a unit of time, but it is not called time"
            )
    speeds = [c for c in columns if c.unit.quantity == "speed"]
    for column in columns:
        if _SPEED.fullmatch(column.name) and column.unit.quantity not in ("speed", "acceleration"):
            _wrong_unit(source, column, "speed")
    asked = [c for c in speeds if chosen is not None and (c.header in chosen or c.name in chosen)]
    named = [c for c in speeds if _SPEED.fullmatch(c.name)]
    speeds = asked or (speeds if chosen is None else named or speeds)
    for group, what in ((times if not own else [], "time"), (speeds, "speed")):
        if len(group) > 1:
            raise DataError(
                f"{source}: columns '{group[0].header}' and '{group[1].header}' both give the {what};"
                " name the one to use and the signals with --column"
            )
    if speeds and speeds[0].unit.name != "km/h" and not _SPEED.fullmatch(speeds[0].name):
        raise DataError(
            f"{source}: column '{speeds[0].header}': found a unit of speed; a channel has one of"
            " acceleration or force, and the column of the train's speed is called speed"
        )
    channels = [c for c in columns if c.unit.quantity in _QUANTITIES]
    for column in channels:
        if chosen is None and (found := _other(column.name, column.unit.quantity)):
            limited = (
                "lateral accelerations of the bogie frame"
                if column.unit.quantity == "acceleration"
                else "track shift forces, sums of Y over both wheels of a wheelset"
            )
            hint = _example([_parsed(contents, place) for place in range(len(contents.columns))])
            raise DataError(
                f"{source}: column '{column.header}': its name says '{found}', and the limit is one of"
                f" {limited}; name the columns to assess with --column{hint}"
            )
    if not channels:
        raise DataError(
            f"{source}: no column to assess; expected accelerations (..._m_s2, ... [g]) or track shift forces"
            " (..._kn, ... [N])"
        )
    return _Roles(times[0] if times and not own else None, speeds[0] if speeds else None, channels)


def _wrong_unit(source: str, column: _Column, expected: str) -> None:
    found = f"found a unit of {column.unit.quantity}; expected one of {expected}"
    raise DataError(f"{source}: column '{column.header}': {found}")


def _check_speed_source(contents: Contents, roles: _Roles, given: float | None) -> None:
    if roles.speed is not None and given is not None:
        raise DataError(
            f"{contents.source}: has a column '{roles.speed.header}' and a given speed; use one of them"
        )
    if given is not None and not 0 < given <= _FASTEST:
        raise DataError(f"speed: found {given * KMH:g} km/h; allowed: above 0 to {_FASTEST * KMH:g} km/h")
    if roles.speed is None and given is None:
        raise DataError(
            f"{contents.source}: no column speed_kmh or speed_m_s; add one or give the speed (--speed)"
        )


def _series(
    contents: Contents, columns: Sequence[_Column], time: _Column | None, given: float | None
) -> tuple[list[Series], list[str]]:
    """Columns in SI units with their times, and what was done to these."""
    # All are read together, as one decimal mark holds for all.
    shared = [] if time is None or given is not None else [time]
    for column in (*columns, *shared):
        if (count := contents.columns[column.place].count) > MOST_VALUES:
            raise DataError(
                f"{contents.source}: column '{column.header}': declares {count:.3g} values; at most"
                f" {MOST_VALUES:.3g} are read"
            )
    found = contents.values([c.place for c in (*columns, *shared)])
    values = [each * c.unit.factor for each, c in zip(found, (*columns, *shared), strict=True)]
    common = values.pop() if shared else None
    notes: dict[str, None] = {}
    result: list[Series] = []
    clocks: dict[bytes, Array] = {}
    for column, numbers in zip(columns, values, strict=True):
        if not len(numbers):
            raise DataError(
                f"{contents.source}: column '{column.header}': found 0 samples; expected a recording of at"
                " least 500 m"
            )
        times, place = _times(contents, column, numbers, common, given), column.place
        at = time.place if time is not None and times is common else place

        def where(row: int, place: int = place) -> str:
            return contents.where(place, row)

        def time_at(row: int, at: int = at) -> str:
            return contents.where(at, row)

        _check(column, numbers, where)
        if len(times) != len(numbers):
            raise DataError(f"{where(0)}: {len(numbers)} values, but the time has {len(times)}")
        key = times.tobytes()
        if key not in clocks:
            if (lost := np.flatnonzero(~np.isfinite(times))).size:
                raise DataError(f"{time_at(int(lost[0]))}: found no time")
            clocks[key], note = put_right(times, time_at)
            notes |= {note: None} if note else {}
        kept = np.flatnonzero(~np.isnan(numbers))
        result.append(Series(clocks[key][kept], numbers[kept], kept, where))
    return result, list(notes)


def _times(
    contents: Contents, column: _Column, numbers: Array, common: Array | None, given: float | None
) -> Array:
    """Times of a column (s): its own, the file's, or those that a sampling rate gives."""
    own, rate = contents.columns[column.place].time, contents.rate if given is None else given
    if given is None and own is not None:
        return own()
    if common is not None:
        return common
    if rate is None:
        raise DataError(
            f"{contents.source}: no column time_s; add one or give the sampling rate (--sample-rate)"
        )
    return np.arange(len(numbers)) / rate


def _check(column: _Column, numbers: Array, where: Callable[[int], str]) -> None:
    if (infinite := np.flatnonzero(np.isinf(numbers))).size:
        raise DataError(f"{where(int(infinite[0]))}: found an infinite number")
    if column.unit.quantity != "speed":
        _check_size(column, numbers, where)
        return
    wrong = np.flatnonzero((numbers <= 0) | (numbers > _FASTEST))
    if wrong.size:
        row = int(wrong[0])
        raise DataError(
            f"{where(row)}: speed {numbers[row] * KMH:g} km/h; allowed: above 0 to {_FASTEST * KMH:g} km/h"
            " (is the unit in the header right? cut standstill off)"
        )


def _check_size(column: _Column, numbers: Array, where: Callable[[int], str]) -> None:
    """Refuse what no train does: numbers too large, and codes that a logger writes in place of one."""
    largest, allowed = _LARGEST[column.unit.quantity]
    size = np.abs(numbers)
    wrong = np.flatnonzero(size > largest)
    why = f"allowed: up to {allowed}"
    if not wrong.size:
        # Written in the unit of the file.
        coded = np.isclose(size[:, None], column.unit.factor * _CODES, rtol=1e-9, atol=0.0).any(axis=1)
        if not coded.any():
            return
        usual = float(np.nanquantile(size, _NEARLY_ALL))
        wrong = np.flatnonzero(coded & (size > _FAR * usual))
        why = f"nearly all others are below {usual / column.unit.factor:.3g} {column.unit.name}"
    if wrong.size:
        row = int(wrong[0])
        found = f"{numbers[row] / column.unit.factor:g} {column.unit.name}"
        raise DataError(
            f"{where(row)}: found {found}; {why} (is the unit right? an error code of the logger?)"
        )


def _still(series: Series, column: _Column) -> Iterator[str]:
    """Refuse a sensor that is dead all along; tell where one has stood still."""
    changes = np.flatnonzero(np.diff(series.values)) + 1
    if not changes.size:
        raise DataError(
            f"{series.place(0)}: found {series.values[0] / column.unit.factor:g} {column.unit.name} all"
            " along, as of a dead sensor; take its column out, or name those to assess with --column"
        )
    begun, ended = np.concatenate(([0], changes)), np.concatenate((changes, [len(series.values)])) - 1
    lasted = series.time[ended] - series.time[begun]
    if lasted.max() >= _STILL:
        first = int(begun[lasted.argmax()])
        start = series.time[first]
        yield (
            f"Column '{column.header}' stands at {series.values[first] / column.unit.factor:g}"
            f" {column.unit.name} from {start:.5g} to {start + lasted.max():.5g} s, as a dead sensor does."
        )


def _said(roles: _Roles, speed: float | None) -> list[str]:
    """Source of the speed, and units that were not SI."""
    notes = [f"Speed as given: {speed * KMH:g} km/h."] if speed is not None else []
    if roles.speed is not None:
        notes.append(f"Speed from column '{roles.speed.header}'.")
    scaled = dict.fromkeys(column.unit for column in roles.channels if column.unit.factor != 1.0)
    for unit in scaled:
        si = "m/s2" if unit.quantity == "acceleration" else "N"
        notes.append(f"{unit.name} was taken as {unit.factor:g} {si}.")
    return notes
