"""How a text table is written: encoding, separator, decimal mark, and which of its lines hold numbers."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import NamedTuple

from sayd_env.config.errors import ConfigError, DataError
from sayd_env.measured.units import unit_of, without_brackets

BLANKS = " "
"""The separator that stands for any run of blanks and tabs."""
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", BLANKS: "blanks"}
COMMENT = ("#", "!", "%", "//")
"""A line that begins so is a comment."""

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig", "UTF-8"),
    (codecs.BOM_UTF32_LE, "utf-32", "UTF-32"),
    (codecs.BOM_UTF32_BE, "utf-32", "UTF-32"),
    (codecs.BOM_UTF16_LE, "utf-16", "UTF-16"),
    (codecs.BOM_UTF16_BE, "utf-16", "UTF-16"),
)
# Most lines that are looked at to find out how the others are written.
_SAMPLE = 500
# Excel writes the separator into the first line, and a cell of a header may go over several lines.
_CLOCK_FORM = re.compile(r"h{1,2}:m{1,2}:s{1,2}(?:[.,]\w+)?", re.IGNORECASE)
_SEPARATOR_LINE = re.compile(r'"?sep=(.)"?\s*', re.IGNORECASE)
_LONGEST_CELL, _LONGEST_HEAD = 5, 200
_HOLLOW = re.compile(r"[ \t]*[;,|][ \t;,|]*|[ \t]*\t[ \t]*")
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")
# Looser than a number: how 1.234,5 is meant is not decided here.
_NUMBER = re.compile(r"[-+]?(?:[.,]?\d[\d.,]*(?:[eEdD][-+]?\d+)?|inf(?:inity)?|nan)", re.IGNORECASE)
_DECIMAL = re.compile(r"[-+]?\d*,\d*(?:[eE][-+]?\d+)?")
# 1,234 is 1.234 or 1234; not so 0,234 and 1,2345 and 12345,678.
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+")


class Line(NamedTuple):
    """A line of the file that is neither blank nor a comment."""

    number: int
    text: str


def decode(content: bytes, source: str) -> tuple[str, str]:
    """Text of a file and the name of its encoding: by its byte-order mark, else UTF-8 or Windows-1252.

    Raises
    ------
    ConfigError
        It is not text.
    """
    codec, name = next((each[1:] for each in _MARKS if content.startswith(each[0])), None) or _unmarked(
        content
    )
    try:
        text = content.decode(codec)
    except UnicodeDecodeError:
        raise ConfigError(f"{source}: is not a text file") from None
    text = text.replace("\r\n", "\n").replace("\r", "\n").rstrip("\x1a")  # as MS-DOS ends a file
    if _CONTROL.search(text):
        raise ConfigError(f"{source}: is not a text file")
    return text, name


def _unmarked(content: bytes) -> tuple[str, str]:
    """Codec and name of an encoding without a mark."""
    # In UTF-16 every other byte of Western text is zero.
    zeros = content[:1000].count(0)
    if zeros > 0.3 * len(content[:1000]):
        even = content[:1000:2].count(0)
        return ("utf-16-be" if 2 * even > zeros else "utf-16-le"), "UTF-16"
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252", "Windows-1252"
    return "utf-8", "UTF-8"


def lines_of(text: str) -> tuple[list[Line], list[Line], str]:
    """Lines that count, comments, and the separator that the file itself names, "" if it does not.

    Lines that are blank, or have separators alone, do not count; see `hollow`.
    """
    texts = text.split("\n")
    named = _SEPARATOR_LINE.fullmatch(texts[0])
    lines: list[Line] = []
    comments: list[Line] = []
    number = 1 if named else 0
    while number < len(texts):
        start, line = number, texts[number]
        number += 1
        if start < _LONGEST_HEAD and line.count('"') % 2:
            line, number = _whole(texts, start)
        if line.lstrip().startswith(COMMENT):
            comments.append(Line(start + 1, line))
        elif line.strip(" \t;,|"):
            lines.append(Line(start + 1, line))
    return lines, comments, named[1] if named else ""


def hollow(text: str, first: int, last: int) -> int | None:
    """Number of the first line between two others that has separators and nothing else, None without one."""
    texts = text.split("\n")[first : last - 1]
    return next((first + 1 + k for k, line in enumerate(texts) if _HOLLOW.fullmatch(line)), None)


def _whole(texts: list[str], start: int) -> tuple[str, int]:
    """A line whose quoted cell goes on in the next ones, and the line behind it."""
    quotes = 0
    for end in range(start, min(start + _LONGEST_CELL, len(texts))):
        quotes += texts[end].count('"')
        if quotes % 2 == 0 and not any(is_number(cell) for cell in re.split("[;,\t]", texts[end])):
            return " ".join(text.strip() for text in texts[start : end + 1]), end + 1
    return texts[start], start + 1


def split(line: Line, separator: str, source: str) -> list[str]:
    """Cells of a line, without quotes and outer blanks.

    Raises
    ------
    DataError
        A quotation mark that is not closed.
    """
    text = " ".join(line.text.split()) if separator == BLANKS else line.text
    try:
        (cells,) = csv.reader([text], delimiter=separator, skipinitialspace=True, strict=True)
    except csv.Error:
        raise DataError(
            f"{source}: line {line.number}: a quotation mark is not closed, or in the middle of a cell"
        ) from None
    return [cell.strip() for cell in cells]


def trimmed(cells: Sequence[str]) -> list[str]:
    """Cells without empty ones at the end, as trailing separators leave them."""
    count = len(cells)
    while count and not cells[count - 1]:
        count -= 1
    return list(cells[:count])


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, with whichever decimal mark."""
    return _NUMBER.fullmatch(cell) is not None


