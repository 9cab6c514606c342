"""Text tables that people have: the one reader of them."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from sayd_env.config.errors import DataError
from sayd_env.config.files import MIB, read_bytes
from sayd_env.config.units import Array, Integers
from sayd_env.measured.dialect import (
    BLANKS,
    Head,
    Line,
    decimal_mark,
    decode,
    hollow,
    is_number,
    lines_of,
    read_head,
    split,
)
from sayd_env.measured.units import name_and_unit

if TYPE_CHECKING:
    from pandas import DataFrame

LARGEST = 256 * MIB
"""Most that is read of a text table."""
MISSING = frozenset({"", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "1.#qnan", "-1.#ind"})
"""What stands in a cell without a value, in lower case."""

# In no unit is any quantity of a vehicle, a track or a damper as large.
_BEYOND = 1e15
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
        Most cells of a row.
    encoding : str
        Of the file, as people call it.
    notes : tuple of str
        What of the file was left out.
    """

    source: str
    head: Head
    lines: Integers
    width: int
    encoding: str
    _body: str = field(repr=False)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.lines)

    @property
    def names(self) -> tuple[str, ...]:
        """Cells of the header; empty without one. A name may be empty or appear twice."""
        return self.head.names

    def no_header(self) -> str:
        """What messages say of a table whose columns have no names."""
        lines = self.head.preamble
        text = f"{self.source}: line {self.head.line}: found no header"
        if not lines:
            return text
        text += f" (what stands above has not {self.head.width} names)"
        names = lines[-1].lstrip("#!%/ ").count(",") + 1
        # 0,5,1,5 below x,y: each of its numbers may have been cut into two.
        if self.head.separator == "," and 1 < names < self.head.width <= 2 * names:
            text += (
                "; commas stand between columns and seem to stand for decimal points as well, so that "
                "numbers cannot be told apart: write another separator, or decimal points"
            )
        return text

    def where(self, row: int, column: int | None = None) -> str:
        """Line of a row in the file, and a column, as messages name them."""
        line = f"{self.source}: line {self.lines[row]}"
        return line if column is None else f"{line}: {self.titled(column)}"

    def titled(self, column: int) -> str:
        """A column as messages name it."""
        name = self.names[column] if column < len(self.names) else ""
        return f"column '{name}'" if name else f"column {column + 1}"

    def first(self, column: int) -> str:
        """Text of a column in the first row, "" without one."""
        text = self._body.partition("\n")[0]
        cells = split(Line(int(self.lines[0]), text), self.head.separator, self.source) if text else []
        return cells[column] if column < len(cells) else ""

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
        for mark in (".", ",") if max(columns) < self.width and not _TRUTH.search(self._body) else ():
            values = self._parsed(columns, mark)
            if values is not None and not np.isinf(values).any() and (gaps or not np.isnan(values).any()):
                return values
        return self._converted(columns, gaps)

    def _parsed(self, columns: Sequence[int], mark: str) -> Array | None:
        """Numbers with a decimal mark, None if there are others, or the mark could be one of thousands."""
        how: dict[str, Any] = {
            "dtype": np.float64,
            "decimal": mark,
            "keep_default_na": False,
            "na_values": _MISSING,
        }
        try:
            frame = self._read(columns, **how)
        except ValueError:
            return None
        values: Array = np.column_stack([np.asarray(frame[k], dtype=np.float64) for k in columns])
        if mark == ".":
            return values
        # 0,5 and 1,2345 and 1234,5 have no mark between thousands.
        part = np.abs(values[np.isfinite(values) & (values != np.round(values))])
        decisive = (part < 1.0) | (part >= 1000.0) | (np.abs(1e3 * part - np.round(1e3 * part)) > 1e-3)
        return values if decisive.any() else None

    def _converted(self, columns: Sequence[int], gaps: bool) -> Array:
        """Numbers cell by cell, so that a bad one has a place."""
        import pandas as pd  # noqa: PLC0415 - every start of the simulator comes by here

        cells = self.cells(columns)

        def place(cell: str) -> str:
            row, k = (int(i) for i in np.argwhere(cells == cell)[0])
            return self.where(row, columns[k])

        mark = decimal_mark({cell for cell in cells.ravel() if "," in cell or "." in cell}, place)
        text = pd.Series(cells.ravel())
        numbers = pd.to_numeric(text.str.replace(",", ".") if mark == "," else text, errors="coerce")
        found: Array = np.array(numbers, dtype=np.float64)
        odd = np.flatnonzero(~np.isfinite(found))
        found[odd] = [_value(cell, mark) for cell in cells.ravel()[odd]]
        found = found.reshape(cells.shape)
        wrong = np.isinf(found) if gaps else ~np.isfinite(found)
        if wrong.any():
            row, k = (int(i) for i in np.argwhere(wrong)[0])
            self._refuse(row, columns[k], cells[row, k])
        return found

    def _refuse(self, row: int, column: int, cell: str) -> NoReturn:
        finite = cell.lower().lstrip("+-").startswith(("nan", "inf"))
        expected = "a finite number" if finite else "a number"
        if _THOUSANDS.fullmatch(cell):
            expected += "; thousands separators are not read"
        raise DataError(f"{self.where(row, column)}: found '{cell[:40]}'; expected {expected}")

    def _read(self, columns: Sequence[int], **how: Any) -> DataFrame:
        import pandas as pd  # noqa: PLC0415 - every start of the simulator comes by here

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


