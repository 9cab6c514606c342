"""Kalker's coefficients: the table, its interpolation and the asymptotes."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.physics.contact.kalker import (
    TABLE_C11,
    TABLE_C22,
    TABLE_C23,
    TABLE_NU,
    TABLE_RATIO,
    kalker_coefficients,
)


@pytest.mark.parametrize("column", [0, 1, 2])
def test_table_nodes(column: int) -> None:
    """The published table comes back at every node."""
    found = kalker_coefficients(TABLE_RATIO, float(TABLE_NU[column]))
    for values, table in zip(found, (TABLE_C11, TABLE_C22, TABLE_C23), strict=True):
        np.testing.assert_allclose(values, table[:, column], rtol=1e-12)


def test_published_values() -> None:
    """Single entries of table E.3 (Kalker 1990), and the set of Zhai's VTCM for a = b and nu near 0.3."""
    c11, c22, c23 = kalker_coefficients([0.5, 1.0, 2.0, 0.8], 0.25)
    np.testing.assert_allclose(c11, [3.62, 4.12, 5.10, 3.91])
    np.testing.assert_allclose(c22, [3.01, 3.67, 4.90, 3.41])
    np.testing.assert_allclose(c23, [0.929, 1.47, 2.62, 1.25])
    np.testing.assert_allclose(np.ravel(kalker_coefficients(1.0, 0.3)), [4.336, 3.732, 1.502], rtol=0.01)


def test_c11_equals_c22_without_poisson() -> None:
    """For nu = 0 both directions are alike (Kalker 1990): C11 = C22 at any axis ratio."""
    ratio = np.geomspace(0.11, 9.0, 200)
    c11, c22, _ = kalker_coefficients(ratio, 0.0)
    np.testing.assert_allclose(c11, c22, rtol=1e-12)


@pytest.mark.parametrize("nu", [0.0, 0.28, 0.5])
@pytest.mark.parametrize("edge", [0.1, 1.0, 10.0])
def test_continuous(nu: float, edge: float) -> None:
    """No jump where table, branches and asymptotes meet."""
    below = kalker_coefficients(edge * (1.0 - 1e-9), nu)
    above = kalker_coefficients(edge * (1.0 + 1e-9), nu)
    np.testing.assert_allclose(below, above, rtol=1e-7)


def test_wide_limit() -> None:
    """The line contact across the rail: C11 = pi^2 / (4 (1 - nu)), C22 = pi^2 / 4 (Kalker 1990)."""
    c11, c22, _ = kalker_coefficients(1e-6, 0.28)
    assert float(c11) == pytest.approx(np.pi**2 / (4.0 * 0.72), rel=1e-4)
    assert float(c22) == pytest.approx(np.pi**2 / 4.0, rel=1e-4)
