"""A study's result as one HTML page that needs no other file: verdict, contents, texts, tables and figures.

A study says what the page holds; how it looks is said here, once for all. Every figure stands on the page as
a picture, which a reader without scripts and a printer see, and with what makes it one to zoom and to hover.
The page loads nothing: style, script, pictures and the library that draws (Plotly) are in it.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from html import escape
from importlib.resources import files
from string import Template
from typing import Any, Protocol, TypeAlias

from sayd_env.report.columns import Listing, is_numeric, styled
from sayd_env.report.figures import Drawing

_SHORT = 10  # characters of a cell that is not broken
_MANY = 12  # columns, beyond which a table is printed smaller
Drawings: TypeAlias = Mapping[str, Drawing]
"""Figures by the names of a result's plots."""
Cell: TypeAlias = tuple[str, str]
"""Text of a cell and how it stands out: ``bold`` and ``red``, as on the console."""


class Block(Protocol):
    """A part of a section."""

    def html(self, drawings: Drawings) -> str:
        """Return the part as HTML; every text is escaped."""


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str

    def html(self, drawings: Drawings) -> str:
        """Return the paragraph."""
        return f"<p>{escape(self.text)}</p>"


@dataclass(frozen=True)
class Code:
    """Text as it stands, folded away under a heading."""

    heading: str
    text: str

    def html(self, drawings: Drawings) -> str:
        """Return an element that opens on demand."""
        return f"<details><summary>{escape(self.heading)}</summary><pre>{escape(self.text)}</pre></details>"


@dataclass(frozen=True)
class Grid:
    """A table."""

    header: Sequence[str]
    parts: Sequence[Sequence[Sequence[Cell]]]
    """Rows, in parts that belong together."""
    links: Mapping[tuple[int, int], str] = field(default_factory=dict)
    """The figure in which a row is seen, by its part and place: the first cell with a text leads there."""
    right: frozenset[int] = frozenset()
    """Columns of numbers."""
    title: str = ""

    @classmethod
    def of(cls, listing: Listing, figure: Callable[[Any], str | None] | None = None) -> Grid:
        """Make a table of all columns that have a heading.

        Parameters
        ----------
        figure : callable, optional
            Name of the figure in which a row is seen.
        """
        columns, rows = listing.columns, listing.rows
        shown = [column for column in columns if column.header]
        parts: list[list[list[Cell]]] = []
        links: dict[tuple[int, int], str] = {}
        for i, part in enumerate(styled(shown, rows, listing.section)):
            parts.append([cells for _, cells in part])
            named = {(i, k): figure(row) for k, (row, _) in enumerate(part)} if figure else {}
            links |= {place: name for place, name in named.items() if name}
        right = frozenset(k for k, column in enumerate(shown) if is_numeric(column, rows))
        return cls([column.heading for column in shown], parts, links, right, listing.title)

    @classmethod
    def facts(cls, pairs: Mapping[str, Any]) -> Grid:
        """Make a table of names and values, without those that are missing."""
        shown = [((name, ""), (_shown(value), "")) for name, value in pairs.items() if value is not None]
        return cls((), [shown])

    def html(self, drawings: Drawings) -> str:
        """Return the table; only figures that there are have links."""
        head = "".join(
            f'<th scope="col"{self._class(k)}>{escape(name)}</th>' for k, name in enumerate(self.header)
        )
        parts = (
            "".join(self._row((i, k), row, drawings) for k, row in enumerate(part))
            for i, part in enumerate(self.parts)
        )
        body = "".join(f'<tbody class="part">\n{rows}</tbody>\n' for rows in parts)
        above = f"<h3>{escape(self.title)}</h3>\n" if self.title else ""
        top = f"<thead><tr>{head}</tr></thead>\n" if self.header else ""
        many = ' class="many"' if len(self.header) > _MANY else ""
        return f'{above}<div class="wide"><table{many}>\n{top}{body}</table></div>'

    def _row(self, place: tuple[int, int], row: Sequence[Cell], drawings: Drawings) -> str:
        figure = self.links.get(place)
        cells = [escape(text) for text, _ in row]
        if figure in drawings:
            # Where rows have what their part has in common once, the first cell of the others is empty.
            first = next((k for k, text in enumerate(cells) if text), 0)
            cells[first] = f'<a href="#{_anchor(str(figure))}">{cells[first] or "figure"}</a>'
        texts = (
            f"<td{self._class(k, style)}>{text}</td>"
            for k, ((_, style), text) in enumerate(zip(row, cells, strict=True))
        )
        mark = ' class="marked"' if any("red" in style for _, style in row) else ""
        return f"<tr{mark}>{''.join(texts)}</tr>\n"

    @cached_property
    def _short(self) -> frozenset[int]:
        """Columns of words that are too short to be broken, such as ``> 430``."""
        rows = [row for part in self.parts for row in part]
        columns = range(min(map(len, rows), default=0))
        return frozenset(k for k in columns if all(len(row[k][0]) <= _SHORT for row in rows)) - self.right

    def _class(self, column: int, style: str = "") -> str:
        kind = "number" if column in self.right else "short" if column in self._short else ""
        names = " ".join(filter(None, (style, kind)))
        return f' class="{names}"' if names else ""


