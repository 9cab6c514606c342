"""Hertz coefficients against closed forms, the classical table and CONTACT."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from sayd_env.config.errors import DataError
from sayd_env.physics.contact.hertz import curvature_ratio, hertz_coefficients

E, NU = 210e9, 0.3

# Angle theta with cos(theta) = |B - A| / (A + B), the coefficients m and n of the major and minor semi-axis
# (value m n (3 pi N (k1 + k2) / (4 (A + B)))^(1/3)) and G8 of the approach. m, n: the classical table (e.g.
# Timoshenko and Goodier, Theory of Elasticity, article 140); G8: Zhai's vehicle-track code VTCM, which has
# 2.130 for m at 40 degrees where the classical table has 2.136.
CLASSICAL = np.array(
    [
        [30.0, 2.731, 0.493, 0.72627],
        [40.0, 2.136, 0.567, 0.81781],
        [50.0, 1.754, 0.641, 0.88662],
        [60.0, 1.486, 0.717, 0.93758],
        [70.0, 1.284, 0.802, 0.97197],
        [80.0, 1.128, 0.893, 0.99298],
        [90.0, 1.0, 1.0, 1.0],
    ]
)


def test_sphere() -> None:
    """Johnson, Contact Mechanics, equations 4.22 to 4.24: a^2 = R d, N = 4/3 E* sqrt(R) d^1.5."""
    radius = np.array([0.01, 0.3, 5.0])
    c_hertz, a_s, b_s = hertz_coefficients(0.5 / radius, 0.5 / radius, E, NU)
    effective = E / (2.0 * (1.0 - NU**2))
    np.testing.assert_allclose(c_hertz, 4.0 / 3.0 * effective * np.sqrt(radius), rtol=1e-12)
    np.testing.assert_allclose(a_s, np.sqrt(radius), rtol=1e-12)
    np.testing.assert_allclose(b_s, np.sqrt(radius), rtol=1e-12)


def test_classical_table() -> None:
    """m and n within 0.3 %, the approach within 0.1 %.

    The tables are old hand computation: at 70 degrees they have n = 0.802 and G8 = 0.97197, where quadrature
    of the ellipsoid's potential (next test) gives 0.7999 and 0.9726. The other entries agree better.
    """
    theta, m, n, approach = CLASSICAL.T
    total, force = 3.0, 80e3
    a_curv = 0.5 * total * (1.0 - np.cos(np.radians(theta)))
    c_hertz, a_s, b_s = hertz_coefficients(a_curv, total - a_curv, E, NU)
    pen = (force / c_hertz) ** (2.0 / 3.0)
    material = 2.0 * (1.0 - NU**2) / (np.pi * E)
    unit = (3.0 * np.pi * force * material / (4.0 * total)) ** (1.0 / 3.0)
    np.testing.assert_allclose(a_s * np.sqrt(pen) / unit, m, rtol=3e-3)
    np.testing.assert_allclose(b_s * np.sqrt(pen) / unit, n, rtol=3e-3)
    scale = ((1.5 * (1.0 - NU**2) / E) ** 2 * total) ** (1.0 / 3.0) * force ** (2.0 / 3.0)
    np.testing.assert_allclose(pen / scale, approach, rtol=1e-3)


@pytest.mark.parametrize("kappa", [0.95, 0.6224594, 0.2])
def test_potential_of_the_ellipsoid(kappa: float) -> None:
    """Curvatures and axes against quadrature of the potential integrals (Hertz 1882), no elliptic functions.

    With the major semi-axis 1, A is proportional to the integral of (1 + t^2)^-1.5 (kappa^2 + t^2)^-0.5 over
    t > 0, B to that with the exponents exchanged, and the approach to that with both exponents -0.5.
    """

    def integrals(k: float) -> tuple[float, float]:
        along = quad(lambda t: (1.0 + t * t) ** -1.5 * (k * k + t * t) ** -0.5, 0.0, np.inf, epsabs=1e-12)[0]
        across = quad(lambda t: (1.0 + t * t) ** -0.5 * (k * k + t * t) ** -1.5, 0.0, np.inf, epsabs=1e-12)[0]
        return along, across

    along, across = integrals(kappa)
    c_hertz, a_s, b_s = hertz_coefficients(along, across, E, NU)
    assert b_s / a_s == pytest.approx(kappa, rel=1e-7)
    approach = quad(lambda t: ((1.0 + t * t) * (kappa * kappa + t * t)) ** -0.5, 0.0, np.inf, epsabs=1e-12)[0]
    assert a_s == pytest.approx(approach**-0.5, rel=1e-7)
    # The same force on a circular contact of the same material: a^3 (A + B) scales with the integrals.
    circle = 0.5 * sum(integrals(1.0))
    c_circle, a_circle, _ = hertz_coefficients(circle, circle, E, NU)
    assert c_hertz / a_s**3 == pytest.approx(c_circle / a_circle**3, rel=1e-7)


@pytest.mark.parametrize("kappa", [0.9, 0.5, 0.1, 0.01])
def test_ellipse_equations(kappa: float) -> None:
    """The pressure of an ellipse of known axes asks for Johnson's curvatures (equations 4.26)."""
    e2, effective, p0, minor = 1.0 - kappa**2, E / (2.0 * (1.0 - NU**2)), 1e9, 4e-3
    k, e = ellipk(e2), ellipe(e2)
    along = p0 / effective * kappa**2 / (minor * e2) * (k - e)
    across = p0 / effective * kappa**2 / (minor * e2) * (e / kappa**2 - k)
    pen = p0 / effective * minor * k
    c_hertz, a_s, b_s = hertz_coefficients(along, across, E, NU)
    assert a_s * np.sqrt(pen) == pytest.approx(minor / kappa, rel=1e-9)
    assert b_s * np.sqrt(pen) == pytest.approx(minor, rel=1e-9)
    assert c_hertz * pen**1.5 == pytest.approx(2.0 / 3.0 * np.pi * p0 * minor**2 / kappa, rel=1e-9)


