"""Figures to zoom and to hover: a drawn Matplotlib figure as traces and axes of Plotly.

A figure is defined once, by what draws it; both the PNG and what a page shows come from it. Converted is
what our figures consist of: lines, error bars, bands, bars, points, maps of cells, texts and spans. Where
the panels stand is left to the page, which has the room of a screen or of a phone for them.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config.units import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

MOST_POINTS = 3000
"""Of a line: beyond it, extremes of short parts are shown."""
_PIXELS = 4.0 / 3.0  # of a page, in a point
_DASHES: Mapping[Any, str] = MappingProxyType({"-": "solid", "--": "dash", "-.": "dashdot", ":": "dot"})
_MARKERS: Mapping[Any, str] = MappingProxyType(
    {
        **{"o": "circle", ".": "circle", "s": "square", "D": "diamond", "^": "triangle-up"},
        **{"v": "triangle-down", "<": "triangle-left", ">": "triangle-right", "P": "cross", "X": "x"},
        **{"*": "star", "h": "hexagon", "8": "octagon", "p": "pentagon", "x": "x-thin-open"},
        **{"+": "cross-thin-open", "|": "line-ns-open", "_": "line-ew-open"},
    }
)
_STEPS = MappingProxyType({"steps-post": "hv", "steps-pre": "vh", "steps": "vh", "steps-mid": "hvh"})


def extremes(x: Array, y: Array, most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Least and largest value in parts of a long signal, each at its own place, so that no peak is lost.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Places, rising, and values.
    most : int
        Points at most; a signal of no more is returned as it is.

    Returns
    -------
    x, y : ndarray
        Points of the signal in their own order, its first and its last among them. Parts without a number
        keep one that is none.
    """
    if len(x) <= most:
        return x, y
    edges = np.linspace(0, len(x), max(1, most // 2 - 1) + 1).astype(int)
    first, part = edges[:-1], np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    kept = [np.array([0, len(x) - 1])]
    for extreme in (np.fmin, np.fmax):
        hits = np.flatnonzero(y == extreme.reduceat(y, first)[part])
        found, places = np.unique(part[hits], return_index=True)
        own = first.copy()
        own[found] = hits[places]
        kept.append(own)
    chosen = np.unique(np.concatenate(kept))
    return x[chosen], y[chosen]


def _within(x: Array, y: Array, limits: tuple[float, float]) -> tuple[Array, Array]:
    """What a panel with these limits shows of a signal, and the point before and behind it."""
    low, high = sorted(limits)
    begin = int(np.searchsorted(x, low, "left")) - 1
    end = int(np.searchsorted(x, high, "right")) + 1
    return x[max(begin, 0) : end], y[max(begin, 0) : end]


def live_figure(figure: Figure) -> dict[str, Any]:
    """Return a figure that has been drawn as Plotly has it.

    Returns
    -------
    dict
        ``title``; ``data`` and ``layout`` of Plotly, the axes without domains; and ``panels``: of each its
        axes, its row and column, how many columns it spans and how many there are, where it begins and what
        it takes of their width, its height over its width, the name of its x-axis, and whether both axes
        have one scale.
    """
    return _Converter().whole(figure)


def _array(values: Any) -> dict[str, str]:
    """Numbers in single precision, as Plotly reads them without parsing."""
    return {
        "dtype": "f4",
        "bdata": base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii"),
    }


def _colour(colour: Any, alpha: float | None = None) -> str:
    from matplotlib.colors import to_rgba  # noqa: PLC0415 - slow to import

    red, green, blue, share = to_rgba(colour, alpha)
    return f"rgba({round(255 * red)},{round(255 * green)},{round(255 * blue)},{share:.3g})"


@dataclass
class _Panel:
    """Axes of a panel, and their numbers in Plotly."""

    axes: Axes
    x: str
    y: str

    def on(self) -> dict[str, str]:
        """The panel, as a trace or an annotation says it."""
        return {"xaxis": self.x, "yaxis": self.y}


@dataclass
class _Converter:
    data: list[dict[str, Any]] = field(default_factory=list)
    layout: dict[str, Any] = field(default_factory=lambda: {"annotations": [], "shapes": []})
    named: set[str] = field(default_factory=set)
    """Names that the legend has."""

    def whole(self, figure: Figure) -> dict[str, Any]:
        panels: list[dict[str, Any]] = []
        seen: list[_Panel] = []
        for axes in figure.axes:
            if axes.get_subplotspec() is None or not axes.axison:
                continue
            seen.append(self._panel(axes, seen))
            twin = seen[-1].x != _number("x", len(seen))
            self._axes(seen[-1], seen)
            if not twin:
                panels.append(self._place(seen[-1]))
            self._artists(seen[-1], figure)
        return {"title": figure.get_suptitle(), "data": self.data, "layout": self.layout, "panels": panels}

    def _panel(self, axes: Axes, others: Sequence[_Panel]) -> _Panel:
        """Axes of their own; those that lie over others (`twinx`) share the x-axis."""
        own = len(others) + 1
        below = [each for each in others if each.axes.get_subplotspec() == axes.get_subplotspec()]
        return _Panel(axes, below[0].x if below else _number("x", own), _number("y", own))

    def _place(self, panel: _Panel) -> dict[str, Any]:
        spec, size = panel.axes.get_subplotspec(), panel.axes.get_window_extent()
        assert spec is not None  # others are no panels
        grid, columns = spec.get_gridspec(), list(spec.colspan)
        widths: Any = grid.get_width_ratios()
        siblings = panel.axes.get_shared_x_axes().get_siblings(panel.axes)
        names = [each.get_xlabel() for each in (panel.axes, *siblings) if each.get_xlabel()]
        return {
            **panel.on(),
            "row": spec.rowspan.start,
            "column": columns[0],
            "span": len(columns),
            "columns": grid.ncols,
            "left": sum(widths[: columns[0]]) / sum(widths),
            "share": sum(widths[k] for k in columns) / sum(widths),
            "height": size.height / size.width,
            "name": _escaped(names[0]) if names else "",
            "equal": panel.axes.get_aspect() == 1.0,
        }

    def _axes(self, panel: _Panel, seen: Sequence[_Panel]) -> None:
        axes, first = panel.axes, next(each for each in seen if each.x == panel.x)
        y = _axis(axes.yaxis, axes.get_ylim(), axes.get_yscale()) | {"anchor": panel.x}
        if first is panel:
            x = _axis(axes.xaxis, axes.get_xlim(), axes.get_xscale()) | {"anchor": panel.y}
            self.layout[_key(panel.x)] = x | _matching("x", panel, seen)
            if axes.get_aspect() == 1.0:
                y |= {"scaleanchor": panel.x, "constrain": "domain"}
        else:
            y |= {"overlaying": first.y, "side": "right", "showgrid": False}
        self.layout[_key(panel.y)] = y | _matching("y", panel, seen)
        if axes.get_title():
            self._note(
                axes.get_title(), f"{panel.x} domain", f"{panel.y} domain", (0.5, 1.0), yanchor="bottom"
            )

    def _artists(self, panel: _Panel, figure: Figure) -> None:
        bars = {}
        for container in panel.axes.containers:
            if hasattr(container, "has_xerr"):
                line, caps, spans = container
                bars[line] = (container, spans)
                bars |= dict.fromkeys(caps)
        for line in panel.axes.get_lines():
            if line not in bars:
                self._line(panel, line)
            elif bars[line] is not None:
                container, spans = bars[line]
                self._line(panel, line, container.get_label(), _errors(container, line, spans))
        for collection in panel.axes.collections:
            self._collection(panel, collection)
        for patch in panel.axes.patches:
            self._patch(panel, patch)
        for image in panel.axes.images:
            self._cells(panel, image, figure)
        for text in panel.axes.texts:
            self._text(panel, text)

    def _line(
        self, panel: _Panel, line: Line2D, name: Any = None, more: Mapping[str, Any] | None = None
    ) -> None:
        x, y = (np.ravel(np.asarray(each, dtype=float)) for each in line.get_data(orig=False))
        own = line.get_transform().contains_branch_seperately(panel.axes.transData)
        name = line.get_label() if name is None else name
        if not all(own):
            self._limit(panel, line, (x, y), own)
            return
        # Extremes are taken of what runs along x, as a history does; a loop is shown whole. A panel that
        # shows a detail gets all its points for that.
        if len(x) > MOST_POINTS and np.all(np.diff(x) >= 0.0):
            x, y = extremes(*_within(x, y, panel.axes.get_xlim()))
        if len(x) == 0:
            return
        dash, marker = _DASHES.get(line.get_linestyle()), _MARKERS.get(line.get_marker())
        if dash is None and marker is None:
            return
        trace = {"type": "scatter", "x": _array(x), "y": _array(y), **panel.on(), **self._name(name)}
        trace["mode"] = "+".join(["lines"] * (dash is not None) + ["markers"] * (marker is not None))
        alpha = line.get_alpha()
        colour = _colour(line.get_color(), alpha)
        if dash is not None:
            shape = _STEPS.get(line.get_drawstyle(), "linear")
            width = _PIXELS * line.get_linewidth()
            trace["line"] = {"color": colour, "width": width, "dash": dash, "shape": shape}
        if marker is not None:
            size = _PIXELS * float(line.get_markersize()) * (0.5 if line.get_marker() == "." else 1.0)
            trace["marker"] = {"symbol": marker, "size": max(size, 2.0), "color": colour}
            if marker.endswith("open"):
                trace["marker"]["line"] = {"width": _PIXELS * line.get_markeredgewidth()}
        self.data.append(trace | dict(more or {}))

    def _limit(self, panel: _Panel, line: Line2D, ends: tuple[Array, Array], own: Sequence[bool]) -> None:
        """A line across the panel: `axhline`, `axvline`."""
        if not np.all(np.isfinite(np.concatenate(ends))):
            return
        (x0, x1), (y0, y1) = ends
        style = {
            "color": _colour(line.get_color(), line.get_alpha()),
            "width": _PIXELS * line.get_linewidth(),
        }
        dash = _DASHES.get(line.get_linestyle(), "solid")
        self._shape(
            panel,
            own,
            (x0, x1, y0, y1),
            type="line",
            line=style | {"dash": dash},
            **self._name(line.get_label()),
        )

    def _shape(
        self, panel: _Panel, own: Sequence[bool], box: tuple[float, float, float, float], **style: Any
    ) -> None:
        x0, x1, y0, y1 = map(float, box)
        where = {"x0": x0, "x1": x1, "y0": y0, "y1": y1}
        where["xref"], where["yref"] = (  # type: ignore[assignment]
            name if data else f"{name} domain" for name, data in zip((panel.x, panel.y), own, strict=True)
        )
        self.layout["shapes"].append(where | style)

    def _collection(self, panel: _Panel, found: Any) -> None:
        from matplotlib.collections import PathCollection, PolyCollection  # noqa: PLC0415 - slow to import

        if isinstance(found, PathCollection):
            places = np.asarray(found.get_offsets(), dtype=float)
            colours = [_colour(each) for each in np.atleast_2d(found.get_facecolor())] or [_colour("black")]
            size = float(np.sqrt(found.get_sizes()[0])) * _PIXELS
            marker = {"color": colours if len(colours) > 1 else colours[0], "size": size}
            trace = {"type": "scatter", "mode": "markers", "marker": marker, **panel.on()}
            x, y = places.T
            self.data.append(trace | {"x": _array(x), "y": _array(y)} | self._name(found.get_label()))
        elif isinstance(found, PolyCollection) and found.get_paths():
            fill = {
                "type": "scatter",
                "mode": "none",
                "fill": "toself",
                "hoverinfo": "skip",
                "showlegend": False,
            }
            fill["fillcolor"] = _colour(found.get_facecolor()[0])
            if found.get_gid():
                fill["legendgroup"] = str(found.get_gid())
            for path in found.get_paths():
                x, y = np.asarray(path.vertices).T
                self.data.append(fill | {"x": _array(x), "y": _array(y)} | panel.on())

    def _patch(self, panel: _Panel, patch: Any) -> None:
        """A bar, or a span of `axvspan`."""
        own = patch.get_transform().contains_branch_seperately(panel.axes.transData)
        corners = patch.get_path().transformed(patch.get_patch_transform()).vertices
        (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
        style = {"type": "rect", "fillcolor": _colour(patch.get_facecolor()), "line": {"width": 0}}
        layer = "below" if patch.get_zorder() < 2.0 else "above"
        self._shape(panel, own, (x0, x1, y0, y1), layer=layer, **style)

    def _cells(self, panel: _Panel, image: Any, figure: Figure) -> None:
        cells: Any = np.ma.filled(np.ma.asarray(image.get_array(), dtype=float), np.nan)
        bars = [axes.get_ylabel() for axes in figure.axes if axes.get_label() == "<colorbar>"]
        trace = {"type": "heatmap", "coloraxis": "coloraxis", "hoverongaps": False, **panel.on()}
        values = [[value if np.isfinite(value) else None for value in row] for row in cells.tolist()]
        self.data.append(trace | {"z": values})
        title = {"text": _escaped(bars[0]), "side": "right"} if bars else {}
        self.layout["coloraxis"] = {
            "cmin": float(image.norm.vmin),
            "cmax": float(image.norm.vmax),
            "colorscale": image.cmap.name.capitalize(),
            "colorbar": {"title": title, "thickness": 14},
        }

    def _text(self, panel: _Panel, text: Text) -> None:
        place: Any = getattr(text, "xyann", text.get_position())
        x, y = (float(each) for each in place)
        for scale, where in ((panel.axes.get_xscale(), "x"), (panel.axes.get_yscale(), "y")):
            if scale == "log":
                x, y = (np.log10(x), y) if where == "x" else (x, np.log10(y))
        align = {"left": "left", "right": "right"}.get(text.get_horizontalalignment(), "center")
        up = {"bottom": "bottom", "baseline": "bottom", "top": "top"}.get(
            text.get_verticalalignment(), "middle"
        )
        style: dict[str, Any] = {"xanchor": align, "yanchor": up}
        if text.get_bbox_patch() is not None:
            style["bgcolor"] = "rgba(255,255,255,0.7)"
        style["font"] = {"size": _PIXELS * float(text.get_fontsize()), "color": _colour(text.get_color())}
        self._note(text.get_text(), panel.x, panel.y, (float(x), float(y)), **style)

    def _note(self, text: str, x: str, y: str, place: tuple[float, float], **style: Any) -> None:
        note = {
            "text": _escaped(text),
            "xref": x,
            "yref": y,
            "x": place[0],
            "y": place[1],
            "showarrow": False,
        }
        self.layout["annotations"].append(note | style)

    def _name(self, label: Any) -> dict[str, Any]:
        """Name, group, and whether the legend shows it: the first of a name does."""
        name = str(label or "")
        if not name or name.startswith("_"):
            return {"showlegend": False, "name": ""}
        first = name not in self.named
        self.named.add(name)
        return {"name": _escaped(name), "legendgroup": name, "showlegend": first}


def _number(which: str, number: int) -> str:
    return which if number == 1 else f"{which}{number}"


def _key(name: str) -> str:
    """Name of an axis in the layout: of ``x2``, ``xaxis2``."""
    return f"{name[0]}axis{name[1:]}"


def _axis(axis: Axis, limits: tuple[float, float], scale: str) -> dict[str, Any]:
    """Name, range, kind and, where they are words, ticks of an axis."""
    from matplotlib.ticker import FixedLocator  # noqa: PLC0415 - slow to import

    log = scale == "log"
    ends = [float(value) for value in (np.log10(limits) if log else limits)]
    found: dict[str, Any] = {"range": ends, "type": "log" if log else "linear"}
    if axis.get_label_text():
        found["title"] = {"text": _escaped(axis.get_label_text())}
    if isinstance(axis.get_major_locator(), FixedLocator):
        found["tickvals"] = [float(place) for place in axis.get_majorticklocs()]
        found["ticktext"] = [_escaped(each.get_text()) for each in axis.get_majorticklabels()]
    return found


def _matching(which: str, panel: _Panel, seen: Sequence[_Panel]) -> dict[str, str]:
    """The first axis that this one is shared with."""
    axes: Any = panel.axes.get_shared_x_axes() if which == "x" else panel.axes.get_shared_y_axes()
    for each in seen[:-1]:
        own, other = getattr(panel, which), getattr(each, which)
        if own != other and axes.joined(panel.axes, each.axes):
            return {"matches": other}
    return {}


def _errors(container: Any, line: Line2D, spans: Sequence[Any]) -> dict[str, Any]:
    """Lengths of error bars to both sides of their points."""
    which = ["x"] * bool(container.has_xerr) + ["y"] * bool(container.has_yerr)
    found = {}
    for name, span in zip(which, spans, strict=True):
        middle = np.asarray(line.get_data(orig=False)[name == "y"], dtype=float)
        ends = np.array(span.get_segments())[:, :, int(name == "y")]
        found[f"error_{name}"] = {
            "array": (ends[:, 1] - middle).tolist(),
            "arrayminus": (middle - ends[:, 0]).tolist(),
            "symmetric": False,
            "color": _colour(span.get_color()[0]),
        }
    return found


def _escaped(text: str) -> str:
    """A text in which nothing is markup to Plotly."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\n", "<br>")
