"""A comparison as one page of plots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config.palette import LIMIT, policy_style
from sayd_env.config.units import Array
from sayd_env.report.figures import (
    label,
    legend_below,
    limit_line,
    log_axis,
    name_rows,
    panels,
    reference_line,
)
from sayd_env.studies.comparison.grid import OWN
from sayd_env.studies.comparison.scores import LEAST_REDUCTION, Score
from sayd_env.studies.comparison.statistics import Bootstrap, Estimate, profile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sayd_env.studies.comparison.result import Comparison

THRESHOLDS = np.linspace(0.0, 2.0, 101)


def draw(result: Comparison, figure: Figure) -> None:
    """Draw cost over speed, distribution and mean against MPPT2, training seeds, bound, and the targets."""
    config = result.config
    figure.suptitle(
        f"{len(result.grid.conditions)} conditions x {len(config.seeds)} seeds, J on line"
        + (", --quick: a look, no result" if result.quick else "")
    )
    drawn: list[Callable[[Comparison, Axes], None]] = [_speeds, _profiles, _iqms, _trainings, _bounds]
    if _opponents(result)[1]:
        drawn.append(_reductions)
    axes = panels(figure, len(drawn), 3, (5.0, 4.5))
    for draw_panel, panel in zip(drawn, axes, strict=True):
        draw_panel(result, panel)
    legend_below(figure, axes[0], axes[-1], columns=6)


def _speeds(result: Comparison, axes: Axes) -> None:
    conditions = result.grid.conditions
    # A line has no speed: NaN, which is none of the grid's.
    speeds = np.array([condition.speed_kmh for condition in conditions], dtype=float)
    grid = np.unique(speeds[np.isfinite(speeds)])
    # Means of other tracks or wheels at each speed are no course over speed: points alone show them.
    others = [
        {str(each.as_dict() | {"speed_kmh": None}) for each in conditions if each.speed_kmh == speed}
        for speed in grid
    ]
    unrelated: dict[str, Any] = {} if all(each == others[0] for each in others) else {"linestyle": "none"}

    def plot(costs: Array, name: str, **style: Any) -> None:
        means = [costs[speeds == speed].mean() for speed in grid]
        axes.plot(grid, means, label=name, **style | unrelated)

    for name, found in result.scores[OWN].items():
        plot(found.J_by_condition, label(name), markersize=5, **policy_style(name).drawn)
    bound = result.bounds[OWN].costs[0].mean(axis=1)
    plot(bound, "best constant of each condition", color=LIMIT, linestyle="--", marker="_", markersize=9)
    axes.set(title="mean J over speed", xlabel="speed (km/h)", ylabel="J")
    log_axis(axes)


def _profiles(result: Comparison, axes: Axes) -> None:
    """Share of the scenarios in which J over MPPT2's does not exceed a threshold."""
    settings = result.config
    bootstrap = Bootstrap(len(result.grid.conditions), len(settings.seeds), settings.bootstrap)
    costs = result.costs[OWN]
    for name, table in costs.items():
        if name == "mppt2":
            continue
        style = policy_style(name)
        share, low, high = profile(table / costs["mppt2"], THRESHOLDS, bootstrap)
        axes.plot(THRESHOLDS, share, **style.plain)
        axes.fill_between(THRESHOLDS, low, high, color=style.colour, alpha=0.15, linewidth=0.0)
    reference_line(axes, 1.0, vertical=True)
    axes.set(title="share of the runs with J / J of MPPT2 up to x", xlabel="x", ylabel="share")
    axes.set_ylim(-0.03, 1.03)


def _iqms(result: Comparison, axes: Axes) -> None:
    controlled = _controlled(result)
    for i, (name, found) in enumerate(controlled.items()):
        _draw_estimate(axes, found.relative_to_mppt2, i, name)
    reference_line(axes, 1.0, vertical=True)
    name_rows(axes, controlled)
    axes.set(title="IQM of J / J of MPPT2, 95 % interval", xlabel="ratio")


