"""Critical speed: where an assessed quantity crosses its limit on a grid of speeds."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sayd_env.config import DataError
from sayd_env.config.units import Array


class Crossing(enum.Enum):
    """How the quantity runs over the grid."""

    FOUND = "found"
    """The limit is exceeded within the grid: the critical speed is interpolated."""
    NOT_REACHED = "not_reached"
    """The limit holds at every speed: the critical speed lies above the grid."""
    BELOW_GRID = "below_grid"
    """The limit is exceeded at the lowest speed already: the critical speed lies below the grid."""


@dataclass(frozen=True)
class CriticalSpeed:
    """A critical speed, or why there is none."""

    speed: float | None
    """Critical speed, in the unit of the grid; None unless `crossing` is ``FOUND``."""
    crossing: Crossing


@dataclass(frozen=True)
class GridSensitivity:
    """How far a critical speed depends on the grid of speeds."""

    shift: float | None
    """Largest change (unit of the grid); None if the crossing is missing on one of the grids."""
    sensitive: bool


def critical_speed(speeds: Array, values: Array, limit: float) -> CriticalSpeed:
    """Speed at which a quantity first exceeds its limit, by linear interpolation.

    Parameters
    ----------
    speeds : array of shape (n,)
        Strictly increasing speeds, in any unit.
    values : array of shape (n,)
        Assessed quantity at each speed, for example the largest of four sliding-RMS maxima.
    limit : float
        Limit, in the unit of the values; a value equal to it does not exceed it.

    Returns
    -------
    CriticalSpeed
        The first crossing from below. Above the limit at the first speed already, no crossing can be
        interpolated: the first speed is only an upper bound and is not returned as a result.

    Raises
    ------
    DataError
        Empty, unequal, unsorted or non-finite data.
    """
    speeds, values = _checked(speeds, values)
    if not np.isfinite(limit):
        raise DataError(f"limit: found {limit}; expected a finite number")
    above = values > limit
    if not above.any():
        return CriticalSpeed(None, Crossing.NOT_REACHED)
    i = int(np.argmax(above))
    if i == 0:
        return CriticalSpeed(None, Crossing.BELOW_GRID)
    fraction = (limit - values[i - 1]) / (values[i] - values[i - 1])
    return CriticalSpeed(float(speeds[i - 1] + fraction * (speeds[i] - speeds[i - 1])), Crossing.FOUND)


def grid_sensitivity(
    reference: CriticalSpeed, others: Sequence[CriticalSpeed], tolerance: float
) -> GridSensitivity:
    """Compare the critical speed of one grid with those of other grids.

    Parameters
    ----------
    reference : CriticalSpeed
        Result on the grid of the study.
    others : sequence of CriticalSpeed
        Results on other grids over the same range.
    tolerance : float
        Largest change that is not called sensitive (unit of the grid).

    Returns
    -------
    GridSensitivity
        Sensitive, too, where a critical speed has no other grid to be compared with.
    """
    if any(other.crossing is not reference.crossing for other in others):
        return GridSensitivity(None, sensitive=True)
    if reference.speed is None:
        return GridSensitivity(None, sensitive=False)
    if not others:
        return GridSensitivity(None, sensitive=True)
    shift = max(abs(other.speed - reference.speed) for other in others if other.speed is not None)
    return GridSensitivity(shift, sensitive=shift > tolerance)


def thinned_grids(speeds: Array, values: Array, limit: float) -> list[CriticalSpeed]:
    """Critical speeds with each inner speed of the grid left out in turn.

    Other grids for `grid_sensitivity` that cost no simulation. Parameters and errors as in `critical_speed`.

    Returns
    -------
    list of CriticalSpeed
        One for each inner speed.
    """
    speeds, values = _checked(speeds, values)
    return [
        critical_speed(np.delete(speeds, i), np.delete(values, i), limit) for i in range(1, len(speeds) - 1)
    ]


def _checked(speeds: Array, values: Array) -> tuple[Array, Array]:
    speeds, values = np.asarray(speeds, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if speeds.ndim != 1 or speeds.shape != values.shape or len(speeds) == 0:
        raise DataError(
            f"speeds of shape {speeds.shape} and values of shape {values.shape}; expected equal lists"
        )
    if not (np.isfinite(speeds).all() and np.isfinite(values).all()):
        raise DataError("speeds and assessed values must be finite numbers")
    if (np.diff(speeds) <= 0).any():
        raise DataError("speeds must be strictly increasing")
    return speeds, values
