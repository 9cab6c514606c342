"""The creep laws of the time loop: limits, symmetry and smoothness of the table, its file, one interface."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from sayd_env.config.units import Array
from sayd_env.physics import array_cache
from sayd_env.physics.array_cache import stored_array
from sayd_env.physics.contact import creep
from sayd_env.physics.contact.fastsim import fastsim
from sayd_env.physics.contact.kalker import TABLE_C11, TABLE_C22, TABLE_C23, TABLE_RATIO, kalker_coefficients
from sayd_env.physics.contact.polach import polach_forces
from sayd_env.physics.kernel import _DistinctArrays

G, MU, N, POISSON, AXIS = 82e9, 0.35, 75e3, 0.28, 5.5e-3
CREEPAGES = 2e-3 * np.array([1.0, 1.0, 1.0 / AXIS])
"""Sizes of xi_x, xi_y and spin (1/m) that saturate this contact."""


def forces(
    xi_x: object, xi_y: object, spin: object, ratio: object = 1.8, law: str = "table", nu: float = POISSON
) -> Array:
    """Forces over mu N by a law in a contact with the ratio a/b."""
    root = np.sqrt(np.asarray(ratio, dtype=float))
    found = creep.creep_forces(law, xi_x, xi_y, spin, N, AXIS * root, AXIS / root, MU, G, nu)  # type: ignore[arg-type]
    return np.asarray(found[:2] / (MU * N))


def random_contacts(count: int, seed: int) -> tuple[Array, ...]:
    """xi_x, xi_y, spin (1/m) and a/b: creepages to 1 %, spin to 1 1/m, a/b 0.3 to 5."""
    rng = np.random.default_rng(seed)
    xi_x, xi_y = 10.0 ** rng.uniform(-5.0, -2.0, (2, count)) * rng.choice((-1.0, 1.0), (2, count))
    return xi_x, xi_y, rng.uniform(-1.0, 1.0, count), np.exp(rng.uniform(np.log(0.3), np.log(5.0), count))


@pytest.mark.parametrize("column", [0, 1, 2])
def test_initial_slope_is_kalkers(column: int):
    """Kalker (1990), table E.3, all ratios 0.1 to 10: within 1 %."""
    nu, tiny = (0.0, 0.25, 0.5)[column], 1e-8
    root = np.sqrt(TABLE_RATIO)
    a, b = AXIS * root, AXIS / root
    linear = G * a * b * tiny * np.array([TABLE_C11, TABLE_C22, TABLE_C23 * AXIS])[:, :, column]
    found = [forces(*(tiny * unit), TABLE_RATIO, nu=nu) * MU * N for unit in np.eye(3)]
    np.testing.assert_allclose(-found[0][0], linear[0], rtol=1e-2)
    np.testing.assert_allclose(-found[1][1], linear[1], rtol=1e-2)
    np.testing.assert_allclose(-found[2][1], linear[2], rtol=1e-2)
    for pure, across in zip(found, (1, 0, 0), strict=True):
        np.testing.assert_allclose(pure[across], 0.0, atol=1e-6 * np.min(linear))


@pytest.mark.parametrize("ratio", [0.05, 0.3, 1.0, 4.0, 15.0])
def test_sliding(ratio: float):
    """Large creepage without spin: mu N against the creepage, whatever its direction, within 1.5 %.

    In the table's terms the direction of the creepage is that of (C11 xi_x, C22 xi_y): between its nodes.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    found = forces(1e3 * np.cos(angle), 1e3 * np.sin(angle), 0.0, ratio)
    error = np.hypot(found[0] + np.cos(angle), found[1] + np.sin(angle))
    print(f"sliding at a/b {ratio}: {error.max():.4f} mu N")
    assert error.max() <= 1.5e-2


def test_no_more_than_friction_allows():
    """Coulomb: no force beyond mu N, at any creepage, spin and ellipse."""
    rng = np.random.default_rng(2)
    n = 20000
    xi_x, xi_y = 10.0 ** rng.uniform(-4.0, -1.0, (2, n)) * rng.choice((-1.0, 1.0), (2, n))
    spin = 10.0 ** rng.uniform(-3.0, 0.5, n)
    size = np.hypot(*forces(xi_x, xi_y, spin, np.exp(rng.uniform(np.log(0.1), np.log(10.0), n))))
    assert size.max() <= 1.0 + 1e-12
    assert size.max() > 0.99


