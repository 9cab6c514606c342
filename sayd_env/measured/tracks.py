"""Measured track irregularities from a CSV file."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from sayd_env.config.errors import DataError
from sayd_env.config.loader import nearest, read_text
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array

POSITION = "x_m"
COLUMNS = tuple(f"{channel}_mm" for channel in CHANNELS)

_MIN_ROWS = 4
# A hole this many times wider than the usual spacing is missing data, over which a spline would swing freely.
_MAX_GAP = 10.0
# No railway in service departs further from its nominal geometry: such a number has another unit.
_MAX_MM = 200.0


@dataclass(frozen=True)
class MeasuredTrack:
    """Measured irregularities in SI units.

    Attributes
    ----------
    source : str
        The file.
    x : ndarray, shape (n,)
        Ascending positions (m).
    values : ndarray, shape (n, 4)
        Alignment, vertical (m), cross-level (rad), gauge (m); zero for channels that the file lacks.
    """

    source: str
    x: Array
    values: Array

    def at(self, x: Array) -> Array:
        """Values at positions by a cubic spline, shape (m, 4); outside the file those at its ends.

        Waves shorter than twice the distance of the positions asked for must not be in the file: they would
        be folded into longer ones.
        """
        inside = np.clip(x, self.x[0], self.x[-1])
        return np.asarray(CubicSpline(self.x, self.values, axis=0)(inside), dtype=np.float64)


def read_measured(path: str | Path, cross_level_base: float = 1.5) -> MeasuredTrack:
    """Read a CSV file with header ``x_m`` and any of ``alignment_mm, vertical_mm, cross_level_mm, gauge_mm``.

    Parameters
    ----------
    path : str or Path
        The file: commas between columns, a point in numbers, blank lines skipped.
    cross_level_base : float
        Distance over which the rails' difference in height is measured (m): angle = height / base.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        No, unknown, missing or repeated columns; cells that are not finite numbers; positions that do not
        ascend; fewer than four rows; a gap; numbers too large to be millimetres.
    """
    source = str(path)
    reader = csv.reader(io.StringIO(read_text(Path(path)).removeprefix("\ufeff"), newline=""), strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise DataError(f"{source}: line {reader.line_num}: not a CSV file ({error})") from None
    if not rows:
        raise DataError(
            f"{source}: is empty; expected a header with {POSITION} and any of {', '.join(COLUMNS)}"
        )
    header = _header(rows[0][1], f"{source}: line {rows[0][0]}")
    if len(rows) - 1 < _MIN_ROWS:
        raise DataError(f"{source}: found {len(rows) - 1} rows of numbers; at least {_MIN_ROWS} are needed")
    lines = [line for line, _ in rows[1:]]
    table = np.array([_numbers(row, header, f"{source}: line {line}") for line, row in rows[1:]])
    x = table[:, header.index(POSITION)]
    _check_positions(x, lines, source)
    _check_size(table, header, lines, source)
    return MeasuredTrack(source, x, _channels(table, header, cross_level_base))


def _header(row: Iterable[str], where: str) -> list[str]:
    names = [cell.strip() for cell in row]
    allowed = (POSITION, *COLUMNS)
    for name in names:
        if name not in allowed:
            raise DataError(
                f"{where}: unknown column '{name}'{nearest(name, allowed)}; allowed: {', '.join(allowed)}"
            )
        if names.count(name) > 1:
            raise DataError(f"{where}: column '{name}' appears twice")
    if POSITION not in names:
        raise DataError(f"{where}: column '{POSITION}' is missing; found {', '.join(names)}")
    if len(names) == 1:
        raise DataError(f"{where}: no irregularity beside '{POSITION}'; expected any of {', '.join(COLUMNS)}")
    return names


def _numbers(row: list[str], header: list[str], where: str) -> list[float]:
    if len(row) != len(header):
        raise DataError(f"{where}: found {len(row)} cells; expected {len(header)} ({', '.join(header)})")
    return [_number(cell, f"{where}: column '{name}'") for cell, name in zip(row, header, strict=True)]


def _number(cell: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        raise DataError(f"{where}: found '{cell.strip()[:40]}'; expected a number") from None
    if not np.isfinite(value):
        raise DataError(f"{where}: found '{cell.strip()}'; expected a finite number")
    return value


def _check_positions(x: Array, lines: list[int], source: str) -> None:
    spacing = np.diff(x)
    wrong = np.flatnonzero(spacing <= 0.0)
    if wrong.size:
        i = int(wrong[0]) + 1
        problem = "appears twice" if spacing[i - 1] == 0.0 else f"comes after {x[i - 1]:g} m"
        raise DataError(f"{source}: line {lines[i]}: {POSITION} {x[i]:g} {problem}; positions must ascend")
    usual = float(np.median(spacing))
    gaps = np.flatnonzero(spacing > _MAX_GAP * usual)
    if gaps.size:
        i = int(gaps[0]) + 1
        raise DataError(
            f"{source}: line {lines[i]}: a gap of {spacing[i - 1]:g} m before {POSITION} {x[i]:g}; "
            f"the usual spacing is {usual:g} m, at most {_MAX_GAP:g} times that is allowed"
        )


def _check_size(table: Array, header: list[str], lines: list[int], source: str) -> None:
    for j, name in enumerate(header):
        if name == POSITION:
            continue
        large = np.flatnonzero(np.abs(table[:, j]) > _MAX_MM)
        if large.size:
            i = int(large[0])
            raise DataError(
                f"{source}: line {lines[i]}: column '{name}': found {table[i, j]:g} mm; "
                f"at most {_MAX_MM:g} mm is allowed (is the unit mm?)"
            )


def _channels(table: Array, header: list[str], cross_level_base: float) -> Array:
    values = np.zeros((len(table), len(CHANNELS)))
    for j, (channel, name) in enumerate(zip(CHANNELS, COLUMNS, strict=True)):
        if name in header:
            base = cross_level_base if channel == "cross_level" else 1.0
            values[:, j] = 1e-3 * table[:, header.index(name)] / base
    return values