def _trainings(result: Comparison, axes: Axes) -> None:
    controlled = _controlled(result)
    for i, (name, found) in enumerate(controlled.items()):
        style = policy_style(name)
        places = [i] * len(found.J_by_training_seed)
        axes.plot(found.J_by_training_seed, places, style.marker, color=style.colour, alpha=0.7)
        axes.plot(found.J, i, "|", color=style.colour, markersize=18)
    name_rows(axes, controlled)
    axes.locator_params(axis="x", nbins=5)
    axes.set(title="mean J of each training seed; bar: mean of all", xlabel="J")


def _bounds(result: Comparison, axes: Axes) -> None:
    """J of each condition over that of its best constant command, conditions in the order of the latter."""
    bound = result.bounds[OWN].costs[0].mean(axis=1)
    order = np.argsort(bound)
    for name, found in _controlled(result).items():
        style = policy_style(name)
        ratio = (found.J_by_condition / bound)[order]
        # No lines: neighbours have nothing in common but their place.
        axes.plot(np.arange(len(ratio)), ratio, style.marker, color=style.colour, markersize=4)
    reference_line(axes, 1.0)
    axes.set(
        title="J / J of the best constant command", xlabel="conditions, from easy to hard", ylabel="ratio"
    )
    axes.locator_params(axis="x", integer=True)
    log_axis(axes)


def _controlled(result: Comparison) -> dict[str, Score]:
    """Scores without the passive vehicle's, beside which all others would be one point where it hunts."""
    return {name: found for name, found in result.scores[OWN].items() if name != "passive"}


def _opponents(result: Comparison) -> tuple[str, list[str]]:
    """Whose best controller J is held against, and of whom: learned policies, without any all controllers."""
    learned = [each.name for each in result.entrants if each.learned]
    scores = _ways(result).values()
    chosen = learned or list(_controlled(result))
    tuned = all("tuned" in found[name].best_of for found in scores for name in chosen)
    group = "tuned" if tuned else "paper"
    # The best one is not held against itself.
    return group, [
        name for name in chosen if any(found[name].best_of[group].geometric != name for found in scores)
    ]


def _ways(result: Comparison) -> dict[str, Mapping[str, Score]]:
    """Scores by part and way of taking J."""
    return {
        f"{part}, {_WORDS[variant.filter]}, k_F x {variant.factor:g}": found
        for part, scores in result.parts.items()
        for variant, found in scores.items()
        if variant.factor in result.config.force_weights
    }


def _reductions(result: Comparison, axes: Axes) -> None:
    """How far J lies below the best tuned controller's, or the paper's best, by part and way of taking J."""
    ways, (group, chosen) = _ways(result), _opponents(result)
    words = {"tuned": "best tuned controller's", "paper": "best of the paper's"}[group]
    for k, name in enumerate(chosen):
        for i, found in enumerate(ways.values()):
            place = i + 0.6 * ((k + 0.5) / len(chosen) - 0.5)
            best = found[name].best_of[group].geometric
            if best != name:
                _draw_estimate(axes, found[name].geometric_by_controller[best], place, name, 100.0)
    reference_line(axes, 0.0, vertical=True)
    if any(each.learned for each in result.entrants):
        asked = 100.0 * LEAST_REDUCTION[group]
        limit_line(axes, asked, f"asked of learned policies: {asked:g} % below", vertical=True)
    name_rows(axes, list(ways))
    axes.set(title=f"J below the {words}", xlabel="%, geometric mean")


_WORDS = {"online": "on line", "offline": "off line"}


def _draw_estimate(axes: Axes, found: Estimate, place: float, name: str, scale: float = 1.0) -> None:
    """Draw a policy's number with its interval."""
    style = policy_style(name)
    # A resampled interval need not hold the number itself.
    around = np.maximum([[found.value - found.low], [found.high - found.value]], 0.0)
    shown: dict[str, Any] = {"fmt": style.marker, "color": style.colour, "capsize": 4}
    axes.errorbar(scale * found.value, place, xerr=scale * around, **shown)
