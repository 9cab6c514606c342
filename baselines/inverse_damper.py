"""The inverse of the semi-active damper's characteristic: the current for a force at a stroke rate."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.units import Array
from sayd_env.physics.kernel import kernel
from sayd_env.physics.sayd import LAST_ROOT, fed_pressure, steady_force, to_tank
from sayd_env.physics.throttle import (
    CURRENTS,
    DROP_ROOT,
    DROP_SCALE,
    ROOT_STEP,
    ROOTS,
    series_table,
    table_start,
)

FASTEST = 2.0
"""Stroke rate (m/s) at which the table of the closed damper ends; its force then stays."""
SLOWEST = 1e-6
"""Stroke rate (m/s) below which its force is proportional to the stroke rate."""
RATES = 8000  # neighbours differ by 0.2 %, and so the force between them by much less
DROPS = 2000


class _Tables(NamedTuple):
    rate: Array
    """(RATES,) stroke rates, rising from 0, m/s."""
    force: Array
    """(RATES,) force of the damper at its `closed` current, N."""
    drop: Array
    """(DROPS,) pressure drops p_A - p_B of a chamber A under pressure, rising from 0, Pa."""
    tank: Array
    """(DROPS,) flow from it to the tank, through bleed and relief valve, m3/s."""
    through: Array
    """(CURRENTS * ROOTS,) flow of rectifier and throttle, as the compiled damper reads it, m3/s."""
    constant: Array
    """Area (m2), sliding friction (N), opening drop of the rectifier (Pa), the currents `closed` and `open`,
    and that of the table's first row."""


class InverseDamper:
    """Quasi-static characteristic of a semi-active damper, solved for the current.

    At a constant stroke rate v the flows balance: A v = Q(p_A - p_B, i) + Q_tank(p_A). A wanted force gives
    the pressure drop (F - F_friction) / A, this the flow to the tank, the rest must pass the throttle, and
    its characteristic field gives the current. `sayd_env.physics.sayd.steady_force` is the inverse.

    Parameters
    ----------
    damper : SaydDamperConfig
        The damper.
    closed, open_ : float
        Range of the current: 0 closed, 1 open.

    Raises
    ------
    DataError
        A throttle table that cannot be used.
    """

    def __init__(self, damper: SaydDamperConfig, closed: float, open_: float) -> None:
        rate = np.concatenate([[0.0], np.geomspace(SLOWEST, FASTEST, RATES - 1)])
        drop, tank = _tank_over_drop(damper)
        self._tables = _Tables(
            rate=rate,
            force=steady_force(damper, rate, closed),
            drop=drop,
            tank=tank,
            through=series_table(damper.throttle, damper.rectifier).ravel(),
            constant=np.array(
                [
                    damper.cylinder.area,
                    damper.friction.sliding,
                    2.0 * damper.rectifier.opening,
                    closed,
                    open_,
                    table_start(damper.throttle),
                ]
            ),
        )

    def currents(self, rate: Array, share: Array) -> Array:
        """Currents at which the damper resists with a share of the closed damper's force.

        Parameters
        ----------
        rate : ndarray
            Stroke rates, m/s; the sign does not matter.
        share : ndarray
            Wanted coefficient c over c_max, that of the damper at its `closed` current; 1 and more close it.

        Returns
        -------
        ndarray
            Currents between `closed` and `open`.
        """
        out = np.empty(rate.shape)  # in C order, whatever that of the rates: its flat form must be itself
        _currents(self._tables, rate.ravel(), share.ravel(), out.ravel())
        return out

    def for_forces(self, rate: Array, force: Array) -> Array:
        """Currents at which the damper pulls with a force at a stroke rate, as far as it can.

        It resists motion: where the force would drive it, the valve opens; where it is more than the closed
        damper's, it closes.

        Parameters
        ----------
        rate, force : ndarray
            Stroke rates (m/s), positive for a damper that grows longer, and tensions (N).

        Returns
        -------
        ndarray
            Currents between `closed` and `open`.
        """
        most = np.interp(np.abs(rate), self._tables.rate, self._tables.force)
        share = np.divide(np.abs(force), most, out=np.ones_like(most), where=most > 0.0)
        return self.currents(rate, np.where(force * rate >= 0.0, share, 0.0))


