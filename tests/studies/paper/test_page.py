"""The page of the paper's statements: claims beside their figures, and where the numbers come from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from sayd_env.report.figures import png_bytes
from sayd_env.runs.controlled import ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.paper.controlled_claims import controlled_claims
from sayd_env.studies.paper.figures import controlled_plots
from sayd_env.studies.paper.page import FIGURES, reproduce_page

PNG = b"\x89PNG\r\n\x1a\n"


def test_the_page_shows_claims_and_figures_side_by_side(
    paper_runs: Callable[..., ControlledRuns], limits: Limits, read_page: Callable[[str], Any]
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
    read = read_page(reproduce_page(controlled_claims(runs, limits), images, document, 1))
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
    assert list(FIGURES) == [1, 2, 3, 8, *range(10, 19)]
    rows = [row for figure in FIGURES.values() for row in figure.rows]
    expected = [f"{kind}{i}" for kind, count in (("P", 11), ("M", 9), ("S", 6)) for i in range(1, count + 1)]
    assert sorted(rows) == sorted(expected)


@pytest.mark.parametrize("empty", [{}, {"config": None, "versions": None}])
def test_a_page_without_provenance_is_a_page(empty: dict[str, Any], read_page: Callable[[str], Any]):
    assert "0 of 0 rows hold" in read_page(reproduce_page([], {}, empty, 0)).text
