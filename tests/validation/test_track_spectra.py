"""Spectra and random irregularities against published formulas and figures.

Sources: ERRI B176 in the rational form of SIMPACK as used by ORVD (Open Rail Vehicle Dynamics); RMS by band,
integrated independently of this project from the formulas of ERRI B176 and of the Chinese high-speed spectrum
(coefficients as in TB/T 3352-2014, taken from VTCM_simulation). American track: the formula of Garg and
Dukkipati (1984) with the numbers of line grades 5 and 6, integrated in closed form; FRA class 6 (Hamid et al.
1983) in inches and feet, in which its numbers are round.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import welch

from sayd_env.config.track import CHANNELS, SpectrumConfig, read_track
from sayd_env.physics.track import irregularity_psd, random_irregularity, realise

# Name, channel, band of wavelengths (m), RMS (mm; mrad times 1.5 m for the cross-level).
RMS_BY_BAND = [
    ("german_low-estimate", "alignment", (2, 120), 1.86),
    ("german_low-estimate", "alignment", (3, 25), 0.71),
    ("german_low-estimate", "alignment", (3, 70), 1.39),
    ("german_low-estimate", "alignment", (25, 70), 1.20),
    ("german_low-estimate", "alignment", (70, 120), 1.23),
    ("german_low-estimate", "vertical", (2, 120), 2.57),
    ("german_low-estimate", "vertical", (3, 25), 0.98),
    ("german_low-estimate", "vertical", (70, 120), 1.70),
    ("german_high", "alignment", (2, 120), 3.17),
    ("german_high", "alignment", (3, 25), 1.21),
    ("german_high", "vertical", (2, 120), 4.20),
    ("german_high", "vertical", (3, 70), 3.15),
    ("china", "alignment", (2, 200), 0.6678),
    ("china", "vertical", (2, 200), 1.2203),
    ("china", "cross_level", (2, 200), 0.5235),
    ("china", "gauge", (2, 200), 0.3437),
    ("china", "alignment", (2, 120), 0.53),
    ("china", "alignment", (3, 25), 0.26),
    ("china", "vertical", (25, 70), 0.36),
    ("china", "vertical", (70, 120), 0.54),
    ("china", "cross_level", (3, 25), 0.29),
    ("china", "cross_level", (3, 70), 0.38),
    ("china", "gauge", (3, 70), 0.30),
]


def spectrum(name: str, band: tuple[float, float] | None = None) -> SpectrumConfig:
    sets = (
        []
        if band is None
        else [f"irregularity.wavelength_{k}={float(v)}" for k, v in zip(("min", "max"), band, strict=True)]
    )
    config = read_track(name, sets).irregularity
    assert isinstance(config, SpectrumConfig)
    return config


def in_mm(channel: str, rms: float) -> float:
    return 1e3 * rms * (1.5 if channel == "cross_level" else 1.0)


@pytest.mark.parametrize(("name", "channel", "band", "expected"), RMS_BY_BAND)
def test_rms_of_the_density(name: str, channel: str, band: tuple[float, float], expected: float) -> None:
    config = spectrum(name, band)
    limits = np.geomspace(1 / band[1], 1 / band[0], 30)
    column = CHANNELS.index(channel)
    variance = sum(
        quad(lambda f: float(irregularity_psd(config, f)[0, column]), a, b, epsrel=1e-6)[0]
        for a, b in pairwise(limits)
    )
    half_a_digit = 0.5e-2 if round(expected, 2) == expected else 0.5e-4
    assert in_mm(channel, variance**0.5) == pytest.approx(expected, abs=1.01 * half_a_digit)


@pytest.mark.parametrize(("name", "channel", "band", "expected"), RMS_BY_BAND)
def test_rms_of_a_realisation_over_its_period(
    name: str, channel: str, band: tuple[float, float], expected: float
) -> None:
    # With deterministic amplitudes the RMS over a period is that of the density, whatever the seed.
    points = 2**16 - 1
    series = random_irregularity(spectrum(name, band), points, 0.25, seed=3)
    rms = in_mm(channel, float(np.std(series[:, CHANNELS.index(channel)])))
    assert rms == pytest.approx(expected, abs=5e-3, rel=2e-3)


@pytest.mark.parametrize(
    ("name", "b0_lateral", "b0_vertical"),
    [("german_low-estimate", 1.440846e-7, 2.741619e-7), ("german_high", 4.164787e-7, 7.343623e-7)],
)
def test_german_density_is_simpacks_form(name: str, b0_lateral: float, b0_vertical: float) -> None:
    f = np.geomspace(1 / 119, 1 / 2.01, 50)
    omega = 2 * np.pi * f
    shape = 2 * np.pi / (2.8855e-4 + 0.6803895 * omega**2 + omega**4)
    psd = irregularity_psd(spectrum(name), f)
    np.testing.assert_allclose(psd[:, 0], b0_lateral * shape, rtol=1e-4)
    np.testing.assert_allclose(psd[:, 1], b0_vertical * shape, rtol=1e-4)


def test_german_gauge_and_cross_level_at_their_cut_off() -> None:
    """At Omega_s the factor Omega^2/(Omega^2 + Omega_s^2) is one half."""
    psd = irregularity_psd(spectrum("german_low-estimate"), 0.438 / (2 * np.pi))
    alignment, vertical, cross_level, gauge = psd[0]
    assert gauge / alignment == pytest.approx(0.5 * 5.32e-8 / 2.119e-7)
    assert cross_level / vertical == pytest.approx(0.5 / 0.75**2)


# k A_a and k A_v (m2 rad/m) with k = 0.25 and A in cm2 rad/m, and Omega_s (rad/m).
GRADES = {
    "grade_6": (0.25 * 0.0339e-4, 0.25 * 0.0339e-4, 0.438),
    "grade_5": (0.25 * 0.0762e-4, 0.25 * 0.2095e-4, 0.8209),
}
OMEGA_C = 0.8245


@pytest.mark.parametrize("name", GRADES)
@pytest.mark.parametrize("band", [(2.0, 120.0), (3.0, 25.0), (25.0, 70.0)])
def test_american_line_grades_in_closed_form(name: str, band: tuple[float, float]) -> None:
    """Integrals over Omega of both forms, by partial fractions.

    c^2 / (O^2 (O^2 + c^2)) = 1 / O^2 - 1 / (O^2 + c^2), and
    c^2 / ((O^2 + c^2)(O^2 + s^2)) = c^2 / (c^2 - s^2) (1 / (O^2 + s^2) - 1 / (O^2 + c^2)).
    """
    low, high = 2 * np.pi / band[1], 2 * np.pi / band[0]
    alignment, vertical, s = GRADES[name]

    def over(corner: float) -> float:
        return float(np.arctan(high / corner) - np.arctan(low / corner)) / corner

    steep = (1 / low - 1 / high) - over(OMEGA_C)
    level = OMEGA_C**2 / (OMEGA_C**2 - s**2) * (over(s) - over(OMEGA_C))
    expected = [alignment * steep, vertical * steep, 4 * vertical * level / 1.5**2, 4 * vertical * level]
    config = spectrum(name, band)
    edges = np.geomspace(1 / band[1], 1 / band[0], 20)
    for column, variance in enumerate(expected):
        pieces = (
            quad(lambda f, k=column: float(irregularity_psd(config, f)[0, k]), a, b, epsrel=1e-9)[0]
            for a, b in pairwise(edges)
        )
        assert sum(pieces) == pytest.approx(variance, rel=1e-6)
    series = random_irregularity(config, 2**16 - 1, 0.25, seed=3)
    np.testing.assert_allclose(series.var(axis=0), expected, rtol=5e-3)


def test_fra_class_6_is_that_of_inches_and_feet() -> None:
    """Roughness in in2/ft and cut-offs in cycles/ft; densities in in2/(cycle/ft)."""
    inch, foot = 0.0254, 0.3048
    f = np.geomspace(1 / 119, 1 / 2.01, 40)
    k = f * foot
    expected = []
    for roughness, lower, upper, rising in (
        (2.8e-5, 10.0e-3, 56.0e-3, True),
        (4.5e-5, 7.1e-3, 40.0e-3, True),
        (3.4e-5, 7.1e-3, 40.0e-3, False),
        (2.8e-5, 8.9e-3, 71.0e-3, False),
    ):
        shape = (k**2 + lower**2) / k**4 if rising else 1.0 / (k**2 + lower**2)
        expected.append(roughness * upper**2 / (k**2 + upper**2) * shape * inch**2 * foot)
    psd = irregularity_psd(spectrum("fra_6"), f)
    psd[:, 2] *= 1.5**2
    np.testing.assert_allclose(psd, np.stack(expected, axis=1), rtol=5e-3)


def test_chinese_percentile_90_is_2303_times_the_mean() -> None:
    """Chi squared with two degrees of freedom (Liu, Li and Wang 2014, Civil-Comp 104, paper 97)."""
    upper = read_track("china", ["irregularity.density.percentile=0.9"]).irregularity
    assert isinstance(upper, SpectrumConfig)
    f = [0.01, 0.1, 0.4]
    ratio = irregularity_psd(upper, f) / irregularity_psd(spectrum("china"), f)
    np.testing.assert_allclose(ratio, 2.303, rtol=2e-4)


@pytest.mark.parametrize("name", ["german_low-estimate", "china"])
def test_welch_spectrum_of_realisations(name: str) -> None:
    """Welch's estimate, averaged over 300 seeds, by third-octave bands from 3 to 60 m: within 5 %.

    The narrowest band holds four lines of some five independent segments a seed: a spread of 1.5 %.
    """
    config = spectrum(name)
    step, segment = 0.25, 4096
    x = np.arange(100.0, 4100.0, step)
    estimates = []
    for seed in range(300):
        value, _ = realise(config, 4200.0, seed, grid_step=step).evaluate(x)
        f, psd = welch(value, fs=1 / step, nperseg=segment, axis=0)
        estimates.append(psd)
    estimate, expected = np.mean(estimates, axis=0), irregularity_psd(config, f)
    edges = np.geomspace(1 / 60, 1 / 3, 14)
    for low, high in pairwise(edges):
        band = (f >= low) & (f < high)
        np.testing.assert_allclose(estimate[band].mean(axis=0), expected[band].mean(axis=0), rtol=0.05)


def test_nothing_outside_the_band() -> None:
    config = spectrum("german_low-estimate")
    assert not irregularity_psd(config, [0.0, 1 / 121, 0.51]).any()
    series = random_irregularity(config, 2**14 - 1, 0.25, seed=0)
    power = np.abs(np.fft.rfft(np.vstack([series, 2 * series[-1] - series[-2]]), axis=0)) ** 2
    f = np.fft.rfftfreq(2**14, 0.25)
    assert power[f > 0.51].sum() < 1e-5 * power.sum()
    assert power[f < 1 / 121 - f[1]].sum() < 1e-5 * power.sum()
