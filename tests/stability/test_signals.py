"""Signal processing against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.config import DataError
from sayd_env.config.assessment import load_assessment
from sayd_env.stability import (
    assess,
    averaged_spectra,
    band_pass,
    distance_run,
    dominant_frequency,
    sliding_rms,
)

SETTINGS = load_assessment()
WHOLE = SETTINGS.model_copy(update={"run_in": 0.0, "length": None})
RATE = 1000.0


def time_of(distance: float, speed: float, rate: float = RATE) -> np.ndarray:
    return np.arange(int(np.ceil(distance / speed * rate)) + 1) / rate


def mean_square_of_sine(amplitude: float, f: float, phase: float, start: np.ndarray, end: np.ndarray):
    """Average of A^2 sin^2(2 pi f t + phase) from start to end."""

    def swing(t: np.ndarray) -> np.ndarray:
        return np.sin(4 * np.pi * f * t + 2 * phase)

    return amplitude**2 * (0.5 - (swing(end) - swing(start)) / (8 * np.pi * f * (end - start)))


def butterworth_gain(f: float, low: float, high: float, order: int, rate: float) -> float:
    """Magnitude of a digital Butterworth band-pass: analogue prototype with pre-warped frequencies."""
    w, a, b = (np.tan(np.pi * x / rate) for x in (f, low, high))
    return float(1 / np.sqrt(1 + ((w * w - a * b) / (w * (b - a))) ** (2 * order)))


@pytest.mark.parametrize("speed_kmh", [120, 200, 280, 370, 400, 445])
@pytest.mark.parametrize("f0", [2.0, 4.3, 9.7])
def test_sine_has_rms_of_amplitude_over_root_two_at_any_speed(speed_kmh: float, f0: float) -> None:
    speed, amplitude, phase = speed_kmh / 3.6, 3.0, 0.7
    t = time_of(5900, speed)  # 400 m more than assessed: the filter sees no end
    signal = amplitude * np.sin(2 * np.pi * f0 * t + phase)
    result = assess(signal[:, None], RATE, speed, SETTINGS)
    assert result.dominant_frequency[0] == pytest.approx(f0, abs=2e-3)
    # 100 m hold no whole number of periods: each window has its own exact value around A / sqrt(2).
    start = (result.position - 50) / speed
    exact = np.sqrt(mean_square_of_sine(amplitude, f0, phase, start, start + 100 / speed))
    gain = butterworth_gain(f0, max(f0 - 2, 0.5), f0 + 2, 4, RATE) ** 2
    np.testing.assert_allclose(result.rms[:, 0], gain * exact, rtol=1e-3)
    assert result.rms[:, 0].mean() == pytest.approx(gain * amplitude / np.sqrt(2), rel=2e-3)
    assert gain == pytest.approx(1, abs=5e-3)


def test_whole_periods_give_amplitude_over_root_two_in_every_window() -> None:
    speed = 400 / 3.6  # 0.9 s per window
    f0 = 4 / 0.9
    t = time_of(5900, speed)
    result = assess(2.0 * np.sin(2 * np.pi * f0 * t)[:, None], RATE, speed, SETTINGS)
    np.testing.assert_allclose(result.rms[:, 0], np.sqrt(2), rtol=5e-4)


@pytest.mark.parametrize("f0", [3.0, 5.0])
def test_second_tone_is_damped_by_the_square_of_the_butterworth_gain(f0: float) -> None:
    t = np.arange(40_000) / RATE
    second = np.sin(2 * np.pi * (f0 + 5) * t)
    filtered = band_pass(second[:, None], RATE, np.array([f0]), SETTINGS)[:, 0]
    middle = slice(10_000, 30_000)  # whole periods of all tones here
    gain = np.sqrt(2 * np.mean(filtered[middle] ** 2))
    assert gain == pytest.approx(butterworth_gain(f0 + 5, f0 - 2, f0 + 2, 4, RATE) ** 2, rel=1e-3)
    # Both tones at once: the filter follows the stronger one, the weaker one adds its damped power.
    both = 2 * np.sin(2 * np.pi * f0 * t) + second
    result = assess(both[:, None], RATE, 100.0, WHOLE.model_copy(update={"window_length": 2000.0}))
    assert result.dominant_frequency[0] == pytest.approx(f0, abs=2e-3)
    own = butterworth_gain(f0, f0 - 2, f0 + 2, 4, RATE) ** 2
    expected = np.sqrt(0.5 * ((2 * own) ** 2 + gain**2))
    assert result.rms[50:-50, 0] == pytest.approx(expected, rel=1e-3)


def test_forward_and_backward_filter_has_no_phase_shift() -> None:
    t = np.arange(20_000) / RATE
    signal = np.sin(2 * np.pi * 4 * t)
    filtered = band_pass(signal[:, None], RATE, np.array([4.0]), SETTINGS)[:, 0]
    np.testing.assert_allclose(filtered[5000:15_000], signal[5000:15_000], atol=1e-3)


@pytest.mark.parametrize("f0", [1.5, 1.63, 4.0, 4.024, 7.77, 12.0])
def test_dominant_frequency_of_a_tone_does_not_depend_on_speed(f0: float) -> None:
    found = []
    for speed_kmh in (80, 160, 280, 320, 350, 400, 445):
        speed = speed_kmh / 3.6
        t = time_of(5000, speed)
        signal = np.sin(2 * np.pi * f0 * t)[:, None]
        found.append(dominant_frequency(signal, RATE, distance_run(speed, RATE, len(t)), SETTINGS)[0])
    assert np.array(found) == pytest.approx(f0, abs=2e-3)


def test_dominant_frequency_of_a_chirp_is_that_of_its_strongest_segment() -> None:
    speed = 100.0
    t = time_of(5000, speed)
    rate_of_change = 0.04  # Hz/s: 4 to 6 Hz
    strongest = 22.5  # s: middle of the segment from 2000 to 2500 m
    amplitude = 0.2 + np.exp(-(((t - strongest) / 2.5) ** 2))
    signal = amplitude * np.sin(2 * np.pi * (4 * t + 0.5 * rate_of_change * t**2))
    f0 = dominant_frequency(signal[:, None], RATE, distance_run(speed, RATE, len(t)), SETTINGS)[0]
    assert f0 == pytest.approx(4 + rate_of_change * strongest, abs=0.02)


def test_a_strong_component_outside_the_range_does_not_hide_the_peak_inside() -> None:
    speed = 100.0
    t = time_of(5000, speed)
    signal = 5 * np.sin(2 * np.pi * 0.8 * t) + np.sin(2 * np.pi * 4 * t) + 20
    f0 = dominant_frequency(signal[:, None], RATE, distance_run(speed, RATE, len(t)), SETTINGS)[0]
    assert f0 == pytest.approx(4, abs=0.01)


def test_spectrum_shows_the_mean_square_of_a_tone() -> None:
    t = time_of(5000, 100.0)
    signal = 3 * np.sin(2 * np.pi * 5 * t)[:, None]
    frequencies, spectra = averaged_spectra(signal, RATE, distance_run(100.0, RATE, len(t)), SETTINGS)
    assert spectra[0].max() == pytest.approx(4.5, rel=1e-3)
    assert frequencies[spectra[0].argmax()] == pytest.approx(5)
    assert np.diff(frequencies) == pytest.approx(SETTINGS.frequency_step)


def noise(n: int, channels: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, channels))


def test_scaling_and_order_of_channels() -> None:
    speed = 350 / 3.6
    signals = noise(len(time_of(5500, speed)), 3)
    result = assess(signals, RATE, speed, SETTINGS)
    scaled = assess(-7.5 * signals[:, ::-1], RATE, speed, SETTINGS)
    np.testing.assert_allclose(scaled.rms, 7.5 * result.rms[:, ::-1], rtol=1e-9)
    np.testing.assert_allclose(scaled.dominant_frequency, result.dominant_frequency[::-1], rtol=1e-9)


def test_constant_offset_does_not_matter() -> None:
    speed = 350 / 3.6
    signals = noise(len(time_of(5500, speed)), 2)
    result, shifted = (assess(signals + offset, RATE, speed, SETTINGS) for offset in (0.0, 50.0))
    np.testing.assert_allclose(shifted.dominant_frequency, result.dominant_frequency, atol=1e-6)
    np.testing.assert_allclose(shifted.rms, result.rms, rtol=1e-6)


@pytest.mark.parametrize("rate", [200.0, 256.0, 512.0, 2000.0])
def test_sampling_rate_does_not_matter(rate: float) -> None:
    speed = 350 / 3.6

    def signal(t: np.ndarray) -> np.ndarray:
        slow = 1 + 0.3 * np.sin(2 * np.pi * 0.1 * t)
        return (slow * np.sin(2 * np.pi * 4.1 * t) + 0.3 * np.sin(2 * np.pi * 6.3 * t + 1))[:, None]

    reference = assess(signal(time_of(5900, speed)), RATE, speed, SETTINGS)
    other = assess(signal(time_of(5900, speed, rate)), rate, speed, SETTINGS)
    assert other.dominant_frequency == pytest.approx(reference.dominant_frequency, abs=2e-3)
    # The bilinear transform moves the edge at 6.1 Hz by 0.3 % at 200 Hz, and with it the tone beside it.
    np.testing.assert_allclose(other.rms, reference.rms, rtol=2e-3)


def test_windows_and_positions_of_a_standard_run() -> None:
    speed = 400 / 3.6
    result = assess(noise(len(time_of(5500, speed)), 8), RATE, speed, SETTINGS)
    assert result.rms.shape == (491, 8)  # (5000 - 100) / 10 + 1
    assert result.position[0] == pytest.approx(550)
    assert np.diff(result.position) == pytest.approx(10)
    assert result.maximum == pytest.approx(result.rms.max(axis=0))


def test_one_sample_interval_may_be_missing_at_the_end_but_no_more() -> None:
    speed = 100.0
    signals = noise(55_000, 1)  # spans 5499.9 m
    assert assess(signals, RATE, speed, SETTINGS).rms.shape == (491, 1)
    with pytest.raises(DataError, match=r"covers 5\d+ m; the assessment needs 5500 m"):
        assess(signals[:-20], RATE, speed, SETTINGS)


def test_run_in_is_not_assessed() -> None:
    speed = 100.0
    t = time_of(5900, speed)
    signal = np.sin(2 * np.pi * 4 * t)
    loud = np.where(t < 3.0, 50 * np.sin(2 * np.pi * 7 * t), signal)
    quiet, disturbed = (assess(s[:, None], RATE, speed, SETTINGS) for s in (signal, loud))
    assert disturbed.dominant_frequency == pytest.approx(quiet.dominant_frequency)
    # What the filter still remembers of the run-in, 2 s before the first window, is below 1 %.
    assert disturbed.maximum == pytest.approx(quiet.maximum, rel=0.01)


def test_varying_speed_moves_the_windows_with_the_distance() -> None:
    t = np.arange(60_000) / RATE
    speed = 80.0 + 20.0 * t / t[-1]
    distance = distance_run(speed, RATE, len(t))
    assert distance[-1] == pytest.approx(90 * t[-1], rel=1e-9)
    loud = np.where((distance >= 2000) & (distance < 2100), 3.0, 1.0)
    position, rms = sliding_rms(loud[:, None], RATE, distance, SETTINGS)
    assert position[rms[:, 0].argmax()] == pytest.approx(2050)
    assert rms.max() == pytest.approx(3, rel=1e-3)
    half = np.sqrt((9 + 1) / 2)
    assert rms[np.abs(position - 2000).argmin(), 0] == pytest.approx(half, rel=2e-3)


@pytest.mark.parametrize("value", [1.0, 3.0, 9.81, -1234.567])
def test_constant_channel_has_no_frequency_and_no_rms(value: float) -> None:
    """What rounding leaves when its mean is taken away is no harmonic."""
    result = assess(np.full((60_000, 1), value), RATE, 100.0, SETTINGS)
    assert np.isnan(result.dominant_frequency[0])
    assert result.maximum[0] == pytest.approx(0, abs=1e-9)
    zero = assess(np.zeros((60_000, 1)), RATE, 100.0, SETTINGS)
    assert np.isnan(zero.dominant_frequency[0])
    assert zero.maximum[0] == 0


@pytest.mark.parametrize(
    ("signals", "rate", "speed", "message"),
    [
        (np.zeros(100), 1000.0, 50.0, "shape"),
        (np.zeros((100, 0)), 1000.0, 50.0, "shape"),
        (np.zeros((1, 2)), 1000.0, 50.0, "1 samples"),
        (np.full((100, 1), np.nan), 1000.0, 50.0, "channel 0, sample 0: found nan"),
        (np.zeros((100, 1)), 150.0, 50.0, "150 Hz; expected 200 Hz or more"),
        (np.zeros((100, 1)), float("nan"), 50.0, "sampling rate nan"),
        (np.zeros((100, 1)), 1000.0, 0.0, "speed 0 m/s at sample 0"),
        (np.zeros((100, 1)), 1000.0, np.ones(99), "speed of shape"),
        (np.zeros((100, 1)), 1000.0, 50.0, "covers 5 m; the assessment needs 5500 m"),
    ],
)
def test_unusable_signals(signals: np.ndarray, rate: float, speed: float, message: str) -> None:
    with pytest.raises(DataError, match=message):
        assess(signals, rate, speed, SETTINGS)


def test_single_steps_refuse_what_they_cannot_use() -> None:
    signals, distance = np.random.default_rng(0).normal(size=(60_000, 2)), distance_run(100.0, RATE, 60_000)
    with pytest.raises(DataError, match="expected 2, one for each channel"):
        band_pass(signals, RATE, np.array([5.0]), SETTINGS)
    with pytest.raises(DataError, match="a band of 3 to 7 Hz needs more than 14 samples a second; found 12"):
        band_pass(signals, 12.0, np.array([5.0, 5.0]), SETTINGS)
    signals[7, 1] = np.nan
    for function in (dominant_frequency, band_pass):
        with pytest.raises(DataError, match="expected finite numbers"):
            function(signals, RATE, distance, SETTINGS)


def test_too_short_for_a_segment_or_a_window() -> None:
    distance = distance_run(50.0, RATE, 100)
    with pytest.raises(DataError, match="segment of the spectrum needs 500 m"):
        dominant_frequency(np.ones((100, 1)), RATE, distance, SETTINGS)
    with pytest.raises(DataError, match="window of the sliding RMS needs 100 m"):
        sliding_rms(np.ones((100, 1)), RATE, distance, SETTINGS)
