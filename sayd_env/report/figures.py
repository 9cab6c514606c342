"""What all figures have in common: panels, limits, legends, axes of costs, and how a figure becomes a PNG.

Figures need no window and no state of `matplotlib.pyplot`; a reader's own settings of Matplotlib change
nothing. Names are drawn as they are: a ``$`` or ``_`` starts no formula.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from sayd_env.config.palette import LIMIT, Style, plain_matplotlib
from sayd_env.config.units import Array
from sayd_env.envs.cost import mean_cost
from sayd_env.report.live import live_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Plot: TypeAlias = "Callable[[Figure], None]"
"""Draws one picture into an empty figure."""

SIZE = (8.0, 5.0)
"""Inches."""
DPI = 150
COLOUR_MAP = "viridis"
"""Of numbers: safe for colour-blind readers, and in grey."""
UNKNOWN = "\ufffd"
"""Drawn for what the typeface does not have."""


class Drawing(NamedTuple):
    """A figure as it is stored and shown."""

    png: bytes
    live: Mapping[str, Any]
    """What a page needs to make it one to zoom and to hover, see `sayd_env.report.live.live_figure`."""


def drawing(draw: Plot, *, live: bool = True) -> Drawing:
    """Draw into a fresh figure and return it as PNG, and `live` what makes it live."""
    image = io.BytesIO()
    with plain_matplotlib():
        from matplotlib.figure import Figure  # noqa: PLC0415 - slow to import, and --json needs none

        figure = Figure(figsize=SIZE, layout="constrained")
        draw(figure)
        _replace_unknown(figure)
        figure.savefig(image, format="png", dpi=DPI)
        return Drawing(image.getvalue(), live_figure(figure) if live else {})


def panels(
    figure: Figure, count: int, columns: int = 1, size: tuple[float, float] = (5.0, 3.0), **sharing: Any
) -> list[Axes]:
    """Make axes in a grid, row by row, with a light grid of their own.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        An empty figure, which gets the size that the panels need.
    count, columns : int
        Number of panels, and of columns at most.
    size : tuple of float
        Width and height of a panel, inches.
    **sharing
        Further keywords of `matplotlib.figure.Figure.subplots`.
    """
    columns = max(1, min(columns, count))
    rows = math.ceil(count / columns)
    figure.set_size_inches(size[0] * columns, size[1] * rows + 0.5)
    grid = figure.subplots(rows, columns, squeeze=False, **sharing).ravel()
    for axes in grid[count:]:
        axes.set_axis_off()
        # Where panels of a column share their axis, the last one that is seen has its labels.
        grid[list(grid).index(axes) - columns].xaxis.set_tick_params(labelbottom=True)
    for axes in grid[:count]:
        axes.grid(alpha=0.3)
    return list(grid[:count])


def limit_line(axes: Axes, value: float, label: str = "", *, vertical: bool = False) -> None:
    """Draw a limit as a dashed line."""
    draw = axes.axvline if vertical else axes.axhline
    draw(value, color=LIMIT, linestyle="--", linewidth=1.0, label=label or None)


def reference_line(axes: Axes, value: float, *, vertical: bool = False) -> None:
    """Draw the line from which differences or ratios are counted."""
    draw = axes.axvline if vertical else axes.axhline
    draw(value, color=LIMIT, linewidth=0.8)


def log_axis(axes: Axes, which: str = "y") -> None:
    """Make an axis logarithmic, as where costs differ a hundred times, with ticks that are plain numbers.

    What it shows has been drawn: without any positive value the axis stays as it is.
    """
    from matplotlib.ticker import FuncFormatter, NullFormatter  # noqa: PLC0415 - as above

    from sayd_env.report.ticks import PlainTicks  # noqa: PLC0415

    if math.isinf(axes.dataLim.minposx if which == "x" else axes.dataLim.minposy):
        return  # nothing that such an axis could show, as where every run derails at once
    axes.set(**{f"{which}scale": "log"})
    axis = axes.yaxis if which == "y" else axes.xaxis
    axis.set_major_locator(PlainTicks())
    axis.set_minor_locator(PlainTicks(minor=True))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def name_rows(axes: Axes, names: Iterable[str]) -> None:
    """Put names, from the top, where bars or points have the places 0, 1, ..."""
    labels = [label(name) for name in names]
    axes.set_yticks(range(len(labels)), labels)
    axes.set_ylim(len(labels) - 0.5, -0.5)


def ratio_rows(
    figure: Figure, ratios: Mapping[str, Sequence[float]], colours: Mapping[str, str], about: str
) -> None:
    """Draw ratios, each name's in a row: points, and a bar at their geometric mean; `about` is the label."""
    figure.set_size_inches(8.0, 0.4 * len(ratios) + 1.5)
    axes = figure.subplots()
    axes.grid(alpha=0.3)
    for k, (name, values) in enumerate(ratios.items()):
        mean, colour = mean_cost(values, "geometric"), colours[name]
        axes.plot(values, [k] * len(values), "o", color=colour, markersize=4, alpha=0.6)
        axes.plot([mean], [k], "|", color=colour, markersize=18, markeredgewidth=2.5)
    name_rows(axes, ratios)
    log_axis(axes, "x")
    reference_line(axes, 1.0, vertical=True)
    axes.set_xlabel(about)


