"""The search of a tuning: gains within their ranges for which a cost is smallest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import differential_evolution, minimize, minimize_scalar
from scipy.stats import qmc

from sayd_env.config.tuning import ControllerTuning, Gains
from sayd_env.config.units import Array

LAST_RADIUS = 0.01
"""Step at which the local search ends, as a share of half the ranges."""
CostAt = Callable[[str, Array], float]
"""Stage and place in the ranges -> what is to be small."""


def minimise(tuning: ControllerTuning, own: Gains, cost: CostAt, seed: int) -> None:
    """Search the ranges of some gains for the least cost.

    One gain: Brent's bounded search. Several: differential evolution, whose first points are the gains that
    the controller has, the guesses and a Latin hypercube; then COBYQA, a trust-region method without
    derivatives, from its best point.

    Parameters
    ----------
    tuning : ControllerTuning
        Ranges and budget.
    own : mapping
        The gains that the controller has.
    cost : callable
        Cost at a place.
    seed : int
        Of the global search.
    """
    bounds = [(gain.low, gain.high) for gain in tuning.gains.values()]
    if len(bounds) == 1:
        minimize_scalar(
            lambda x: cost("polish", np.array([x])),
            bounds=bounds[0],
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
                "final_tr_radius": min(LAST_RADIUS, tuning.radius),
            },
        )


def _first_points(tuning: ControllerTuning, own: Gains, seed: int) -> Array:
    known = [tuning.place(own), *([guess[name] for name in tuning.gains] for guess in tuning.guesses)]
    low = [gain.low for gain in tuning.gains.values()]
    high = [gain.high for gain in tuning.gains.values()]
    cube = qmc.LatinHypercube(len(low), rng=seed).random(tuning.population)
    return np.vstack([known, qmc.scale(cube, low, high)])[: tuning.population]
