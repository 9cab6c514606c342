"""Pages for a browser: well-formed, complete in themselves, with every text escaped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from sayd_env.report.columns import Column
from sayd_env.report.html import Code, Grid, Picture, Section, Text, report

PNG = b"\x89PNG\r\n\x1a\n"
NASTY = "<script>alert('x')</script> & \"quotes\" $title"


def test_a_page_holds_all_that_it_shows(read_page: Callable[[str], Any]):
    blocks = [
        Text("words"),
        Grid(("a", "b"), [(1.5, True), (None, False), ("x", 3)], frozenset({1})),
        Picture(PNG, "a picture", ("first", "second")),
        Code("folded", "x: 1\n"),
    ]
    page = report("Title", [Section("One", blocks), Section("Two", [])])
    read = read_page(page)
    assert read.links == []
    assert read.pictures == [PNG]
    assert "script" not in read.tags
    assert "@import" not in page
    assert "url(" not in page
    assert page.count('<tr class="marked"><td></td><td>no</td></tr>') == 1
    for words in ("Title", "One", "Two", "words", "1.5 yes", "x 3", "first second", "folded x: 1"):
        assert words in read.text


def test_every_text_is_escaped(read_page: Callable[[str], Any]):
    blocks = [Text(NASTY), Grid((NASTY,), [(NASTY,)]), Picture(PNG, NASTY, (NASTY,)), Code(NASTY, NASTY)]
    read = read_page(report(NASTY, [Section(NASTY, blocks)]))
    assert "script" not in read.tags
    assert read.links == []
    assert read.text.count(NASTY) == 9  # two of them in the title, none of the alternative text


def test_a_row_of_another_length_is_refused():
    with pytest.raises(ValueError, match="a row of 1 cells under a header of 2"):
        Grid(("a", "b"), [(1,)]).html()


def test_a_grid_of_columns_has_their_headings_and_words(read_page: Callable[[str], Any]):
    columns = (Column("share", "share", "%", 100.0, 0), Column("hidden"), Column("holds", "holds"))
    grid = Grid.of(columns, [{"share": 0.85, "hidden": 7, "holds": False}])
    assert read_page(report("", [Section("", [grid])])).text.endswith("share (%) holds 85 no")
