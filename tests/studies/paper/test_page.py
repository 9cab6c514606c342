"""The page of the paper's statements: claims beside their figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sayd_env.report.figures import Drawing
from sayd_env.report.html import page_html
from sayd_env.runs.controlled import ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.paper.controlled_claims import controlled_claims
from sayd_env.studies.paper.figures import controlled_plots
from sayd_env.studies.paper.page import FIGURES, reproduce_page


def test_the_page_shows_claims_and_figures_side_by_side(
    paper_runs: Callable[..., ControlledRuns], limits: Limits, read_page: Callable[[str], Any]
):
    runs = paper_runs(1)
    plots = controlled_plots(runs, limits, ("a", "b", "c", "d"))
    assert [int(name[7:9]) for name in plots] == list(range(11, 19))
    drawings = {name: Drawing(name.encode(), {}) for name in plots}
    page = reproduce_page(controlled_claims(runs, limits), list(plots), 1)
    assert page.verdict.good
    text = page_html(page, drawings, {})
    read = read_page(text)
    assert read.pictures == [name.encode() for name in plots]
    assert "16 of 16 statements of the paper hold, on 1 track seed." in read.text
    assert '<a href="#figure-figure_11_mppt1">M1</a>' in text
    assert "Figure 12: MPPT1 at 400 km/h over time" in read.text
    assert "Figure 10" not in read.text  # no picture of it
    # Each row stands in the table of all, and once more beside its figure; C1 has no figure.
    assert read.text.count("MPPT1, 400 km/h, V(0) = 0 %") == 2


def test_every_figure_of_results_has_words_and_every_row_a_place():
    assert list(FIGURES) == [1, 2, 3, 8, *range(10, 19)]
    rows = [row for figure in FIGURES.values() for row in figure.rows]
    expected = [f"{kind}{i}" for kind, count in (("P", 11), ("M", 9), ("S", 6)) for i in range(1, count + 1)]
    assert sorted(rows) == sorted(expected)
