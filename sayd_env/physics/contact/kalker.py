"""Kalker's coefficients of the linear theory of rolling contact.

They give the initial slope of the creep forces of two like bodies with the contact semi-axes a (rolling) and
b (lateral) and the shear modulus G::

    F_x = -G a b C11 xi_x
    F_y = -G a b C22 xi_y - G (a b)^1.5 C23 spin

The table is mathematics (the half-space solved once for all), not a parameter: it stands here, and not among
the configurations.

References
----------
J. J. Kalker, Three-Dimensional Elastic Bodies in Rolling Contact (Kluwer, 1990), table E.3 and its
asymptotes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sayd_env.config.units import Array

# Nodes of the table: a/b = 0.1 ... 1.0 and then b/a = 0.9 ... 0.1; the columns are nu = 0, 0.25 and 0.5.
TABLE_RATIO: Array = np.concatenate(
    [np.arange(1, 11) / 10.0, 10.0 / np.arange(9, 0, -1)],
)
TABLE_NU: Array = np.array([0.0, 0.25, 0.5])

# fmt: off
TABLE_C11: Array = np.array([
    [2.51, 3.31, 4.85], [2.59, 3.37, 4.81], [2.68, 3.44, 4.80], [2.78, 3.53, 4.82], [2.88, 3.62, 4.83],
    [2.98, 3.72, 4.91], [3.09, 3.81, 4.97], [3.19, 3.91, 5.05], [3.29, 4.01, 5.12], [3.40, 4.12, 5.20],
    [3.51, 4.22, 5.30], [3.65, 4.36, 5.42], [3.82, 4.54, 5.58], [4.06, 4.78, 5.80], [4.37, 5.10, 6.11],
    [4.84, 5.57, 6.57], [5.57, 6.34, 7.34], [6.96, 7.78, 8.82], [10.7, 11.7, 12.9],
])
TABLE_C22: Array = np.array([
    [2.51, 2.52, 2.53], [2.59, 2.63, 2.66], [2.68, 2.75, 2.81], [2.78, 2.88, 2.98], [2.88, 3.01, 3.14],
    [2.98, 3.14, 3.31], [3.09, 3.28, 3.48], [3.19, 3.41, 3.65], [3.29, 3.54, 3.82], [3.40, 3.67, 3.98],
    [3.51, 3.81, 4.16], [3.65, 3.99, 4.39], [3.82, 4.21, 4.67], [4.06, 4.50, 5.04], [4.37, 4.90, 5.56],
    [4.84, 5.48, 6.31], [5.57, 6.40, 7.51], [6.96, 8.14, 9.79], [10.7, 12.8, 16.0],
])
# Some printings have 1.15 at a/b = 0.8, nu = 0.25, out of line with its neighbours; 1.25 is right.
TABLE_C23: Array = np.array([
    [0.334, 0.473, 0.731], [0.483, 0.603, 0.809], [0.607, 0.715, 0.889], [0.720, 0.823, 0.977],
    [0.827, 0.929, 1.07], [0.930, 1.03, 1.18], [1.03, 1.14, 1.29], [1.13, 1.25, 1.40], [1.23, 1.36, 1.51],
    [1.33, 1.47, 1.63], [1.44, 1.59, 1.77], [1.58, 1.75, 1.94], [1.76, 1.95, 2.18], [2.01, 2.23, 2.50],
    [2.35, 2.62, 2.96], [2.88, 3.24, 3.70], [3.79, 4.32, 5.01], [5.72, 6.63, 7.89], [12.2, 14.6, 18.0],
])
# fmt: on

# The table's axis in the ratio g = min(a/b, b/a), unrolled so that it grows: g for a <= b, 2 - g beyond.
_TABLE_AXIS = np.where(TABLE_RATIO <= 1.0, TABLE_RATIO, 2.0 - 1.0 / TABLE_RATIO)


def _nu_weights(nu: float) -> Array:
    """Lagrange weights of the three columns at a Poisson's ratio."""
    n0, n1, n2 = TABLE_NU
    return np.array(
        [
            (nu - n1) * (nu - n2) / ((n0 - n1) * (n0 - n2)),
            (nu - n0) * (nu - n2) / ((n1 - n0) * (n1 - n2)),
            (nu - n0) * (nu - n1) / ((n2 - n0) * (n2 - n1)),
        ]
    )


