"""Statistics of a comparison: interquartile means, intervals, probabilities of improvement, paired gains.

Values of a policy are arrays of shape (R, C, S): R training seeds, C conditions, S scenarios of each (one for
each seed of the tracks). A policy that was not trained has R = 1. All policies met the same scenarios.

Intervals are percentile bootstraps. Two kinds of resampling answer two questions:

stratified
    How well are these conditions known? Each resample has every condition, as every task in Agarwal et al.,
    "Deep Reinforcement Learning at the Edge of the Statistical Precipice" (2021), but other runs of it.
    Training seeds are drawn once for all conditions, because one training ran in all of them; to draw them
    anew in each condition would average out what a lucky training gains everywhere. So are the seeds of the
    scenarios: one seed is one vehicle, one set of sensors and one realisation of the track in all conditions.
paired
    What would other conditions say? Conditions, seeds of the scenarios and training seeds are drawn, each by
    itself and whole (Owen, "The pigeonhole bootstrap", 2007), the first two the same for both policies. What
    they do to both policies cancels out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import trim_mean

from sayd_env.config.comparison import BootstrapConfig
from sayd_env.config.units import Array, Integers
from sayd_env.envs.cost import mean_cost

Draws = Integers
LEVEL = 0.95
"""Level of the intervals."""
SMALLEST = 1e-300
"""Of which there is a logarithm."""
CHUNK = 4_000_000
"""Values that are resampled at once."""


@dataclass(frozen=True)
class Estimate:
    """A number and its interval."""

    value: float
    low: float
    high: float
    name: str = "value"
    """Key of the number in the result."""

    def as_dict(self) -> dict[str, Any]:
        """Keys of an estimate in the result."""
        return {self.name: self.value, "ci95": [self.low, self.high]}


def interquartile_mean(values: Array, axis: int | None = None) -> Array:
    """Mean of the middle half of the values."""
    return np.asarray(trim_mean(values, 0.25, axis=axis))


def improvements(values: Array, reference: Array) -> Array:
    """Whether each value is below the reference's in the same scenario: 1, or 0; one half for a tie.

    Their mean is the probability of improvement: the Mann-Whitney statistic of each scenario, as a share of
    the pairs, averaged over the scenarios. The reference has the shape (1, C, S).
    """
    return 0.5 * (1.0 + np.sign(reference - values))


class _Resampled(NamedTuple):
    """A policy's values and what resampling makes of them."""

    values: Array
    """Kept, so that no other array takes its place in memory."""
    means: Array
    """(B,)."""
    logarithms: Array
    """(B,) means over the conditions of the logarithm of the means of each."""


