"""A comparison as one page of plots."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sayd_env.studies.comparison.grid import OWN
from sayd_env.studies.comparison.scores import LEAST_REDUCTION, Score
from sayd_env.studies.comparison.statistics import Bootstrap, profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sayd_env.studies.comparison.result import Comparison

Array = npt.NDArray[np.float64]
THRESHOLDS = np.linspace(0.0, 2.0, 101)


def draw(result: Comparison, figure: Figure) -> None:
    """Draw cost over speed, distribution and mean against MPPT2, training seeds, bound, and the targets."""
    figure.set_size_inches(15.0, 9.5)
    config = result.config
    figure.suptitle(
        f"{len(result.grid.conditions)} conditions x {len(config.seeds)} seeds, J on line"
        + (", --quick: a look, no result" if result.quick else "")
    )
    axes = figure.subplots(2, 3)
    colours = {each.name: f"C{i}" for i, each in enumerate(result.entrants)}
    _speeds(result, axes[0, 0], colours)
    _profiles(result, axes[0, 1], colours)
    _middles(result, axes[0, 2], colours)
    _trainings(result, axes[1, 0], colours)
    _bounds(result, axes[1, 1], colours)
    _reductions(result, axes[1, 2], colours)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6), fontsize="small")
    for axis in axes.ravel():
        axis.grid(alpha=0.3)


def _speeds(result: Comparison, axis: Axes, colours: dict[str, str]) -> None:
    speeds = np.array([condition.speed_kmh for condition in result.grid.conditions])
    grid = np.unique(speeds)
    lines = {name: found.by_condition for name, found in result.scores[OWN].items()}
    for name, costs in lines.items():
        means = [costs[speeds == speed].mean() for speed in grid]
        axis.plot(grid, means, "o-", markersize=4, color=colours[name], label=name)
    bound = result.bounds[OWN].costs[0].mean(axis=1)
    means = [bound[speeds == speed].mean() for speed in grid]
    axis.plot(grid, means, "k--", label="best constant of each condition")
    axis.set(title="mean J over speed", xlabel="speed (km/h)", ylabel="J", yscale="log")


def _profiles(result: Comparison, axis: Axes, colours: dict[str, str]) -> None:
    """Share of the scenarios in which J over MPPT2's does not exceed a threshold."""
    settings = result.config
    bootstrap = Bootstrap(len(result.grid.conditions), len(settings.seeds), settings.bootstrap)
    costs = result.costs[OWN]
    for name, table in costs.items():
        if name == "mppt2":
            continue
        share, low, high = profile(table / costs["mppt2"], THRESHOLDS, bootstrap)
        axis.plot(THRESHOLDS, share, color=colours[name])
        axis.fill_between(THRESHOLDS, low, high, color=colours[name], alpha=0.15, linewidth=0.0)
    axis.axvline(1.0, color="k", linewidth=0.8)
    axis.set(title="share of the runs with J / J of MPPT2 up to x", xlabel="x", ylabel="share")


def _middles(result: Comparison, axis: Axes, colours: dict[str, str]) -> None:
    controlled = _controlled(result)
    for i, (name, found) in enumerate(controlled.items()):
        middle = found.to_mppt2
        error = [[max(middle.value - middle.low, 0.0)], [max(middle.high - middle.value, 0.0)]]
        axis.errorbar(middle.value, i, xerr=error, fmt="o", color=colours[name], capsize=4)
    axis.axvline(1.0, color="k", linewidth=0.8)
    axis.set_yticks(range(len(controlled)), list(controlled))
    axis.invert_yaxis()
    axis.set(title="IQM of J / J of MPPT2, 95 % interval", xlabel="ratio")


def _trainings(result: Comparison, axis: Axes, colours: dict[str, str]) -> None:
    controlled = _controlled(result)
    for i, (name, found) in enumerate(controlled.items()):
        axis.plot(found.by_training, [i] * len(found.by_training), "o", color=colours[name], alpha=0.7)
        axis.plot(found.mean, i, "|", color=colours[name], markersize=18)
    axis.set_yticks(range(len(controlled)), list(controlled))
    axis.invert_yaxis()
    axis.set(title="mean J of each training seed; bar: mean of all", xlabel="J")


def _bounds(result: Comparison, axis: Axes, colours: dict[str, str]) -> None:
    """J of each condition over that of its best constant command, conditions in the order of the latter."""
    bound = result.bounds[OWN].costs[0].mean(axis=1)
    order = np.argsort(bound)
    for name, found in _controlled(result).items():
        ratio = (found.by_condition / bound)[order]
        axis.plot(ratio, ".-", color=colours[name], linewidth=0.8, markersize=4)
    axis.axhline(1.0, color="k", linewidth=0.8)
    axis.set(
        title="J / J of the best constant current",
        xlabel="conditions, from easy to hard",
        ylabel="ratio",
    )


def _controlled(result: Comparison) -> dict[str, Score]:
    """Scores without the passive vehicle's, beside which all others would be one point where it hunts."""
    return {name: found for name, found in result.scores[OWN].items() if name != "passive"}


def _reductions(result: Comparison, axis: Axes, colours: dict[str, str]) -> None:
    """Reduction against the best of the paper's controllers by each way of taking J."""
    chosen = [each.name for each in result.entrants if each.learned] or [
        each.name for each in result.entrants if each.name != "passive"
    ]
    labels = [f"{'on' if v.filter == 'online' else 'off'} line, k_F x {v.factor:g}" for v in result.scores]
    for k, name in enumerate(chosen):
        for i, found in enumerate(result.scores.values()):
            gain = found[name].reduction
            error = [[max(gain.value - gain.low, 0.0)], [max(gain.high - gain.value, 0.0)]]
            place = i + 0.6 * ((k + 0.5) / len(chosen) - 0.5)
            axis.errorbar(100 * gain.value, place, xerr=100 * np.array(error), fmt="o", color=colours[name])
    axis.axvline(0.0, color="k", linewidth=0.8)
    axis.axvline(100 * LEAST_REDUCTION, color="k", linestyle="--", linewidth=0.8)
    axis.set_yticks(range(len(labels)), labels)
    axis.invert_yaxis()
    axis.set(title="mean J below the best of the paper's (%)", xlabel="%")
