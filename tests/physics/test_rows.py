"""Sparse products of vehicles side by side: against dense ones, and bit for bit against one vehicle's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError

from sayd_env.config.units import Array
from sayd_env.physics.kernel import kernel
from sayd_env.physics.rows import ABREAST, SINGLE, Lanes, Rows, add_product, multiply, sparse_rows

ROWS, COLUMNS = 23, 17
EMPTY = (0, 7, 8, 22)
"""Rows without entries: the first, two in a row, the last."""
WIDTHS = pytest.mark.parametrize("lanes", [SINGLE, ABREAST], ids=["single", "abreast"])


@kernel(allocates=False)
def product(lanes: Lanes, start: Any, column: Any, value: Any, x: Any, out: Any) -> None:
    """`multiply`, which is merged into its callers, as a function of its own."""
    multiply(lanes, start, column, value, x, out)


@kernel(allocates=False)
def sum_with_product(lanes: Lanes, start: Any, column: Any, value: Any, x: Any, out: Any) -> None:
    """`add_product` likewise."""
    add_product(lanes, start, column, value, x, out)


def matrix(seed: int) -> Array:
    """A matrix (ROWS, COLUMNS), a quarter full; all seeds have their zeros in the same places."""
    full = np.random.default_rng(0).random((ROWS, COLUMNS)) < 0.25
    full[list(EMPTY)] = False
    assert np.all(full.sum(axis=1)[[i for i in range(ROWS) if i not in EMPTY]] > 0)
    return np.where(full, np.random.default_rng(seed).normal(size=(ROWS, COLUMNS)), 0.0)


def each(matrices: list[Array]) -> Rows:
    """Matrices of vehicles side by side, entry by entry."""
    rows = [sparse_rows(one) for one in matrices]
    return rows[0]._replace(value=np.stack([one.value for one in rows], axis=-1).ravel())


def vectors(seed: int, length: int, width: int) -> Array:
    return np.random.default_rng(seed).normal(size=(length, width))


def terms(matrices: list[Array], x: Array) -> Array:
    """Sums (ROWS, W) of the sizes of all terms: what rounding errors are measured by."""
    return np.stack([np.abs(m) @ np.abs(x[:, k]) for k, m in enumerate(matrices)], axis=-1)


def test_rows_are_those_of_the_matrix() -> None:
    dense = matrix(1)
    rows = sparse_rows(dense)
    again = np.zeros_like(dense)
    for i in range(ROWS):
        entries = slice(rows.start[i], rows.start[i + 1])
        again[i, rows.column[entries]] = rows.value[entries]
        assert np.all(np.diff(rows.column[entries].astype(int)) > 0)
    np.testing.assert_array_equal(again, dense)
    assert len(rows.value) == np.count_nonzero(dense)
    assert rows.start.dtype == rows.column.dtype == np.uint32


@pytest.mark.parametrize("shared", [True, False], ids=["one matrix", "a matrix each"])
@WIDTHS
def test_products_are_those_of_dense_matrices(lanes: Lanes, shared: bool) -> None:
    width = len(lanes)
    matrices = [matrix(1)] * width if shared else [matrix(1 + k) for k in range(width)]
    rows = sparse_rows(matrices[0]) if shared else each(matrices)
    x, before = vectors(20, COLUMNS, width), vectors(21, ROWS, width)
    dense = np.stack([m @ x[:, k] for k, m in enumerate(matrices)], axis=-1)
    written, added = np.full(ROWS * width, np.nan), before.ravel().copy()
    product(lanes, *rows, x.ravel(), written)
    sum_with_product(lanes, *rows, x.ravel(), added)
    # Dot products of n terms are within n / 2 units in the last place of the sum of their sizes.
    error = COLUMNS * np.finfo(float).eps * (terms(matrices, x) + np.abs(before))
    assert np.all(np.abs(written.reshape(ROWS, width) - dense) <= error)
    assert np.all(np.abs(added.reshape(ROWS, width) - (before + dense)) <= error)
    # Rows without entries write zeros, and add nothing.
    np.testing.assert_array_equal(written.reshape(ROWS, width)[list(EMPTY)], 0.0)
    np.testing.assert_array_equal(added.reshape(ROWS, width)[list(EMPTY)], before[list(EMPTY)])


@pytest.mark.parametrize("shared", [True, False], ids=["one matrix", "a matrix each"])
@pytest.mark.parametrize("run", [product, sum_with_product], ids=["multiply", "add_product"])
def test_vehicles_abreast_get_their_own_bits(run: Any, shared: bool) -> None:
    width = len(ABREAST)
    matrices = [matrix(1)] * width if shared else [matrix(1 + k) for k in range(width)]
    rows = sparse_rows(matrices[0]) if shared else each(matrices)
    x, out = vectors(22, COLUMNS, width), vectors(23, ROWS, width)
    x[3, 5] = np.nan  # stays with its vehicle
    together = out.ravel().copy()
    run(ABREAST, *rows, x.ravel(), together)
    for k, dense in enumerate(matrices):
        alone = out[:, k].copy()
        run(SINGLE, *sparse_rows(dense), x[:, k].copy(), alone)
        np.testing.assert_array_equal(together.reshape(ROWS, width)[:, k], alone)
    assert np.any(np.isnan(together.reshape(ROWS, width)[:, 5]))
    assert np.all(np.isfinite(np.delete(together.reshape(ROWS, width), 5, axis=1)))


def test_a_matrix_without_entries() -> None:
    rows = sparse_rows(np.zeros((3, 4)))
    written, added = np.full(3, np.nan), np.arange(3.0)
    product(SINGLE, *rows, np.ones(4), written)
    sum_with_product(SINGLE, *rows, np.ones(4), added)
    np.testing.assert_array_equal(written, 0.0)
    np.testing.assert_array_equal(added, np.arange(3.0))


@pytest.mark.compiled
@pytest.mark.parametrize("run", [product, sum_with_product], ids=["multiply", "add_product"])
@pytest.mark.parametrize("spoilt", ["column", "value", "x", "out"])
@pytest.mark.parametrize("how", ["strided", "of another type", "of two dimensions"])
def test_arrays_that_would_be_misread_are_refused(run: Any, spoilt: str, how: str) -> None:
    """Strided or two-dimensional arrays, or those of another type: by name, when they are compiled."""
    rows = sparse_rows(matrix(1))
    arrays: dict[str, Any] = {**rows._asdict(), "x": np.ones(COLUMNS), "out": np.zeros(ROWS)}
    good = arrays[spoilt]
    spoil = {
        "strided": np.repeat(good, 2)[::2],
        "of another type": good.astype(np.int64 if spoilt == "column" else np.float32),
        "of two dimensions": good.reshape(1, -1),
    }
    arrays[spoilt] = spoil[how]
    with pytest.raises(TypingError, match=rf"{spoilt}: found .*expected a flat contiguous array"):
        run(SINGLE, *arrays.values())
