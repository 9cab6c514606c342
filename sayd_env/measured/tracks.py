"""Measured track irregularities from a CSV file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from sayd_env.config.errors import DataError
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array
from sayd_env.measured.table import IRREGULARITIES, Table, read_table

_MIN_ROWS = 4
# A hole this many times wider than the usual spacing is missing data, over which a spline would swing freely.
_MAX_GAP = 10.0
# No railway in service departs further from its nominal geometry: such a number has another unit.
_MAX_MM = 200.0


@dataclass(frozen=True)
class MeasuredTrack:
    """Measured irregularities in SI units.

    Attributes
    ----------
    source : str
        The file.
    x : ndarray, shape (n,)
        Ascending positions (m).
    values : ndarray, shape (n, 4)
        Alignment, vertical (m), cross-level (rad), gauge (m); zero for channels that the file lacks.
    """

    source: str
    x: Array
    values: Array

    def at(self, x: Array) -> Array:
        """Values at positions by a cubic spline, shape (m, 4); outside the file those at its ends.

        Waves shorter than twice the distance of the positions asked for must not be in the file: they would
        be folded into longer ones.
        """
        inside = np.clip(x, self.x[0], self.x[-1])
        return np.asarray(CubicSpline(self.x, self.values, axis=0)(inside), dtype=np.float64)


def read_measured(path: str | Path, cross_level_base: float = 1.5) -> MeasuredTrack:
    """Read the irregularities of a CSV file: ``alignment_mm, vertical_mm, cross_level_mm, gauge_mm``.

    Parameters
    ----------
    path : str or Path
        The file; see `read_table`. What it says beside irregularities belongs to a line and is left alone.
    cross_level_base : float
        Distance over which the rails' difference in height is measured (m): angle = height / base.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        It is none that `read_table` takes, or has fewer than four rows; a gap; numbers too large to be
        millimetres.
    """
    table = read_table(path, IRREGULARITIES, _MIN_ROWS)
    _check_gaps(table)
    values = np.zeros((len(table.x), len(CHANNELS)))
    for j, (channel, name) in enumerate(zip(CHANNELS, IRREGULARITIES, strict=True)):
        if name in table.columns:
            _check_size(table, name)
            base = cross_level_base if channel == "cross_level" else 1.0
            values[:, j] = 1e-3 * table.columns[name] / base
    return MeasuredTrack(table.source, table.x, values)


def _check_gaps(table: Table) -> None:
    spacing = np.diff(table.x)
    usual = float(np.median(spacing))
    gaps = np.flatnonzero(spacing > _MAX_GAP * usual)
    if gaps.size:
        i = int(gaps[0]) + 1
        raise DataError(
            f"{table.where(i)}: a gap of {spacing[i - 1]:g} m before {table.place(i)}; "
            f"the usual spacing is {usual:g} m, at most {_MAX_GAP:g} times that is allowed"
        )


def _check_size(table: Table, name: str) -> None:
    large = np.flatnonzero(np.abs(table.columns[name]) > _MAX_MM)
    if large.size:
        i = int(large[0])
        raise DataError(
            f"{table.where(i)}: column '{name}': found {table.columns[name][i]:g} mm; "
            f"at most {_MAX_MM:g} mm is allowed (is the unit mm?)"
        )
