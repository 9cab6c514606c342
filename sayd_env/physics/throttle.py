"""The adjustable throttle: its characteristic field, and the one of throttle and rectifier together.

The flow from chamber to chamber passes a check valve, the throttle and a second check valve, one behind the
other; four check valves send it through the throttle in the same direction whichever chamber it leaves. A
series of resistances is one resistance, so the compiled damper reads one table.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from sayd_env.config.damper import (
    EqualPercentageThrottle,
    OrificeThrottle,
    SpringValve,
    TableThrottle,
    Throttle,
)
from sayd_env.config.units import Array
from sayd_env.measured.valves import LARGEST_DROP, ThrottleField, read_valve_map
from sayd_env.physics.kernel import kernel

CURRENTS = 129
"""Nodes over the current of the compiled table: see `table_currents`."""
ROOTS = 129
"""Nodes over the warped pressure drop of the compiled table."""
DROP_ROOT = 20.0
"""Root of the pressure drop (Pa^0.5) at which `warped` goes over from linear to a square root."""
DROP_SCALE = DROP_ROOT**2
ROOT_STEP = (math.sqrt(LARGEST_DROP + DROP_SCALE) - DROP_ROOT) / (ROOTS - 1)
"""Distance of nodes over the warped pressure drop, Pa^0.5."""


def warped(drop: Array) -> Array:
    """Abscissa of the compiled table: a square root with a finite slope at 0.

    `drop` is what a pressure drop has above the check valves' opening drop (Pa, >= 0).
    """
    return np.asarray(np.sqrt(drop + DROP_SCALE) - DROP_ROOT)


def spring_valve_flow(valve: SpringValve, drop: npt.ArrayLike) -> Array:
    """Flow (m3/s) through a relief or check valve at a pressure drop (Pa), eq. (24)."""
    dp = np.asarray(drop, dtype=float)
    q_n, p_o, p_s, dp_n = valve.nominal_flow, valve.opening, valve.full, valve.nominal_drop
    partial = q_n * math.sqrt(p_s / dp_n) * (dp - p_o) / (p_s - p_o)
    wide = q_n * np.sqrt(np.maximum(dp, p_s) / dp_n)
    return np.where(dp < p_o, 0.0, np.where(dp <= p_s, partial, wide))


def spring_valve_drop(valve: SpringValve, flow: npt.ArrayLike) -> Array:
    """Pressure drop (Pa) over a check or relief valve at a flow >= 0 (m3/s), the inverse of eq. (24).

    A valve that is about to open has no flow and the drop p_o.
    """
    q = np.asarray(flow, dtype=float)
    q_n, p_o, p_s, dp_n = valve.nominal_flow, valve.opening, valve.full, valve.nominal_drop
    q_s = q_n * math.sqrt(p_s / dp_n)
    return np.where(q <= q_s, p_o + (p_s - p_o) * q / q_s, dp_n * (q / q_n) ** 2)


def throttle_field(throttle: Throttle) -> ThrottleField:
    """Characteristic field of a configured throttle.

    Raises
    ------
    ConfigError, DataError
        A valve map that cannot be used.
    """
    if isinstance(throttle, TableThrottle):
        return read_valve_map(throttle)
    return _orifice_field(throttle, np.linspace(0.0, 1.0, CURRENTS))


def _orifice_field(throttle: OrificeThrottle | EqualPercentageThrottle, current: Array) -> ThrottleField:
    drop = np.array([0.0, LARGEST_DROP])  # linear over the root of the drop: two points are exact
    area = opening_area(throttle, current)
    flow = throttle.discharge * area[:, None] * np.sqrt(2.0 * drop / throttle.density)
    return ThrottleField(current, drop, flow)


def opening_area(throttle: OrificeThrottle | EqualPercentageThrottle, current: npt.ArrayLike) -> Array:
    """Area of a throttle (m2) at currents from 0 to 1."""
    i = np.asarray(current, dtype=float)
    if isinstance(throttle, EqualPercentageThrottle):
        return np.asarray(throttle.closed_area * throttle.ratio**i)
    travel = np.maximum(0.0, (i - throttle.overlap) / (1.0 - throttle.overlap))
    rise = throttle.open_area - throttle.closed_area
    return np.asarray(throttle.closed_area + rise * travel**throttle.exponent)


def overlap(throttle: Throttle) -> float:
    """Largest current up to which a throttle is as closed as at current 0.

    Raises
    ------
    ConfigError, DataError
        A valve map that cannot be used.
    """
    if isinstance(throttle, OrificeThrottle):
        return throttle.overlap
    if isinstance(throttle, EqualPercentageThrottle):
        return 0.0 if throttle.ratio > 1.0 else 1.0
    field = throttle_field(throttle)
    # The flow does not fall with the current: equal rows are the first ones.
    return float(field.current[np.all(field.flow == field.flow[0], axis=1)][-1])


def table_start(throttle: Throttle) -> float:
    """Current of the compiled table's first row: the throttle's `overlap`, below which nothing changes.

    Raises
    ------
    ConfigError, DataError
        A valve map that cannot be used.
    """
    end = overlap(throttle)
    return end if end < 1.0 else 0.0


def table_currents(throttle: Throttle) -> Array:
    """Currents (CURRENTS,) of the compiled table's rows, from `table_start` to 1.

    Close at its beginning, where an area that rises with a small power of the current is bent most: the root
    of the distance from there is even.
    """
    start = table_start(throttle)
    return np.asarray(start + (1.0 - start) * np.linspace(0.0, 1.0, CURRENTS) ** 2)


def series_table(throttle: Throttle, check: SpringValve) -> Array:
    """Flow of throttle and two check valves in series, as the compiled damper reads it.

    Returns
    -------
    ndarray, shape (CURRENTS, ROOTS)
        Flow (m3/s) at `table_currents`, over pressure drops above the check valves' opening whose `warped`
        values are ROOT_STEP apart.

    Raises
    ------
    ConfigError, DataError
        A valve map that cannot be used.
    """
    if isinstance(throttle, TableThrottle):  # its file may change
        return _series_table(throttle_field(throttle), table_currents(throttle), check)
    return _orifice_series_table(throttle, check)


@lru_cache(maxsize=64)
def _orifice_series_table(throttle: OrificeThrottle | EqualPercentageThrottle, check: SpringValve) -> Array:
    current = table_currents(throttle)
    # Shared by all who ask, and yet not read-only: compiled code would take that for another type.
    return _series_table(_orifice_field(throttle, current), current, check)


def _series_table(field: ThrottleField, wanted: Array, check: SpringValve) -> Array:
    below = np.clip(np.searchsorted(field.current, wanted, side="right") - 1, 0, len(field.current) - 2)
    share = (wanted - field.current[below]) / (field.current[below + 1] - field.current[below])
    flow = field.flow[below] + share[:, None] * (field.flow[below + 1] - field.flow[below])
    over = (DROP_ROOT + ROOT_STEP * np.arange(ROOTS, dtype=np.float64)) ** 2 - DROP_SCALE
    table = np.empty((len(wanted), ROOTS))
    wide = check.nominal_flow * math.sqrt(check.full / check.nominal_drop)
    linear = 2.0 * (check.full - check.opening) / wide
    square = 2.0 * check.nominal_drop / check.nominal_flow**2
    _solve_series(np.sqrt(field.drop), flow, wide, linear, square, 2.0 * check.opening, over, table)
    return table


@kernel(allocates=False)
def _solve_series(
    root: Array,
    flow: Array,
    wide: float,
    linear: float,
    square: float,
    opening: float,
    over: Array,
    out: Array,
) -> None:
    """Flow at which throttle and check valves share a pressure drop, solved in closed form.

    Between two of its pressure drops the throttle's flow is q = a + b r over their root r. Both check valves
    together take linear q above their opening up to the flow `wide`, from there on square q^2.

    Parameters
    ----------
    root : ndarray, shape (p,)
        Roots of the throttle's pressure drops, Pa^0.5.
    flow : ndarray, shape (c, p)
        Its flows, m3/s.
    wide : float
        Flow at which the check valves are fully open, m3/s.
    linear, square, opening : float
        The check valves' drops: Pa s/m3, Pa s2/m6, Pa.
    over : ndarray, shape (k,)
        Whole pressure drops above `opening`, rising, Pa.
    out : ndarray, shape (c, k)
        Receives the flows.
    """
    for c in range(flow.shape[0]):
        k = 0
        for m in range(over.shape[0]):
            while k + 2 < root.shape[0]:
                q = flow[c, k + 1]
                check = linear * q if q <= wide else square * q * q - opening
                if root[k + 1] * root[k + 1] + check > over[m]:
                    break
                k += 1
            b = (flow[c, k + 1] - flow[c, k]) / (root[k + 1] - root[k])
            a = flow[c, k] - b * root[k]
            # r^2 + linear (a + b r) = over.
            rest = over[m] - linear * a
            half = 0.5 * linear * b
            q = a + b * rest / (half + math.sqrt(half * half + rest)) if rest > 0.0 else a
            if q > wide:  # r^2 + square (a + b r)^2 - opening = over
                lead, half = 1.0 + square * b * b, square * a * b
                rest = over[m] + opening - square * a * a
                q = a + b * rest / (half + math.sqrt(half * half + lead * rest))
            out[c, m] = q
