"""Power spectral densities of track irregularities and random irregularities that have them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.fft import irfft, next_fast_len

from sayd_env.config.track import (
    CHANNELS,
    AmericanDensityConfig,
    ChinaDensityConfig,
    GermanDensityConfig,
    PowerLawConfig,
    SpectrumConfig,
)
from sayd_env.config.units import Array

# First part of the spawn key of the phases' random streams: no other user of the same seed shares them.
_STREAM = 74
# The period holds the longest wave at least this often, so that a short run, too, sees a continuum.
_PERIODS_OF_LONGEST_WAVE = 20.0


def irregularity_psd(config: SpectrumConfig, frequency: ArrayLike) -> Array:
    """One-sided power spectral densities over spatial frequency, scaled and cut to the band of wavelengths.

    Parameters
    ----------
    config : SpectrumConfig
        Spectrum with its levels and band.
    frequency : array_like, shape (n,)
        Spatial frequency f (1/m); zero density outside the band.

    Returns
    -------
    ndarray, shape (n, 4)
        S(f) of alignment, vertical (m2/(1/m)), cross-level angle (rad2/(1/m)) and gauge (m2/(1/m));
        the integral over positive f is the variance.

    Notes
    -----
    Over angular wavenumbers: S_f(f) = 2 pi S_Omega(2 pi f). A cross-level's height over its base is an angle.
    """
    f = np.atleast_1d(np.asarray(frequency, dtype=np.float64))
    low, high = 1.0 / config.wavelength_max, 1.0 / config.wavelength_min
    inside = (f >= low) & (f <= high)
    return np.where(inside[:, None], _density(config, np.clip(f, low, high)), 0.0)


def random_irregularity(config: SpectrumConfig, points: int, step: float, seed: int) -> Array:
    """Random irregularities on a uniform grid.

    Parameters
    ----------
    config : SpectrumConfig
        Spectrum.
    points : int
        Number of grid points.
    step : float
        Distance of the grid points (m).
    seed : int
        Seed of the realisation, not negative. Each channel has a stream of its own.

    Returns
    -------
    ndarray, shape (points, 4)
        Alignment, vertical (m), cross-level (rad) and gauge (m).

    Notes
    -----
    Random phases with deterministic amplitudes, as in the sources of the spectra:
    r(x) = sum_k sqrt(2 S(f_k) df) cos(2 pi f_k x + phi_k), phi_k uniform in [0, 2 pi), summed by one inverse
    FFT. The variance over a period is thus the same for all seeds. The period is longer than the grid.
    A bin cut by an edge of the band counts with the part of its width that lies inside.
    """
    period = max(points * step, _PERIODS_OF_LONGEST_WAVE * config.wavelength_max)
    n = next_fast_len(int(np.ceil(period / step)) + 1, real=True)
    df = 1.0 / (n * step)
    low, high = 1.0 / config.wavelength_max, 1.0 / config.wavelength_min
    f = df * np.arange(n // 2 + 1)
    (inside,) = np.nonzero((f + 0.5 * df > low) & (f - 0.5 * df < high))
    band = slice(int(inside[0]), int(inside[-1]) + 1)
    f = f[band]
    width = np.clip(f + 0.5 * df, low, high) - np.clip(f - 0.5 * df, low, high)
    amplitude = np.sqrt(2.0 * _density(config, np.clip(f, low, high)) * width[:, None])
    phase = np.stack([_phases(seed, channel, band.stop) for channel in range(len(CHANNELS))], axis=1)
    spectrum = np.zeros((n // 2 + 1, len(CHANNELS)), dtype=np.complex128)
    spectrum[band] = 0.5 * n * amplitude * np.exp(1j * phase[band])
    series: Array = irfft(spectrum, n=n, axis=0)
    return series[:points]


def _phases(seed: int, channel: int, count: int) -> Array:
    """Phases of the first bins; those of a bin do not depend on how many there are."""
    stream = np.random.SeedSequence(seed, spawn_key=(_STREAM, channel))
    return np.random.default_rng(stream).uniform(0.0, 2.0 * np.pi, count)


def _density(config: SpectrumConfig, f: Array) -> Array:
    density = config.density
    if isinstance(density, GermanDensityConfig):
        shapes = _german(density, f)
    elif isinstance(density, AmericanDensityConfig):
        shapes = _american(density, f)
    else:
        shapes = _china(density, f)
    factor = np.array([config.scale * getattr(config.levels, channel) for channel in CHANNELS])
    return np.asarray(shapes * factor**2)


def _german(density: GermanDensityConfig, f: Array) -> Array:
    omega2 = (2.0 * np.pi * f) ** 2
    c2, r2, s2 = density.omega_c**2, density.omega_r**2, density.omega_s**2
    plain = c2 / ((omega2 + r2) * (omega2 + c2))
    high_passed = plain * omega2 / (omega2 + s2)
    columns = [
        density.alignment * plain,
        density.vertical * plain,
        density.vertical / density.half_base**2 * high_passed,
        density.gauge * high_passed,
    ]
    return 2.0 * np.pi * np.stack(columns, axis=1)


def _china(density: ChinaDensityConfig, f: Array) -> Array:
    laws = (density.alignment, density.vertical, density.cross_level, density.gauge)
    columns = np.stack([_power_law(law, f) for law in laws], axis=1)
    columns[:, CHANNELS.index("cross_level")] /= density.cross_level_base**2
    # Estimates of a spectral density follow chi squared with two degrees of freedom (Liu, Li and Wang 2014).
    percentile = 1.0 if density.percentile is None else -np.log1p(-density.percentile)
    return 1e-6 * percentile * columns


def _power_law(law: PowerLawConfig, f: Array) -> Array:
    part = np.searchsorted(np.asarray(law.limits, dtype=np.float64), f, side="right")
    return np.asarray(np.asarray(law.coefficients)[part] * f ** -np.asarray(law.exponents)[part])


def _american(density: AmericanDensityConfig, f: Array) -> Array:
    unit = 2.0 * np.pi if density.wavenumber == "rad/m" else 1.0
    k2 = (unit * f) ** 2
    columns = []
    for channel in CHANNELS:
        law = getattr(density, channel)
        lower2, upper2 = law.lower**2, law.upper**2
        shape = (k2 + lower2) / k2**2 if channel in ("alignment", "vertical") else 1.0 / (k2 + lower2)
        columns.append(unit * law.roughness * upper2 / (k2 + upper2) * shape)
    shapes = np.stack(columns, axis=1)
    shapes[:, CHANNELS.index("cross_level")] /= density.cross_level_base**2
    return shapes