def test_symmetry():
    """Reversed xi_x reverses Fx alone; reversed xi_y and spin reverse Fy alone: to the bit."""
    xi_x, xi_y, spin, ratio = random_contacts(200, 0)
    fx, fy = forces(xi_x, xi_y, spin, ratio)
    np.testing.assert_array_equal(forces(-xi_x, xi_y, spin, ratio), [-fx, fy])
    np.testing.assert_array_equal(forces(xi_x, -xi_y, -spin, ratio), [fx, -fy])


def test_no_creepage_and_no_contact():
    """No creepage, no force; no load, no force, whatever the creepages; no patch makes no nonsense."""
    for law in creep.LAWS:
        np.testing.assert_allclose(forces(0.0, 0.0, 0.0, law=law), 0.0, atol=1e-15)
        x = np.zeros((creep.ROWS_IN, 2))
        x[creep.XI_X : creep.BOUND] = 1e-3
        x[creep.C11 :] = 4.0
        out = np.full((creep.ROWS_OUT, 2), np.nan)
        run(law, x, out)
        np.testing.assert_array_equal(out, 0.0)


def test_what_is_not_a_number_stays_inside_the_table():
    """A vehicle that diverges must not read outside the table: something huge lies before and behind it."""
    table = creep.law_table("table", POISSON)
    around = np.full(3 * len(table), 1e300)
    around[len(table) : 2 * len(table)] = table
    for row, value in product(range(creep.ROWS_IN), (np.nan, np.inf, -np.inf)):
        x = np.full((creep.ROWS_IN, 1), 1e-3)
        x[row] = value
        out = np.empty(creep.ROWS_OUT)
        creep.table_rows(x.ravel(), out, creep.scratch(1), around[len(table) : 2 * len(table)], G)
        assert not np.any(np.abs(out[np.isfinite(out)]) > 1e100)


def run(law: str, x: Array, out: Array) -> None:
    """A kernel over the contacts in the columns of x."""
    kernel = (creep.table_rows, creep.polach_rows, creep.fastsim_rows)[creep.LAWS.index(law)]
    flat = np.empty(out.size)
    kernel(x.ravel(), flat, creep.scratch(x.shape[1]), creep.law_table(law, POISSON), G)
    out[:] = flat.reshape(out.shape)


@pytest.mark.parametrize("law", creep.LAWS)
def test_a_contact_does_not_see_its_neighbours(law: str):
    """The same bits alone, among 8, among 64 and among 77 (a rest behind the vector instructions)."""
    xi_x, xi_y, spin, ratio = random_contacts(77, 1)
    root = np.sqrt(ratio)
    coefficients = kalker_coefficients(ratio, POISSON)
    x = np.array([xi_x, xi_y, spin, np.full(77, MU * N), AXIS * root, AXIS / root, *coefficients])
    every = np.empty((creep.ROWS_OUT, 77))
    run(law, x, every)
    for count in (1, 8, 64):
        some = np.empty((creep.ROWS_OUT, count))
        run(law, np.ascontiguousarray(x[:, :count]), some)
        np.testing.assert_array_equal(some, every[:, :count])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_slopes_are_continuous(axis: int):
    """Along each creepage, through zero and many cells: the slope's change over a step goes with the step.

    At a kink the second difference over the step stays as it is when the step is made smaller; with
    continuous slopes it falls with it.
    """
    x = np.linspace(-6.0, 6.0, 4001) * CREEPAGES[axis]
    # Small creepages, too: there the forces rise steepest.
    x = np.unique(np.concatenate([x, 1e-2 * x, [0.0]]))
    for ratio, rest in product((0.3, 1.0, 2.7), ((0.0, 0.0), (0.3, -0.2), (-1.0, 0.5))):
        others = np.insert(np.array(rest), axis, 0.0) * CREEPAGES
        jumps = []
        for step in (1e-3, 1e-5):
            h = step * CREEPAGES[axis]
            left, middle, right = (along(axis, x + k * h, others, ratio) for k in (-1.0, 0.0, 1.0))
            slopes = np.abs(right - middle) / step
            jumps.append(np.abs(right - 2.0 * middle + left).max() / step / slopes.max())
        assert jumps[1] < max(0.02 * jumps[0], 1e-5)


def along(axis: int, x: Array, others: Array, ratio: float) -> Array:
    """Forces over one creepage, the other two being constant."""
    creepages = [np.full(len(x), value) for value in others]
    creepages[axis] = x
    return forces(creepages[0], creepages[1], creepages[2], ratio)


