"""Products of policies against NumPy's, in which no number of rows shows."""

from __future__ import annotations

import numpy as np
import pytest

from sayd_env.agents.products import columns, layer, times


@pytest.mark.parametrize("shape", [(7, 5, 3), (1, 533, 220), (64, 110, 64), (3, 4, 0), (0, 4, 2)])
def test_products_are_those_of_numpy(shape: tuple[int, int, int]) -> None:
    n, m, k = shape
    random = np.random.default_rng(1)
    values, weight, bias = random.normal(size=(n, m)), random.normal(size=(m, k)), random.normal(size=k)
    few = weight * (random.random((m, k)) < 0.1)
    np.testing.assert_allclose(layer(values, weight, bias), values @ weight + bias, rtol=0, atol=1e-12)
    np.testing.assert_allclose(times(values, columns(few)), values @ few, rtol=0, atol=1e-12)
    for i in range(n):
        np.testing.assert_array_equal(
            layer(values, weight, bias)[i : i + 1], layer(values[i : i + 1], weight, bias)
        )
