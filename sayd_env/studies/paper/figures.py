"""Counterparts of the paper's figures 11 to 18: the controlled vehicle over speed and over time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config.palette import BLUE, GREEN, VERMILION
from sayd_env.report.figures import Plot, legend_below, panels
from sayd_env.runs.controlled import REAR, ControlledRun, ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.critical_speed import draw_trends
from sayd_env.studies.paper.controlled_claims import CLOSED, CONTINUOUS, MPPT1, MPPT2, ON_OFF, OPEN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ZOOM = (20.0, 22.0)
"""s, the part of a run that figures 16 and 18 show in detail."""
_SHOWN = 40.0  # s
_COLOURS = {CLOSED: BLUE, OPEN: VERMILION}


def controlled_plots(runs: ControlledRuns, limits: Limits, wheelsets: Sequence[str]) -> dict[str, Plot]:
    """Counterparts of figures 11 to 18, by file name; histories are those of the first seed.

    Raises
    ------
    ValueError
        One of `required_runs` is missing.
    """

    def trends(policy: str, title: str, *, track_shift: bool) -> Plot:
        sweep = runs.sweep(policy, CLOSED)
        return lambda figure: draw_trends(figure, sweep, limits, wheelsets, title, track_shift=track_shift)

    def first(policy: str, kmh: float, initial: float = CLOSED) -> ControlledRun:
        return runs.at(policy, kmh, initial)[0]

    def starts(policy: str, kmh: float, title: str) -> Plot:
        shown = [first(policy, kmh), first(policy, kmh, OPEN)]
        return partial(draw_starts, runs=shown, title=f"{title}, {kmh:g} km/h")

    def switching(policy: str, title: str) -> Plot:
        return partial(draw_switching, run=first(policy, 400), title=f"{title}, 400 km/h")

    return {
        "figure_11_mppt1": trends(MPPT1, "MPPT1", track_shift=False),
        "figure_12_mppt1_command": starts(MPPT1, 400, "MPPT1"),
        "figure_13_mppt2": trends(MPPT2, "MPPT2", track_shift=False),
        "figure_14_mppt2_command": starts(MPPT2, 300, "MPPT2"),
        "figure_15_skyhook_onoff": trends(ON_OFF, "on-off skyhook", track_shift=True),
        "figure_16_skyhook_onoff_command": switching(ON_OFF, "on-off skyhook"),
        "figure_17_skyhook_continuous": trends(CONTINUOUS, "continuous skyhook", track_shift=True),
        "figure_18_skyhook_continuous_command": switching(CONTINUOUS, "continuous skyhook"),
    }


def draw_starts(figure: Figure, runs: Sequence[ControlledRun], title: str) -> None:
    """Draw rear command and force of one rear damper of runs with different first commands (figure 12).

    The last run is drawn in front in the upper panel, the first one in the lower.
    """
    top, bottom = panels(figure, 2, size=(8.0, 3.0), sharex=True)
    for run in runs:
        _draw_command(top, run)
    for run in reversed(runs):
        _draw_force(bottom, run)
    top.set(title=f"{title}, seed {runs[0].seed}: rear bogie", ylabel="command (%)", ylim=(-5, 105))
    bottom.set(xlabel="time since the first command (s)", ylabel="force of one damper (kN)", xlim=(0, _SHOWN))
    legend_below(figure, top)


def draw_switching(figure: Figure, run: ControlledRun, title: str) -> None:
    """Draw rear command and force of one rear damper, the whole and a detail of two seconds (figure 16)."""
    axes = panels(figure, 4, 2, (5.0, 3.0), sharex="col", sharey="row", width_ratios=(3, 2))
    for command, force, span in zip(axes[:2], axes[2:], ((0.0, _SHOWN), ZOOM), strict=True):
        _draw_command(command, run)
        _draw_force(force, run)
        force.set(xlabel="time since the first command (s)", xlim=span)
    axes[0].set(title=f"{title}, seed {run.seed}: rear bogie", ylabel="command (%)", ylim=(-5, 105))
    axes[1].set_title("detail")
    axes[3].locator_params(axis="x", nbins=4)
    axes[2].set_ylabel("force of one damper (kN)")


def _draw_command(axes: Axes, run: ControlledRun) -> None:
    shown = run.command[: round(_SHOWN / run.control_period), REAR]
    time = np.arange(len(shown)) * run.control_period
    start: dict[str, Any] = {"drawstyle": "steps-post", "label": f"V(0) = {100 * run.initial_current:g} %"}
    axes.plot(time, 100 * shown, color=_COLOURS.get(run.initial_current, GREEN), linewidth=0.8, **start)


def _draw_force(axes: Axes, run: ControlledRun) -> None:
    time = np.arange(len(run.force_trace)) * run.trace_period
    axes.plot(time, run.force_trace * 1e-3, color=_COLOURS.get(run.initial_current, GREEN), linewidth=0.6)
