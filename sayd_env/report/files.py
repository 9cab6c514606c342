"""What a study hands over and how it reaches the disk: complete or not at all."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from pydantic import BaseModel
from rich.console import Console

from sayd_env.config.errors import ConfigError
from sayd_env.config.plain import jsonable
from sayd_env.config.software import provenance
from sayd_env.config.storage import try_to_write, write_files
from sayd_env.report.columns import Table
from sayd_env.report.figures import Plot, drawing
from sayd_env.report.html import Page, page_html

RECORD, PAGE = "result.json", "report.html"
SUFFIXES = (".csv", ".png", ".html")
"""Of the files beside the record."""


class Result(Protocol):
    """What every study returns; the command line needs nothing else to store and show it."""

    def as_dict(self) -> dict[str, Any]:
        """Return the keys of ``--json``; NumPy values are welcome, NaN becomes null."""

    def tables(self) -> Mapping[str, Table]:
        """Return tables by file name without suffix; each becomes a CSV file."""
        return {}

    def plots(self) -> Mapping[str, Plot]:
        """Return drawing functions by file name without suffix; each becomes a PNG file."""
        return {}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print what a person wants to see first, in 80 columns unless `wide`."""


@runtime_checkable
class Paged(Protocol):
    """What a result offers beyond `Result` if it has a page for a browser, ``report.html``."""

    def page(self) -> Page:
        """Return what the page holds; its pictures have the names of the plots."""


class ResultDirectory:
    """A directory for the files of one study.

    Everything is rendered in memory first and then written at once, ``result.json`` last, see
    `sayd_env.config.storage`: a run that fails leaves nothing, and an interrupted one no file by half.

    Parameters
    ----------
    path : Path
        The directory; it is made when there is something to write.
    option : str
        What gave it, for messages.

    Raises
    ------
    ConfigError
        When it cannot be created or written to, which is found out here, before the study spends any time, or
        holds a folder of the name of a file of ours.
    """

    def __init__(self, path: Path, option: str = "--out") -> None:
        self.path = path
        try:
            try_to_write(path)
        except (FileExistsError, NotADirectoryError):
            raise ConfigError(f"{option} {path}: a file is in the way, expected a directory") from None
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else None
            raise ConfigError(f"{option} {path}: cannot be written ({reason or error})") from None
        self._refuse_folders([RECORD])

    def save(self, result: Result, document: dict[str, Any]) -> list[Path]:
        """Write tables, plots, a page if there is one, and ``result.json``; return their paths in this order.

        Parameters
        ----------
        result : Result
            The study's result.
        document : mapping
            Content of ``result.json``, see `document`; the names of the files are filled in.

        Raises
        ------
        StudyError
            When a file cannot be written (a full disk, a removed directory).
        """
        contents = {f"{name}.csv": csv_bytes(*table) for name, table in result.tables().items()}
        paged = isinstance(result, Paged)
        drawings = {name: drawing(draw, live=paged) for name, draw in result.plots().items()}
        contents |= {f"{name}.png": each.png for name, each in drawings.items()}
        if isinstance(result, Paged):
            contents[PAGE] = page_html(result.page(), drawings, document).encode()
        former = self._former_files()
        contents[RECORD] = json_text(document | {"written": [*contents, RECORD]}).encode()
        written = self.write(contents)
        for name in former - contents.keys():
            with suppress(OSError):
                (self.path / name).unlink()
        return written

    def write(self, contents: Mapping[str, bytes]) -> list[Path]:
        """Write several files at once, see `save`.

        Raises
        ------
        ConfigError
            A folder of a file's name is in the way.
        StudyError
            A file cannot be written.
        """
        self._refuse_folders(contents)
        return write_files(self.path, contents)

    def former_command(self) -> str | None:
        """What was typed for the result that lies here; None where there is none that can be read."""
        command = self._former().get("command")
        return command if isinstance(command, str) else None

    def _former(self) -> dict[str, Any]:
        """Content of the ``result.json`` that lies here."""
        try:
            found = json.loads((self.path / RECORD).read_bytes())
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def _former_files(self) -> set[str]:
        """Files of the result that lies here; those that a new one does not have would pass for its own."""
        listed = self._former().get("written")
        names = {name for name in listed if isinstance(name, str)} if isinstance(listed, list) else set()
        return {name for name in names if Path(name).name == name and Path(name).suffix in SUFFIXES}

    def _refuse_folders(self, names: Iterable[str]) -> None:
        for name in names:
            if (self.path / name).is_dir():
                raise ConfigError(f"--out {self.path}: a folder named {name} is in the way")


def document(
    result: Result,
    config: BaseModel | Mapping[str, Any] | None,
    seed: int | None,
    command: str | None = None,
) -> dict[str, Any]:
    """Everything a result needs to be understood and repeated: the content of ``result.json``.

    Parameters
    ----------
    result : Result
        The study's result; its keys stand at the top level.
    config : BaseModel or mapping, optional
        The full resolved configuration.
    seed : int, optional
        First seed of the random draws; None where nothing is random.
    command : str, optional
        How to repeat it.

    Returns
    -------
    dict
        The result's keys and ``command``, ``created``, ``seed``, ``config``, ``versions``, ``git_commit``
        (null outside a checkout), ``git_modified`` (whether tracked files differ from that commit) and
        ``written`` (names of its tables, pictures, page and record, see `ResultDirectory.save`).
    """
    about = {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": seed,
        "config": config,
        **provenance(command),
        "written": [],
    }
    content = result.as_dict()
    if clash := sorted(set(content) & set(about)):
        raise ValueError(f"a result must not use the keys {clash}")
    plain: dict[str, Any] = jsonable(content | about)
    return plain


def json_text(content: Any) -> str:
    """JSON with a line feed at its end."""
    return json.dumps(jsonable(content), indent=2, allow_nan=False) + "\n"


def csv_bytes(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> bytes:
    """Return a table as CSV; missing and non-finite numbers are empty cells.

    Raises
    ------
    ValueError
        A row that is not as long as the header.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for row in rows:
        cells = jsonable(list(row))
        if len(cells) != len(header):
            raise ValueError(f"a row of {len(cells)} cells under a header of {len(header)}")
        writer.writerow(cells)
    return text.getvalue().encode()