def legend_below(figure: Figure, *axes: Axes, columns: int = 4) -> None:
    """Put one legend of some panels, each name once, below all of them."""
    by_label: dict[str, Any] = {}
    for panel in axes:
        handles, labels = panel.get_legend_handles_labels()
        by_label |= dict(zip(labels, handles, strict=True))
    if by_label:
        place: Any = {"loc": "outside lower center", "ncols": min(columns, len(by_label))}
        figure.legend(by_label.values(), by_label, fontsize="small", **place)


def with_band(axes: Axes, x: Array, values: Array, style: Style, name: str) -> None:
    """Draw the medians of several series, shape (x, series), in the band from the lowest to the highest."""
    axes.plot(x, np.median(values, axis=1), label=label(name), markersize=4, **style.drawn)
    axes.fill_between(
        x,
        values.min(axis=1),
        values.max(axis=1),
        color=style.colour,
        alpha=0.12,
        linewidth=0.0,
        gid=label(name),
    )


def heat_maps(
    figure: Figure,
    maps: Mapping[str, Sequence[Sequence[tuple[float, str]]]],
    *,
    x: tuple[str, Sequence[str]],
    y: tuple[str, Sequence[str]],
    values: str,
    span: tuple[float, float],
) -> None:
    """Draw tables side by side as coloured cells that hold their values.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        An empty figure.
    maps : mapping
        Rows from the bottom of cells from the left by title; a cell is a number for its colour and a text.
    x, y : tuple of str and sequence of str
        Name of an axis and labels of its cells.
    values : str
        What the numbers are.
    span : tuple of float
        Lowest and highest number of the colours.
    """
    axes = panels(figure, len(maps), 3, (4.0, 3.6))
    image = None
    for panel, (title, rows) in zip(axes, maps.items(), strict=True):
        numbers = [[number for number, _ in row] for row in rows]
        colours: Any = {"cmap": COLOUR_MAP, "vmin": span[0], "vmax": span[1]}
        image = panel.imshow(numbers, origin="lower", aspect="auto", **colours)
        panel.grid(visible=False)
        box = {"facecolor": "white", "alpha": 0.7, "edgecolor": "none", "pad": 1.0}
        for i, row in enumerate(rows):
            for j, (_, text) in enumerate(row):
                panel.text(j, i, text, ha="center", va="center", fontsize=8, bbox=box)
        panel.set_xticks(range(len(x[1])), x[1])
        panel.set_yticks(range(len(y[1])), y[1])
        panel.set(title=title, xlabel=x[0], ylabel=y[0])
    if image is not None:
        figure.colorbar(image, ax=axes, label=values)


def label(name: str) -> str:
    """A name as a legend or an axis can show it."""
    known = "".join(c if c == "\n" or (c.isprintable() and _has(ord(c))) else UNKNOWN for c in name)
    # Matplotlib hides what begins with an underscore.
    return f" {known}" if known.startswith("_") else known


@cache
def _has(code: int) -> bool:
    """Whether the typeface has a character."""
    from matplotlib.font_manager import findfont, get_font  # noqa: PLC0415 - slow to import

    return bool(get_font(findfont("DejaVu Sans")).get_char_index(code))


def _replace_unknown(figure: Figure) -> None:
    """Replace what the typeface does not have, for example in titles that hold a name."""
    from matplotlib.text import Text  # noqa: PLC0415 - slow to import

    for text in figure.findobj(Text):
        if isinstance(text, Text) and (shown := text.get_text()) and not shown.startswith("_"):
            text.set_text(label(shown))
