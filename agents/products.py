"""The few sums of products that a policy needs, compiled.

A BLAS would give each of these small products to all of its threads, which then wait for one another and for
the processor beside simulations that use it already: twenty times the time of one thread. And its results
depend on the number of rows; these are the same bits for one vehicle and for many.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sayd_env.config.units import Array, Integers
from sayd_env.physics.kernel import kernel


class Columns(NamedTuple):
    """A matrix with few entries that are not 0, column by column."""

    begins: Integers
    """(k + 1,) first entry of each column, and the number of all."""
    rows: Integers
    """(entries,) row of each."""
    weights: Array
    """(entries,) value of each."""


def columns(matrix: Array) -> Columns:
    """The entries of a matrix, shape (m, k), that are not 0."""
    places = [np.flatnonzero(column) for column in matrix.T]
    return Columns(
        begins=np.concatenate([[0], np.cumsum([len(each) for each in places])]).astype(np.int64),
        rows=np.concatenate([*places, np.zeros(0, dtype=np.intp)]).astype(np.int64),
        weights=np.concatenate([*(column[p] for column, p in zip(matrix.T, places, strict=True)), []]),
    )


def times(values: Array, matrix: Columns) -> Array:
    """Values, shape (n, m), times a matrix, shape (m, k): a new array of shape (n, k)."""
    result = np.empty((len(values), len(matrix.begins) - 1))
    _sparse(np.ascontiguousarray(values), matrix.begins, matrix.rows, matrix.weights, result)
    return result


def layer(values: Array, weight: Array, bias: Array) -> Array:
    """Values, shape (n, m), times weights, shape (m, k), plus a bias: a new array of shape (n, k)."""
    result = np.empty((len(values), len(bias)))
    _dense(np.ascontiguousarray(values), weight, bias, result)
    return result


@kernel(allocates=False)
def _sparse(values: Array, begins: Integers, rows: Integers, weights: Array, result: Array) -> None:
    for i in range(values.shape[0]):
        for j in range(result.shape[1]):
            total = 0.0
            for k in range(begins[j], begins[j + 1]):
                total += values[i, rows[k]] * weights[k]
            result[i, j] = total


@kernel(distinct=True, allocates=False)
def _dense(values: Array, weight: Array, bias: Array, result: Array) -> None:
    for i in range(values.shape[0]):
        for j in range(result.shape[1]):
            result[i, j] = bias[j]
        for m in range(values.shape[1]):
            value = values[i, m]
            for j in range(result.shape[1]):
                result[i, j] += value * weight[m, j]
