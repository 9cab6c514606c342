"""Arrays that begin at a cache line."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from sayd_env.config.units import Array, Integers
from sayd_env.physics.aligned import LINE, aligned, copied, zeros


class Two(NamedTuple):
    values: Array
    places: Integers
    number: float


@pytest.mark.parametrize("shape", [(0,), (1,), (7,), (3, 5), (2, 3, 8)])
def test_arrays_begin_at_a_cache_line(shape: tuple[int, ...]) -> None:
    made = [zeros(*shape) for _ in range(20)]
    assert all(array.ctypes.data % LINE == 0 or array.size == 0 for array in made)
    assert all(array.flags.c_contiguous and array.shape == shape and not array.any() for array in made)


def test_copies_are_the_same_numbers_elsewhere() -> None:
    fields = Two(np.arange(12.0).reshape(3, 4)[:, 1:], np.arange(3), 2.0)
    again = copied(fields)
    np.testing.assert_array_equal(again.values, fields.values)
    np.testing.assert_array_equal(again.places, fields.places)
    assert again.places.dtype == np.int64
    assert again.number == 2.0
    again.values[:] = again.places[:] = 0
    assert fields.values.any()
    assert fields.places.any()
    assert aligned(np.ones(3)).ctypes.data % LINE == 0