class Head(NamedTuple):
    """What stands above the rows of a table, and how they are separated."""

    names: tuple[str, ...]
    """Cells of the header, without quotes; empty without one."""
    units: tuple[str, ...]
    """Cells of the row of units below it, without brackets, one for each name; empty without one."""
    line: int
    """Line of the header in the file; of the first row without one."""
    width: int
    """Number of columns: of names or, without a header, of cells in most rows."""
    separator: str
    preamble: tuple[str, ...]
    """Lines above the header, comments included."""
    rows: int
    """Number of lines, comments not counted, above the first row."""
    commented: bool
    """Whether the names stand in a comment, which may mean something else."""


def read_head(lines: Sequence[Line], comments: Sequence[Line], named: str, source: str) -> Head:
    """Find header, units and first row.

    The first row is the first line in which the first column of numbers holds one, and most others do. The
    header is the line above it; if this holds nothing but units, the one above that. Without such a line,
    a comment directly above the rows is the header if it has a name for each column.

    Parameters
    ----------
    lines, comments, named
        See `lines_of`; one line at least.
    source : str
        The file, for messages.

    Raises
    ------
    DataError
        A quotation mark that is not closed.
    """
    separator = named or find_separator(lines)
    if separator == "," and not named and _is_one_column(lines):
        separator = ";"
    sample = [trimmed(split(line, separator, source)) for line in _tail(lines)]
    usual = _usual(sample)
    first = _first_row(lines, sample, separator, source)
    above = lines[max(0, first - 3) : first]
    names, units, place = _names(above, separator, usual, source)
    commented = False
    # Names for a part of the columns are none: such a line belongs to what stands above a table. So does
    # free text above columns between blanks.
    rows = list(map(len, sample))
    short = len(names) < usual and rows.count(len(names)) < rows.count(usual)
    if first < len(lines) and (short or (separator == BLANKS and len(names) != usual)):
        names, units, place = [], [], None
        last = above[-1].number if above else 0
        near = [each for each in comments if last < each.number < lines[first].number][-3:]
        bare = [Line(line.number, line.text.strip().lstrip("#!%/ ")) for line in near]
        found = _names(bare, separator, usual, source)
        if commented := len(found[0]) == usual and usual > 1:
            names, units, place = found
    line = place or (lines[first].number if first < len(lines) else lines[-1].number)
    preamble = sorted(each for each in (*lines[:first], *comments) if each.number < line)
    return Head(
        tuple(names),
        tuple(units),
        line,
        len(names) or usual,
        separator,
        tuple(each.text for each in preamble),
        first,
        commented,
    )


