"""Text tables that people have: the one reader of them, and tables over distance, as tracks and lines are."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sayd_env.config.errors import DataError
from sayd_env.config.files import MIB, read_bytes
from sayd_env.config.loader import nearest
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array
from sayd_env.measured.dialect import (
    BLANKS,
    Head,
    Line,
    decimal_mark,
    decode,
    is_number,
    lines_of,
    read_head,
    split,
)
from sayd_env.measured.units import unit_of

LARGEST = 256 * MIB
"""Most that is read of a text table."""
MISSING = frozenset({"", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "1.#qnan", "-1.#ind"})
"""What stands in a cell without a value, in lower case."""

POSITIONS: Mapping[str, float] = {"x_m": 1.0, "x_km": 1000.0}
"""Columns of the distance, one of which a file has; metres in their unit."""
IRREGULARITIES = tuple(f"{channel}_mm" for channel in CHANNELS)
"""Columns of a track's departures from its nominal geometry."""
CONDITIONS = ("speed_kmh", "radius_m", "curvature_1_km", "cant_mm", "nominal_gauge_mm", "friction", "rail")
"""Columns of what lies along a line beside them."""

_MINIMAL, _NONE = 0, 3  # csv.QUOTE_MINIMAL and csv.QUOTE_NONE


@dataclass(frozen=True)
class TextTable:
    """A table in a text file: its header, and its cells and numbers on demand.

    Attributes
    ----------
    source : str
        The file.
    head : Head
        What stands above the rows.
    lines : ndarray of int, shape (n,)
        Line of each row in the file.
    width : int
        Most cells of a row; may be less than the columns of the header.
    encoding : str
        Of the file, as people call it.
    """

    source: str
    head: Head
    lines: NDArray[np.int64]
    width: int
    encoding: str
    _body: str = field(repr=False)

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def names(self) -> tuple[str, ...]:
        """Cells of the header; empty without one. A name may be empty or appear twice."""
        return self.head.names

    def where(self, row: int, column: int | None = None) -> str:
        """Line of a row in the file, and a column, as messages name them."""
        line = f"{self.source}: line {self.lines[row]}"
        return line if column is None else f"{line}: {self.titled(column)}"

    def titled(self, column: int) -> str:
        """A column as messages name it."""
        name = self.names[column] if column < len(self.names) else ""
        return f"column '{name}'" if name else f"column {column + 1}"

    def cells(self, columns: Sequence[int]) -> NDArray[np.object_]:
        """Text of columns, shape (n, len(columns)); "" where a row ends before a column."""
        found = np.full((len(self), len(columns)), "", dtype=object)
        frame = self._read([k for k in columns if k < self.width], dtype=str, keep_default_na=False)
        for place, k in enumerate(columns):
            if k < self.width:
                found[:, place] = [str(cell).strip() for cell in frame[k]]
        return found

    def numbers(self, columns: Sequence[int], *, gaps: bool = False) -> Array:
        """Numbers of columns.

        Parameters
        ----------
        columns : sequence of int
            Columns by their place.
        gaps : bool
            Cells without a value become NaN; otherwise they are refused.

        Returns
        -------
        ndarray, shape (n, len(columns))

        Raises
        ------
        DataError
            A cell that is no finite number, with its line and column; a decimal mark that is not the same
            everywhere, or could be one between thousands.
        """
        if not (len(self) and len(columns)):
            return np.empty((len(self), len(columns)))
        if self._plain and max(columns) < self.width:
            try:
                frame = self._read(columns, dtype=np.float64, keep_default_na=False, na_values=_MISSING)
            except ValueError:
                return self._converted(columns, gaps)
            values = np.column_stack([frame[k].to_numpy(dtype=np.float64) for k in columns])
            if not np.isinf(values).any() and (gaps or not np.isnan(values).any()):
                return values
        return self._converted(columns, gaps)

    @cached_property
    def _plain(self) -> bool:
        """Whether no comma can be a decimal mark, and no word passes for a number with pandas."""
        comma = self.head.separator != "," and "," in self._body
        return not (comma or '"' in self._body or _TRUTH.search(self._body))

    def _converted(self, columns: Sequence[int], gaps: bool) -> Array:
        """Numbers cell by cell, so that a bad one has a place."""
        cells = self.cells(columns)
        known = set(cells.ravel())

        def place(cell: str) -> str:
            row, k = (int(i) for i in np.argwhere(cells == cell)[0])
            return self.where(row, columns[k])

        mark = decimal_mark(known, place)
        values = {cell: _value(cell, mark) for cell in known}
        found = np.array([[values[cell] for cell in row] for row in cells], dtype=np.float64)
        wrong = np.isinf(found) if gaps else ~np.isfinite(found)
        if wrong.any():
            row, k = (int(i) for i in np.argwhere(wrong)[0])
            self._refuse(row, columns[k], cells[row, k])
        return found

    def _refuse(self, row: int, column: int, cell: str) -> NoReturn:
        finite = cell.lower().lstrip("+-").startswith(("nan", "inf"))
        expected = "a finite number" if finite else "a number"
        raise DataError(f"{self.where(row, column)}: found '{cell[:40]}'; expected {expected}")

    def _read(self, columns: Sequence[int], **how: Any) -> pd.DataFrame:
        return pd.read_csv(
            io.StringIO(self._body),
            sep=r"\s+" if self.head.separator == BLANKS else self.head.separator,
            header=None,
            names=list(range(self.width)),
            usecols=sorted(set(columns)),
            index_col=False,
            skipinitialspace=True,
            skip_blank_lines=False,
            quoting=_MINIMAL if '"' in self._body else _NONE,
            low_memory=False,
            **how,
        )


