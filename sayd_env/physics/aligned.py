"""Arrays that begin at a cache line: a vector register then takes one line where it would take parts of two.

Eight numbers of a row are one line of 64 bytes. Vehicles side by side are up to a tenth faster so; results do
not depend on it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config.units import Array

LINE = 64
"""Bytes in a cache line."""


def zeros(*shape: int) -> Array:
    """A contiguous array of zeros."""
    size = int(np.prod(shape)) * 8
    memory = np.zeros(size + LINE, dtype=np.uint8)
    first = -memory.ctypes.data % LINE
    return memory[first : first + size].view(np.float64).reshape(shape)


def aligned(values: Array) -> Array:
    """A contiguous copy."""
    copy = zeros(*values.shape)
    copy[...] = values
    return copy


def copied(fields: Any) -> Any:
    """A named tuple whose arrays are copies."""
    return fields._make(_copy(value) if isinstance(value, np.ndarray) else value for value in fields)


def _copy(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return aligned(values) if values.dtype == np.float64 else values.copy()
