"""Figures of Matplotlib as Plotly has them: the same numbers, axes, names and styles."""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sayd_env.config.palette import policy_style
from sayd_env.report.figures import (
    drawing,
    heat_maps,
    label,
    limit_line,
    log_axis,
    name_rows,
    panels,
    with_band,
)
from sayd_env.report.live import MOST_POINTS, extremes


def live(draw: Callable[[Axes], Any], **options: Any) -> Any:
    """What one panel becomes."""
    return drawing(lambda figure: draw(panels(figure, 1, **options)[0])).live


def numbers(packed: dict[str, str]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed["bdata"]), dtype="<f4")


def test_a_line_keeps_numbers_style_and_name():
    style = policy_style("mppt2")
    found = live(
        lambda axes: axes.plot([1.0, 2.0, 4.0], [3.0, np.nan, 5.0], label="mppt2 <b>", **style.drawn)
    )
    (trace,) = found["data"]
    np.testing.assert_array_equal(numbers(trace["x"]), [1.0, 2.0, 4.0])
    np.testing.assert_array_equal(numbers(trace["y"]), [3.0, np.nan, 5.0])
    assert (trace["mode"], trace["marker"]["symbol"], trace["line"]["dash"]) == (
        "lines+markers",
        "triangle-up",
        "solid",
    )
    assert trace["line"]["color"] == "rgba(0,114,178,1)"  # Okabe and Ito's blue
    assert trace["name"] == "mppt2 &lt;b&gt;"


def test_axes_have_their_ranges_names_and_kinds():
    def draw(axes: Axes) -> None:
        axes.plot([0.0, 1.0], [0.01, 10.0])
        axes.set(xlabel="speed (km/h)", xlim=(-1.0, 3.0), ylim=(0.001, 100.0), title="J")
        log_axis(axes)

    layout = live(draw)["layout"]
    assert layout["xaxis"]["range"] == [-1.0, 3.0]
    assert layout["xaxis"]["title"] == {"text": "speed (km/h)"}
    np.testing.assert_allclose(layout["yaxis"]["range"], [-3.0, 2.0])  # powers of ten
    assert layout["yaxis"]["type"] == "log"
    assert [note["text"] for note in layout["annotations"]] == ["J"]


def test_a_name_is_in_the_legend_once_and_moves_all_that_has_it():
    def draw(figure: Figure) -> None:
        for axes in panels(figure, 2, 2, sharex=True, sharey=True):
            with_band(axes, np.arange(3.0), np.ones((3, 2)), policy_style("ppo"), "ppo")
            axes.plot([0.0, 1.0], [0.0, 1.0], "o")

    found = drawing(draw).live
    lines = [trace for trace in found["data"] if trace.get("name")]
    assert [trace["showlegend"] for trace in lines] == [True, False]
    bands = [trace for trace in found["data"] if trace.get("fill") == "toself"]
    assert {trace["legendgroup"] for trace in (*lines, *bands)} == {"ppo"}
    assert found["layout"]["xaxis2"]["matches"] == "x"
    assert found["layout"]["yaxis2"]["matches"] == "y"
    assert [(panel["row"], panel["column"], panel["columns"]) for panel in found["panels"]] == [
        (0, 0, 2),
        (0, 1, 2),
    ]


def test_limits_and_spans_cross_the_panel():
    def draw(axes: Axes) -> None:
        axes.plot([0.0, 10.0], [0.0, 2.0])
        limit_line(axes, 1.0, "limit")
        axes.axvspan(2.0, 3.0, color="0.9")

    found = live(draw)
    assert len(found["data"]) == 1
    limit, span = found["layout"]["shapes"]
    assert (limit["xref"], limit["x0"], limit["x1"], limit["yref"], limit["y0"]) == ("x domain", 0, 1, "y", 1)
    assert (limit["name"], limit["showlegend"], limit["line"]["dash"]) == ("limit", True, "dash")
    assert (span["xref"], span["x0"], span["x1"], span["yref"]) == ("x", 2.0, 3.0, "y domain")


