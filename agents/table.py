"""A table that grows while a training runs, kept as a CSV file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from sayd_env.config import DataError, read_text
from sayd_env.config.explain import shown
from sayd_env.config.storage import write_file


class Table:
    """Rows of numbers and names; the file is always that of whole rows.

    Parameters
    ----------
    path : Path
        The CSV file; its rows are taken over if it exists.
    numbers, texts : collection of str
        Columns in which each row has a finite number, or a text.
    until : int, optional
        Rows with more `steps`, one of `numbers`, are left out: they belong to what a resumed run does again.

    Raises
    ------
    ConfigError, DataError
        The file cannot be read, or is damaged.
    """

    def __init__(
        self,
        path: Path,
        *,
        numbers: Collection[str] = (),
        texts: Collection[str] = (),
        until: int | None = None,
    ) -> None:
        self._path = path
        self.rows: list[dict[str, Any]] = []
        if path.exists():
            found = _read(path, numbers, texts)
            self.rows = [row for row in found if until is None or row["steps"] <= until]

    def add(self, row: dict[str, Any]) -> None:
        """Add a row; it may have columns that those before do not have."""
        self.rows.append(row)

    def save(self) -> None:
        """Write the file.

        Raises
        ------
        StudyError
            It cannot be written.
        """
        columns = list(dict.fromkeys(column for row in self.rows for column in row))
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        write_file(self._path, text.getvalue().encode())


def _read(path: Path, numbers: Collection[str], texts: Collection[str]) -> Iterator[dict[str, Any]]:
    reader = csv.reader(io.StringIO(read_text(path, "table"), newline=""), strict=True)
    try:
        header = next(reader, None)
        if header is None:
            raise DataError(f"{path}: is empty; move it away to go on without its rows")
        if header and not (len(set(header)) == len(header) and {*numbers, *texts} <= set(header)):
            expected = ", ".join((*texts, *numbers)) or "different columns"
            raise ValueError(f"found columns {', '.join(header[:10])}; expected {expected}")
        for cells in reader:
            if len(cells) != len(header):
                raise ValueError(f"found {len(cells)} cells; the header has {len(header)}")
            row = {key: _value(text) for key, text in zip(header, cells, strict=True) if text != ""}
            for key in (*numbers, *texts):
                found = row.get(key)
                if not (isinstance(found, str) if key in texts else _is_finite(found)):
                    expected = "a text" if key in texts else "a finite number"
                    raise ValueError(f"column '{key}': found {shown(found)}; expected {expected}")
            yield row
    except (ValueError, csv.Error) as error:
        raise DataError(
            f"{path}: line {reader.line_num}: is damaged ({error}); move it away to go on without its rows"
        ) from None


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
