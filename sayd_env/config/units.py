"""The types of arrays, gravity, and the one unit that is not SI: speeds are given and printed in km/h."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Array32: TypeAlias = NDArray[np.float32]
"""Observations and commands, as learners and networks take them."""
ComplexArray: TypeAlias = NDArray[np.complex128]
Integers: TypeAlias = NDArray[np.int64]
"""Counts, and places in other arrays."""
Flags: TypeAlias = NDArray[np.bool_]

KMH = 3.6
"""km/h in 1 m/s."""

GRAVITY = 9.81
"""Acceleration of gravity (m/s2), the value behind the paper's axle load."""
