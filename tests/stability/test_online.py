"""The on-line filter against SciPy and closed forms."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from sayd_env.config import ConfigError
from sayd_env.config.assessment import load_assessment
from sayd_env.config.control import load_online
from sayd_env.stability.online import (
    Band,
    BandState,
    band,
    band_state,
    follow_speed,
    push,
    restart,
    retune,
    retune_group,
)

ASSESSMENT = load_assessment()
ONLINE = load_online()
RATE = 1000.0
SPEED = 100.0  # m/s: 500 m take 5 s


@pytest.fixture(scope="module")
def constants() -> Band:
    return band(ONLINE, ASSESSMENT, RATE)


def run(constants: Band, state: BandState, signals: np.ndarray, rate: float = RATE):
    """Filtered signals, and f_0 of each group in each second, tuned at whole seconds."""
    filtered, chosen = np.empty_like(signals), []
    for i, sample in enumerate(signals):
        if i % int(rate) == 0:
            retune(constants, state)
            chosen.append(constants.frequency[state.choice])
        push(constants, state, sample, filtered[i])
    return filtered, np.array(chosen)


def f0_by_matrix(signals: np.ndarray, rate: float) -> float:
    """Highest peak of the summed spectra of block means, by a discrete Fourier matrix."""
    samples = max(1, round(0.01 * rate))
    means = signals.reshape(-1, samples, signals.shape[1]).mean(axis=1)
    n = len(means)
    k = np.arange(n)
    hann = np.sin(np.pi * k / n) ** 2
    centred = means - hann @ means / hann.sum()
    grid = np.round(np.arange(1.4, 12.15, 0.1), 1)
    matrix = np.exp(-2j * np.pi * np.outer(grid, k * samples / rate))
    power = (np.abs(matrix @ (centred * hann[:, None])) ** 2).sum(axis=1)
    inner = range(1, len(grid) - 1)
    peaks = [i for i in inner if power[i] > power[i - 1] and power[i] >= power[i + 1]]
    if not peaks:
        return float(grid[1] if power[1] >= power[-2] else grid[-2])
    return float(grid[max(peaks, key=lambda i: power[i])])


def reference(signals: np.ndarray, rate: float, speed: float, groups: int):
    """The same from SciPy: filters from rest, each begun 2 s before its f_0 came into force."""
    seconds = len(signals) // int(rate)
    behind = round(500.0 / speed * rate)
    filtered, chosen = np.empty_like(signals), np.empty((seconds, groups))
    for group, columns in enumerate(np.split(np.arange(signals.shape[1]), groups)):
        own = signals[:, columns]
        f0 = 5.0
        for second in range(seconds):
            now = second * int(rate)
            if now >= behind:
                f0 = f0_by_matrix(own[now - behind : now], rate)
            chosen[second, group] = f0
        moved = [0, *(np.flatnonzero(np.diff(chosen[:, group])) + 1), seconds]
        for first, last in pairwise(moved):
            begin, start, stop = (max(0, int(s * rate)) for s in (first - 2, first, last))
            f0 = chosen[first, group]
            sections = butter(4, (max(f0 - 2.0, 0.5), f0 + 2.0), "bandpass", fs=rate, output="sos")
            filtered[start:stop, columns] = sosfilt(sections, own[begin:stop], axis=0)[start - begin :]
    return filtered, chosen


def hunting(seconds: int, rate: float, channels: int, seed: int = 3) -> np.ndarray:
    """Noise, and a tone that wanders between 2 and 9 Hz in each channel."""
    random = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    frequency = 5.5 + 3.5 * np.sin(2 * np.pi * t / 30.0 + np.linspace(0.0, 2.0, channels)[:, None])
    tone = np.sin(2 * np.pi * np.cumsum(frequency, axis=1) / rate)
    return (tone + random.normal(0.3, 0.5, size=tone.shape)).T.copy()


def test_long_random_signal_equals_scipy(constants: Band) -> None:
    signals = hunting(60, RATE, 4)
    filtered, chosen = run(constants, band_state(constants, SPEED, 4, 2), signals)
    expected, frequencies = reference(signals, RATE, SPEED, 2)
    np.testing.assert_allclose(chosen, frequencies, rtol=0, atol=1e-9)
    assert len(np.unique(frequencies[:, 0])) > 20  # so that filters really moved
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("rate", [1000.0, 500.0, 200.0, 100.0, 50.0])
def test_any_rate_equals_scipy(rate: float) -> None:
    constants = band(ONLINE, ASSESSMENT, rate)
    signals = hunting(25, rate, 2, seed=int(rate))
    filtered, chosen = run(constants, band_state(constants, SPEED, 2, 1), signals, rate)
    expected, frequencies = reference(signals, rate, SPEED, 1)
    np.testing.assert_allclose(chosen, frequencies, rtol=0, atol=1e-9)
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("speed_kmh", [120, 200, 280, 350, 400])
def test_f0_of_a_tone_is_the_nearest_on_the_grid_at_any_speed(constants: Band, speed_kmh: int) -> None:
    tones = np.array([1.5, 1.72, 2.26, 3.33, 4.04, 5.58, 7.77, 10.01, 12.0])
    speed = speed_kmh / 3.6
    t = np.arange(int(500 / speed) * 1000 + 2001) / RATE
    state = band_state(constants, speed, len(tones), len(tones))
    _, chosen = run(constants, state, 0.7 * np.sin(2 * np.pi * np.outer(t, tones) + 0.4) + 3.0)
    assert np.abs(chosen[-1] - tones).max() <= 0.5 * ONLINE.frequency_step


def test_f0_is_5_hz_until_500_m_are_run(constants: Band) -> None:
    signals = np.sin(2 * np.pi * 8 * np.arange(6000) / RATE)[:, None]
    state = band_state(constants, SPEED, 1, 1)
    out = np.empty(1)
    for i, sample in enumerate(signals):
        retune(constants, state) if i in (1000, 4000, 4990, 4999) else None
        assert constants.frequency[state.choice[0]] == pytest.approx(5.0)
        push(constants, state, sample, out)
        if i == 4999:
            break
    retune(constants, state)
    assert constants.frequency[state.choice[0]] == pytest.approx(8.0)


@pytest.mark.parametrize("f", [2.5, 4.0, 5.0, 6.8, 9.0])
def test_gain_is_that_of_a_butterworth_band(constants: Band, f: float) -> None:
    """Closed form of the digital band of order 4 around 5 Hz: one pass, not two."""
    t = np.arange(20_000) / RATE
    state = band_state(constants, 10.0, 1, 1)  # 500 m take 50 s: f_0 stays
    filtered, _ = run(constants, state, np.sin(2 * np.pi * f * t)[:, None])
    w, low, high = (np.tan(np.pi * x / RATE) for x in (f, 3.0, 7.0))
    gain = 1 / np.sqrt(1 + ((w * w - low * high) / (w * (high - low))) ** 8)
    measured = np.sqrt(2 * np.mean(filtered[10_000:] ** 2))  # whole periods, thirty time constants behind
    assert measured == pytest.approx(gain, rel=1e-6)


def test_a_group_adds_the_spectra_of_its_points(constants: Band) -> None:
    t = np.arange(7000) / RATE
    slow, fast = (np.sin(2 * np.pi * f * t) for f in (4.0, 7.0))
    points = np.stack([slow + 0.8 * fast, 0.8 * fast], axis=1)  # mean squares 1 to 2 * 0.64
    together = run(constants, band_state(constants, SPEED, 2, 1), points)[1]
    apart = run(constants, band_state(constants, SPEED, 2, 2), points)[1]
    assert together[-1] == pytest.approx([7.0])
    assert apart[-1] == pytest.approx([4.0, 7.0])


def test_groups_in_one_state_run_as_alone(constants: Band) -> None:
    signals = hunting(15, RATE, 6)
    speeds = np.array([55.0, 111.0, 83.0])
    together = run(constants, band_state(constants, speeds, 6, 3), signals)
    for group, speed in enumerate(speeds):
        own = np.ascontiguousarray(signals[:, 2 * group : 2 * group + 2])
        alone = run(constants, band_state(constants, speed, 2, 1), own)
        np.testing.assert_array_equal(together[0][:, 2 * group : 2 * group + 2], alone[0])
        np.testing.assert_array_equal(together[1][:, group], alone[1][:, 0])


def test_a_restarted_group_runs_as_new_and_leaves_the_others_alone(constants: Band) -> None:
    before, after = hunting(7, RATE, 4), hunting(12, RATE, 4, seed=8)
    state, untouched = (band_state(constants, np.array([90.0, 100.0]), 4, 2, slowest=60.0) for _ in range(2))
    run(constants, state, before[:6997])  # within a block
    run(constants, untouched, before[:6997])
    restart(constants, state, 1, 62.0)
    filtered, chosen = run(constants, state, after)
    others, _ = run(constants, untouched, after)
    np.testing.assert_array_equal(filtered[:, :2], others[:, :2])
    new = band_state(constants, 62.0, 2, 1)
    expected, frequencies = run(constants, new, np.ascontiguousarray(after[:, 2:]))
    np.testing.assert_array_equal(filtered[:, 2:], expected)
    np.testing.assert_array_equal(chosen[:, 1:], frequencies)
    with pytest.raises(ConfigError, match=r"keeps 833 block means, 50 m/s needs 1000"):
        restart(constants, state, 0, 50.0)


def test_one_group_can_be_retuned_by_itself(constants: Band) -> None:
    state = band_state(constants, SPEED, 2, 2)
    out = np.empty(2)
    for value in np.sin(2 * np.pi * 8 * np.arange(5000) / RATE):
        push(constants, state, np.full(2, value), out)
    retune_group(constants, state, 1)
    assert constants.frequency[state.choice] == pytest.approx([5.0, 8.0])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_unusable_samples_stay_in_their_channel_and_pass(constants: Band, bad: float) -> None:
    signals = hunting(14, RATE, 4)
    spoilt = signals.copy()
    spoilt[5500, 1] = bad
    spoilt[5600:5650, 0] = bad
    state = band_state(constants, SPEED, 4, 2)
    filtered, chosen = run(constants, state, spoilt)
    clean, frequencies = run(constants, band_state(constants, SPEED, 4, 2), signals)
    np.testing.assert_array_equal(filtered[:, 2:], clean[:, 2:])
    np.testing.assert_array_equal(chosen[:, 1], frequencies[:, 1])
    assert chosen.min() >= 1.5
    assert chosen.max() <= 12.0
    assert chosen[-1, 0] == frequencies[-1, 0]  # 500 m later, nothing is left of it
    if not np.isfinite(bad):
        assert np.isfinite(filtered[8000:]).all()


@pytest.mark.parametrize("value", [0.0, 3.0, -1e6])
def test_a_constant_signal_moves_nothing(constants: Band, value: float) -> None:
    state = band_state(constants, SPEED, 2, 1)
    filtered, chosen = run(constants, state, np.full((12_000, 2), value))
    assert chosen == pytest.approx(5.0)
    assert np.abs(filtered[8000:]).max() <= 1e-6 * abs(value)


def test_a_state_is_made_of_arrays_whose_first_axes_can_be_stacked(constants: Band) -> None:
    states = [band_state(constants, speed, 4, 2) for speed in (60.0, 110.0)]
    for name, fields in zip(BandState._fields, zip(*states, strict=True), strict=True):
        assert all(isinstance(field, np.ndarray) for field in fields), name
        assert fields[0].shape[1:] == fields[1].shape[1:], name


@pytest.mark.parametrize("rate", [28.0, 20.0, 0.0, -1000.0, float("nan"), float("inf")])
def test_rates_too_slow_for_the_highest_band_are_refused(rate: float) -> None:
    with pytest.raises(ConfigError, match="highest band ends at 14 Hz, so it needs more than 28 Hz"):
        band(ONLINE, ASSESSMENT, rate)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("start_frequency=1.4", r"start_frequency: found 1.4; expected 1.5 to 12 Hz"),
        ("start_frequency=12.5", r"start_frequency: found 12.5"),
        ("block=0.05", r"block: found 0.05; expected less than 0.0413 s"),
    ],
)
def test_settings_that_do_not_fit_the_assessment(assignment: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        band(load_online(overrides=[assignment]), ASSESSMENT, RATE)


@pytest.mark.parametrize("key", ["start_frequency", "frequency_step", "block", "settling"])
def test_settings_must_be_positive(key: str) -> None:
    for value in ("0", "-1", ".nan", "text"):
        with pytest.raises(ConfigError, match=rf"{key}: found .*; expected a (finite )?number"):
            load_online(overrides=[f"{key}={value}"])


@pytest.mark.parametrize(
    ("speed", "channels", "groups", "message"),
    [
        (SPEED, 4, 3, "4 channels in 3 groups"),
        (SPEED, 4, 0, "4 channels in 0 groups"),
        (SPEED, 0, 1, "0 channels in 1 groups"),
        (0.0, 4, 2, "a speed of 0 m/s; expected 1 m/s or more"),
        (float("nan"), 4, 2, "a speed of nan m/s"),
    ],
)
def test_unusable_states(constants: Band, speed: float, channels: int, groups: int, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        band_state(constants, speed, channels, groups)


def test_a_spectrum_follows_the_speed_and_not_a_dead_sensor(constants: Band) -> None:
    """500 m at the present speed; where the sensor reads 0 or nothing the spectrum stays as long as it is."""
    fast, slow = (band_state(constants, v, 2, 1, slowest=50.0) for v in (100.0, 70.0))
    follow_speed(constants, fast, 0, 70.0)
    assert np.array_equal(fast.length, slow.length)
    np.testing.assert_allclose(fast.window, slow.window, rtol=1e-12, atol=1e-15)
    for dead in (0.0, float("nan")):
        follow_speed(constants, fast, 0, dead)
        assert np.array_equal(fast.length, slow.length)