def test_continuous_over_the_ellipse_and_constant_beyond_its_ends():
    """No jump over a/b; beyond 1/10 and 10 the shape of the curve is that of the end."""
    ratio = np.geomspace(0.05, 20.0, 4001)
    step = np.abs(np.diff(forces(5e-4, -7e-4, 0.3, ratio), axis=1))
    assert step.max() < 5e-3
    small = 1e-9
    for end in (0.03, 30.0):
        c11 = float(kalker_coefficients(end, POISSON)[0])
        assert -forces(small, 0.0, 0.0, end)[0] == pytest.approx(
            G * AXIS**2 * c11 * small / (MU * N), rel=1e-3
        )


def test_table_beside_fastsim_and_beside_linear_interpolation():
    """Random contacts against FASTSIM with twice the elements; linear interpolation of the same nodes.

    Measured: the table errs by 0.20 % of mu N in the mean and 4.0 % at most. Linear interpolation between the
    same nodes errs by 0.65 % and 7.7 %, by 6 to 8 % of the slopes at no creepage, and has kinks at all cells.
    """
    xi_x, xi_y, spin, ratio = random_contacts(20000, 3)
    exact = reference(xi_x, xi_y, spin, ratio, 128)
    error = np.hypot(*(forces(xi_x, xi_y, spin, ratio) - exact))
    print(f"table against FASTSIM: mean {error.mean():.4f}, largest {error.max():.4f} mu N")
    assert error.mean() <= 0.005
    assert error.max() <= 0.06
    plain = np.hypot(*(linear_interpolation(xi_x, xi_y, spin, ratio) - exact))
    print(f"linear interpolation: mean {plain.mean():.4f}, largest {plain.max():.4f} mu N")
    assert error.mean() < 0.6 * plain.mean()


def reference(xi_x: Array, xi_y: Array, spin: Array, ratio: Array, elements: int) -> Array:
    """Forces over mu N by FASTSIM with the parabolic bound on so many elements."""
    root = np.sqrt(ratio)
    rows = (xi_x, xi_y, spin, np.full(len(ratio), MU * N), AXIS * root, AXIS / root)
    x = np.concatenate([*rows, *kalker_coefficients(ratio, POISSON)])
    out = np.empty(creep.ROWS_OUT * len(ratio))
    creep.fastsim_rows(x, out, creep.scratch(len(ratio)), np.array([float(elements)]), G)
    return np.asarray(out.reshape(creep.ROWS_OUT, -1)[:2] / (MU * N))


def linear_interpolation(xi_x: Array, xi_y: Array, spin: Array, ratio: Array) -> Array:
    """What the table's nodes would give, interpolated linearly in U, V and W (and over a/b as the table)."""
    c, s = 1.5, math.sqrt(3.0)
    cells = (8, 8, 14)
    axes = [np.arange(0, cells[0] + 2) / cells[0]]
    axes.append(np.arange(-cells[1] - 1, cells[1] + 2) / cells[1])
    axes.append(np.arange(0, cells[2] + 2) / cells[2])
    place = np.stack(np.meshgrid(*axes, indexing="ij"))
    radius = np.sqrt(np.sum(place**2, axis=0))
    inside = np.minimum(radius, 1.0 - 1e-6)
    u, v, w = place * (c / (1.0 - inside)) * np.where(radius > 1.0, inside / np.maximum(radius, 1.0), 1.0)
    stiffness = G * AXIS**2 / (MU * N)
    t, found = np.sqrt(ratio) / (np.sqrt(ratio) + creep._RATIO_MIDDLE), np.zeros((2, len(ratio)))
    fifth, last = (math.sqrt(r) / (math.sqrt(r) + creep._RATIO_MIDDLE) for r in (5.0, 10.0))
    nodes = last - 0.5 * (last - fifth) * np.arange(12.0, -1.0, -1.0)
    c11, c22, c23 = kalker_coefficients(ratio, POISSON)
    point = stiffness * np.array([c11 * xi_x, c22 * xi_y, s * AXIS * c23 * spin])
    point = point / (c + np.sqrt(np.sum(point**2, axis=0)))
    sign = np.where(spin >= 0.0, 1.0, -1.0)
    query = np.array([np.abs(point[0]), sign * point[1], np.abs(point[2])]).T
    for node in nodes:
        share = np.maximum(0.0, 1.0 - np.abs(t - node) / (nodes[1] - nodes[0]))
        a_over_b = (creep._RATIO_MIDDLE * node / (1.0 - node)) ** 2
        k11, k22, k23 = (stiffness * float(k) for k in kalker_coefficients(a_over_b, POISSON))
        grid = (u / k11, v / k22, w / (s * AXIS * k23))
        values = reference(*(part.ravel() for part in grid), np.full(u.size, a_over_b), 64)
        for k, component in enumerate(values):
            table = RegularGridInterpolator(axes, component.reshape(u.shape))
            found[k] += share * table(query)
    return found * np.array([np.where(xi_x >= 0.0, 1.0, -1.0), sign])


