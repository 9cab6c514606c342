"""Hertz's elliptic contact: the powers of the penetration that give force and semi-axes.

Two bodies of the same material touch where the gap between the undeformed surfaces is ``A x^2 + B y^2``.
At the penetration ``d`` (approach of distant points) the normal force is ``c_hertz d^1.5`` and the contact
ellipse has the semi-axes ``a_s sqrt(d)`` (rolling direction x) and ``b_s sqrt(d)`` (lateral y). The three
coefficients depend on A, B and the material alone, so a contact table holds them at its nodes.

References
----------
K. L. Johnson, Contact Mechanics (Cambridge, 1985), section 4.2(c), equations 4.25 to 4.30.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.special import ellipkm1, elliprd

from sayd_env.config.errors import DataError
from sayd_env.config.units import Array

# Axis ratios down to exp(-9) = 1.2e-4. A wheel on a rail stays above about 0.02.
_LARGEST_LOG_ASPECT = 9.0
_SPLINE_NODES = 1500


def _curvature_integrals(kappa: Array) -> tuple[Array, Array]:
    """Integrals K and D = (K - E) / e^2 of the ellipse with the axis ratio kappa = minor / major.

    D comes from Carlson's R_D: the difference K - E loses all digits for a nearly circular contact.
    """
    squared = kappa * kappa
    return ellipkm1(squared), elliprd(0.0, squared, 1.0) / 3.0


def curvature_ratio(kappa: ArrayLike) -> Array:
    """Ratio of the relative curvatures (across the minor over along the major axis) of an axis ratio.

    Parameters
    ----------
    kappa : array_like
        Minor over major semi-axis, 0 < kappa <= 1.

    Returns
    -------
    ndarray
        ``(E / kappa^2 - K) / (K - E)``, Johnson's equation 4.28; 1 for the circle.
    """
    kappa = np.asarray(kappa, dtype=float)
    k, d = _curvature_integrals(kappa)
    return np.asarray((k - d) / (kappa * kappa * d))


@cache
def _inverse() -> tuple[CubicSpline, float]:
    """Spline of -log(kappa) over the log of the curvature ratio (relative error below 1e-11), and its end."""
    log_aspect = np.linspace(0.0, _LARGEST_LOG_ASPECT, _SPLINE_NODES)
    log_ratio = np.log(curvature_ratio(np.exp(-log_aspect)))
    return CubicSpline(log_ratio, log_aspect), float(log_ratio[-1])


def _axis_ratio(ratio: Array) -> Array:
    """Axis ratio kappa of a curvature ratio >= 1."""
    inverse, largest = _inverse()
    log_ratio = np.log(ratio)
    if np.any(log_ratio > largest):
        raise DataError(
            f"contact curvatures: the larger is {np.max(ratio):.3g} times the smaller, "
            f"at most {np.exp(largest):.3g} is allowed (is a surface flat or conformal here?)"
        )
    return np.asarray(np.exp(-inverse(log_ratio)))


def hertz_coefficients(A: ArrayLike, B: ArrayLike, E: float, nu: float) -> tuple[Array, Array, Array]:
    """Coefficients of force and semi-axes in powers of the penetration.

    Parameters
    ----------
    A, B : array_like
        Half the relative curvatures in the rolling and in the lateral direction: gap = A x^2 + B y^2 (1/m).
    E : float
        Young's modulus of both bodies (Pa).
    nu : float
        Poisson's ratio of both bodies.

    Returns
    -------
    c_hertz, a_s, b_s : ndarray
        Normal force over penetration^1.5 (N/m^1.5) and semi-axes in rolling and lateral direction over
        sqrt(penetration) (sqrt(m)), in the broadcast shape of A and B.

    Raises
    ------
    DataError
        If a curvature is not positive and finite, or one is more than about 1e7 times the other.

    Notes
    -----
    With the smaller curvature A' along the major semi-axis a', E* = E / (2 (1 - nu^2)) and the integrals K
    and D: ``a' = sqrt(D d / (A' K))`` and ``N = (2 pi / 3) E* a' d / K``.
    """
    along, across = np.broadcast_arrays(np.asarray(A, dtype=float), np.asarray(B, dtype=float))
    if not (np.all(along > 0.0) and np.all(across > 0.0) and np.all(np.isfinite(along + across))):
        raise DataError("contact curvatures: A and B must be positive and finite at every node")
    small = np.minimum(along, across)
    kappa = _axis_ratio(np.maximum(along, across) / small)
    k, d = _curvature_integrals(kappa)
    major = np.sqrt(d / (small * k))
    effective = E / (2.0 * (1.0 - nu * nu))
    c_hertz = (2.0 * np.pi / 3.0) * effective * major / k
    rolling_is_major = along <= across
    a_s = np.where(rolling_is_major, major, kappa * major)
    b_s = np.where(rolling_is_major, kappa * major, major)
    return c_hertz, a_s, b_s