def _asymptotes_wide(g: Array, nu: float) -> list[Array]:
    """C11, C22, C23 of a contact much wider than long, g = a/b << 1."""
    c11 = np.full_like(g, np.pi**2 / (4.0 * (1.0 - nu)))
    c22 = np.full_like(g, np.pi**2 / 4.0)
    c23 = np.pi * np.sqrt(g) / (3.0 * (1.0 - nu)) * (1.0 + nu * (np.log(16.0 / g) - 5.0))
    return [c11, c22, c23]


def _asymptotes_long(g: Array, nu: float) -> list[Array]:
    """C11, C22, C23 of a contact much longer than wide, g = b/a << 1."""
    log = np.log(16.0 / (g * g))
    rest = 3.0 - np.log(4.0)
    d11 = log - 2.0 * nu
    d22 = (1.0 - nu) * log + 2.0 * nu
    c11 = 2.0 * np.pi / (d11 * g) * (1.0 + rest / d11)
    c22 = 2.0 * np.pi / (d22 * g) * (1.0 + (1.0 - nu) * rest / d22)
    c23 = 2.0 * np.pi / (3.0 * g**1.5 * ((1.0 - nu) * log - 2.0 + 4.0 * nu))
    return [c11, c22, c23]


def kalker_coefficients(a_over_b: ArrayLike, nu: float) -> tuple[Array, Array, Array]:
    """Kalker's C11, C22 and C23 at any axis ratio.

    Parameters
    ----------
    a_over_b : array_like
        Semi-axis in rolling direction over lateral semi-axis, positive.
    nu : float
        Poisson's ratio, 0 to 0.5.

    Returns
    -------
    c11, c22, c23 : ndarray
        Coefficients in the shape of `a_over_b`.

    Notes
    -----
    The coefficients are piecewise linear in g = min(a/b, b/a), then 1/C is quadratic in nu (as in CONTACT).
    Outside a/b = 0.1 ... 10 stand Kalker's asymptotes, which miss the table's ends by up to 6 %; a factor
    linear in g closes that jump and goes to 1 with g to 0: the coefficients are continuous, the limit exact.
    """
    ratio = np.asarray(a_over_b, dtype=float)
    g = np.minimum(ratio, 1.0 / ratio)
    axis = np.where(ratio <= 1.0, g, 2.0 - g)
    edge = np.asarray(TABLE_RATIO[0])
    share = g / edge
    outside = np.minimum(g, edge)  # inside the table the asymptotes are evaluated at its end, then dropped
    wide, long = _asymptotes_wide(outside, nu), _asymptotes_long(outside, nu)
    edge_wide, edge_long = _asymptotes_wide(edge, nu), _asymptotes_long(edge, nu)
    weights = _nu_weights(nu)
    coefficients = []
    for i, table in enumerate((TABLE_C11, TABLE_C22, TABLE_C23)):
        ends = 1.0 / ((1.0 / table[[0, -1]]) @ weights)
        below = wide[i] * (1.0 + (ends[0] / edge_wide[i] - 1.0) * share)
        above = long[i] * (1.0 + (ends[1] / edge_long[i] - 1.0) * share)
        slender = np.where(ratio <= 1.0, below, above)
        columns = [np.interp(axis, _TABLE_AXIS, column) for column in table.T]
        inside = 1.0 / sum(weight / column for weight, column in zip(weights, columns, strict=True))
        coefficients.append(np.where(g < edge, slender, inside))
    return coefficients[0], coefficients[1], coefficients[2]
