"""What searches have in common, and the search of a tuning: gains for which a cost is smallest."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np
import yaml
from scipy.optimize import differential_evolution, minimize, minimize_scalar
from scipy.stats import qmc

from sayd_env.config.palette import BLACK, cycled
from sayd_env.config.tuning import ControllerTuning, Gains
from sayd_env.config.units import Array
from sayd_env.report.figures import label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LAST_RADIUS = 0.01
"""Step at which the local search ends, as a share of half the ranges."""
CostAt = Callable[[str, Array], float]
"""Stage and place in the ranges -> what is to be small."""


class Tried(Protocol):
    """An evaluation of a search."""

    @property
    def stage(self) -> str:
        """What asked for it."""

    @property
    def cost(self) -> float:
        """What is to be small."""


E = TypeVar("E", bound=Tried)


def best_of(evaluations: Iterable[E], *stages: str) -> E:
    """The first evaluation with the lowest cost, among those of some stages or of all."""
    return min((e for e in evaluations if not stages or e.stage in stages), key=lambda e: e.cost)


def draw_costs(axes: Axes, evaluations: Sequence[Tried]) -> None:
    """Draw the costs of a search in its order: points for each stage, and the best of it so far."""
    for number, stage in enumerate(dict.fromkeys(e.stage for e in evaluations)):
        places = [i for i, e in enumerate(evaluations) if e.stage == stage]
        costs = [evaluations[i].cost for i in places]
        style = cycled(number)
        axes.plot(places, costs, style.marker, color=style.colour, markersize=3, label=label(stage))
        step: dict[str, Any] = {"linewidth": 1.0, "drawstyle": "steps-post"}
        best: dict[str, Any] = {} if number else {"label": "best of the stage"}
        axes.plot(places, np.minimum.accumulate(costs), color=BLACK, **step, **best)
    axes.set_xlabel("evaluation")


def provenance_lines(about: Mapping[str, object]) -> list[str]:
    """Where the numbers of a YAML file come from."""
    return ["provenance:", *(f"  {name}: {as_yaml(str(value))}" for name, value in about.items())]


def as_yaml(text: str) -> str:
    """The text, in quotes where YAML would read something else: a command or a path may hold any sign."""
    try:
        found = yaml.safe_load(f"- {text}")[0]
    except yaml.YAMLError:
        found = {}
    other = isinstance(found, dict | list) or (isinstance(found, str) and found != text)
    return json.dumps(text) if other else text


def minimise(tuning: ControllerTuning, own: Gains, cost: CostAt, seed: int) -> None:
    """Search the ranges of some gains for the least cost.

    One gain: evenly spaced points, then Brent's bounded search between the neighbours of the best one, or
    between the ends without such points. Several: differential evolution, whose first points are the gains
    that the controller has, the guesses and a Latin hypercube; then COBYQA, a trust-region method without
    derivatives, from its best point.

    `own` are the gains that the controller has; the seed is that of the global search.
    """
    bounds = [(gain.low, gain.high) for gain in tuning.gains.values()]
    if len(bounds) == 1:
        (low, high), count = bounds[0], tuning.search
        if count:
            places = np.linspace(low, high, count)
            best = int(np.argmin([cost("search", np.array([x])) for x in places]))
            low, high = places[max(best - 1, 0)], places[min(best + 1, count - 1)]
        if tuning.polish:
            minimize_scalar(
                lambda x: cost("polish", np.array([x])),
                bounds=(low, high),
                method="bounded",
                options={"maxiter": tuning.polish, "xatol": 0.0},
            )
        return
    found = differential_evolution(
        lambda x: cost("search", x),
        bounds,
        init=_first_points(tuning, own, seed),
        maxiter=tuning.search // tuning.population - 1,
        tol=0.0,
        polish=False,
        rng=seed,
    )
    if tuning.polish:
        minimize(
            lambda x: cost("polish", x),
            found.x,
            method="COBYQA",
            bounds=bounds,
            options={
                "maxfev": tuning.polish,
                "scale": True,
                "initial_tr_radius": tuning.radius,
                "final_tr_radius": LAST_RADIUS,
            },
        )


def _first_points(tuning: ControllerTuning, own: Gains, seed: int) -> Array:
    known = [tuning.place(own), *([guess[name] for name in tuning.gains] for guess in tuning.guesses)]
    low = [gain.low for gain in tuning.gains.values()]
    high = [gain.high for gain in tuning.gains.values()]
    cube = qmc.LatinHypercube(len(low), rng=seed).random(tuning.population)
    return np.vstack([known, qmc.scale(cube, low, high)])[: tuning.population]
