"""Polach's creep forces with spin: a creep law of the time loop beside the table of FASTSIM.

The kernel `polach` is straight-line arithmetic without branches and is inlined into its callers, so that a
loop over the wheels compiles to vector instructions: give that loop an end that the compiler does not know
(an array's length), or it unrolls the loop instead of vectorising it.

References
----------
O. Polach, A fast wheel-rail forces calculation computer code, Vehicle System Dynamics 33 suppl. (1999)
728-739: the law with spin. O. Polach, Creep forces in simulations of traction vehicles running on adhesion
limit, Wear 258 (2005) 992-1000: the reduction factors k_A and k_S.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from sayd_env.config.units import Array
from sayd_env.physics.kernel import kernel

# Odd fraction t P(z) / Q(z), z = t^2, with the least maximum error (4.6e-10) to atan on [0, 1], by iterated
# weighted least squares.
_P1, _P2, _P3 = 1.12362280389, 0.282668985531, 0.00868905945112
_Q1, _Q2, _Q3 = 1.45695597837, 0.568324430221, 0.0495687062001

_HALF_PI = 0.5 * math.pi
_TWO_OVER_PI = 2.0 / math.pi
_QUARTER_PI = 0.25 * math.pi
# Added to squared creepages: no creepage gives no force, without a branch.
_NO_CREEP = 1e-60
# Least friction bound to divide by (N); the result is multiplied by the true bound.
_NO_FORCE = 1e-9


@kernel(inline=True)
def arctangent(x: float) -> float:
    """Arc tangent of x >= 0, maximum error 5e-10 at 0.9999 pi/2: a rational function, which vectorises.

    Above 1 it is pi/2 - atan(1/x); numerator and denominator are selected, so there is no jump.
    """
    beyond = x > 1.0
    t = (1.0 if beyond else x) / (x if beyond else 1.0)
    z = t * t
    value = t * (1.0 + z * (_P1 + z * (_P2 + z * _P3))) / (1.0 + z * (_Q1 + z * (_Q2 + z * _Q3)))
    return _HALF_PI - value if beyond else value


def polach_spin_gain(a_over_b: ArrayLike) -> Array:
    """Factor K = 1 + 6.3 (1 - exp(-a/b)) of Polach's spin force (1999), constant for an ellipse."""
    return np.asarray(1.0 - 6.3 * np.expm1(-np.asarray(a_over_b, dtype=float)))


