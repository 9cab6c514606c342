"""Sliding means along the track while a vehicle runs, compiled: one addition and one subtraction a sample."""

from __future__ import annotations

from sayd_env.config.units import Array
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import Index


@kernel(distinct=True, allocates=False)
def slide(values: Array, samples: float, place: Index, ring: Array, sums: Array, means: Array) -> None:
    """Take one sample of every channel into its mean over the last so many samples.

    The oldest sample counts by its part of the window, so that the window is exactly as long as asked for.
    Before the window is full, zeros stand for what is missing. The sums are added up anew each time the ring
    has gone round, so rounding errors do not grow along a run.

    Parameters
    ----------
    values : ndarray, shape (c,)
        The new samples, in any unit.
    samples : float
        Length of the window, 1 or more; not necessarily a whole number.
    place : ndarray, shape (1,)
        Row of the oldest sample in the ring.
    ring : ndarray, shape (floor(samples) + 1, c)
        The last samples.
    sums : ndarray, shape (c,)
        Sums over the whole samples of the window.
    means : ndarray, shape (c,)
        Receives the means.
    """
    rows = ring.shape[0]
    part = samples - (rows - 1)
    newest = place[0]
    oldest = newest + 1 if newest + 1 < rows else 0
    for k in range(values.shape[0]):
        ring[newest, k] = values[k]
        sums[k] += values[k] - ring[oldest, k]
    if oldest == 0:
        for k in range(values.shape[0]):
            sums[k] = 0.0
        for row in range(1, rows):
            for k in range(values.shape[0]):
                sums[k] += ring[row, k]
    for k in range(values.shape[0]):
        means[k] = (sums[k] + part * ring[oldest, k]) / samples
    place[0] = oldest