def _tank_over_drop(damper: SaydDamperConfig) -> tuple[Array, Array]:
    """Flow from the chamber under pressure to the tank over the pressure drop between the chambers.

    What leaves to the tank comes back into the other chamber, whose own drop adds to p_A - p_B.
    """
    relief, tank = damper.relief, damper.oil.tank_pressure
    over = np.concatenate(
        [
            np.linspace(0.0, relief.opening, DROPS // 4),
            # Without a bleed the suction valve needs its opening pressure for the least flow: the drop jumps.
            [relief.opening * (1.0 + 1e-9)],
            np.linspace(relief.opening, relief.full, DROPS // 4, endpoint=False)[1:],
            np.geomspace(relief.full, 10.0 * relief.full, DROPS // 2),
        ]
    )
    return over + tank - fed_pressure(damper, tank + over), to_tank(damper, tank + over)


@kernel(inline=True, allocates=False)
def _below(nodes: Array, value: float) -> int:
    """Index of the interval of rising nodes in which a value lies; the outermost ones go on."""
    low, high = 0, nodes.shape[0] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if nodes[middle] <= value:
            low = middle
        else:
            high = middle
    return low


@kernel(inline=True, allocates=False)
def _at(nodes: Array, values: Array, place: float) -> float:
    """Interpolate linearly; beyond the last node the last value stays."""
    k = _below(nodes, place)
    share = (place - nodes[k]) / (nodes[k + 1] - nodes[k])
    return float(values[k] + min(share, 1.0) * (values[k + 1] - values[k]))


@kernel(inline=True, allocates=False)
def _through(table: Array, row: int, node: int, right: float) -> float:
    low = table[row * ROOTS + node]
    return float(low + right * (table[row * ROOTS + node + 1] - low))


@kernel(inline=True, allocates=False)
def _passing(table: Array, start: float, drop: float, flow: float) -> float:
    """Current at which a flow passes rectifier and throttle; `drop` is what opens them further."""
    place = (math.sqrt(drop + DROP_SCALE) - DROP_ROOT) / ROOT_STEP
    node = int(min(place, LAST_ROOT))
    right = place - node
    low, high = 0, CURRENTS - 1
    if _through(table, high, node, right) <= flow:
        return 1.0
    while high - low > 1:
        middle = (low + high) // 2
        if _through(table, middle, node, right) <= flow:
            low = middle
        else:
            high = middle
    less, more = _through(table, low, node, right), _through(table, high, node, right)
    # Below the closed valve's leakage no current will do: a negative one comes out, to be cut to the range.
    place = (low + (flow - less) / (more - less)) / (CURRENTS - 1)
    return float(start + (1.0 - start) * place * abs(place))  # rows over the root, see `table_currents`


@kernel(allocates=False)
def _currents(tables: _Tables, rate: Array, share: Array, out: Array) -> None:
    area, sliding, checked = tables.constant[0], tables.constant[1], tables.constant[2]
    closed, open_ = tables.constant[3], tables.constant[4]
    for k in range(out.shape[0]):
        if share[k] >= 1.0:
            out[k] = closed
            continue
        speed = min(abs(rate[k]), FASTEST)
        wanted = max(share[k], 0.0) * _at(tables.rate, tables.force, speed)
        drop = (wanted - sliding) / area
        if not drop > checked:  # nothing passes below; not even the open valve resists so little
            out[k] = open_
            continue
        flow = area * speed - _at(tables.drop, tables.tank, drop)
        out[k] = min(max(_passing(tables.through, tables.constant[5], drop - checked, flow), closed), open_)
