"""Realisations of track irregularities and the spline kernel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.signal import correlate

from sayd_env.config import ConfigError
from sayd_env.config.track import (
    DefectConfig,
    IrregularityConfig,
    NoIrregularityConfig,
    SineConfig,
    read_track,
)
from sayd_env.physics.track import (
    TrackRealisation,
    interpolation_coefficients,
    realise,
    spline_value_slope,
)


def german() -> IrregularityConfig:
    return read_track("german_low-estimate").irregularity


def sine(wavelength: float, channel: str = "alignment") -> SineConfig:
    return SineConfig.model_validate(
        {"type": "sine", "channel": channel, "amplitude": 2e-3, "wavelength": wavelength, "scale": 0.5}
    )


def one(realisation: TrackRealisation, x: float) -> tuple[np.ndarray, np.ndarray]:
    value, slope = np.full((2, 4), np.nan)
    spline_value_slope(realisation.coefficients, realisation.x0, realisation.step, x, value, slope)
    return value, slope


def test_kernel_is_scipys_b_spline() -> None:
    rng = np.random.default_rng(0)
    coefficients = rng.normal(size=(40, 4))
    x0, step = -3.0, 0.25
    knots = x0 + step * np.arange(-3, 41)
    x = np.append(rng.uniform(x0, x0 + 37 * step, 500), x0 + step * np.arange(38))
    value, slope = TrackRealisation(x0, step, 5.0, coefficients).evaluate(x)
    expected = BSpline(knots, coefficients, 3)
    np.testing.assert_allclose(value, expected(x), rtol=0, atol=1e-13)
    np.testing.assert_allclose(slope, expected(x, 1), rtol=0, atol=1e-11)


def test_spline_passes_through_the_samples() -> None:
    samples = np.random.default_rng(1).normal(size=(200, 4))
    realisation = TrackRealisation(10.0, 0.5, 90.0, interpolation_coefficients(samples))
    value, _ = realisation.evaluate(10.0 + 0.5 * np.arange(200))
    np.testing.assert_allclose(value, samples, rtol=0, atol=1e-12)
    assert realisation.coefficients.flags.c_contiguous


@pytest.mark.parametrize("x", [-1e300, -np.inf, np.nan, -100.0, 600.0, 1e18, np.inf])
def test_outside_the_table_the_ends_hold(x: float) -> None:
    realisation = realise(sine(10.0), 500.0, 0, fade_in=0.0)
    value, slope = one(realisation, x)
    rows = realisation.coefficients[-3:] if x > 0 else realisation.coefficients[:3]
    assert not slope.any()
    if not np.isnan(x):
        np.testing.assert_allclose(value, (rows[0] + 4 * rows[1] + rows[2]) / 6, atol=1e-15)


@pytest.mark.parametrize("wavelength", [2.0, 3.0, 25.0])
def test_sine_is_its_closed_form(wavelength: float) -> None:
    realisation = realise(sine(wavelength), 300.0, 0)
    x = np.linspace(60.0, 300.0, 7001)
    value, slope = realisation.evaluate(x)
    k = 2 * np.pi / wavelength
    np.testing.assert_allclose(value[:, 0], 1e-3 * np.sin(k * x), rtol=0, atol=0.002e-3)
    np.testing.assert_allclose(slope[:, 0], 1e-3 * k * np.cos(k * x), rtol=0, atol=0.01e-3 * k)
    assert not value[:, 1:].any()


def test_finer_grid_converges_with_fourth_order() -> None:
    x = np.linspace(10.0, 90.0, 4001)
    exact = 1e-3 * np.sin(2 * np.pi * x / 4.0)
    errors = [
        np.abs(realise(sine(4.0), 100.0, 0, fade_in=0.0, grid_step=step).evaluate(x)[0][:, 0] - exact).max()
        for step in (0.5, 0.25, 0.125)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 4.0, atol=0.3)


def test_fade_in_is_the_quintic_smooth_step() -> None:
    x = np.linspace(-30.0, 50.0, 1601)
    value, slope = realise(sine(20.0), 200.0, 0, fade_in=50.0).evaluate(x)
    t = np.clip(x / 50.0, 0, 1)
    fade = 6 * t**5 - 15 * t**4 + 10 * t**3
    np.testing.assert_allclose(value[:, 0], 1e-3 * fade * np.sin(2 * np.pi * x / 20.0), atol=3e-9)
    assert np.abs(value[x < -0.5]).max() < 1e-9
    assert np.abs(slope[x < -0.5]).max() < 1e-8


def test_second_derivative_is_continuous() -> None:
    realisation = realise(german(), 400.0, 5)
    knots = np.arange(0.0, 400.0, realisation.step)
    tiny = 1e-4
    slope = [realisation.evaluate(knots + k * tiny)[1] for k in (-2, -1, 0, 1, 2)]
    # One-sided differences of second order, so that a jump of the third derivative leaves no trace.
    left = (3 * slope[2] - 4 * slope[1] + slope[0]) / (2 * tiny)
    right = -(3 * slope[2] - 4 * slope[3] + slope[4]) / (2 * tiny)
    assert np.abs(left).max() > 1e-4
    np.testing.assert_allclose(left, right, rtol=0, atol=1e-8)


def test_defect_is_a_raised_cosine() -> None:
    config = DefectConfig(type="defect", channel="vertical", amplitude=-4e-3, length=10.0, position=20.0)
    realisation = realise(config, 100.0, 0)
    value, _ = realisation.evaluate([15.0, 20.0, 22.5, 25.0, 27.5, 30.0, 35.0])
    np.testing.assert_allclose(value[:, 1], [0, 0, -2e-3, -4e-3, -2e-3, 0, 0], atol=2e-6)
    assert not value[:, [0, 2, 3]].any()


def test_a_defect_behind_what_is_judged_is_refused() -> None:
    config = DefectConfig(type="defect", channel="vertical", amplitude=-4e-3, length=10.0, position=90.0)
    realise(config, 100.0, 0, judged=[(0.0, 95.0)])
    with pytest.raises(ConfigError, match=r"begins at 90 m of the run, which is judged up to 80 m"):
        realise(config, 100.0, 0, judged=[(0.0, 40.0), (50.0, 80.0)])


def test_even_track() -> None:
    realisation = realise(NoIrregularityConfig(type="none"), 100.0, 0)
    assert not realisation.coefficients.any()


def test_same_seed_same_bits_and_another_seed_another_track() -> None:
    first, again, other = (realise(german(), 1000.0, seed) for seed in (7, 7, 8))
    assert first.coefficients.tobytes() == again.coefficients.tobytes()
    assert first.coefficients.shape == other.coefficients.shape
    x = np.arange(100.0, 1000.0)
    correlation = np.corrcoef(first.evaluate(x)[0][:, 0], other.evaluate(x)[0][:, 0])[0, 1]
    assert abs(correlation) < 0.5


def test_scale_and_levels_multiply_the_amplitude() -> None:
    plain = realise(german(), 500.0, 2)
    sets = ["irregularity.scale=0.5", "irregularity.levels={alignment: 0.6, vertical: 0}"]
    scaled = realise(read_track("german_low-estimate", sets).irregularity, 500.0, 2)
    np.testing.assert_allclose(
        scaled.coefficients, plain.coefficients * [0.3, 0.0, 0.5, 0.5], rtol=1e-12, atol=1e-18
    )


def test_channels_are_independent() -> None:
    x = np.arange(60.0, 3000.0)
    matrices = np.array([np.corrcoef(realise(german(), 3000.0, s).evaluate(x)[0].T) for s in range(40)])
    pairs = matrices[:, *np.triu_indices(4, 1)]
    # The mean over seeds of each correlation is zero to within its own sampling error (4 sigma, 6 pairs).
    sigma = pairs.std(axis=0, ddof=1) / np.sqrt(len(pairs))
    assert (np.abs(pairs.mean(axis=0)) < 4 * sigma).all()
    assert np.abs(pairs).max() < 0.7


@pytest.mark.parametrize("length", [300.0, 5000.0])
def test_a_run_does_not_repeat_itself(length: float) -> None:
    x = np.arange(50.0, length, 0.5)
    y = realise(german(), length, 1).evaluate(x)[0][:, 0]
    lag = round(0.2 * len(x))
    overlap = np.arange(len(x), 0, -1)
    correlation = correlate(y, y)[len(y) - 1 :] / (overlap * y.var())
    assert correlation[lag : len(x) // 2].max() < 0.8


def test_realisation_covers_the_run() -> None:
    realisation = realise(german(), 777.7, 0)
    last = realisation.x0 + realisation.step * (len(realisation.coefficients) - 3)
    assert realisation.x0 < 0.0
    assert last > 777.7


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length": 0.0}, "length: found 0.0"),
        ({"length": float("nan")}, "length: found nan"),
        ({"length": 1e9}, "length: found 1e\\+09 m; .* 1e\\+06 m at most"),
        ({"grid_step": -0.25}, "grid step: found -0.25"),
        ({"grid_step": 0.5}, "wavelength_min: found 2 m; a grid step of 0.5 m allows 4 m"),
        ({"fade_in": -1.0}, "fade-in: found -1.0"),
        ({"seed": -1}, "seed: found -1"),
    ],
)
def test_bad_arguments(change: dict[str, float], message: str) -> None:
    arguments: dict[str, float] = {"length": 500.0, "seed": 0}
    with pytest.raises(ConfigError, match=message):
        realise(german(), **(arguments | change))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["german_low", "china", "defect"])
def test_a_table_that_covers_less_is_the_same_track(name: str) -> None:
    """Bit for bit, up to where it ends: how long an episode is changes nothing of it."""
    irregularity = read_track(name).irregularity
    whole, part = realise(irregularity, 1500.0, 3), realise(irregularity, 1500.0, 3, covered=400.3)
    assert len(part.coefficients) < 0.35 * len(whole.coefficients)
    assert part.length == 400.3
    x = np.linspace(-4.0, 400.3, 5000)
    np.testing.assert_array_equal(part.evaluate(x), whole.evaluate(x))