def _tail(lines: Sequence[Line]) -> Sequence[Line]:
    return lines[-min(_SAMPLE, max(2, len(lines) // 2)) :]


def _usual(rows: Sequence[Sequence[str]]) -> int:
    """Number of cells of most rows; of two that are as frequent the larger, as last cells may be empty."""
    count = Counter(map(len, rows))
    return max(count, key=lambda cells: (count[cells], cells))


def _is_one_column(lines: Sequence[Line]) -> bool:
    """Whether two cells at a comma are one number: the line above them has one name."""
    plain = next((line.text for line in reversed(lines) if not is_number(line.text.strip())), "")
    return "," not in plain and bool(plain) and all(line.text.count(",") <= 1 for line in _tail(lines))


def _first_row(lines: Sequence[Line], sample: Sequence[list[str]], separator: str, source: str) -> int:
    width = max(map(len, sample))
    columns = [[row[k] for row in sample if k < len(row) and row[k]] for k in range(width)]
    numeric = [k for k, cells in enumerate(columns) if 2 * sum(map(is_number, cells)) >= max(1, len(cells))]
    for place, line in enumerate(lines) if numeric else ():
        cells = split(line, separator, source)
        filled = [cells[k] for k in numeric if k < len(cells) and cells[k]]
        leads = numeric[0] < len(cells) and is_number(cells[numeric[0]])
        if leads and 2 * len(cells) > width and 2 * sum(map(is_number, filled)) >= len(filled):
            return place
    return len(lines)


def _names(
    above: Sequence[Line], separator: str, usual: int, source: str
) -> tuple[list[str], list[str], int | None]:
    """Names and units in the lines above the first row, and the line of the names; None without any."""
    if not above:
        return [], [], None
    rows = [trimmed(_header_cells(line, separator, usual, source)) for line in above]
    if len(rows) > 1 and len(rows[-2]) >= len(rows[-1]) > 0 and _are_units(rows[-1]):
        units = [without_brackets(cell) for cell in rows[-1]]
        return rows[-2], units + [""] * (len(rows[-2]) - len(units)), above[-2].number
    return rows[-1], [], above[-1].number


def _header_cells(line: Line, separator: str, usual: int, source: str) -> list[str]:
    """Cells of a header; between blanks, a unit in brackets belongs to the name in front of it."""
    if separator != BLANKS:
        return split(line, separator, source)
    apart = re.split(r"\s{2,}|\t", line.text.strip())
    if len(apart) == usual:
        return apart
    joined = Line(line.number, re.sub(r"\s+(?=[\[(])", "\x00", line.text))
    return [cell.replace("\x00", " ") for cell in split(joined, separator, source)]


def _are_units(cells: Sequence[str]) -> bool:
    return all(unit_of(cell) is not None or is_clock_form(cell) for cell in cells if cell)


def is_clock_form(unit: str) -> bool:
    """Whether what stands for a unit is the form of times of day, such as hh:mm:ss.sss."""
    return _CLOCK_FORM.fullmatch(unit.strip(" []()")) is not None


def find_separator(lines: Sequence[Line]) -> str:
    """What separates the columns of most lines; a semicolon where there is one column.

    Semicolons, tabs and bars are never part of a number, so they come first. Commas and blanks are told
    apart by what leaves numbers: ``0,5 270`` has blanks, ``0.5, 270`` commas.
    """
    found = {each: _judged(_tail(lines), each) for each in SEPARATORS}
    for each in (";", "\t", "|"):
        if found[each].regular and found[each].share >= 0.5:
            return each
    if found[BLANKS].regular and found[BLANKS].share > max(found[","].share, 0.95):
        return BLANKS
    if found[","].regular and found[","].share >= 0.5:
        return ","
    # In a header alone, or mostly text, blanks are within names: "Bogie 1 [m/s2]" has no number.
    apart = [each for each in SEPARATORS if found[each].width > 1]
    sure = [each for each in apart if each != BLANKS or found[each].share > 0.5]
    return max(
        sure or apart or [";"], key=lambda each: (found[each].numbers, each != BLANKS, found[each].width)
    )


class _Judged(NamedTuple):
    """What a separator makes of the lines."""

    regular: bool
    """Nearly all lines have the same number of cells, two or more."""
    share: float
    """Of cells that are numbers or empty."""
    numbers: int
    width: int
    """Most frequent number of cells."""


def _judged(sample: Sequence[Line], separator: str) -> _Judged:
    rows = []
    for line in sample:
        try:
            rows.append(trimmed(split(line, separator, "")))
        except DataError:
            rows.append([])
    count = Counter(map(len, rows))
    width = _usual(rows)
    cells = [cell for row in rows for cell in row]
    numbers = sum(map(is_number, cells))
    near = sum(count[n] for n in count if n <= width and n > 1)
    share = (numbers + cells.count("")) / max(1, len(cells))
    return _Judged(width > 1 and near >= 0.9 * len(rows), share, numbers, width)


def decimal_mark(cells: set[str], place: Callable[[str], str]) -> str:
    """Decimal mark of numbers, by all of them.

    Parameters
    ----------
    cells : set of str
        What stands in the columns that are read.
    place : callable
        Where a cell stands first, as a message begins.

    Raises
    ------
    DataError
        Commas and points are both in use, or each number with a comma could have its thousands apart.
    """
    commas = sorted(cell for cell in cells if _DECIMAL.fullmatch(cell) or _GROUPED.fullmatch(cell))
    if not commas:
        return "."
    points = sorted(cell for cell in cells if "." in cell and is_number(cell))
    first = commas[0]
    if points:
        raise DataError(
            f"{place(first)}: found '{first}', and elsewhere '{points[0]}'; a file has one decimal mark, a"
            " point or a comma, and no mark between thousands"
        )
    if all(_GROUPED.fullmatch(cell) for cell in commas):
        raise DataError(
            f"{place(first)}: found '{first}', which may be {first.replace(',', '.')} or"
            f" {first.replace(',', '')}; write decimal points, and no mark between thousands"
        )
    return ","
