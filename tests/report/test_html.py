"""Pages for a browser: well-formed, complete in themselves, with every text escaped."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

from sayd_env.report.columns import Column, Listing
from sayd_env.report.figures import Drawing
from sayd_env.report.html import Code, Grid, Page, Picture, Section, Text, Verdict, page_html

PNG = b"\x89PNG\r\n\x1a\n"
NASTY = "<script>alert('x')</script> & \"quotes\" $title"


def page(*blocks: Any, title: str = "Title", words: str = "It holds.", **drawings: Drawing) -> str:
    return page_html(Page(title, Verdict([words], True), [Section("One", blocks)]), drawings, {})


def test_a_page_holds_all_that_it_shows(read_page: Callable[[str], Any]):
    picture = Picture("a", "a picture", ("first", "second"))
    text = page(Text("words"), picture, Code("folded", "x: 1\n"), a=Drawing(PNG, {"data": []}))
    read = read_page(text)
    assert read.links == []
    assert read.pictures == [PNG]
    assert "@import" not in text
    assert "url(" not in text
    for words in ("Title", "One", "words", "first second", "folded x: 1"):
        assert words in read.text
    assert read.text.index("Verdict It holds.") < read.text.index("Contents") < read.text.index("words")


def test_the_library_that_draws_is_there_once_and_only_where_it_is_needed():
    live = {name: Drawing(PNG, {"data": []}) for name in "ab"}
    assert page(Picture("a", ""), Picture("b", ""), **live).count('id="plotly"') == 1
    assert "plotly" not in page(Text("words"))


def test_every_text_is_escaped(read_page: Callable[[str], Any]):
    grid = Grid((NASTY,), [[[(NASTY, "")]]], title=NASTY)
    live = Drawing(PNG, {"data": [{"name": "</script><script>alert('y')</script>"}]})
    picture = Picture("a", NASTY, (NASTY,))
    text = page(Text(NASTY), grid, picture, Code(NASTY, NASTY), title=NASTY, words=NASTY, a=live)
    read = read_page(text)
    assert read.tags.count("script") == 3  # the figure's numbers, the library and what starts it
    assert read.links == []
    assert read.text.count(NASTY) == 10  # two of them in the title, none of the alternative text
    (content,) = re.findall(r'<script type="application/json">(.*?)</script>', text)
    assert json.loads(content) == live.live


def test_a_grid_has_what_the_console_has_and_leads_to_figures(read_page: Callable[[str], Any]):
    columns = (
        Column("share", "share", "%", 100.0, 0, best=True),
        Column("hidden"),
        Column("holds", "holds", bad=lambda holds: not holds),
    )
    rows = [{"share": 0.85, "hidden": 7, "holds": False}, {"share": 0.5, "hidden": 8, "holds": True}]
    names = {7: "seen", 8: "not drawn"}
    grid = Grid.of(Listing("", columns, rows), lambda row: names[row["hidden"]])
    text = grid.html({"seen": Drawing(PNG, {})})
    assert read_page(text).text == "share (%) holds 85 no 50 yes"
    assert '<tr class="marked"><td class="number"><a href="#figure-seen">85</a></td>' in text
    assert '<td class="red short">no</td>' in text
    assert '<td class="bold number">50</td>' in text
    assert text.count("<a ") == 1


def test_a_row_leads_to_its_figure_from_its_first_text():
    """Rows have what their section has in common once; the others begin with an empty cell."""
    columns = (Column("section", "section"), Column("policy", "policy"))
    rows = [{"section": "curve", "policy": "mppt2"}, {"section": "", "policy": "ppo"}]
    text = Grid.of(Listing("", columns, rows), lambda _: "seen").html({"seen": Drawing(PNG, {})})
    for link in ("curve", "ppo"):
        assert f'<a href="#figure-seen">{link}</a>' in text
    assert text.count("<a ") == 2


def test_short_words_are_not_broken():
    rows = [{"speed": "> 430", "words": "a text that is long"}, {"speed": "-", "words": "short"}]
    text = Grid.of(Listing("", (Column("speed", "km/h"), Column("words", "words")), rows)).html({})
    assert '<td class="short">&gt; 430</td><td>a text that is long</td>' in text


def test_a_page_says_where_its_numbers_come_from(read_page: Callable[[str], Any]):
    document = {
        "command": "sayd reproduce",
        "seed": 0,
        "quick": True,
        "versions": {"numpy": "2.0"},
        "git_commit": None,
        "config": {"friction": 0.4, "damper": {"provenance": {"track_seeds": "1000 to 1009"}}},
    }
    read = read_page(page_html(Page("T", Verdict(["w"]), []), {}, document))
    for words in ("sayd reproduce", "numpy 2.0", "damper: track_seeds 1000 to 1009", '"friction": 0.4'):
        assert words in read.text
    assert "git_commit" not in read.text
    assert "a look, not a result" in read.text
    for empty in ({}, {"config": None, "versions": None}):
        assert "T" in read_page(page_html(Page("T", Verdict(["w"]), []), {}, empty)).text
