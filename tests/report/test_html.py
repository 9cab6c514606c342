"""Pages for a browser: well-formed, complete in themselves, with every text escaped."""

from __future__ import annotations

import base64
from collections.abc import Callable
from html.parser import HTMLParser
from typing import Any

import pytest

from sayd_env.report.files import png_bytes
from sayd_env.report.html import Code, Grid, Picture, Section, Text, report
from sayd_env.runs.controlled import ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.paper.controlled_claims import controlled_claims
from sayd_env.studies.paper.figures import controlled_plots
from sayd_env.studies.paper.page import FIGURES, reproduce_page

VOID = {"meta", "img", "br", "link", "input", "hr"}
PNG = b"\x89PNG\r\n\x1a\n"
NASTY = "<script>alert('x')</script> & \"quotes\" $title"


class Page(HTMLParser):
    """Checks that tags are closed in turn, and collects what is in the page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[str] = []
        self.links: list[str] = []
        self.pictures: list[bytes] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name == "src" and value is not None and value.startswith("data:image/png;base64,"):
                self.pictures.append(base64.b64decode(value.partition(",")[2], validate=True))
            elif name in ("src", "href", "srcset", "action") or name.startswith("on"):
                self.links.append(f"{name}={value}")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())


def test_a_page_holds_all_that_it_shows():
    blocks = [
        Text("words"),
        Grid(("a", "b"), [(1.5, True), (None, False), ("x", 3)], frozenset({1})),
        Picture(PNG, "a picture", ("first", "second")),
        Code("folded", "x: 1\n"),
    ]
    page = report("Title", [Section("One", blocks), Section("Two", [])])
    read = Page(page)
    assert read.links == []
    assert read.pictures == [PNG]
    assert "script" not in read.tags
    assert "@import" not in page
    assert "url(" not in page
    assert page.count('<tr class="marked"><td></td><td>no</td></tr>') == 1
    for words in ("Title", "One", "Two", "words", "1.5 yes", "x 3", "first second", "folded x: 1"):
        assert words in read.text


def test_every_text_is_escaped():
    blocks = [Text(NASTY), Grid((NASTY,), [(NASTY,)]), Picture(PNG, NASTY, (NASTY,)), Code(NASTY, NASTY)]
    read = Page(report(NASTY, [Section(NASTY, blocks)]))
    assert "script" not in read.tags
    assert read.links == []
    assert read.text.count(NASTY) == 9  # two of them in the title, none of the alternative text


def test_a_row_of_another_length_is_refused():
    with pytest.raises(ValueError, match="a row of 1 cells under a header of 2"):
        Grid(("a", "b"), [(1,)]).html()


def test_the_page_shows_claims_and_figures_side_by_side(
    paper_runs: Callable[..., ControlledRuns], limits: Limits
):
    runs = paper_runs(1)
    plots = controlled_plots(runs, limits, ("a", "b", "c", "d"))
    assert [int(name[7:9]) for name in plots] == list(range(11, 19))
    images = {name: png_bytes(draw) for name, draw in plots.items()}
    document = {
        "command": "sayd reproduce",
        "seed": 0,
        "versions": {"numpy": "2.0"},
        "git_commit": None,
        "config": {"friction": 0.4, "provenance": {"track_seeds": "1000 to 1009"}},
    }
    read = Page(reproduce_page(controlled_claims(runs, limits), images, document, 1))
    assert read.pictures == list(images.values())
    assert all(image.startswith(PNG) for image in read.pictures)
    assert read.links == []
    assert "16 of 16 rows hold, on 1 track seeds" in read.text
    assert "Figure 12: MPPT1 at 400 km/h over time" in read.text
    assert "Figure 10" not in read.text  # no picture of it
    for words in ("sayd reproduce", "numpy 2.0", "track_seeds 1000 to 1009", '"friction": 0.4'):
        assert words in read.text
    # Each row stands in the table of all, and once more beside its figure; C1 has no figure.
    assert read.text.count("MPPT1, 400 km/h, V(0) = 0 %") == 2


def test_every_figure_of_results_has_words_and_every_row_a_place():
    assert [figure.number for figure in FIGURES] == [1, 2, 3, 8, *range(10, 19)]
    rows = [row for figure in FIGURES for row in figure.rows]
    expected = [f"{kind}{i}" for kind, count in (("P", 11), ("M", 9), ("S", 6)) for i in range(1, count + 1)]
    assert sorted(rows) == sorted(expected)


@pytest.mark.parametrize("empty", [{}, {"config": None, "versions": None}])
def test_a_page_without_provenance_is_a_page(empty: dict[str, Any]):
    assert "0 of 0 rows hold" in Page(reproduce_page([], {}, empty, 0)).text
