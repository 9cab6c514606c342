"""FASTSIM: exact integrals of the simplified theory, and convergence of its grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sayd_env.physics.contact.fastsim import fastsim
from sayd_env.physics.contact.kalker import kalker_coefficients

G, A, B, MU, N = 82e9, 4.5e-3, 6.5e-3, 0.35, 70e3
C11, C22, C23 = (float(c) for c in kalker_coefficients(A / B, 0.28))


def forces(
    xi_x: float, xi_y: float, spin: float, grid: int = 200, **options: bool
) -> tuple[float, float, float]:
    """The kernel for the contact of this file."""
    return fastsim(xi_x, xi_y, spin, N, A, B, C11, C22, C23, MU, G, grid, grid, **options)


def test_linear_forces() -> None:
    """Small creepage gives Kalker's linear forces (Kalker 1982): the flexibilities are made for that."""
    tiny = 1e-7
    assert forces(tiny, 0.0, 0.0)[0] == pytest.approx(-G * A * B * C11 * tiny, rel=2e-3)
    assert forces(0.0, tiny, 0.0)[1] == pytest.approx(-G * A * B * C22 * tiny, rel=2e-3)
    assert forces(0.0, 0.0, tiny)[1] == pytest.approx(-G * (A * B) ** 1.5 * C23 * tiny, rel=2e-3)


@pytest.mark.parametrize("parabolic", [False, True])
def test_coulomb_limit(parabolic: bool) -> None:
    """Large creepage: mu N against the creepage, no moment."""
    fx, fy, mz = forces(0.3, -0.4, 0.0, parabolic=parabolic)
    np.testing.assert_allclose((fx, fy), (-0.6 * MU * N, 0.8 * MU * N), rtol=2e-3)
    assert abs(mz) < 1e-3 * MU * N * A


def test_pure_longitudinal_parabolic() -> None:
    """Closed form for the parabolic bound: F = mu N (tau - tau^2 / 3 + tau^3 / 27), Kalker's strip argument.

    With a slope k = xi / (L g') every strip slides from the point where k (h - x) meets the bound; the
    integral over the ellipse is done by quadrature on 2000 strips here.
    """
    xi = 1.5e-3
    peak = 2.0 * MU * N / (math.pi * A * B)
    slope = 3.0 * G * C11 * xi / (8.0 * A)
    y = (np.arange(2000) + 0.5) / 1000.0 - 1.0
    half = A * np.sqrt(1.0 - y**2)
    stick = np.clip(half - (slope * A**2 / peak - half), 0.0, None)
    stick = np.minimum(stick, 2.0 * half)
    turn = half - stick
    slip = peak / A**2 * (half**2 * (turn + half) - (turn**3 + half**3) / 3.0)
    force = np.sum(0.5 * slope * stick**2 + slip) * B * 1e-3
    assert -forces(xi, 0.0, 0.0, 400, parabolic=True)[0] == pytest.approx(force, rel=2e-3)


@pytest.mark.parametrize("parabolic", [False, True])
@pytest.mark.parametrize("creep", [(1e-3, 5e-4, 0.0), (5e-4, -1e-3, 0.5), (3e-3, 2e-3, 1.0)])
def test_both_marches_converge(parabolic: bool, creep: tuple[float, float, float]) -> None:
    """Both marches, by whole elements and from the exact edge, have one limit: 0.3 % of mu N apart at 400."""
    exact = forces(*creep, 400, parabolic=parabolic)
    element = forces(*creep, 400, parabolic=parabolic, whole_elements=True)
    coarse = forces(*creep, 100, parabolic=parabolic)
    np.testing.assert_allclose(exact[:2], element[:2], atol=3e-3 * MU * N)
    np.testing.assert_allclose(coarse[:2], exact[:2], atol=3e-3 * MU * N)


def test_signs() -> None:
    """Reversed creepages reverse all forces; mirrored ones (y, spin) reverse the lateral force and moment."""
    fx, fy, mz = forces(1e-3, -7e-4, 0.3)
    np.testing.assert_allclose(forces(-1e-3, 7e-4, -0.3), (-fx, -fy, -mz), rtol=1e-9)
    np.testing.assert_allclose(forces(1e-3, 7e-4, -0.3), (fx, -fy, -mz), rtol=1e-9)


def test_no_creepage() -> None:
    """No creepage, no force."""
    assert forces(0.0, 0.0, 0.0) == (0.0, 0.0, 0.0)
