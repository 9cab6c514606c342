"""A measured file over distance: CSV with a header, each column a quantity with its unit in its name."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sayd_env.config.errors import DataError
from sayd_env.config.loader import nearest, read_text
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array

POSITIONS: Mapping[str, float] = {"x_m": 1.0, "x_km": 1000.0}
"""Columns of the distance, one of which a file has; metres in their unit."""
IRREGULARITIES = tuple(f"{channel}_mm" for channel in CHANNELS)
"""Columns of a track's departures from its nominal geometry."""
CONDITIONS = ("speed_kmh", "radius_m", "curvature_1_km", "cant_mm", "nominal_gauge_mm", "friction", "rail")
"""Columns of what lies along a line beside them."""


@dataclass(frozen=True)
class Table:
    """Columns of a file in the units of their names, and the lines where its rows stand.

    Attributes
    ----------
    source : str
        The file.
    position : str
        Name of the column of the distance.
    x : ndarray, shape (n,)
        Ascending distances (m).
    columns : mapping
        The other columns by name, each of shape (n,).
    lines : list of int
        Line of each row in the file.
    """

    source: str
    position: str
    x: Array
    columns: Mapping[str, Array]
    lines: list[int]

    def where(self, row: int) -> str:
        """Line of a row in the file, as messages name it."""
        return f"{self.source}: line {self.lines[row]}"

    def place(self, row: int) -> str:
        """Distance of a row, as it stands in the file."""
        return f"{self.position} {self.x[row] / POSITIONS[self.position]:g}"


def read_table(path: str | Path, needed: Collection[str], rows: int) -> Table:
    """Read a file over distance.

    Parameters
    ----------
    path : str or Path
        The file: commas between columns, a point in numbers, blank lines skipped.
    needed : collection of str
        Columns of which it has one at least.
    rows : int
        Fewest rows of numbers.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        No, unknown, missing or repeated columns; cells that are not finite numbers; too few rows; distances
        that do not ascend.
    """
    source = str(path)
    reader = csv.reader(io.StringIO(read_text(Path(path)).removeprefix("\ufeff"), newline=""), strict=True)
    try:
        found = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise DataError(f"{source}: line {reader.line_num}: not a CSV file ({error})") from None
    if not found:
        raise DataError(
            f"{source}: is empty; expected a header with {' or '.join(POSITIONS)} and any of "
            f"{', '.join(needed)}"
        )
    header = _header(found[0][1], needed, f"{source}: line {found[0][0]}")
    if len(found) - 1 < rows:
        raise DataError(f"{source}: found {len(found) - 1} rows of numbers; at least {rows} are needed")
    lines = [line for line, _ in found[1:]]
    cells = np.array([_numbers(row, header, f"{source}: line {line}") for line, row in found[1:]])
    columns = dict(zip(header, cells.T, strict=True))
    position = next(name for name in POSITIONS if name in columns)
    table = Table(source, position, POSITIONS[position] * columns.pop(position), columns, lines)
    _check_order(table)
    return table


def _header(row: Iterable[str], needed: Collection[str], where: str) -> list[str]:
    names = [cell.strip() for cell in row]
    allowed = (*POSITIONS, *IRREGULARITIES, *CONDITIONS)
    for name in names:
        if name not in allowed:
            raise DataError(
                f"{where}: unknown column '{name}'{nearest(name, allowed)}; allowed: {', '.join(allowed)}"
            )
        if names.count(name) > 1:
            raise DataError(f"{where}: column '{name}' appears twice")
    positions = [name for name in names if name in POSITIONS]
    if not positions:
        raise DataError(
            f"{where}: column {' or '.join(map(repr, POSITIONS))} is missing; found {', '.join(names)}"
        )
    if len(positions) > 1:
        raise DataError(f"{where}: found {' and '.join(positions)}; expected one of them")
    if not set(needed) & set(names):
        raise DataError(
            f"{where}: nothing to read beside '{positions[0]}'; expected any of {', '.join(needed)}"
        )
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


def _check_order(table: Table) -> None:
    spacing = np.diff(table.x)
    wrong = np.flatnonzero(spacing <= 0.0)
    if wrong.size:
        i = int(wrong[0]) + 1
        problem = "appears twice" if spacing[i - 1] == 0.0 else f"comes after {table.place(i - 1)}"
        raise DataError(f"{table.where(i)}: {table.place(i)} {problem}; positions must ascend")
