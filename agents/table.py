"""A table that grows while a training runs, kept as a CSV file."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from sayd_env.config import DataError
from sayd_env.config.storage import write_file


class Table:
    """Rows of numbers and names; the file is always that of whole rows.

    Parameters
    ----------
    path : Path
        The CSV file; its rows are taken over if it exists.
    until : int, optional
        Rows with more `steps` are left out: they belong to what a resumed run does again.

    Raises
    ------
    DataError
        The file is damaged.
    """

    def __init__(self, path: Path, until: int | None = None) -> None:
        self._path = path
        self.rows: list[dict[str, Any]] = []
        if path.is_file():
            self.rows = [row for row in _read(path) if until is None or (row["steps"] or 0) <= until]

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


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return [
                {key: _value(text) for key, text in row.items() if text != ""}
                for row in csv.DictReader(stream, strict=True)
            ]
    except (OSError, UnicodeDecodeError, csv.Error, AttributeError) as error:
        raise DataError(f"{path}: cannot be read as a table ({error})") from None


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
