"""Polach's law: its published form, limits and invariances."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from llvmlite import binding

from sayd_env.physics.contact import polach as module
from sayd_env.physics.contact.kalker import kalker_coefficients
from sayd_env.physics.contact.polach import (
    _polach_loop,
    polach_forces,
    polach_spin_gain,
)
from sayd_env.physics.kernel import kernel

G, A, B, MU, N = 82e9, 4.5e-3, 6.5e-3, 0.35, 70e3
C = tuple(float(c) for c in kalker_coefficients(A / B, 0.28))
GAIN = float(polach_spin_gain(A / B))


@kernel
def polach(*contact: float) -> tuple[float, float]:
    return module.polach(*contact)


@kernel
def arctangent(x: float) -> float:
    return module.arctangent(x)


def law(xi_x: float, xi_y: float, spin: float, normal: float = N, *factors: float) -> tuple[float, float]:
    """The kernel for the contact of this file; `factors` are k_A and k_S."""
    fx, fy = polach(xi_x, xi_y, spin, normal, A, B, *C, GAIN, MU, G, *factors)
    return float(fx), float(fy)


def published(xi_x: float, xi_y: float, spin: float) -> tuple[float, float]:
    """Polach (1999) as printed: with arc tangent, the variable d and the power 1.5."""
    c11, c22, c23 = C
    corrected = xi_y + spin * A if abs(xi_y + spin * A) > abs(xi_y) else xi_y
    creep = math.hypot(xi_x, corrected)
    plain = math.hypot(xi_x, xi_y)
    slope = math.hypot(c11 * xi_x / plain, c22 * xi_y / plain)
    eps = 0.25 * math.pi * G * A * B * slope * creep / (N * MU)
    force = 2.0 * N * MU / math.pi * (eps / (1.0 + eps**2) + math.atan(eps))
    gain = 1.0 + 6.3 * (1.0 - math.exp(-A / B))
    eps_s = 8.0 / 3.0 * B * math.sqrt(A * B) * G * c23 * abs(corrected) / (gain * N * MU)
    d = (eps_s**2 - 1.0) / (eps_s**2 + 1.0)
    bracket = eps_s * (-(d**3) / 3.0 + d**2 / 2.0 - 1.0 / 6.0) + (1.0 - d**2) ** 1.5 / 3.0
    spin_force = 9.0 / 16.0 * A * N * MU * gain * bracket
    return -force * xi_x / creep, -(force * xi_y + spin_force * spin) / creep


def test_published_form() -> None:
    """The closed spin bracket and the rational arc tangent change nothing (1e-8 of mu N)."""
    for xi_x, xi_y, spin in np.random.default_rng(1).normal(0.0, (3e-3, 3e-3, 0.4), (300, 3)):
        np.testing.assert_allclose(law(xi_x, xi_y, spin), published(xi_x, xi_y, spin), atol=1e-8 * MU * N)


def test_arctangent() -> None:
    """Against math.atan; the promised error is 1e-7."""
    for x in np.concatenate([np.linspace(0.0, 3.0, 3001), np.geomspace(3.0, 1e18, 200)]):
        assert abs(arctangent(float(x)) - math.atan(x)) < 1e-9


def test_initial_slope() -> None:
    """Kalker's linear forces at small creepage: -G a b C11, -G a b C22, -G (a b)^1.5 C23."""
    tiny = 1e-8
    area = G * A * B
    assert law(tiny, 0.0, 0.0)[0] == pytest.approx(-area * C[0] * tiny, rel=1e-5)
    assert law(0.0, tiny, 0.0)[1] == pytest.approx(-area * C[1] * tiny, rel=1e-5)
    assert law(0.0, 0.0, tiny)[1] == pytest.approx(-area * math.sqrt(A * B) * C[2] * tiny, rel=1e-5)


