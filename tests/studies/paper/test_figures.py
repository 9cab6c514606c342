"""Counterparts of the paper's figures 11 to 18: what is drawn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from sayd_env.runs.controlled import ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.paper.figures import ZOOM, controlled_plots


@pytest.fixture(scope="module")
def drawn(paper_runs: Callable[..., ControlledRuns], limits: Limits) -> Callable[[int], Figure]:
    """Drawer of a figure by the paper's number."""
    plots = controlled_plots(paper_runs(2), limits, ("a", "b", "c", "d"))

    def drawn(number: int) -> Figure:
        figure = Figure()
        (draw,) = (plot for name, plot in plots.items() if name.startswith(f"figure_{number}"))
        draw(figure)
        return figure

    return drawn


@pytest.mark.parametrize("number", [12, 14])
def test_commands_begin_at_both_ends_of_the_valve(drawn: Callable[[int], Figure], number: int):
    top, bottom = drawn(number).axes
    steps = [line for line in top.lines if line.get_drawstyle() == "steps-post"]
    assert [(line.get_xdata()[0], line.get_ydata()[0]) for line in steps] == [(0.0, 0.0), (0.0, 100.0)]
    assert bottom.get_xlim() == (0.0, 40.0)


@pytest.mark.parametrize("number", [16, 18])
def test_a_second_stands_beside_the_whole(drawn: Callable[[int], Figure], number: int):
    spans = [axes.get_xlim() for axes in drawn(number).axes]
    assert spans == [(0.0, 40.0), ZOOM] * 2
    assert 1.0 <= ZOOM[1] - ZOOM[0] <= 2.0


def test_frequencies_are_points_in_the_band_of_row_m2(drawn: Callable[[int], Figure]):
    frequencies, acceleration = drawn(11).axes
    assert {line.get_linestyle() for line in frequencies.lines} == {"None"}
    (band,) = frequencies.patches
    assert np.sort(
        band.get_extents().transformed(frequencies.transData.inverted()).intervaly
    ) == pytest.approx([2.0, 10.0])
    assert acceleration.get_ylim()[0] == 0.0
