"""A table, said once: its columns make what is printed, the CSV file and the rows of the JSON document."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, TypeAlias

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table as PrintedTable
from rich.text import Text

Table: TypeAlias = tuple[Sequence[str], Iterable[Sequence[Any]]]
"""Header and rows; units stand in the header names (``speed_kmh``)."""
DERAILED = "derailed"
"""How an infinite ratio to a limit is printed."""
LIMITED: dict[str, Any] = {"digits": 2, "limit": 1.0, "infinite": DERAILED}
"""Of a column of ratios to a limit."""
PERCENT: dict[str, Any] = {"unit": "%", "scale": 100.0, "digits": 0}
"""Of a column of shares."""


_GAP = 2  # characters between columns
_UNBROKEN = (22, 20)  # characters of a word that is not broken; the second where room lacks
_LONG = 10_000  # from here on a whole number is easier to read with its thousands apart


@dataclass(frozen=True)
class Column:
    """A column of a study's table."""

    name: str
    """Where a row has its value: its key or attribute, and the name in CSV and JSON."""
    header: str = ""
    """Heading of the printed column; without one the column is not printed."""
    unit: str = ""
    """Of the printed values."""
    scale: float = 1.0
    """Printed value over stored value."""
    digits: int | None = None
    """Of a printed number behind the point; None for four that count."""
    limit: float = math.inf
    """Values above it are printed in red."""
    best: bool = False
    """The lowest value of a section is printed in bold."""
    wide: bool = False
    """Printed with ``--wide`` only."""
    infinite: str = "inf"
    """How an infinite value is printed."""
    bad: Callable[[Any], bool] | None = None
    """Which values are printed in red."""

    @property
    def heading(self) -> str:
        """Heading with the unit."""
        return f"{self.header} ({self.unit})" if self.unit else self.header

    def of(self, row: Any) -> Any:
        """Value of a row, a mapping or an object."""
        return row[self.name] if isinstance(row, Mapping) else getattr(row, self.name)

    def words(self, value: Any) -> str:
        """How a value is printed."""
        if value is None or (_is_number(value) and math.isnan(value)):
            return "-"
        if isinstance(value, bool | np.bool_):
            return "yes" if value else "no"
        if not _is_number(value):
            return "".join(c if c.isprintable() else "\ufffd" for c in str(value))
        if math.isinf(value):
            return self.infinite if value > 0 else f"-{self.infinite}"
        if isinstance(value, int | np.integer) and self.scale == 1.0 and self.digits is None:
            return f"{value:,}" if abs(int(value)) >= _LONG else str(value)
        return self._number(self.scale * float(value))

    def _number(self, value: float) -> str:
        if self.digits is not None:
            return f"{value:.{self.digits}f}"
        return f"{value:,.0f}" if abs(value) >= _LONG else f"{value:.4g}"

    def style(self, value: Any, lowest: float) -> str:
        """How a value stands out where `lowest` is the lowest one of its section."""
        number = _is_number(value)
        bold = self.best and number and value == lowest
        infinite = number and math.isinf(value)
        red = infinite or (number and value > self.limit) or (self.bad is not None and self.bad(value))
        return " ".join(word for word, on in (("bold", bold or infinite), ("red", red)) if on)


@dataclass(frozen=True)
class Listing:
    """A table that is printed and that stands on a page."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Any]
    """Mappings or objects that have the columns' values."""
    section: str | None = None
    """Where rows have what a section has in common; without it the table is one section."""

    def print(self, console: Console, wide: bool = False) -> None:
        """Print the columns that have a heading, those of ``--wide`` only if `wide`.

        Texts are wrapped where the console is narrow, unless `wide`. Numbers are not: where there is no room
        for all of them the last columns are left to ``--wide``.
        """
        shown = [column for column in self.columns if column.header and (wide or not column.wide)]
        gaps = _GAP * (len(shown) - 1)
        widths = _widths(shown, self.rows, math.inf if wide else console.width - gaps)
        while not wide and sum(widths) + gaps > console.width and len(shown) > 1:
            shown, gaps = shown[:-1], gaps - _GAP
            widths = _widths(shown, self.rows, console.width - gaps)
        table = PrintedTable(
            box=box.SIMPLE_HEAD,
            pad_edge=False,
            padding=(0, _GAP - 1, 0, 0),
            show_edge=False,
            width=sum(widths) + gaps,
        )
        for column, width in zip(shown, widths, strict=True):
            justify: Any = "right" if is_numeric(column, self.rows) else "left"
            table.add_column(Text(column.heading), justify=justify, width=width, overflow="fold")
        for group in styled(shown, self.rows, self.section):
            for row, cells in group:
                table.add_row(*map(Text.assemble, cells), end_section=row is group[-1][0])
        console.print(Text(self.title, "bold"))
        console.print(table, crop=False)
        hidden = sum(bool(column.header) for column in self.columns) - len(shown)
        if hidden:
            console.print(f"{hidden} more column{'s' if hidden > 1 else ''} with --wide", style="italic")
        console.print()


def csv_table(columns: Sequence[Column], rows: Iterable[Any]) -> Table:
    """Stored values of all columns, as a CSV file has them."""
    return [column.name for column in columns], [[column.of(row) for column in columns] for row in rows]


def json_rows(columns: Sequence[Column], rows: Iterable[Any]) -> list[dict[str, Any]]:
    """Stored values of all columns, as the JSON document has them."""
    return [{column.name: column.of(row) for column in columns} for row in rows]


def styled(
    columns: Sequence[Column], rows: Sequence[Any], section: str | None = None
) -> Iterator[list[tuple[Any, list[tuple[str, str]]]]]:
    """Rows in their sections, each with what is shown of it: the words of every cell and how it stands out.

    Rows and section are those of a `Listing`.
    """
    for group in _sections(rows, section):
        lowest = [_lowest(column, group) for column in columns]
        yield [
            (
                row,
                [
                    (column.words(value), column.style(value, least))
                    for column, least in zip(columns, lowest, strict=True)
                    for value in (column.of(row),)
                ],
            )
            for row in group
        ]


def is_numeric(column: Column, rows: Sequence[Any]) -> bool:
    """Whether a column holds numbers alone, which stand on the right."""
    return all(value is None or _is_number(value) for value in map(column.of, rows))


def _widths(columns: Sequence[Column], rows: Sequence[Any], room: float) -> list[int]:
    """Widths of the columns: what they need, or as little as leaves words whole where there is no room."""
    lines = [[column.heading, *(column.words(column.of(row)) for row in rows)] for column in columns]
    widths = [max(map(len, texts)) for texts in lines]
    words = [[word for text in texts for word in text.split()] for texts in lines]
    for unbroken in _UNBROKEN:
        least = [max((min(len(word), unbroken) for word in each), default=1) for each in words]
        while sum(widths) > room and any(width > low for width, low in zip(widths, least, strict=True)):
            widest = max(range(len(widths)), key=lambda i: (widths[i] > least[i], widths[i]))
            widths[widest] -= 1
    return widths


def _sections(rows: Sequence[Any], section: str | None) -> list[list[Any]]:
    if section is None:
        return [list(rows)] if rows else []
    common = Column(section)
    return [list(group) for _, group in groupby(rows, common.of)]


def _lowest(column: Column, rows: Sequence[Any]) -> float:
    """Lowest value of a section; NaN, which equals nothing, where there is no other to compare it with."""
    values = [value for row in rows if _is_number(value := column.of(row)) and not math.isnan(value)]
    return min(values) if len(rows) > 1 and values else math.nan


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
