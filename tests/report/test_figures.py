"""Figures: no backend, none of the reader's settings, names as they are, and what all figures share."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from sayd_env.config.palette import wheelset_style
from sayd_env.report.figures import (
    DPI,
    drawing,
    heat_maps,
    label,
    legend_below,
    limit_line,
    log_axis,
    name_rows,
    panels,
    with_band,
)

NAMES = ("$", "_hidden", r"$\\frac{1}$", "a_b^c", r"\\frac", "bell\x07", "漢字", "$x", "%")


def named(figure: Figure) -> None:
    """A figure that has names wherever a figure may have them."""
    axes = panels(figure, len(NAMES), 3)
    for panel, name in zip(axes, NAMES, strict=True):
        panel.plot([1.0, 1000.0], [0.0, 1.0], label=label(name))
        panel.set(title=name, xlabel=name, ylabel=name)
        name_rows(panel, [name, name])
        log_axis(panel, "x")
        panel.annotate(name, (1.0, 0.5))
    figure.suptitle(" ".join(NAMES))
    legend_below(figure, axes[0])


def test_names_are_no_formulas_and_warn_of_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert drawing(named, live=False).png.startswith(b"\x89PNG")


def test_a_name_that_begins_with_an_underscore_has_its_place_in_a_legend():
    figure = Figure()
    (axes,) = panels(figure, 1)
    axes.plot([0, 1], [0, 1], label=label("_mine"))
    legend_below(figure, axes)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [" _mine"]


def test_what_the_typeface_lacks_is_replaced():
    assert label("tab\tbell\x07 漢 é μ") == "tab\ufffdbell\ufffd \ufffd é μ"


@pytest.mark.parametrize("backend", ["module://matplotlib_inline.backend_inline", "none-such", "TkAgg"])
def test_a_backend_that_is_not_installed_is_not_asked_for(backend: str):
    """Nor does a folder that Matplotlib cannot write cause a word of it."""
    code = (
        "import os, sys; sys.modules['matplotlib_inline'] = None;"
        "from sayd_env.report.figures import drawing;"
        "assert drawing(lambda figure: figure.subplots().plot([0, 1])).png.startswith(b'\\x89PNG');"
        f"assert os.environ['MPLBACKEND'] == {backend!r};"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    nowhere = {name: "/proc/none" for name in ("HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME")}
    found = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        env={**os.environ, "MPLBACKEND": backend} | nowhere,
    )
    assert found.stderr == b""


def test_the_reader_s_own_settings_change_no_figure(tmp_path: Path):
    code = (
        "import sys; from sayd_env.report.figures import drawing;"
        "found = drawing(lambda f: f.subplots().set(title='a title', xlabel='x_1'));"
        "sys.stdout.buffer.write(found.png)"
    )
    (tmp_path / "matplotlibrc").write_text("font.size: 20\naxes.facecolor: red\ntext.usetex: True\n")
    pictures = [
        subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, env={**os.environ, **settings}
        ).stdout
        for settings in ({}, {"MATPLOTLIBRC": str(tmp_path / "matplotlibrc")})
    ]
    assert pictures[0] == pictures[1]


def test_panels_fill_a_grid_row_by_row():
    figure = Figure()
    axes = panels(figure, 5, 2, (4.0, 3.0), sharex=True)
    assert len(axes) == 5
    assert figure.get_size_inches()[0] == 8.0
    assert [panel.axison for panel in figure.axes] == [True] * 5 + [False]
    boxes = [panel.get_position() for panel in axes]
    assert boxes[0].y0 == boxes[1].y0 > boxes[2].y0
    assert boxes[0].x0 < boxes[1].x0


def test_a_band_reaches_from_the_lowest_to_the_highest_around_the_medians():
    (axes,) = panels(Figure(), 1)
    values = np.array([[1.0, 2.0, 6.0], [0.0, 5.0, 7.0]])
    with_band(axes, np.array([10.0, 20.0]), values, wheelset_style(2), "third")
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), [2.0, 5.0])
    corners = axes.collections[0].get_paths()[0].vertices
    for x, low, high in ((10.0, 1.0, 6.0), (20.0, 0.0, 7.0)):
        at = corners[corners[:, 0] == x][:, 1]
        assert (at.min(), at.max()) == (low, high)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.01, 10.0, {"0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1", "2", "5", "10"}),
        (0.013, 4.0, {"0.02", "0.05", "0.1", "0.2", "0.5", "1", "2"}),  # more than two decades
        (0.013, 0.09, {"0.015", "0.02", "0.03", "0.05", "0.07"}),
        (0.8, 1.9, {"0.8", "1", "1.2", "1.4", "1.6", "1.8"}),  # less than a factor of 5: as a linear axis
        (1e-4, 100.0, {"0.0001", "0.001", "0.01", "0.1", "1", "10", "100"}),
    ],
)
def test_a_cost_axis_has_plain_numbers(low: float, high: float, expected: set[str]):
    figure = Figure()
    (axes,) = panels(figure, 1)
    axes.plot([0, 1], [low, high])
    log_axis(axes)
    axes.set_ylim(low, high)  # ticks follow limits that are set afterwards
    figure.draw_without_rendering()
    ticks = axes.yaxis.get_major_ticks()
    assert {t.label1.get_text() for t in ticks if low <= t.get_loc() <= high * (1.0 + 1e-9)} == expected


@pytest.mark.parametrize("values", [[], [np.nan, np.nan], [0.0, 0.0], [-2.0, -1.0]])
def test_a_cost_axis_without_a_cost_stays_as_it_is(values: list[float]):
    """As where every run derails at once; Matplotlib would warn or fail."""
    figure = Figure()
    (axes,) = panels(figure, 1)
    axes.plot(range(len(values)), values)
    log_axis(axes)
    figure.draw_without_rendering()
    assert axes.get_yscale() == "linear"


def test_limits_are_dashed_and_maps_hold_their_words():
    figure = Figure()
    (axes,) = panels(figure, 1)
    limit_line(axes, 2.0, "limit")
    assert axes.lines[0].get_linestyle() == "--"
    cells = [[(0.0, "low"), (0.5, "middle")], [(1.0, "high"), (0.25, "$a$")]]
    figure = Figure()
    heat_maps(figure, {"one": cells}, x=("x", ["1", "2"]), y=("y", ["3", "4"]), values="v", span=(0.0, 1.0))
    image = figure.axes[0].images[0]
    np.testing.assert_array_equal(image.get_array(), [[0.0, 0.5], [1.0, 0.25]])
    assert [text.get_text() for text in figure.axes[0].texts] == ["low", "middle", "high", "$a$"]


def test_a_figure_has_its_size_in_pixels():
    found = drawing(lambda figure: figure.set_size_inches(4.0, 2.0))
    image = Image.open(io.BytesIO(found.png))
    assert image.size == (4 * DPI, 2 * DPI)
