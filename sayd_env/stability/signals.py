"""Signal processing of the stability assessment: dominant frequency, band-pass filter, sliding RMS.

All functions take signals of shape (n, channels), sampled uniformly in time. Segments and windows are
measured along the track, so they take the distance of every sample.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import ZoomFFT, butter, get_window, sosfiltfilt

from sayd_env.config import DataError
from sayd_env.config.assessment import AssessmentConfig
from sayd_env.config.units import Array

ROUNDING = 1e-20
"""A spectrum below this share of the mean square is what rounding leaves of a constant signal."""

_LACKING = 1e-5
"""Share of a length that may lack: distances added up from speeds end so much before those of a line."""


def distance_run(speed: float | Array, sample_rate: float, n: int) -> Array:
    """Distance of each sample from the first.

    Parameters
    ----------
    speed : float or array of shape (n,)
        Speed, constant or of each sample (m/s).
    sample_rate : float
        Samples per second (Hz).
    n : int
        Number of samples.

    Returns
    -------
    array of shape (n,)
        Distance (m), starting with 0.
    """
    if np.ndim(speed) == 0:
        return np.arange(n, dtype=np.float64) * (float(speed) / sample_rate)
    distance: Array = cumulative_trapezoid(
        np.asarray(speed, dtype=np.float64), dx=1 / sample_rate, initial=0.0
    )
    return distance


def end_of(distance: Array) -> float:
    """Distance at the end of a signal (m): the last sample stands for its whole interval."""
    return float(distance[-1] + (distance[-1] - distance[-2]))


def dominant_frequency(
    signals: Array,
    sample_rate: float,
    distance: Array,
    settings: AssessmentConfig,
    span: tuple[float, float] | None = None,
) -> Array:
    """Frequency of the strongest harmonic component of each channel.

    The mean-square spectra of Hann-windowed segments of equal distance are averaged (Welch 1967) on a
    frequency grid that does not depend on the speed. The result is the highest peak in the searched range,
    interpolated by a parabola through the logarithms of three neighbours. Without any peak it is the end of
    the range to which the spectrum rises.

    Parameters
    ----------
    signals : array of shape (n, channels)
        Signals, in any unit.
    sample_rate : float
        Samples per second (Hz).
    distance : array of shape (n,)
        Distance of each sample (m), increasing; spans at least one segment.
    settings : AssessmentConfig
        Segments and frequency range.
    span : tuple of float, optional
        Distances between which the signal is used (m); all of it by default.

    Returns
    -------
    array of shape (channels,)
        Dominant frequency f_0 (Hz); NaN for a constant signal, which has none.

    Raises
    ------
    DataError
        Less than one segment; numbers that are not finite.
    """
    _check(signals)
    frequencies, spectra = averaged_spectra(signals, sample_rate, distance, settings, span)
    least = ROUNDING * np.mean(np.square(signals), axis=0)
    return np.array([_highest_peak(frequencies, *each) for each in zip(spectra, least.tolist(), strict=True)])


def averaged_spectra(
    signals: Array,
    sample_rate: float,
    distance: Array,
    settings: AssessmentConfig,
    span: tuple[float, float] | None = None,
) -> tuple[Array, Array]:
    """Mean-square spectra averaged over segments of equal distance.

    Parameters are those of `dominant_frequency`. The grid exceeds the searched range by one step at both
    ends, so that a component exactly at an end still is a peak.

    Returns
    -------
    frequencies : array of shape (m,)
        Frequency grid (Hz).
    spectra : array of shape (channels, m)
        Mean square of a harmonic component at each frequency (unit of the signal squared).

    Raises
    ------
    DataError
        A span shorter than one segment.
    """
    step = settings.frequency_step
    count = round((settings.frequency_max - settings.frequency_min) / step) + 3
    band = (settings.frequency_min - step, settings.frequency_min + (count - 2) * step)
    segments = _segments(distance, span, settings.segment_length, settings.segment_overlap)
    power = np.zeros((signals.shape[1], count))
    for start, stop in segments:
        transform, window = _transform(stop - start, band, count, sample_rate)
        segment = signals[start:stop].T
        # The windowed mean leaks far less of a quasi-static part into the lowest lines than the plain one.
        centred = segment - (segment @ window / window.sum())[:, None]
        power += np.abs(transform(centred * window)) ** 2
    return np.linspace(*band, count), power / len(segments)


def band_pass(signals: Array, sample_rate: float, frequency: Array, settings: AssessmentConfig) -> Array:
    """Filter each channel to f_0 +- 2 Hz, without phase shift.

    Butterworth band-pass run forward and backward, so its gain is the square of the plain filter's. Ends are
    continued by mirror images, which keep the power of the signal (an odd continuation adds a step).

    Parameters
    ----------
    signals : array of shape (n, channels)
        Signals, in any unit.
    sample_rate : float
        Samples per second (Hz).
    frequency : array of shape (channels,)
        Dominant frequency of each channel (Hz); a channel with NaN becomes zero.
    settings : AssessmentConfig
        Width, lower edge, order and padding of the filter.

    Returns
    -------
    array of shape (n, channels)
        Filtered signals.

    Raises
    ------
    DataError
        Not one frequency for each channel; samples too far apart for the band; numbers that are not finite.
    """
    _check(signals)
    if np.shape(frequency) != signals.shape[1:]:
        raise DataError(
            f"frequencies of shape {np.shape(frequency)}; expected {signals.shape[1]}, one for each channel"
        )
    padding = min(round(settings.filter_padding * sample_rate), len(signals) - 1)
    filtered = np.zeros_like(signals, dtype=np.float64)
    for channel, f0 in enumerate(frequency):
        if np.isnan(f0):
            continue
        sections = band_sections(float(f0), settings, sample_rate)
        row = np.ascontiguousarray(signals[:, channel])
        filtered[:, channel] = sosfiltfilt(sections, row, padtype="even", padlen=padding)
    return filtered


def band_sections(f0: float, settings: AssessmentConfig, sample_rate: float) -> Array:
    """Butterworth band-pass around f_0 (Hz): second-order sections, (s, 6), made once and not to be changed.

    Raises
    ------
    DataError
        A sampling rate (Hz) too low for the band.
    """
    edges = (max(f0 - settings.band_half_width, settings.band_min), f0 + settings.band_half_width)
    if not edges[1] < 0.5 * sample_rate:
        raise DataError(
            f"a band of {edges[0]:g} to {edges[1]:g} Hz needs more than {2 * edges[1]:g} samples a second; "
            f"found {sample_rate:g}"
        )
    return _designed(settings.filter_order, edges, sample_rate)


@lru_cache(maxsize=1024)
def _designed(order: int, edges: tuple[float, float], sample_rate: float) -> Array:
    sections: Array = butter(order, edges, "bandpass", fs=sample_rate, output="sos")
    return sections


def sliding_rms(
    signals: Array,
    sample_rate: float,
    distance: Array,
    settings: AssessmentConfig,
    span: tuple[float, float] | None = None,
) -> tuple[Array, Array]:
    """RMS in windows of equal distance.

    The root of the time average while the vehicle passes the window; window edges between two samples are
    interpolated.

    Parameters
    ----------
    signals : array of shape (n, channels)
        Filtered signals.
    sample_rate : float
        Samples per second (Hz).
    distance : array of shape (n,)
        Distance of each sample (m), increasing; spans at least one window.
    settings : AssessmentConfig
        Length and step of the windows.
    span : tuple of float, optional
        Distances between which the signal is used (m); all of it by default.

    Returns
    -------
    position : array of shape (windows,)
        Centre of each window (m).
    rms : array of shape (windows, channels)
        RMS in each window, in the unit of the signals.

    Raises
    ------
    DataError
        Less than one window.
    """
    starts = _starts(
        distance, span, settings.window_length, settings.window_step, "window of the sliding RMS"
    )
    ends = starts + settings.window_length
    time = np.arange(len(distance)) / sample_rate
    duration = np.interp(ends, distance, time) - np.interp(starts, distance, time)
    energy = cumulative_trapezoid(signals**2, dx=1 / sample_rate, axis=0, initial=0.0)
    # One search serves all channels: position of every edge as a fractional sample number.
    edges = np.interp(np.stack([starts, ends]), distance, np.arange(len(distance), dtype=np.float64))
    below = np.minimum(edges.astype(np.int64), len(distance) - 2)
    part = (edges - below)[..., None]
    at_edges = energy[below] * (1 - part) + energy[below + 1] * part
    # Rounding can leave a tiny negative difference where the signal is zero.
    mean_square = np.maximum(at_edges[1] - at_edges[0], 0.0) / duration[:, None]
    return starts + 0.5 * settings.window_length, np.sqrt(mean_square)


def _check(signals: Array) -> None:
    if np.ndim(signals) != 2 or not np.isfinite(signals).all():
        raise DataError(
            f"signals of shape {np.shape(signals)}; expected finite numbers of shape (n, channels)"
        )


def _starts(
    distance: Array, span: tuple[float, float] | None, length: float, step: float, what: str
) -> Array:
    """Starts of all pieces of `length` (m) every `step` (m) that fit into the span."""
    first, last = span or (float(distance[0]), end_of(distance))
    count = int((last - first - length) / step + 1e-6) + 1
    if last - first < length * (1 - _LACKING):
        raise DataError(f"the signal covers {last - first:.0f} m; one {what} needs {length:g} m")
    return np.asarray(first + step * np.arange(count), dtype=np.float64)


def _segments(
    distance: Array, span: tuple[float, float] | None, length: float, overlap: float
) -> list[tuple[int, int]]:
    starts = _starts(distance, span, length, length * (1 - overlap), "segment of the spectrum")
    first = np.searchsorted(distance, starts - 1e-9)
    last = np.searchsorted(distance, starts + length - 1e-9)
    return [(int(a), int(b)) for a, b in zip(first, last, strict=True)]


@lru_cache(maxsize=8)
def _transform(n: int, band: tuple[float, float], count: int, sample_rate: float) -> tuple[ZoomFFT, Array]:
    """Transform of n samples to the frequency grid, and the window that scales a harmonic to its RMS."""
    window = get_window("hann", n)
    return ZoomFFT(n, band, m=count, fs=sample_rate, endpoint=True), window * (np.sqrt(2) / window.sum())


def _highest_peak(frequencies: Array, spectrum: Array, least: float) -> float:
    if spectrum.sum() <= least:
        return float("nan")
    inner = spectrum[1:-1]
    peaks = np.flatnonzero((inner > spectrum[:-2]) & (inner >= spectrum[2:])) + 1
    if len(peaks) == 0:
        return float(frequencies[1] if inner[0] >= inner[-1] else frequencies[-2])
    k = peaks[np.argmax(spectrum[peaks])]
    left, mid, right = np.log(np.maximum(spectrum[k - 1 : k + 2], spectrum[k] * 1e-12))
    offset = 0.5 * (left - right) / (left - 2 * mid + right)
    f0 = frequencies[k] + offset * (frequencies[1] - frequencies[0])
    return float(np.clip(f0, frequencies[1], frequencies[-2]))