@pytest.mark.parametrize(
    ("a", "b", "approach"),
    [(3.889087e-3, 7.778175e-3, 0.08718e-3), (5.5e-3, 5.5e-3, 0.0898e-3)],
)
def test_contact_program(a: float, b: float, approach: float) -> None:
    """CONTACT (revision 2707): approach and peak pressure for N = 75 kN, G = 82 GPa, nu = 0.28."""
    g, nu, force = 82e9, 0.28, 75e3
    young = 2.0 * g * (1.0 + nu)

    def pen_for(total: float, share: float) -> tuple[float, float, float]:
        c_hertz, a_s, b_s = hertz_coefficients(share * total, (1.0 - share) * total, young, nu)
        pen = (force / c_hertz) ** (2.0 / 3.0)
        return float(pen), float(a_s * np.sqrt(pen)), float(b_s * np.sqrt(pen))

    def aspect(share: float) -> float:
        _, a_found, b_found = pen_for(2.0, share)
        return a_found / b_found - a / b

    share = brentq(aspect, 0.05, 0.95)
    total = brentq(lambda total: pen_for(total, share)[1] - a, 0.05, 50.0)
    pen, a_found, b_found = pen_for(total, share)
    assert b_found == pytest.approx(b, rel=1e-6)
    assert pen == pytest.approx(approach, rel=2e-4)
    assert 1.5 * force / (np.pi * a_found * b_found) == pytest.approx(1184e6, rel=5e-4)


def test_exchange_of_axes_and_scaling() -> None:
    """Exchanging A and B exchanges a and b; lengths scale with sqrt(1/curvature)."""
    a_curv, b_curv = np.array([1.2, 0.4, 3.0]), np.array([0.3, 2.0, 3.0])
    c1, a1, b1 = hertz_coefficients(a_curv, b_curv, E, NU)
    c2, a2, b2 = hertz_coefficients(4.0 * b_curv, 4.0 * a_curv, E, NU)
    np.testing.assert_allclose(c2, 0.5 * c1, rtol=1e-12)
    np.testing.assert_allclose(a2, 0.5 * b1, rtol=1e-12)
    np.testing.assert_allclose(b2, 0.5 * a1, rtol=1e-12)


def test_curvature_ratio_near_circle() -> None:
    """Series of equation 4.28 at the circle: ratio = 1 + 3/2 (1 - kappa), without cancellation."""
    small = 1e-7
    assert (curvature_ratio(1.0 - small) - 1.0) / small == pytest.approx(1.5, rel=1e-5)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_bad_curvature(bad: float) -> None:
    """Conformal or flat surfaces are no Hertzian contact."""
    with pytest.raises(DataError, match="positive and finite"):
        hertz_coefficients([1.0, bad], 1.0, E, NU)
    with pytest.raises(DataError, match="times the smaller"):
        hertz_coefficients(1e-9, 1.0, E, NU)
