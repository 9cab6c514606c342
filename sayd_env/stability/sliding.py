"""Sliding means along the track while a vehicle runs, compiled: one addition and one subtraction a sample."""

from __future__ import annotations

from sayd_env.config.units import Array, Integers
from sayd_env.physics.kernel import kernel


@kernel(distinct=True, allocates=False)
def slide(values: Array, samples: float, place: Integers, ring: Array, sums: Array, means: Array) -> None:
    """Take one sample of every channel into its mean over the last so many samples.

    The oldest sample counts by its part of the window, so that the window is exactly as long as asked for.
    Before the window is full, zeros stand for what is missing. The sums are added up anew each time the ring
    has gone round, so rounding errors do not grow along a run. Where the window's length changes, `add_up`
    comes first.

    Parameters
    ----------
    values : ndarray, shape (c,)
        The new samples, in any unit.
    samples : float
        Length of the window, 1 or more; not necessarily a whole number.
    place : ndarray, shape (1,)
        Row of the ring that the next sample takes.
    ring : ndarray, shape (floor(samples) + 1 or more, c)
        The last samples.
    sums : ndarray, shape (c,)
        Sums over the whole samples of the window.
    means : ndarray, shape (c,)
        Receives the means.
    """
    rows, whole = ring.shape[0], int(samples)
    part = samples - whole
    newest = place[0]
    oldest = newest - whole if newest >= whole else newest - whole + rows
    for k in range(values.shape[0]):
        ring[newest, k] = values[k]
        sums[k] += values[k] - ring[oldest, k]
    place[0] = newest + 1 if newest + 1 < rows else 0
    if place[0] == 0:
        add_up(samples, place, ring, sums)
    for k in range(values.shape[0]):
        means[k] = (sums[k] + part * ring[oldest, k]) / samples


@kernel(distinct=True, allocates=False)
def add_up(samples: float, place: Integers, ring: Array, sums: Array) -> None:
    """Sums over the whole samples of a window of this length; parameters as for `slide`."""
    rows, whole = ring.shape[0], int(samples)
    for k in range(sums.shape[0]):
        sums[k] = 0.0
    row = place[0] - whole
    row = row if row >= 0 else row + rows
    for _ in range(whole):
        for k in range(sums.shape[0]):
            sums[k] += ring[row, k]
        row = row + 1 if row + 1 < rows else 0
