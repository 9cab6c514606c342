"""Counterparts of the paper's figures 11 to 18: the controlled vehicle over speed and over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config.palette import BLACK, BLUE, GREY, VERMILION
from sayd_env.report.figures import Plot, legend_below, panels
from sayd_env.runs.controlled import REAR, ControlledRun, ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.critical_speed import draw_trends
from sayd_env.studies.paper.controlled_claims import CLOSED, CONTINUOUS, MPPT1, MPPT2, ON_OFF, OPEN, SCATTER

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ZOOM = (20.0, 21.0)
"""s, the part of a run that figures 16 and 18 show in detail."""
_SHOWN = 40.0  # s
_TIME, _FORCE = "time since the first command (s)", "force of one damper (kN)"


def controlled_plots(runs: ControlledRuns, limits: Limits, wheelsets: Sequence[str]) -> dict[str, Plot]:
    """Counterparts of figures 11 to 18, by file name; histories are those of the first seed.

    Raises
    ------
    ValueError
        One of `required_runs` is missing.
    """

    def trends(policy: str, title: str, scatter: tuple[float, float] | None = None) -> Plot:
        sweep = runs.sweep(policy, CLOSED)
        return lambda figure: draw_trends(figure, sweep, limits, wheelsets, title, scatter)

    def first(policy: str, kmh: float, initial: float = CLOSED) -> ControlledRun:
        return runs.at(policy, kmh, initial)[0]

    def starts(policy: str, kmh: float, title: str) -> Plot:
        shown = [first(policy, kmh), first(policy, kmh, OPEN)]
        return partial(draw_starts, runs=shown, title=f"{title}, {kmh:g} km/h")

    def switching(policy: str, title: str) -> Plot:
        return partial(draw_switching, run=first(policy, 400), title=f"{title}, 400 km/h")

    return {
        "figure_11_mppt1": trends(MPPT1, "MPPT1", SCATTER),
        "figure_12_mppt1_command": starts(MPPT1, 400, "MPPT1"),
        "figure_13_mppt2": trends(MPPT2, "MPPT2", SCATTER),
        "figure_14_mppt2_command": starts(MPPT2, 300, "MPPT2"),
        "figure_15_skyhook_onoff": trends(ON_OFF, "on-off skyhook"),
        "figure_16_skyhook_onoff_command": switching(ON_OFF, "on-off skyhook"),
        "figure_17_skyhook_continuous": trends(CONTINUOUS, "continuous skyhook"),
        "figure_18_skyhook_continuous_command": switching(CONTINUOUS, "continuous skyhook"),
    }


def draw_starts(figure: Figure, runs: Sequence[ControlledRun], title: str) -> None:
    """Draw rear commands of runs with different first ones, and the force of one damper in the first run.

    As the paper's figure 12, whose lower panel shows the closed start alone.
    """
    top, bottom = panels(figure, 2, size=(8.0, 3.0), sharex=True)
    for run in runs:
        _draw_command(top, run, label=f"V(0) = {100 * run.initial_current:g} %")
        top.plot(0.0, 100 * run.initial_current, "o", color=_colour(run), clip_on=False)
    _draw_force(bottom, runs[0])
    top.set(title=f"{title}, seed {runs[0].seed}: rear bogie", ylabel="command (%)", ylim=(-5, 105))
    bottom.set(xlabel=_TIME, ylabel=_FORCE, xlim=(0, _SHOWN))
    legend_below(figure, top)


def draw_switching(figure: Figure, run: ControlledRun, title: str) -> None:
    """Draw rear command and force of one rear damper, the whole and a second of them (figure 16).

    A command that switches all the time would be one block of colour over the whole run: its mean over each
    second stands before it.
    """
    axes = panels(figure, 4, 2, (5.0, 3.0), sharex="col", sharey="row", width_ratios=(3, 2))
    for command, force, span in zip(axes[:2], axes[2:], ((0.0, _SHOWN), ZOOM), strict=True):
        whole = span != ZOOM
        _draw_command(command, run, alpha=0.25 if whole else 1.0, label="command")
        if whole:
            _draw_means(command, run)
        _draw_force(force, run)
        force.set(xlabel=_TIME, xlim=span)
    for panel in axes[::2]:
        panel.axvspan(*ZOOM, color=GREY, alpha=0.5, linewidth=0.0, zorder=3)
    axes[0].set(title=f"{title}, seed {run.seed}: rear bogie", ylabel="command (%)", ylim=(-5, 105))
    axes[1].set_title(f"detail from {ZOOM[0]:g} to {ZOOM[1]:g} s")
    axes[3].locator_params(axis="x", nbins=5, prune="both")  # the panel beside it has a number there
    axes[2].set_ylabel(_FORCE)
    legend_below(figure, axes[0])


def _draw_command(axes: Axes, run: ControlledRun, **line: Any) -> None:
    """Draw what holds at the end of the run-in, and then the steps of the command."""
    shown = np.r_[run.initial_current, run.command[: round(_SHOWN / run.control_period), REAR]]
    time = np.r_[0.0, np.arange(len(shown) - 1) * run.control_period]
    axes.plot(time, 100 * shown, color=_colour(run), linewidth=0.8, drawstyle="steps-post", **line)


def _draw_means(axes: Axes, run: ControlledRun) -> None:
    """Draw the mean of the command over each second."""
    second = round(1.0 / run.control_period)
    whole = run.command[: int(_SHOWN) * second, REAR]
    means = whole[: len(whole) // second * second].reshape(-1, second).mean(axis=1)
    axes.plot(np.arange(len(means)) + 0.5, 100 * means, color=BLACK, linewidth=1.2, label="mean of a second")


def _draw_force(axes: Axes, run: ControlledRun) -> None:
    time = np.arange(len(run.force_trace)) * run.trace_period
    axes.plot(time, run.force_trace * 1e-3, color=_colour(run), linewidth=0.6)


def _colour(run: ControlledRun) -> str:
    return BLUE if run.initial_current == CLOSED else VERMILION