_UNFINISHED = re.compile(r"[-+.,]$|\d[eEdD]$")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:([,.' \u2019\u00a0\u202f])\d{3})(?:\1\d{3})*(?:[.,]\d*)?")
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


def read_text_table(
    path: str | Path, what: str = "table", largest: int = LARGEST, *, may_end_short: bool = False
) -> TextTable:
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
    may_end_short : bool
        A last line that was cut off, as where a logger lost its power, is left out, with a note.

    Raises
    ------
    ConfigError
        The file cannot be read, is too large, or is no text.
    DataError
        It is empty, a quotation mark is not closed, or a row has more or fewer cells than there are columns.
    """
    source = str(path)
    text, encoding = decode(read_bytes(Path(path), what, largest), source)
    lines, comments, separator = lines_of(text)
    if not lines:
        raise DataError(f"{source}: is empty; expected a header and rows of numbers")
    cut = may_end_short and not text.endswith("\n")
    table = table_of(
        lines,
        source,
        comments=comments,
        separator=separator,
        encoding=encoding,
        may_end_short=may_end_short,
        cut=cut,
    )
    refuse_hollow(text, table)
    return table


def refuse_hollow(text: str, table: TextTable) -> None:
    """Refuse rows of separators alone among a table's rows: numbers are missing there.

    Raises
    ------
    DataError
        The message says the line.
    """
    if len(table) and (number := hollow(text, int(table.lines[0]), int(table.lines[-1]))):
        raise DataError(f"{table.source}: line {number}: found separators alone; expected a row of numbers")


def table_of(
    lines: Sequence[Line],
    source: str,
    *,
    comments: Sequence[Line] = (),
    separator: str = "",
    encoding: str = "UTF-8",
    may_end_short: bool = False,
    cut: bool = False,
) -> TextTable:
    """Table of lines, one at least: of a whole file, or of a part of it whose header is read elsewhere.

    Parameters
    ----------
    lines, comments, separator
        See `sayd_env.measured.dialect.lines_of`.
    source, encoding : str
        The file and its encoding.
    may_end_short : bool
        See `read_text_table`.
    cut : bool
        The last line has no end, so that its last number may have been cut.

    Raises
    ------
    DataError
        A quotation mark is not closed, or a row has more or fewer cells than there are columns.
    """
    head = read_head(lines, comments, separator, source)
    rows = lines[head.rows :]
    notes: tuple[str, ...] = ()
    if may_end_short and len(rows) > 1 and (why := _cut_off(rows, head, cut)):
        notes = (f"Line {rows[-1].number}, the last one, is left out: it {why}.",)
        rows = rows[:-1]
    width = _width(rows, head, source)
    numbers = np.array([line.number for line in rows], dtype=np.int64)
    # Blanks of all kinds are one: pandas does not know them all.
    plain = head.separator == BLANKS and not any('"' in line.text for line in rows)
    body = "\n".join(" ".join(line.text.split()) if plain else line.text for line in rows)
    return TextTable(source, head, numbers, width, encoding, body, notes)


def _count(text: str, separator: str) -> int:
    """Cells of a line without quotation marks, empty ones at its end included."""
    return text.count(separator) + 1 if separator != BLANKS else len(text.split())


def _cut_off(rows: Sequence[Line], head: Head, cut: bool) -> str:
    """What shows that the last line was not written to its end, "" for nothing."""
    *_, above, last = rows
    cells = _count(last.text, head.separator)
    if cells < head.width and '"' not in last.text:
        return f"has {cells} of {head.width} cells"
    if cut and _UNFINISHED.search(last.text) and not _UNFINISHED.search(above.text):
        return f"ends within a number ('{last.text[-20:]}')"
    return ""


def _width(rows: Iterable[Line], head: Head, source: str) -> int:
    """Most cells of a row, empty ones at its end included; only empty ones may lie beyond the columns."""
    widest = 0
    separator = head.separator
    for row in rows:
        cells = _count(row.text, separator)
        if cells > head.width or '"' in row.text:
            found = split(row, separator, source)
            filled = max((k + 1 for k, cell in enumerate(found) if cell), default=0)
            if filled > head.width:
                hint = " (a decimal comma needs another separator, or quotes)" if separator == "," else ""
                raise DataError(
                    f"{source}: line {row.number}: found {filled} cells; expected {head.width}{hint}"
                )
            cells = len(found)
        if cells < head.width:
            raise DataError(
                f"{source}: line {row.number}: found {cells} cell{'s' * (cells != 1)}, "
                f"'{row.text.strip()[:40]}'; expected {head.width}"
            )
        widest = max(widest, cells)
    return widest


def labelled(table: TextTable, column: int) -> tuple[str, str]:
    """Name of a column in small letters with ``_`` between words, and its unit as the file has it, or ""."""
    name, unit = name_and_unit(table.names[column])
    below = table.head.units[column] if table.head.units else ""
    return "_".join(re.findall(r"[^\W_]+", name.lower())), unit or below


def physical_numbers(table: TextTable, columns: Sequence[int]) -> Array:
    """Numbers of columns as `TextTable.numbers` gives them, none of which is beyond all quantities.

    Raises
    ------
    DataError
        As there, or a number that would overflow when it is squared or given another unit.
    """
    found = table.numbers(columns)
    for row, k in np.argwhere(np.abs(found) > _BEYOND)[:1]:
        raise DataError(
            f"{table.where(int(row), columns[k])}: found {found[row, k]:g}; at most {_BEYOND:g} is read"
        )
    return found
