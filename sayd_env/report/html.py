"""A study's result as one HTML page that needs no other file: texts, tables and pictures in sections.

The page has no scripts and loads nothing: its style stands in the page, pictures are PNG in the page.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import escape
from string import Template
from typing import Any, Protocol

from sayd_env.report.columns import Column


class Block(Protocol):
    """A part of a section."""

    def html(self) -> str:
        """Return the part as HTML; every text is escaped."""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str

    def html(self) -> str:
        """Return the paragraph."""
        return f"<p>{escape(self.text)}</p>"


@dataclass(frozen=True)
class Code:
    """Text as it stands, folded away under a heading."""

    heading: str
    text: str

    def html(self) -> str:
        """Return an element that opens on demand."""
        return f"<details><summary>{escape(self.heading)}</summary><pre>{escape(self.text)}</pre></details>"


@dataclass(frozen=True)
class Grid:
    """A table."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    marked: frozenset[int] = field(default=frozenset())
    """Numbers of the rows that stand out."""

    @classmethod
    def of(cls, columns: Sequence[Column], rows: Sequence[Any], marked: frozenset[int] = frozenset()) -> Grid:
        """Make the table of all columns that have a heading."""
        shown = [column for column in columns if column.header]
        cells = [[column.words(column.of(row)) for column in shown] for row in rows]
        return cls([column.heading for column in shown], cells, marked)

    def html(self) -> str:
        """Return the table; numbers in their shortest form, nothing for None.

        Raises
        ------
        ValueError
            A row that is not as long as the header.
        """
        head = "".join(f'<th scope="col">{escape(name)}</th>' for name in self.header)
        body = "\n".join(self._row(number, row) for number, row in enumerate(self.rows))
        return (
            f'<div class="wide"><table>\n<thead><tr>{head}</tr></thead>\n'
            f"<tbody>\n{body}\n</tbody>\n</table></div>"
        )

    def _row(self, number: int, row: Sequence[Any]) -> str:
        if len(row) != len(self.header):
            raise ValueError(f"a row of {len(row)} cells under a header of {len(self.header)}")
        mark = ' class="marked"' if number in self.marked else ""
        return f"<tr{mark}>{''.join(f'<td>{escape(_shown(cell))}</td>' for cell in row)}</tr>"


@dataclass(frozen=True)
class Picture:
    """A picture with words beside it."""

    png: bytes
    alternative: str
    """What the picture shows, for those who do not see it."""
    words: Sequence[str] = ()
    """Paragraphs beside it."""

    def html(self) -> str:
        """Return the figure; the picture is in the page."""
        data = base64.b64encode(self.png).decode("ascii")
        words = "".join(f"<p>{escape(text)}</p>" for text in self.words)
        return (
            f'<figure><img alt="{escape(self.alternative)}" src="data:image/png;base64,{data}">'
            f"<figcaption>{words}</figcaption></figure>"
        )


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it."""

    heading: str
    blocks: Sequence[Block]

    def html(self) -> str:
        """Return the section."""
        parts = "\n".join(block.html() for block in self.blocks)
        return f"<section>\n<h2>{escape(self.heading)}</h2>\n{parts}\n</section>"


def report(title: str, sections: Iterable[Section]) -> str:
    """Return a whole page.

    Parameters
    ----------
    title : str
        Heading of the page.
    sections : iterable of Section
        Its content.

    Examples
    --------
    >>> page = report("A sine", [Section("Values", [Grid(("x", "sin x"), [(0, 0.0)])])])
    >>> "<td>0</td>" in page
    True
    """
    body = "\n".join(section.html() for section in sections)
    return _PAGE.substitute(title=escape(title), style=_STYLE, body=body)


def _shown(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    return f"{cell:g}" if isinstance(cell, float) else str(cell)


_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>$style</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 76rem;
  margin: 2rem auto; padding: 0 1rem; }
h1, h2 { line-height: 1.2; }
h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; padding-bottom: 0.3rem; }
figure { display: grid; grid-template-columns: 3fr 2fr; gap: 1.5rem; margin: 1.5rem 0; align-items: start; }
figure img { width: 100%; height: auto; border: 1px solid #ddd; }
figcaption p:first-child { margin-top: 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; }
th, td { text-align: left; vertical-align: top; padding: 0.3rem 0.8rem 0.3rem 0;
  border-bottom: 1px solid #ddd; }
tr.marked td { background: #fbe9e7; }
pre { overflow-x: auto; background: #f6f6f6; padding: 1rem; font-size: 0.85rem; }
@media (max-width: 50rem) { figure { grid-template-columns: 1fr; } }
@media print { body { max-width: none; } figure, tr { break-inside: avoid; } }
"""
