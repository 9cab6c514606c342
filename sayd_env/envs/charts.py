"""Charts of a vehicle's last seconds, drawn by Matplotlib fast enough for a video.

Axes, ticks and titles are drawn once and kept; a picture draws lines and the newest numbers on top of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config.palette import BLACK, FAINT, FRONT, INK, LIMIT, REAR, SOFT, plain_matplotlib
from sayd_env.config.units import Array
from sayd_env.envs.recorder import WINDOW, Frame

DPI = 100
LEFT, RIGHT, TOP, BOTTOM = 44, 14, 30, 22
"""Pixels around the axes of a chart."""


@dataclass(frozen=True)
class Chart:
    """A quantity over the last seconds."""

    title: str
    values: Callable[[Frame], Array | None]
    """Of shape (t, lines), SI."""
    lines: Mapping[str, str] = field(default_factory=lambda: {"front": FRONT, "rear": REAR})
    """Colour of each line by its name."""
    scale: float = 1.0
    """Shown over SI."""
    limit: Callable[[Frame], float] = lambda _: 0.0
    """SI; 0 for none."""
    name: str = ""
    """Of the limit."""
    least: float = 0.0
    """The axis reaches at least this far."""
    digits: int = 2
    """Of the newest value, behind the point."""


ACCELERATION = Chart(
    "Frame acceleration, RMS of 1 s (m/s²)",
    lambda frame: frame.acceleration,
    limit=lambda frame: frame.acceleration_limit,
    name="limit",
)
FORCE = Chart(
    "Damper force, RMS of 1 s (kN)",
    lambda frame: frame.force,
    scale=1e-3,
    limit=lambda frame: frame.force_reference,
    name="F max",
)
VALVE = Chart("Valve opening, mean of a bogie", lambda frame: frame.valve, least=1.0)
COST = Chart("Cost J of the last second", lambda frame: frame.cost[:, None], {"": BLACK}, least=0.1, digits=3)


@dataclass(frozen=True)
class Extent:
    """Axes that stay as they are all through a video."""

    seconds: float
    """From the first picture to the last, s."""
    largest: Sequence[float]
    """What each chart has to show, SI."""


class Charts:
    """Charts side by side in one image.

    Parameters
    ----------
    charts : sequence of Chart
    width, height : int
        Pixels of one chart.
    gap : int
        Pixels between two.
    extent : Extent, optional
        Of the axes; by default they show the last seconds, and values as they come.
    """

    def __init__(
        self, charts: Sequence[Chart], width: int, height: int, gap: int, extent: Extent | None = None
    ) -> None:
        with plain_matplotlib():
            from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - slow to import
            from matplotlib.figure import Figure  # noqa: PLC0415

            whole = len(charts) * (width + gap) - gap
            figure = Figure(figsize=(whole / DPI, height / DPI), dpi=DPI, facecolor="none")
            canvas: Any = FigureCanvasAgg(figure)  # Matplotlib leaves its methods untyped
            self._panels = []
            for number, chart in enumerate(charts):
                left, inner = number * (width + gap) + LEFT, width - LEFT - RIGHT
                box = (left / whole, BOTTOM / height, inner / whole, (height - TOP - BOTTOM) / height)
                video = None if extent is None else (extent.seconds, extent.largest[number])
                self._panels.append(_Panel(figure.add_axes(box), chart, video))
            canvas.draw()
        self._canvas = canvas
        self._ground: Any = None

    def draw(self, frame: Frame) -> npt.NDArray[np.uint8]:
        """Draw the charts; the image, shape (height, width, 4), is overwritten by the next one."""
        changed = [panel.update(frame) for panel in self._panels]  # all of them, whichever changes first
        if any(changed) or self._ground is None:
            self._canvas.draw()
            self._ground = self._canvas.copy_from_bbox(self._canvas.figure.bbox)
        self._canvas.restore_region(self._ground)
        for panel in self._panels:
            panel.draw()
        return np.asarray(self._canvas.buffer_rgba())


def _newest(value: float, digits: int) -> str:
    """A number of no more signs than one below 10 has: there is no room for more beside the other's."""
    whole = len(f"{abs(value):.{digits}f}".partition(".")[0])
    return f"{value:.{max(digits + 1 - whole, 0)}f}"


