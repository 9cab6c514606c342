"""Ride comfort by EN 12299: frequency weightings and the mean comfort index of a place in the carbody."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from sayd_env.config import DataError, nearest
from sayd_env.config.units import Array, ComplexArray

BLOCK = 5.0
"""Time of one weighted RMS value, s."""
QUANTILE = 0.95
"""Quantile of the RMS values that counts."""
FACTOR = 6.0
"""Of the mean comfort index: it is 6 for a weighted RMS of 1 m/s2."""

LOW, HIGH = 0.4, 100.0
"""Edges of the band limits, Hz: second-order Butterworth filters, both weightings."""


class Weighting(NamedTuple):
    """Shape of a weighting between its band limits."""

    corner: float
    """f_3 = f_4: from acceleration to velocity, Hz."""
    quality: float
    """Q of this transition."""
    gain: float = 1.0
    """K."""
    step: tuple[float, float, float, float] | None = None
    """f_5 (Hz), Q_5, f_6 (Hz), Q_6 of the upward step; None for none."""


WEIGHTINGS = {
    "Wd": Weighting(corner=2.0, quality=0.63),
    "Wb": Weighting(corner=16.0, quality=0.63, gain=0.4, step=(2.5, 0.8, 4.0, 0.8)),
}
"""Horizontal (Wd) and vertical (Wb) vibration of passengers, EN 12299, annex on frequency weighting."""


def weighting(name: str, frequency: npt.ArrayLike) -> ComplexArray:
    """Frequency response of a weighting.

    Parameters
    ----------
    name : str
        ``"Wd"`` for x and y, ``"Wb"`` for z.
    frequency : array_like
        Frequencies (Hz).

    Returns
    -------
    ndarray of complex
        Factor on the acceleration.

    Raises
    ------
    DataError
        An unknown name.

    Notes
    -----
    Band limits, transition from acceleration to velocity and upward step, as ISO 8041 writes them:
    ``H = s^2 / (s^2 + s w_1 / Q_1 + w_1^2) * w_2^2 / (s^2 + s w_2 / Q_1 + w_2^2)
    * (1 + s / w_3) / (1 + s / (Q_4 w_4) + (s / w_4)^2)
    * K (1 + s / (Q_5 w_5) + (s / w_5)^2) / (1 + s / (Q_6 w_6) + (s / w_6)^2)``, with Q_1 = 1 / sqrt 2.
    Wd is that of ISO 2631-1. Wb has the parameters of EN 12299; those of ISO 2631-4 give up to 12 % less
    around 16 Hz and up to 8 % more around 4 Hz.
    """
    if name not in WEIGHTINGS:
        raise DataError(f"unknown weighting '{name}'{nearest(name, WEIGHTINGS)}; expected Wd or Wb")
    shape = WEIGHTINGS[name]
    f = np.asarray(frequency, dtype=np.float64)
    high_pass = -((f / LOW) ** 2) / _second_order(f / LOW, np.sqrt(0.5))
    response = high_pass / _second_order(f / HIGH, np.sqrt(0.5))
    response *= shape.gain * (1.0 + 1j * f / shape.corner) / _second_order(f / shape.corner, shape.quality)
    if shape.step is not None:
        below, q_below, above, q_above = shape.step
        response *= _second_order(f / below, q_below) / _second_order(f / above, q_above)
    return np.asarray(response, dtype=np.complex128)


def _second_order(ratio: Array, quality: float) -> ComplexArray:
    """``1 + s / (Q w_0) + (s / w_0)^2`` at s = i w, from w / w_0."""
    return np.asarray(1.0 - ratio**2 + 1j * ratio / quality)


def weighted(signals: Array, sample_rate: float, name: str) -> Array:
    """Pass signals through a weighting, from rest.

    Parameters
    ----------
    signals : ndarray, shape (t, c)
        Accelerations (m/s2).
    sample_rate : float
        Hz.
    name : str
        See `weighting`.

    Returns
    -------
    ndarray, shape (t, c)
        Weighted accelerations (m/s2). The response is exact at every frequency: it is applied to the
        spectrum of the signal, continued by zeros so that its end does not run into its start.

    Raises
    ------
    DataError
        An unknown weighting.
    """
    n = len(signals)
    length = next_fast_len(2 * n, real=True)
    response = weighting(name, rfftfreq(length, 1.0 / sample_rate))
    result = irfft(rfft(signals, length, axis=0) * response[:, None], length, axis=0)
    return np.asarray(result[:n], dtype=np.float64)


def mean_comfort(acceleration: Array, sample_rate: float, start: int = 0, stop: int | None = None) -> float:
    """Mean comfort index of one place on the floor, EN 12299 (simplified method).

    Parameters
    ----------
    acceleration : ndarray, shape (t, 3)
        Accelerations along x, y and z (m/s2).
    sample_rate : float
        Hz.
    start, stop : int
        Samples between which the ride counts; what lies before starts the filters.

    Returns
    -------
    float
        ``N_MV = 6 sqrt(a_x^2 + a_y^2 + a_z^2)`` with the 95 % quantiles of the RMS of successive 5 s,
        weighted by Wd, Wd and Wb: below 1.5 very comfortable, 1.5 to 2.5 comfortable, 2.5 to 3.5 medium,
        3.5 to 4.5 uncomfortable, from 4.5 on very uncomfortable. The standard takes 60 such values.

    Raises
    ------
    DataError
        Another shape, less than 5 s, or a value that is not a number.
    """
    signals = np.asarray(acceleration, dtype=np.float64)
    if signals.ndim != 2 or signals.shape[1] != 3:
        raise DataError(f"acceleration of shape {signals.shape}; expected (samples, 3): x, y and z")
    if not np.isfinite(signals).all():
        raise DataError("the acceleration holds a value that is not a number")
    block = round(BLOCK * sample_rate)
    count = (len(signals[start:stop])) // block
    if count == 0:
        raise DataError(f"{len(signals[start:stop]) / sample_rate:.1f} s; the comfort index needs 5 s")
    horizontal = weighted(signals[:, :2], sample_rate, "Wd")
    vertical = weighted(signals[:, 2:], sample_rate, "Wb")
    blocks = np.hstack([horizontal, vertical])[start:][: count * block].reshape(count, block, 3)
    rms = np.sqrt(np.mean(blocks**2, axis=1))
    return float(FACTOR * np.sqrt(np.sum(np.quantile(rms, QUANTILE, axis=0) ** 2)))