def test_fastsim_and_polach_are_the_laws_of_their_modules():
    """Row kernels against the functions for one contact: FASTSIM on 32 x 32 elements, and Polach."""
    xi_x, xi_y, spin, ratio = random_contacts(20, 4)
    root = np.sqrt(ratio)
    a, b = AXIS * root, AXIS / root
    coefficients = kalker_coefficients(ratio, POISSON)
    found = creep.creep_forces("fastsim", xi_x, xi_y, spin, N, a, b, MU, G, POISSON)
    for i in range(20):
        c = [float(values[i]) for values in coefficients]
        alone = fastsim(xi_x[i], xi_y[i], spin[i], N, a[i], b[i], *c, MU, G, 32, 32, True)
        np.testing.assert_allclose(found[:, i], alone, rtol=1e-12)
    expected = polach_forces(xi_x, xi_y, spin, N, a, b, coefficients, MU, G)
    found = creep.creep_forces("polach", xi_x, xi_y, spin, N, a, b, MU, G, POISSON)
    np.testing.assert_allclose(found[:2], expected, rtol=1e-14)


def test_unknown_law_is_refused():
    with pytest.raises(ValueError, match="creep law 'kalker': expected one of table, polach, fastsim"):
        forces(0.0, 0.0, 0.0, law="kalker")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], list[Path]]]:
    """An empty cache; tells the tables in it."""
    monkeypatch.setenv("SAYD_CACHE_DIR", str(tmp_path))
    creep.creep_table.cache_clear()
    yield lambda: sorted(tmp_path.glob("creep-*"))
    creep.creep_table.cache_clear()


def test_table_is_kept_and_read(folder: Callable[[], list[Path]]):
    """One file, no temporary ones; the next process reads what this one made, to the bit."""
    made = creep.creep_table(POISSON)
    (file,) = folder()
    creep.creep_table.cache_clear()
    before = file.stat().st_mtime_ns
    np.testing.assert_array_equal(creep.creep_table(POISSON), made)
    assert file.stat().st_mtime_ns == before
    creep.creep_table(0.3)
    assert len(folder()) == 2  # another Poisson's ratio is another table
    assert made.nbytes < 0.75 * 2**20  # beside the other work in a core's second cache


@pytest.mark.parametrize("damage", ["cut", "flipped", "emptied", "other"])
def test_damaged_file_is_made_anew(folder: Callable[[], list[Path]], damage: str):
    made = creep.creep_table(POISSON)
    (file,) = folder()
    content = bytearray(file.read_bytes())
    if damage == "cut":
        file.write_bytes(content[: len(content) // 2])
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
    elif damage == "emptied":
        file.write_bytes(b"")
    else:
        np.save(file, np.zeros(7))
    creep.creep_table.cache_clear()
    np.testing.assert_array_equal(creep.creep_table(POISSON), made)
    creep.creep_table.cache_clear()
    np.testing.assert_array_equal(stored_array(file, len(made)), made)


def test_table_without_a_place_to_write(monkeypatch: pytest.MonkeyPatch):
    """No cache directory can be written: the table is made all the same."""
    monkeypatch.setattr(array_cache, "cache_folder", lambda: None)
    creep.creep_table.cache_clear()
    assert np.all(np.isfinite(creep.creep_table(POISSON)))
    creep.creep_table.cache_clear()


@pytest.mark.compiled
def test_compiled_law_has_no_gathers():
    """Weights in packed arithmetic, rows of the table in contiguous reads: a loss would show here.

    Compiled anew with the decorator's options: Numba shows no code of a kernel that comes from its cache.
    """
    law = numba.njit(error_model="numpy", nogil=True, pipeline_class=_DistinctArrays, _nrt=False)(  # type: ignore[call-overload]
        creep.table_rows.py_func
    )
    x = np.full(8 * creep.ROWS_IN, 1e-3)
    law(x, np.empty(8 * creep.ROWS_OUT), creep.scratch(8), creep.creep_table(POISSON), G)
    (assembly,) = law.inspect_asm().values()
    assert assembly.count("divpd") >= 3
    assert assembly.count("sqrtpd") >= 2
    assert assembly.count("mulpd") >= 18  # the products of a stencil's rows with their weights
    assert "gather" not in assembly