class _Panel:
    """Axes of a chart, and what moves in them."""

    def __init__(self, axes: Any, chart: Chart, video: tuple[float, float] | None) -> None:
        self.axes, self.chart, self.video = axes, chart, video
        axes.set_facecolor("none")
        axes.spines[:].set_visible(False)
        axes.grid(axis="y", color=FAINT)
        axes.tick_params(length=0.0, labelsize=7, labelcolor=SOFT)
        first, last = (-WINDOW, 0.0) if video is None else (0.0, video[0])
        axes.set_xlim(first, last)
        ticks = (first, 0.5 * (first + last), last)
        words = [f"{s:g} s".replace("-", "\N{MINUS SIGN}") if video or s else "now" for s in ticks]
        axes.set_xticks(ticks, words)
        axes.get_xticklabels()[-1].set_ha("right")
        axes.set_title(chart.title, loc="left", x=-0.09, fontsize=9, fontweight="bold", color=INK, pad=8.0)
        colours = chart.lines.values()
        self.lines = [axes.plot([], [], color=c, linewidth=1.5, animated=True)[0] for c in colours]
        newest: Any = {"transform": axes.transAxes, "ha": "right", "fontsize": 9, "fontweight": "bold"}
        places = 1.0 - 0.13 * np.arange(len(colours))[::-1]
        self.numbers = [
            axes.text(x, 1.08, "", color=c, animated=True, **newest)
            for x, c in zip(places, colours, strict=True)
        ]
        for x, (name, c) in zip(places, chart.lines.items(), strict=True):
            axes.text(x, 1.0, name, color=c, transform=axes.transAxes, ha="right", va="top", fontsize=7)
        self.limit = axes.axhline(np.nan, color=LIMIT, linestyle="--", linewidth=1.0)
        self.limit_name = axes.text(first, 0.0, "", color=LIMIT, fontsize=7, va="bottom")
        self.shown = (0.0, 0.0)

    def update(self, frame: Frame) -> bool:
        """Take a frame's values; say whether the axes have changed."""
        chart = self.chart
        values = chart.values(frame)
        assert values is not None  # the chart is one of this vehicle's
        values = chart.scale * values
        now = frame.time if self.video is None else 0.0
        for line, number, column in zip(self.lines, self.numbers, values.T, strict=True):
            line.set_data(frame.times - now, column)
            number.set_text(_newest(column[-1], chart.digits) if len(column) else "")
        limit = chart.scale * chart.limit(frame)
        largest = float(values.max(initial=0.0)) if self.video is None else chart.scale * self.video[1]
        needed = max(largest, 1.25 * limit, chart.least)
        return self._fit(needed, limit)

    def _fit(self, needed: float, limit: float) -> bool:
        """Let the axis end at a round number; it moves only where a value would not be seen well."""
        from matplotlib.ticker import MaxNLocator  # noqa: PLC0415 - slow to import

        ticks = MaxNLocator(nbins=5, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, needed)
        if (float(ticks[-1]), limit) == self.shown:
            return False
        self.shown = (float(ticks[-1]), limit)
        with plain_matplotlib():  # there may be new ticks
            self.axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        self.axes.set_ylim(0.0, ticks[-1])
        if limit > 0.0:
            self.limit.set_ydata([limit, limit])
            self.limit_name.set_text(f" {self.chart.name} {limit:.3g}")
            self.limit_name.set_y(limit)
        return True

    def draw(self) -> None:
        """Draw what moves."""
        for artist in (*self.lines, *self.numbers):
            self.axes.draw_artist(artist)
