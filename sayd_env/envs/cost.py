"""J of an episode, eq. (27), with the charge for an early end: minus its mean reward per second."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sayd_env.config.environment import EnvironmentConfig, charge_a_second
from sayd_env.config.reward import MeanName
from sayd_env.config.scenario import CostConfig
from sayd_env.config.units import Array
from sayd_env.envs.loop import BOGIES, COST_ACCELERATION, COST_FORCE


@dataclass(frozen=True)
class EpisodeCost:
    """Cost of one episode per second."""

    acceleration: float
    """Mean of (psi_y / y_lim)^2, unweighted."""
    force: float
    """Mean of (psi_F / F_max)^2, unweighted."""
    total: float
    """J: both parts, weighted, and the charge for an early end."""


def squares(terms: Array) -> tuple[Array, Array]:
    """(psi_y / y_lim)^2 and (psi_F / F_max)^2, unweighted means of the bogies.

    Parameters
    ----------
    terms : ndarray, shape (..., TERMS)
        Of control periods, by the places of `sayd_env.envs.loop`; those of a second add up to its mean.

    Returns
    -------
    tuple of ndarray, each of shape (...)
    """
    acceleration = (terms[..., COST_ACCELERATION] + terms[..., COST_ACCELERATION + 1]) / BOGIES
    force = (terms[..., COST_FORCE] + terms[..., COST_FORCE + 1]) / BOGIES
    return acceleration, force


def mean_squares(terms: Array, period: float, seconds: float | None = None) -> tuple[float, float]:
    """Means of both squares over the first seconds of a run, by the on-line filter.

    Parameters
    ----------
    terms : ndarray, shape (n, TERMS)
    period : float
        Control period, s.
    seconds : float, optional
        How much of the run; by default its whole seconds.
    """
    seconds = math.floor(len(terms) * period + 1e-9) if seconds is None else seconds
    acceleration, force = squares(terms[: round(seconds / period)].sum(axis=0) / seconds)
    return float(acceleration), float(force)


def weighted(cost: CostConfig, acceleration: float, force: float) -> float:
    """J of eq. (27)."""
    return float(np.dot((cost.acceleration_weight, cost.force_weight), (acceleration, force)))


def mean_cost(costs: Array | Sequence[float], kind: MeanName) -> float:
    """Mean of J, or of ratios of J, over conditions; for the geometric one they are positive."""
    return float(np.exp(np.mean(np.log(costs))) if kind == "geometric" else np.mean(costs))


def charged(
    config: EnvironmentConfig,
    cost: CostConfig,
    acceleration: Array | float,
    force: Array | float,
    lost: Array | float,
) -> Array:
    """J of episodes, or of parts of them, with the charge for what early ends have cut off.

    Eq. (27) of Wang et al. (2022), and J_term, at the cost's weights, for the share l that is lost:

        J = k_y (psi_y / y_lim)^2 + k_F (psi_F / F_max)^2 + J_term l.

    Parameters
    ----------
    config : EnvironmentConfig
        Its J_term.
    cost : CostConfig
        k_y and k_F (-).
    acceleration, force : ndarray, shape (...), or float
        Both squares (-), unweighted means over the whole time, in which what is lost counts as 0.
    lost : ndarray, shape (...), or float
        Share of the whole time that an early end has cut off, 0 to 1.

    Returns
    -------
    ndarray, shape (...)
        J (-).
    """
    parts = cost.acceleration_weight * acceleration + cost.force_weight * force
    return np.asarray(parts + charge_a_second(config, cost) * lost)


def termination_charge(config: EnvironmentConfig, cost: CostConfig, elapsed: float) -> float:
    """Charge for the rest of an episode that ended early after `elapsed` seconds: J_term for each second."""
    return charge_a_second(config, cost) * max(config.episode_s - elapsed, 0.0)


def episode_cost(
    terms: Array, period: float, config: EnvironmentConfig, cost: CostConfig, *, terminated: bool
) -> EpisodeCost:
    """Cost of an episode.

    Parameters
    ----------
    terms : ndarray, shape (n, TERMS)
        Of the control periods that were run; those beyond the end of the episode do not count.
    period : float
        Control period, s.
    config : EnvironmentConfig
    cost : CostConfig
    terminated : bool
        Whether the run ended early: then the rest is charged. A run that is only shorter than the episode
        counts with its whole seconds.
    """
    elapsed = len(terms) * period
    whole = terminated or elapsed >= config.episode_s - 1e-9
    seconds = config.episode_s if whole else math.floor(elapsed + 1e-9)
    parts = mean_squares(terms, period, seconds)
    charge = termination_charge(config, cost, elapsed) / config.episode_s if terminated else 0.0
    return EpisodeCost(*parts, weighted(cost, *parts) + charge)