def test_coulomb_limit() -> None:
    """Sliding: mu N against the creepage."""
    for angle in np.linspace(0.0, 2.0 * math.pi, 13):
        fx, fy = law(math.cos(angle), math.sin(angle), 0.0)
        expected = (-MU * N * math.cos(angle), -MU * N * math.sin(angle))
        np.testing.assert_allclose((fx, fy), expected, atol=1e-5 * MU * N)


def test_direction_without_spin() -> None:
    """The force opposes the creepage at any size."""
    for xi_x, xi_y in np.random.default_rng(2).normal(0.0, 3e-3, (100, 2)):
        fx, fy = law(xi_x, xi_y, 0.0)
        assert fx * xi_y - fy * xi_x == pytest.approx(0.0, abs=1e-9 * MU * N * math.hypot(xi_x, xi_y))
        assert fx * xi_x + fy * xi_y < 0.0


def test_never_above_friction() -> None:
    """|F| <= mu N over all creepages that a wheel meets, spin included."""
    rng = np.random.default_rng(3)
    size = 20_000
    xi_x, xi_y = rng.normal(0.0, 1.0, (2, size)) * 10.0 ** rng.uniform(-5, -1, size)
    spin = rng.normal(0.0, 1.0, size) * 10.0 ** rng.uniform(-3, 0.5, size)
    fx, fy = polach_forces(xi_x, xi_y, spin, N, A, B, C, MU, G)
    assert np.all(np.hypot(fx, fy) <= MU * N * (1.0 + 1e-9))


def test_signs() -> None:
    """Reversed creepages reverse the forces; mirrored ones (y, spin) reverse the lateral force alone."""
    fx, fy = law(1e-3, -7e-4, 0.3)
    np.testing.assert_allclose(law(-1e-3, 7e-4, -0.3), (-fx, -fy), rtol=1e-14)
    np.testing.assert_allclose(law(1e-3, 7e-4, -0.3), (fx, -fy), rtol=1e-14)
    assert law(0.0, 0.0, 0.3)[1] < 0.0


@pytest.mark.parametrize("normal", [0.0, -5e3, 1e-12])
def test_no_contact(normal: float) -> None:
    """No normal force, no friction: finite and at most mu N."""
    fx, fy = law(1e-3, -1e-3, 0.2, normal)
    assert math.hypot(fx, fy) <= MU * max(normal, 0.0) * (1.0 + 1e-6)


def test_no_creepage() -> None:
    """Finite and zero without creepage; a lifted wheel has no contact ellipse either."""
    assert law(0.0, 0.0, 0.0) == (0.0, 0.0)
    assert polach(1e-3, 1e-3, 0.1, 0.0, 0.0, 0.0, *C, GAIN, MU, G) == (0.0, 0.0)


def test_reduction_factors() -> None:
    """Polach (2005): the initial slope falls to (k_A + k_S) / 2, the limit stays mu N for k_S > 0."""
    tiny = 1e-8
    full, reduced = law(tiny, 0.0, 0.0)[0], law(tiny, 0.0, 0.0, N, 0.8, 0.4)[0]
    assert reduced / full == pytest.approx(0.6, rel=1e-6)
    assert law(1e4, 0.0, 0.0, N, 0.8, 0.4)[0] == pytest.approx(-MU * N, rel=1e-6)


@pytest.mark.compiled
def test_loop_over_wheels_is_vectorised() -> None:
    """Packed divisions and roots in the machine code of the loop over wheels."""
    if not binding.get_host_cpu_features().get("avx2", False):
        pytest.skip("the instructions looked for need AVX2")
    loop = numba.njit(error_model="numpy")(
        _polach_loop.py_func
    )  # compiled here: code from a cache has no text
    loop(np.ones((11, 8)), G, 1.0, 1.0, np.empty((2, 8)))
    assembly = "".join(loop.inspect_asm().values())
    assert "vdivpd" in assembly
    assert "vsqrtpd" in assembly