@kernel(inline=True)
def polach(
    xi_x: float,
    xi_y: float,
    spin: float,
    normal: float,
    a: float,
    b: float,
    c11: float,
    c22: float,
    c23: float,
    spin_gain: float,
    friction: float,
    shear_modulus: float,
    k_a: float = 1.0,
    k_s: float = 1.0,
) -> tuple[float, float]:
    """Creep forces on the wheel by Polach's law.

    Parameters
    ----------
    xi_x, xi_y : float
        Longitudinal and lateral creepage of the wheel over the rail.
    spin : float
        Spin creepage (1/m).
    normal : float
        Normal force (N); the result is 0 if it is not positive.
    a, b : float
        Semi-axes of the contact ellipse in rolling and lateral direction (m).
    c11, c22, c23 : float
        Kalker's coefficients of this ellipse.
    spin_gain : float
        K of `polach_spin_gain`.
    friction : float
        Friction coefficient.
    shear_modulus : float
        Shear modulus (Pa).
    k_a, k_s : float
        Reduction of the creep stiffness in the area of adhesion and of slip (Polach 2005), 1 for clean
        half-space contact. They act on the force of xi_x and xi_y, not on that of spin.

    Returns
    -------
    fx, fy : float
        Longitudinal and lateral force on the wheel (N).

    Notes
    -----
    With ``s_yc = max(|xi_y|, |xi_y + spin a|)`` and ``s_c = hypot(xi_x, s_yc)``::

        eps = pi/4 G a b c s_c / (mu N),        c = hypot(C11 xi_x, C22 xi_y) / hypot(xi_x, xi_y)
        F   = 2/pi mu N (k_A eps / (1 + (k_A eps)^2) + atan(k_S eps))
        e   = 8/3 G b sqrt(a b) C23 s_yc / (K mu N)
        F_S = 3/8 a K mu N e / (1 + e^2)^2
        fx  = -F xi_x / s_c,    fy = -(F xi_y + F_S spin) / s_c

    Polach writes F_S with d = (e^2 - 1) / (e^2 + 1) as 9/16 a K mu N times
    ``e (-d^3/3 + d^2/2 - 1/6) + (1 - d^2)^1.5 / 3``; this bracket is 2/3 e / (1 + e^2)^2 identically.
    """
    bound = friction * normal if normal > 0.0 else 0.0
    per_gain_bound = 1.0 / (spin_gain * (bound if bound > _NO_FORCE else _NO_FORCE))
    with_spin = abs(xi_y + spin * a)
    without_spin = abs(xi_y)
    lateral = with_spin if with_spin > without_spin else without_spin
    creep = math.sqrt(xi_x * xi_x + lateral * lateral + _NO_CREEP)
    per_creep = 1.0 / creep

    stiff_x = c11 * xi_x
    stiff_y = c22 * xi_y
    slope = math.sqrt((stiff_x * stiff_x + stiff_y * stiff_y) / (xi_x * xi_x + xi_y * xi_y + _NO_CREEP))
    eps = _QUARTER_PI * shear_modulus * (a * b) * slope * creep * (per_gain_bound * spin_gain)
    adhesion = k_a * eps
    force = (
        bound * _TWO_OVER_PI * (adhesion / (1.0 + adhesion * adhesion) + arctangent(k_s * eps)) * per_creep
    )

    e = (8.0 / 3.0) * shear_modulus * b * math.sqrt(a * b) * c23 * lateral * per_gain_bound
    decay = 1.0 + e * e
    spin_force = 0.375 * a * spin_gain * bound * e / (decay * decay) * per_creep
    return -force * xi_x, -(force * xi_y + spin_force * spin)


@kernel
def _polach_loop(cases: Array, shear_modulus: float, k_a: float, k_s: float, forces: Array) -> None:
    """`polach` over the columns of cases (11, n), in the order of its arguments, into forces (2, n)."""
    for i in range(cases.shape[1]):
        forces[0, i], forces[1, i] = polach(
            cases[0, i],
            cases[1, i],
            cases[2, i],
            cases[3, i],
            cases[4, i],
            cases[5, i],
            cases[6, i],
            cases[7, i],
            cases[8, i],
            cases[9, i],
            cases[10, i],
            shear_modulus,
            k_a,
            k_s,
        )


def polach_forces(
    xi_x: ArrayLike,
    xi_y: ArrayLike,
    spin: ArrayLike,
    normal: ArrayLike,
    a: ArrayLike,
    b: ArrayLike,
    coefficients: tuple[ArrayLike, ArrayLike, ArrayLike],
    friction: ArrayLike,
    shear_modulus: float,
    k_a: float = 1.0,
    k_s: float = 1.0,
) -> tuple[Array, Array]:
    """`polach` for arrays that broadcast against each other.

    Parameters
    ----------
    xi_x, xi_y, spin, normal, a, b, friction, shear_modulus, k_a, k_s
        As for `polach`; all but the last three may be arrays.
    coefficients : tuple of array_like
        Kalker's C11, C22 and C23.

    Returns
    -------
    fx, fy : ndarray
        Forces on the wheel (N).
    """
    gain = polach_spin_gain(np.asarray(a, dtype=float) / np.asarray(b, dtype=float))
    columns = np.broadcast_arrays(xi_x, xi_y, spin, normal, a, b, *coefficients, gain, friction)
    shape = columns[0].shape
    cases = np.array([np.ravel(column) for column in columns], dtype=float)
    forces = np.empty((2, cases.shape[1]))
    _polach_loop(cases, shear_modulus, k_a, k_s, forces)
    return forces[0].reshape(shape), forces[1].reshape(shape)
