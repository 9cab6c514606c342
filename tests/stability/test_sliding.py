"""Sliding means against a convolution, and against exact sums over long runs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sayd_env.config.units import Array
from sayd_env.stability.sliding import slide


def slid(values: Array, samples: float) -> Array:
    """Means behind each sample."""
    channels = values.shape[1]
    ring, sums = np.zeros((int(samples) + 1, channels)), np.zeros(channels)
    place, means = np.zeros(1, dtype=np.int64), np.empty_like(values)
    for row, out in zip(values, means, strict=True):
        slide(row, samples, place, ring, sums, out)
    return means


@pytest.mark.parametrize("samples", [1.0, 1.4, 2.0, 7.0, 20.571428571428573, 239.99999999999997, 240.0])
def test_means_are_those_of_a_convolution(samples: float) -> None:
    values = np.random.default_rng(3).normal(size=(3000, 12))
    whole = int(samples)
    weights = np.append(np.ones(whole), samples - whole) / samples
    expected = np.stack([np.convolve(column, weights)[: len(values)] for column in values.T], axis=1)
    np.testing.assert_allclose(slid(values, samples), expected, rtol=0, atol=1e-13)


def test_a_ramp_is_late_by_half_the_window() -> None:
    # The mean delay of the window: ages 0 to 19 in full, age 20 by 0.6.
    samples, n = 20.6, 500
    means = slid(np.arange(n, dtype=np.float64)[:, None], samples)[100:, 0]
    delays = np.arange(100, n) - means
    whole, part = 20, samples - 20
    np.testing.assert_allclose(delays, (whole * (whole - 1) / 2 + part * whole) / samples, rtol=0, atol=1e-11)


def test_long_runs_and_large_values_leave_nothing_behind() -> None:
    values = np.full((300_000, 1), 0.1)
    values[1000] = 1e12  # leaves 1e-4 in a sum that is never taken anew
    means = slid(values, 20.25)
    assert means[-1, 0] == pytest.approx(math.fsum([0.1] * 20 + [0.25 * 0.1]) / 20.25, rel=1e-15)
