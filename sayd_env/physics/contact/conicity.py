"""Equivalent conicity by EN 15302, from rigid profiles or from the table that the simulation uses.

A wheelset that rolls without slip on straight track follows y'' = -delta_r(y) / (e r0), with the
difference delta_r of the rolling radii and the track base e. A conical wheelset of conicity tan(gamma)
has the wavelength L = 2 pi sqrt(e r0 / (2 tan(gamma))) (Klingel). The equivalent conicity at an amplitude
is that of the conical wheelset with the wavelength of the real motion. With lengths along the track in
units of sqrt(e r0) the motion is y'' = -delta_r(y) and tan(gamma_e) = (2 pi / L)^2 / 2, so that neither e
nor r0 matters.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq
from scipy.special import roots_legendre

from sayd_env.config import DataError
from sayd_env.config.units import Array
from sayd_env.physics.contact.geometry import ContactTable, RigidContact

AMPLITUDE = 3e-3
"""Of the wheelset's lateral motion, at which EN 15302 quotes conicities (m)."""
_QUADRATURE_NODES = 400
_ROUNDING = 1e-9  # of the potential, by which two sides that are alike differ
_FLAT = 1e-6  # a conicity below this is that of a cylinder


def radius_difference(
    contact: RigidContact | ContactTable, right: RigidContact | ContactTable | None = None
) -> tuple[Array, Array]:
    """Rolling radius of the left minus that of the right wheel over the wheelset's lateral position.

    The right wheel is a left one at the opposite position: the same one, or that of `right`.

    Returns
    -------
    y, delta_r : ndarray, shape (n,)
        Lateral position at rail level (m), difference (m).
    """
    y = contact.y if isinstance(contact, RigidContact) else contact.dy
    return y, contact.delta_r - (right or contact).delta_r[::-1]


def equivalent_conicity(y: ArrayLike, delta_r: ArrayLike, amplitudes: ArrayLike) -> Array:
    """Equivalent conicity tan(gamma_e) by integration of the wheelset's motion (EN 15302, annex B).

    Parameters
    ----------
    y, delta_r : array_like, shape (n,)
        Difference of the rolling radii over the lateral position (m); an odd function where both sides are
        alike.
    amplitudes : array_like, shape (m,)
        Amplitudes of the lateral motion (m): half the way from one side to the other.

    Returns
    -------
    ndarray, shape (m,)
        Conicity; negative where the wheelset is driven outwards from every position up to the amplitude, NaN
        where no motion of this amplitude passes through the centre (driven outwards in part).

    Raises
    ------
    DataError
        An amplitude is not positive or beyond the data, or the data are no function of the position.

    Notes
    -----
    With the potential U' = delta_r / 2 the motion runs between positions m - a and m + a of one potential; m
    is 0 where both sides are alike. With y = m + a sin(theta) and lengths in units of sqrt(e r0 / 2) half the
    wavelength is the integral of D^(-1/2) over theta from -pi/2 to pi/2, D = 2 (U(m + a) - U(y)) / (a
    cos(theta))^2. This form is free of the square root's singularity; Gauss-Legendre on each half.
    """
    y, delta_r, amplitudes = _checked(y, delta_r, amplitudes)
    potential = make_interp_spline(y, 0.5 * delta_r, k=1).antiderivative()
    middle = _middles(y, potential, amplitudes)[:, None]
    nodes, weights = _quadrature()
    quarter_turn = 0.25 * np.pi * (nodes + 1.0)
    # Where both sides are alike, so are both halves.
    halves = [quarter_turn] if np.all(middle == 0.0) else [-quarter_turn, quarter_turn]
    theta, weights = np.concatenate(halves), np.tile(weights, len(halves)) * 2.0 / len(halves)
    reach = amplitudes[:, None]
    rise = potential(middle + np.copysign(reach, theta)) - potential(middle + reach * np.sin(theta))
    stiffness = 2.0 * rise / (reach * np.cos(theta)) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        half = 0.25 * np.pi * np.sum(weights / np.sqrt(np.abs(stiffness)), axis=1)
        conicity = (np.pi / half) ** 2
    outward, inward = np.any(stiffness < -_FLAT, axis=1), np.any(stiffness > _FLAT, axis=1)
    conicity = np.where(outward, np.where(inward, np.nan, -conicity), conicity)
    return np.where(np.isnan(middle[:, 0]), np.nan, np.where(outward | inward, conicity, 0.0))


@cache
def _quadrature() -> tuple[Array, Array]:
    """Nodes and weights by Gauss and Legendre: finding them takes longer than the rest of a conicity."""
    nodes, weights = roots_legendre(_QUADRATURE_NODES)
    return nodes, weights


def _middles(y: Array, potential: Callable[[ArrayLike], Array], amplitudes: Array) -> Array:
    """Middle of the motion of each amplitude (m): nearest to the centre; NaN where there is none."""
    largest, scale = min(-y[0], y[-1]), float(np.ptp(potential(y)))
    middles = np.full(len(amplitudes), np.nan)
    for i, a in enumerate(amplitudes):

        def higher(m: float, a: float = a) -> float:
            return float(potential(m + a) - potential(m - a))

        if abs(higher(0.0)) <= _ROUNDING * scale:
            middles[i] = 0.0
            continue
        grid = np.linspace(-(largest - a), largest - a, 201)
        values = np.array([higher(m) for m in grid])
        crossings = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
        if crossings.size:
            found = [brentq(higher, grid[j], grid[j + 1], xtol=1e-9) for j in crossings]
            middles[i] = min(found, key=abs)
    return middles


def harmonic_conicity(y: ArrayLike, delta_r: ArrayLike, amplitudes: ArrayLike) -> Array:
    """Conicity by harmonic linearisation: first harmonic of delta_r / 2 over a sine, over the amplitude.

    Parameters, errors and the middle of the motion as in `equivalent_conicity`; defined for every profile
    where both sides are alike.
    """
    y, delta_r, amplitudes = _checked(y, delta_r, amplitudes)
    sine = np.sin(2.0 * np.pi * (np.arange(720) + 0.5) / 720)
    middle = _middles(y, make_interp_spline(y, 0.5 * delta_r, k=1).antiderivative(), amplitudes)[:, None]
    cycle = np.interp(middle + amplitudes[:, None] * sine, y, 0.5 * delta_r)
    return np.asarray(2.0 * np.mean(cycle * sine, axis=1) / amplitudes)


def _checked(y: ArrayLike, delta_r: ArrayLike, amplitudes: ArrayLike) -> tuple[Array, Array, Array]:
    position, difference = np.asarray(y, dtype=float), np.asarray(delta_r, dtype=float)
    amplitude = np.atleast_1d(np.asarray(amplitudes, dtype=float))
    if (
        position.ndim != 1
        or position.size < 2
        or position.shape != difference.shape
        or not np.all(np.diff(position) > 0.0)
    ):
        raise DataError("conicity: expected positions that rise, and a difference of radii at each")
    if not np.all(np.isfinite(difference)):
        raise DataError("conicity: the difference of the radii has values that are not finite")
    largest = min(-position[0], position[-1])
    if not np.all((amplitude > 0.0) & (amplitude <= largest)):
        raise DataError(
            f"conicity amplitude: found {np.min(amplitude) * 1e3:g} to {np.max(amplitude) * 1e3:g} mm, "
            f"allowed is above 0 up to {largest * 1e3:g} mm"
        )
    return position, difference, amplitude