class Bootstrap:
    """B resamples of C conditions and S scenarios of each, the same for all policies."""

    def __init__(self, conditions: int, scenarios: int, settings: BootstrapConfig) -> None:
        self.samples, self.seed = settings.samples, settings.seed
        self._seeds = self._random(0).integers(0, scenarios, (self.samples, scenarios))
        drawn = self._random(1).integers(0, conditions, (self.samples, conditions))
        self._seed_shares = _shares(self._seeds, scenarios)
        self._condition_shares = _shares(drawn, conditions)
        self._trainings = lru_cache(self._drawn_trainings)
        self._kept: dict[int, _Resampled] = {}

    def stratified(self, values: Array, statistic: Callable[[Array, int], Array]) -> Array:
        """A statistic, of an array along an axis, of each resample of values (R, C, S): shape (B,)."""
        trainings = self._trainings(len(values))
        places = np.arange(values.shape[1])[None, None, :, None]
        step = max(CHUNK // values.size, 1)
        parts = [
            statistic(
                values[
                    trainings[start : start + step, :, None, None],
                    places,
                    self._seeds[start : start + step, None, None],
                ].reshape(-1, values.size),
                1,
            )
            for start in range(0, self.samples, step)
        ]
        return np.concatenate(parts)

    def means(self, values: Array) -> Array:
        """Stratified means of K quantities at once: (B, K) from values of shape (R, C, S, K)."""
        shares = self._training_shares(len(values)), self._seed_shares
        return np.asarray(np.einsum("br,bs,rsk->bk", *shares, values.mean(axis=1), optimize=True))

    def paired(self, values: Array, reference: Array) -> tuple[Array, Array]:
        """Means of a policy and of a reference over the same resampled scenarios, each of shape (B,)."""
        return self._resampled(values).means, self._resampled(reference).means

    def paired_logarithms(self, values: Array, reference: Array) -> Array:
        """Means over resampled conditions of the logarithm of a ratio of means, shape (B,).

        Of each condition first the means over the resampled seeds and trainings are taken, of a policy and of
        a reference, then the logarithm of their ratio.
        """
        return np.asarray(self._resampled(values).logarithms - self._resampled(reference).logarithms)

    def _resampled(self, values: Array) -> _Resampled:
        """Means of an array, computed once; it must not be changed afterwards."""
        if id(values) not in self._kept:
            shares = self._training_shares(len(values)), self._seed_shares
            by_condition = np.einsum("br,bs,rcs->bc", *shares, values, optimize=True)
            means, logarithms = (
                (self._condition_shares * each).sum(axis=1)
                for each in (by_condition, np.log(np.maximum(by_condition, SMALLEST)))
            )
            self._kept[id(values)] = _Resampled(values, means, logarithms)
        return self._kept[id(values)]

    def _training_shares(self, count: int) -> Array:
        return _shares(self._trainings(count), count)

    def _drawn_trainings(self, count: int) -> Draws:
        return self._random(2).integers(0, count, (self.samples, count))

    def _random(self, stream: int) -> np.random.Generator:
        return np.random.default_rng([self.seed, stream])


def estimate(value: float, resampled: Array, name: str = "value") -> Estimate:
    """A number with the interval that its resamples span."""
    low, high = _ends(resampled)
    return Estimate(float(value), float(low), float(high), name)


def iqm(values: Array, bootstrap: Bootstrap) -> Estimate:
    """Interquartile mean over training seeds and scenarios, stratified; values of shape (R, C, S)."""
    resampled = bootstrap.stratified(values, interquartile_mean)
    return estimate(float(interquartile_mean(values)), resampled, "iqm")


def improvement(values: Array, reference: Array, bootstrap: Bootstrap) -> Estimate:
    """Probability that a run is below the reference's in the same scenario, stratified: `improvements`."""
    better = improvements(values, reference)
    return estimate(better.mean(), bootstrap.means(better[..., None])[:, 0], "probability")


def reduction(values: Array, reference: Array, bootstrap: Bootstrap) -> Estimate:
    """How far the mean lies below the reference's, as a share of that, paired."""
    mine, theirs = bootstrap.paired(values, reference)
    return estimate(1.0 - values.mean() / reference.mean(), 1.0 - mine / theirs, "share")


def geometric_mean(values: Array, reference: Array) -> float:
    """Geometric mean over conditions of a policy's mean in each over the reference's."""
    return mean_cost(values.mean(axis=(0, 2)) / reference.mean(axis=(0, 2)), "geometric")


def geometric_ratio(values: Array, reference: Array, bootstrap: Bootstrap) -> Estimate:
    """Geometric mean over conditions of the ratio of means, paired."""
    resampled = np.exp(bootstrap.paired_logarithms(values, reference))
    return estimate(geometric_mean(values, reference), resampled, "ratio")


def geometric_reduction(values: Array, reference: Array, bootstrap: Bootstrap) -> Estimate:
    """How far the geometric mean of the ratios lies below 1, as a share, paired."""
    found = geometric_ratio(values, reference, bootstrap)
    return Estimate(1.0 - found.value, 1.0 - found.high, 1.0 - found.low, "share")


def difference(values: Array, reference: Array, bootstrap: Bootstrap) -> Estimate:
    """Mean J minus the reference's, paired."""
    mine, theirs = bootstrap.paired(values, reference)
    return estimate(values.mean() - reference.mean(), mine - theirs, "J")


def profile(values: Array, thresholds: Array, bootstrap: Bootstrap) -> tuple[Array, Array, Array]:
    """Share of the runs that do not exceed each of K thresholds, and both ends of its stratified interval."""
    below = (values[..., None] <= thresholds).astype(np.float64)
    low, high = _ends(bootstrap.means(below))
    return below.mean(axis=(0, 1, 2)), low, high


def _ends(resampled: Array) -> Array:
    """Both ends of the interval, along the first axis."""
    return np.asarray(np.quantile(resampled, (0.5 - LEVEL / 2, 0.5 + LEVEL / 2), axis=0))


def _shares(draws: Draws, count: int) -> Array:
    """How often each of `count` places was drawn, along the last axis, as a share of the draws."""
    counts = np.stack([(draws == place).sum(axis=-1) for place in range(count)], axis=-1)
    return counts.astype(np.float64) / count