_TRUTH = re.compile("true|false", re.IGNORECASE)
_FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[-+]?\d)")
_MISSING = sorted({form for word in MISSING for form in (word, word.upper(), word.capitalize(), "NaN")})


def _value(cell: str, mark: str) -> float:
    """A finite number, NaN for a missing one, infinite for anything else."""
    if cell.lower() in MISSING:
        return np.nan
    if not is_number(cell):
        return np.inf
    try:
        return float(_FORTRAN.sub("e", cell.replace(",", ".") if mark == "," else cell))
    except ValueError:
        return np.inf


def read_text_table(path: str | Path, what: str = "table", largest: int = LARGEST) -> TextTable:
    """Read a text table as measuring systems, spreadsheets and programs write it.

    Encoding, separator (semicolon, tab, bar, comma or blanks), decimal mark, quotes, comments (lines that
    begin with ``#``, ``!``, ``%`` or ``//``), lines before the header, a row of units below it and trailing
    separators are found out from the file. What stays open is refused.

    Parameters
    ----------
    path : str or Path
        A regular file.
    what : str
        What it should be, for messages.
    largest : int
        Most bytes that are read.

    Raises
    ------
    ConfigError
        The file cannot be read, is too large, or is no text.
    DataError
        It is empty, a quotation mark is not closed, or a row has more cells than there are columns.
    """
    source = str(path)
    text, encoding = decode(read_bytes(Path(path), what, largest), source)
    lines, comments, separator = lines_of(text)
    if not lines:
        raise DataError(f"{source}: is empty; expected a {what}")
    return table_of(lines, source, comments=comments, separator=separator, encoding=encoding)


def table_of(
    lines: Sequence[Line],
    source: str,
    *,
    comments: Sequence[Line] = (),
    separator: str = "",
    encoding: str = "UTF-8",
) -> TextTable:
    """Table of lines, one at least: of a whole file, or of a part of it whose beginning is told otherwise.

    Parameters
    ----------
    lines, comments, separator
        See `sayd_env.measured.dialect.lines_of`.
    source, encoding : str
        The file and its encoding.

    Raises
    ------
    DataError
        A quotation mark is not closed, or a row has more cells than there are columns.
    """
    head = read_head(lines, comments, separator, source)
    rows = lines[head.rows :]
    width = _width(rows, head, source)
    numbers = np.array([line.number for line in rows], dtype=np.int64)
    return TextTable(source, head, numbers, width, encoding, "\n".join(line.text for line in rows))


def _width(rows: Iterable[Line], head: Head, source: str) -> int:
    """Most cells of a row, empty ones at its end included; only empty ones may lie beyond the columns."""
    widest = 0
    separator = head.separator
    for row in rows:
        cells = row.text.count(separator) + 1 if separator != BLANKS else len(row.text.split())
        if cells > head.width or '"' in row.text:
            found = split(row, separator, source)
            filled = max((k + 1 for k, cell in enumerate(found) if cell), default=0)
            if filled > head.width:
                hint = " (a decimal comma needs another separator, or quotes)" if separator == "," else ""
                raise DataError(
                    f"{source}: line {row.number}: found {filled} cells; expected {head.width}{hint}"
                )
            cells = len(found)
        widest = max(widest, cells)
    return widest


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
    lines : sequence of int
        Line of each row in the file.
    """

    source: str
    position: str
    x: Array
    columns: Mapping[str, Array]
    lines: Sequence[int]

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
        The file, see `read_text_table`; a unit stands in a column's name (``gauge_mm``) or below it.
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
    text = read_text_table(path, "table over distance")
    where = f"{text.source}: line {text.head.line}"
    names = _with_units(text.head, where)
    _check_header(names, needed, where)
    if len(text) < rows:
        raise DataError(f"{text.source}: found {len(text)} rows of numbers; at least {rows} are needed")
    columns = dict(zip(names, text.numbers(range(len(names))).T, strict=True))
    position = next(name for name in POSITIONS if name in columns)
    lines = text.lines.tolist()
    table = Table(text.source, position, POSITIONS[position] * columns.pop(position), columns, lines)
    _check_order(table)
    return table


def _with_units(head: Head, where: str) -> list[str]:
    """Names of columns with the units that stand below them."""
    if not head.names:
        raise DataError(f"{where}: found no header; expected {' or '.join(POSITIONS)} and names of columns")
    names = []
    for name, unit in zip(head.names, head.units or [""] * len(head.names), strict=True):
        known = unit_of(unit)
        suffix = "" if known is None or known.name in ("-", "1") else "_" + known.name.replace("/", "_")
        names.append(name if name.lower().endswith(suffix.lower()) else name + suffix.replace("km_h", "kmh"))
    return names


def _check_header(names: Sequence[str], needed: Collection[str], where: str) -> None:
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


def _check_order(table: Table) -> None:
    spacing = np.diff(table.x)
    wrong = np.flatnonzero(spacing <= 0.0)
    if wrong.size:
        i = int(wrong[0]) + 1
        problem = "appears twice" if spacing[i - 1] == 0.0 else f"comes after {table.place(i - 1)}"
        raise DataError(f"{table.where(i)}: {table.place(i)} {problem}; positions must ascend")