def test_error_bars_have_their_lengths_and_rows_their_names():
    def draw(axes: Axes) -> None:
        axes.errorbar(3.0, 0.0, xerr=[[1.0], [2.0]], fmt="D", capsize=4)
        name_rows(axes, [label("mppt2")])

    found = live(draw)
    (trace,) = found["data"]
    assert trace["error_x"]["array"] == [2.0]
    assert trace["error_x"]["arrayminus"] == [1.0]
    assert found["layout"]["yaxis"]["ticktext"] == ["mppt2"]
    assert found["layout"]["yaxis"]["range"] == [0.5, -0.5]  # from the top


def test_a_second_axis_lies_over_the_first():
    def draw(axes: Axes) -> None:
        axes.plot([0.0, 1.0], [0.0, 1.0])
        axes.twinx().plot([0.0, 1.0], [100.0, 200.0])

    found = live(draw)
    assert len(found["panels"]) == 1
    assert found["layout"]["yaxis2"]["overlaying"] == "y"
    assert [(trace["xaxis"], trace["yaxis"]) for trace in found["data"]] == [("x", "y"), ("x", "y2")]


def test_maps_keep_their_cells_words_and_scale():
    cells = [[(0.0, "low"), (np.nan, "-")], [(1.0, "high"), (0.25, "a")]]
    found = drawing(
        lambda figure: heat_maps(
            figure, {"one": cells}, x=("x", ["1", "2"]), y=("y", ["3", "4"]), values="v", span=(0.0, 1.0)
        ),
    ).live
    (trace,) = found["data"]
    assert trace["z"] == [[0.0, None], [1.0, 0.25]]
    assert [note["text"] for note in found["layout"]["annotations"]] == ["one", "low", "-", "high", "a"]
    assert found["layout"]["xaxis"]["ticktext"] == ["1", "2"]
    scale = found["layout"]["coloraxis"]
    assert (scale["cmin"], scale["cmax"], scale["colorscale"]) == (0.0, 1.0, "Viridis")
    assert scale["colorbar"]["title"]["text"] == "v"
    assert len(found["panels"]) == 1


def test_extremes_lose_no_peak_and_nothing_at_the_end():
    x = np.arange(100_003.0)
    y = np.zeros(x.shape)
    y[[5, 70_000, 100_002]] = 3.0, -2.0, 7.0
    where, values = extremes(x, y)
    assert len(where) == len(values) <= MOST_POINTS
    np.testing.assert_array_equal(values, y[where.astype(int)])
    assert np.all(np.diff(where) >= 0.0)
    assert sorted(values[values != 0.0]) == [-2.0, 3.0, 7.0]
    assert where[values == -2.0] == 70_000
    assert (where[0], where[-1]) == (0.0, 100_002.0)
    same = extremes(x[:10], y[:10])
    np.testing.assert_array_equal(same[1], y[:10])


def test_extremes_stand_in_their_own_order_and_keep_gaps():
    x = np.arange(10_000.0)
    falling, gap = -x, np.where((x > 4000.0) & (x < 6000.0), np.nan, x)
    where, values = extremes(x, falling)
    np.testing.assert_array_equal(values, -where)
    where, values = extremes(x, gap)
    missing = where[np.isnan(values)]
    assert missing.size
    assert 4000.0 < missing.min() < missing.max() < 6000.0
    assert np.nanmax(values[where <= 5000.0]) == 4000.0
    assert np.nanmin(values[where >= 5000.0]) == 6000.0


def test_a_detail_of_a_long_history_shows_every_point():
    time = np.arange(0.0, 40.0, 0.005)
    force = np.sin(2.0 * np.pi * 9.0 * time)

    def draw(figure: Figure) -> None:
        whole, detail = panels(figure, 2)
        for axes in (whole, detail):
            axes.plot(time, force)
        detail.set_xlim(20.0, 21.0)

    whole, detail = drawing(draw).live["data"]
    assert len(numbers(whole["x"])) <= MOST_POINTS
    shown = slice(np.searchsorted(time, 20.0) - 1, np.searchsorted(time, 21.0, "right") + 1)
    np.testing.assert_array_equal(numbers(detail["x"]), time[shown].astype("<f4"))
    np.testing.assert_array_equal(numbers(detail["y"]), force[shown].astype("<f4"))