@dataclass(frozen=True)
class Picture:
    """A figure with words below it."""

    name: str
    """Of the result's plot."""
    alternative: str
    """What it shows, for those who do not see it."""
    words: Sequence[str] = ()
    """Paragraphs below it."""

    def html(self, drawings: Drawings) -> str:
        """Return the figure: a picture, and what makes it live."""
        png, live = drawings[self.name]
        data = base64.b64encode(png).decode("ascii")
        words = "".join(f"<p>{escape(text)}</p>" for text in self.words)
        # Nothing in a script may end it.
        content = json.dumps(live, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        return (
            f'<figure id="{_anchor(self.name)}">'
            f'<img alt="{escape(self.alternative)}" src="data:image/png;base64,{data}">'
            f'<h3 class="title"></h3><div class="plot"></div><figcaption>{words}</figcaption>'
            f'<script type="application/json">{content}</script></figure>'
        )


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it."""

    heading: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Verdict:
    """What a reader wants to know first."""

    words: Sequence[str]
    """Paragraphs."""
    good: bool | None = None
    """None where there is nothing to pass."""


@dataclass(frozen=True)
class Page:
    """What a study says of its result."""

    title: str
    verdict: Verdict
    sections: Sequence[Section]


def page_html(page: Page, drawings: Drawings, document: Mapping[str, Any]) -> str:
    """Return a whole page.

    Parameters
    ----------
    page : Page
        Its content.
    drawings : mapping
        The result's figures.
    document : mapping
        Content of ``result.json``: where the numbers come from.

    Examples
    --------
    >>> page = Page("A sine", Verdict(["It swings."]), [Section("Values", [Text("sin 0 = 0")])])
    >>> "<p>sin 0 = 0</p>" in page_html(page, {}, {})
    True
    """
    sections = [*page.sections, Section("How this was computed", list(_provenance(document)))]
    body = "\n".join(
        f'<section id="section-{k}">\n<h2>{escape(section.heading)}</h2>\n'
        + "\n".join(block.html(drawings) for block in section.blocks)
        + "\n</section>"
        for k, section in enumerate(sections, start=1)
    )
    contents = "".join(
        f'<li><a href="#section-{k}">{escape(section.heading)}</a></li>'
        for k, section in enumerate(sections, start=1)
    )
    live = any(drawing.live for drawing in drawings.values())
    return _PAGE.substitute(
        title=escape(page.title),
        style=_asset("page.css"),
        verdict=_verdict(page.verdict, quick=bool(document.get("quick"))),
        contents=contents,
        body=body,
        script=_SCRIPT.substitute(library=_plotly(), start=_asset("page.js")) if live else "",
    )


def _verdict(verdict: Verdict, *, quick: bool) -> str:
    kind = {None: "", True: " good", False: " bad"}[verdict.good]
    words = [*verdict.words, *(["With --quick: a look, not a result."] if quick else [])]
    texts = "".join(f"<p>{escape(text)}</p>" for text in words)
    return f'<section class="verdict{kind}" id="verdict"><h2>Verdict</h2>{texts}</section>'


def _provenance(document: Mapping[str, Any]) -> Iterator[Block]:
    """Where the numbers come from: command, versions, and every origin that the configuration names."""
    yield Grid.facts(
        {key: document.get(key) for key in ("command", "created", "seed", "git_commit", "git_modified")}
    )
    yield from (Text(str(note)) for note in document.get("notes") or ())
    config = document.get("config") or {}
    for path, origin in _origins(config):
        yield Grid.facts({f"{path}: {key}": value for key, value in origin.items()})
    versions = dict(sorted(dict(document.get("versions") or {}).items()))
    yield Code(
        "versions of the software", "\n".join(f"{name} {version}" for name, version in versions.items())
    )
    yield Code("configuration, in SI units", json.dumps(config, indent=1))


def _origins(config: Any, path: str = "") -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Every non-empty section `provenance` of a configuration, with the key under which it stands."""
    if not isinstance(config, Mapping):
        return
    for key, value in config.items():
        if key == "provenance" and isinstance(value, Mapping) and value:
            yield path or "scenario", value
        else:
            yield from _origins(value, f"{path}.{key}".lstrip("."))


def _anchor(name: str) -> str:
    """Id of a figure."""
    return escape(f"figure-{name.replace(' ', '-')}")


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


@cache
def _asset(name: str) -> str:
    return files("sayd_env.report").joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """The library that draws, packed: a third of its size."""
    from plotly.offline import get_plotlyjs  # noqa: PLC0415 - slow to import, and only pages need it

    return base64.b64encode(gzip.compress(get_plotlyjs().encode(), 6, mtime=0)).decode("ascii")


_SCRIPT = Template("""<script type="text/plain" id="plotly">$library</script>
<script>$start</script>""")
_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>$style</style>
</head>
<body>
<header><h1>$title</h1></header>
$verdict
<nav><h2>Contents</h2><ul>$contents</ul></nav>
$body
<footer>Figures: drag to zoom, double-click to go back, click a name to hide its line.</footer>
$script
</body>
</html>
""")
