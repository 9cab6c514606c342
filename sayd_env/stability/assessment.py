"""Assessment of signals at one speed: from raw time histories to the maximum of the sliding RMS."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sayd_env.config import DataError
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.units import Array
from sayd_env.stability.signals import band_pass, distance_run, dominant_frequency, end_of, sliding_rms


@dataclass(frozen=True)
class Assessment:
    """What EN 14363 sees of a set of signals."""

    dominant_frequency: Array
    """f_0 of each channel (Hz), shape (channels,); NaN for a constant signal."""
    position: Array
    """Centre of each window, from the first sample, run-in included (m), shape (windows,)."""
    rms: Array
    """Sliding RMS, in the unit of the signals, shape (windows, channels)."""

    @property
    def maximum(self) -> Array:
        """Maximum of the sliding RMS, shape (channels,)."""
        return np.asarray(self.rms.max(axis=0))


def assess(
    signals: Array, sample_rate: float, speed: float | Array, settings: AssessmentConfig
) -> Assessment:
    """Assess signals by EN 14363, section 3 of Wang et al. (2022).

    The run-in is discarded and `settings.length` metres are assessed. What lies before and behind them is
    used only to start the filter; without it, the filter works on mirror images of the ends, and the
    outermost windows (about half a second) are less exact.

    Parameters
    ----------
    signals : array of shape (n, channels)
        Track shift forces (N) and accelerations (m/s2), or anything else that is to be judged.
    sample_rate : float
        Samples per second (Hz).
    speed : float or array of shape (n,)
        Speed, constant or of each sample (m/s).
    settings : AssessmentConfig
        The procedure.

    Returns
    -------
    Assessment
        Dominant frequencies and sliding RMS.

    Raises
    ------
    DataError
        Signals that are too short, sampled too slowly or not finite, or a speed that is not positive.
    """
    signals = _checked_signals(signals, sample_rate, settings)
    speed = _checked_speed(speed, len(signals))
    distance = distance_run(speed, sample_rate, len(signals))
    span = assessed_span(distance, settings)
    f0 = dominant_frequency(signals, sample_rate, distance, settings, span)
    filtered = band_pass(signals, sample_rate, f0, settings)
    position, rms = sliding_rms(filtered, sample_rate, distance, settings, span)
    return Assessment(f0, position, rms)


def assessed_span(distance: Array, settings: AssessmentConfig) -> tuple[float, float]:
    """Distances between which a signal is assessed.

    Parameters
    ----------
    distance : array of shape (n,)
        Distance of each sample (m), increasing from 0.
    settings : AssessmentConfig
        Run-in and length.

    Returns
    -------
    tuple of float
        First and last assessed distance (m).

    Raises
    ------
    DataError
        The signal is shorter than run-in and length.
    """
    shortest = max(settings.segment_length, settings.window_length)
    length = shortest if settings.length is None else settings.length
    covered = end_of(distance)
    if covered < (settings.run_in + length) * (1 - 1e-9):
        raise DataError(
            f"the signal covers {covered:.0f} m; the assessment needs {settings.run_in + length:.0f} m"
            f" ({settings.run_in:g} m of run-in and {length:g} m to assess)"
        )
    return settings.run_in, covered if settings.length is None else settings.run_in + length


def _checked_signals(signals: Array, sample_rate: float, settings: AssessmentConfig) -> Array:
    signals = np.asarray(signals, dtype=np.float64)
    if signals.ndim != 2 or signals.shape[1] == 0:
        raise DataError(f"signals of shape {signals.shape}; expected (samples, channels)")
    if len(signals) < 2:
        raise DataError(f"{len(signals)} samples; expected at least one segment of the spectrum")
    if not np.isfinite(signals).all():
        row, channel = np.argwhere(~np.isfinite(signals))[0]
        raise DataError(f"channel {channel}, sample {row}: found {signals[row, channel]}; expected numbers")
    if not (math.isfinite(sample_rate) and sample_rate >= settings.minimum_sample_rate * (1 - 1e-9)):
        raise DataError(
            f"sampling rate {sample_rate:g} Hz; expected {settings.minimum_sample_rate:g} Hz or more"
        )
    return signals


def _checked_speed(speed: float | Array, n: int) -> float | Array:
    speed = np.asarray(speed, dtype=np.float64)
    if speed.shape not in ((), (n,)):
        raise DataError(f"speed of shape {speed.shape}; expected one value or one for each of {n} samples")
    wrong = ~(np.isfinite(speed) & (speed > 0))
    if wrong.any():
        sample = int(np.argmax(wrong))
        raise DataError(
            f"speed {speed.flat[sample]:g} m/s at sample {sample}; the assessment needs a moving train"
        )
    return float(speed) if speed.ndim == 0 else speed
