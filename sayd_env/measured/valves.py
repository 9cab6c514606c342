"""Valve maps: flow over pressure drop and current, as a test rig prints them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RegularGridInterpolator

from sayd_env.config.damper import TableThrottle
from sayd_env.config.errors import DataError
from sayd_env.config.units import Array
from sayd_env.measured.dialect import decimal_mark
from sayd_env.measured.rig_tables import (
    CURRENT,
    DROP,
    FLOW,
    Role,
    agreed_unit,
    allowed,
    check_size,
    column_unit,
    columns,
    extended,
    role_of,
)
from sayd_env.measured.table import TextTable, physical_numbers, read_text_table
from sayd_env.measured.units import Unit, name_and_unit, unit_of

_MAP = (CURRENT, DROP, FLOW)
# Closer than any rig resolves, and so close that slopes between them grow beyond all numbers.
_CLOSEST = 1.0  # Pa
_MOST_NODES = 1000
LARGEST_DROP = 1.2e7
"""Pressure drop (Pa) to which a damper knows its throttle; beyond it the flow goes on with the root."""
_CELL = re.compile(r"(?:[A-Za-z_ ]+[=:])?\s*(?P<number>[-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*(?P<unit>\D*)")
_ROUNDING = 1e-9
# A share beyond it is a percentage.
_FURTHEST_SHARE = 2.0


@dataclass(frozen=True)
class ThrottleField:
    """Characteristic field of a throttle: flow over current and pressure drop."""

    current: Array
    """(c,) rising from 0 to 1."""
    drop: Array
    """(p,) pressure drops, rising from 0, Pa."""
    flow: Array
    """(c, p) flows, m3/s."""

    def at(self, current: npt.ArrayLike, drop: npt.ArrayLike) -> Array:
        """Flow (m3/s) at currents and pressure drops >= 0 (Pa) that broadcast against each other.

        Linear over the current and over the root of the pressure drop, in which an orifice is linear; the
        last slope goes on.
        """
        i, dp = np.broadcast_arrays(np.asarray(current, dtype=float), np.asarray(drop, dtype=float))
        field = RegularGridInterpolator(
            (self.current, np.sqrt(self.drop)), self.flow, bounds_error=False, fill_value=None
        )
        return np.asarray(field(np.stack([i, np.sqrt(dp)], axis=-1)))


def read_valve_map(throttle: TableThrottle) -> ThrottleField:
    """Read a measured characteristic field.

    Parameters
    ----------
    throttle : TableThrottle
        Names the file: currents in the first row, pressure drops in the first column and flows in the rest,
        or a column of each. Units stand in the first cell, in the header, or in `throttle`. Between currents
        the flow is linear, between pressure drops it is linear over their root, from 0 flow at no drop on.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        Units that are missing or unknown; currents in A without their range; currents that do not reach from
        one end of it to the other; numbers that no valve has; a flow that does not rise with the pressure
        drop or falls with the command.
    """
    return _map(throttle)[0]


def map_note(throttle: TableThrottle) -> str:
    """What `read_valve_map` found in a file."""
    field, current, unit = _map(throttle)
    closed, wide = throttle.current_range or (0.0, 1.0 / unit.factor)
    name = "" if unit.name == "-" else f" {unit.name}"
    return (
        f"{throttle.file}: flow at {len(current)} currents from {current.min():g} to {current.max():g}{name} "
        f"({closed:g} closed, {wide:g} open) over pressure drops to {field.drop[-1] / 1e5:.4g} bar"
        + f", of which those to {LARGEST_DROP / 1e5:g} bar count"
        * bool(field.drop[-1] > LARGEST_DROP)
    )


def _map(throttle: TableThrottle) -> tuple[ThrottleField, Array, Unit]:
    """Field of a file, and its currents in their unit."""
    table = read_text_table(throttle.file, "valve map")
    units = {CURRENT: throttle.current_unit, DROP: throttle.drop_unit, FLOW: throttle.flow_unit}
    grid = is_grid(table)
    current, drop, flow, unit, rows = _grid(table, units) if grid else _listed(table, units)
    command = _commands(table, current, unit, throttle.current_range)
    if command[0] > command[-1]:
        command, flow = command[::-1], flow[::-1]
    _check_flow(rows, command, drop, flow)
    ends = np.array([0.0, 1.0])
    kept = (command > _ROUNDING) & (command < 1.0 - _ROUNDING)
    wanted = np.concatenate((ends[:1], command[kept], ends[1:]))
    flow = np.array([np.interp(wanted, command, each) for each in flow.T]).T
    return ThrottleField(wanted, drop, flow), current, unit


def is_grid(table: TextTable) -> bool:
    """Whether the header holds currents."""
    return len(table.names) > 1 and all(_CELL.fullmatch(name) for name in table.names[1:])


def _grid(table: TextTable, units: Mapping[Role, str | None]) -> tuple[Array, Array, Array, Unit, list[str]]:
    """Currents (c,) in their unit, drops (p,), flows (c, p), that unit, and where each drop stands."""
    cells = [match.groupdict() for name in table.names[1:] if (match := _CELL.fullmatch(name))]
    head = f"{table.source}: line {table.head.line}"
    mark = decimal_mark({cell["number"] for cell in cells}, lambda _: head)
    currents = []
    for cell in cells:
        try:
            currents.append(float(cell["number"].replace(mark, ".")))
        except ValueError:
            raise DataError(f"{head}: found '{cell['number']}'; expected a current") from None
    corner = table.names[0]
    stated = re.findall(r"[\[(]([^])]*)[])]", corner) or [
        unit for part in re.split(r"[\s\\|;,]+", corner) if (unit := name_and_unit(part)[1])
    ]
    stated += sorted({cell["unit"].strip(" []()") for cell in cells} - {""})
    where = f"{head}: first cell '{corner}'"
    for text in stated:
        if (known := unit_of(text)) is None or role_of("", known, _MAP) is None:
            raise DataError(f"{where}: found '{text}' as a unit; {allowed(_MAP)}")
    found = {role: _stated(where, role, stated, units[role]) for role in units}
    numbers = physical_numbers(table, range(len(table.names)))
    if len(numbers) < 2 or len(currents) < 2:
        raise DataError(
            f"{table.source}: found {len(numbers)} pressure drops and {len(currents)} currents; "
            "at least 2 of each are needed"
        )
    drop, flow = numbers[:, 0] * found[DROP].factor, numbers[:, 1:].T * found[FLOW].factor
    rows = [table.where(row) for row in range(len(table))]
    check_size(table.source, DROP, drop)
    check_size(table.source, FLOW, flow)
    if drop[0] > 0.0:  # nothing flows without a pressure drop
        drop, flow, rows = np.r_[0.0, drop], np.pad(flow, ((0, 0), (1, 0))), [where, *rows]
    return np.array(currents), drop, flow, found[CURRENT], rows


def _stated(where: str, role: Role, stated: Sequence[str], given: str | None) -> Unit:
    found = {unit for text in stated if (unit := unit_of(text)) and unit.quantity in role.quantities}
    if len(found) > 1:
        raise DataError(f"{where}: found {' and '.join(unit.name for unit in found)}; expected one unit")
    return agreed_unit(where, role, found.pop() if found else None, given)


def _listed(
    table: TextTable, units: Mapping[Role, str | None]
) -> tuple[Array, Array, Array, Unit, list[str]]:
    """As `_grid`, of a file with a column of currents, drops and flows each."""
    i, drop, flow = columns(table, units).T
    unit = column_unit(table, CURRENT, units)
    currents, nodes = np.unique(i), np.unique(np.r_[0.0, drop])
    if max(len(currents), len(nodes)) > _MOST_NODES:
        raise DataError(
            f"{table.source}: found {len(currents)} currents and {len(nodes)} pressure drops; at most "
            f"{_MOST_NODES} of each are read"
        )
    flows = np.empty((len(currents), len(nodes)))
    for k, current in enumerate(currents):
        rows = np.flatnonzero(i == current)
        rows = rows[np.argsort(drop[rows], kind="stable")]
        dp, q = drop[rows], flow[rows]
        if dp[0] > 0.0:
            dp, q = np.r_[0.0, dp], np.r_[0.0, q]
        where = [table.where(int(row)) for row in rows]
        _check_flow([where[0]] * (len(dp) - len(rows)) + where, np.array([current]), dp, q[None])
        if len(dp) < 2:
            raise DataError(f"{where[0]}: current {current:g} has no flow at a pressure drop above 0")
        flows[k] = extended(np.column_stack([np.sqrt(dp), q]), np.sqrt(nodes))
    if len(currents) < 2:
        raise DataError(f"{table.source}: found one current; at least 2 are needed")
    return currents / unit.factor, nodes, flows, unit, [table.source] * len(nodes)


def _commands(table: TextTable, current: Array, unit: Unit, limits: tuple[float, float] | None) -> Array:
    """Currents as a share of the way from the closed to the open valve, all of which they have to cover."""
    where = f"{table.source}: line {table.head.line}"
    if unit.quantity == "ratio":
        closed, wide = limits or (0.0, 1.0 / unit.factor)
        if limits is None and current.max() > _FURTHEST_SHARE * wide:
            raise DataError(
                f"{where}: found currents up to {current.max():g} {unit.name}, where {wide:g} is wide open; "
                "expected shares, % or current_range"
            )
    elif limits is None:
        raise DataError(
            f"{where}: currents in {unit.name} need current_range: their values of the valve closed and wide "
            f"open, for example [{current.min():g}, {current.max():g}] (the command is 0 and 1 there)"
        )
    else:
        closed, wide = limits
    if closed == wide:
        raise DataError(f"{where}: current_range: found [{closed:g}, {wide:g}]; expected two currents")
    command = (current - closed) / (wide - closed) + 0.0  # no -0
    steps = np.diff(command)
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        shown = ", ".join(f"{each:g}" for each in current[:20])
        raise DataError(f"{where}: currents must rise, found {shown}")
    if command.min() > _ROUNDING or command.max() < 1.0 - _ROUNDING:
        raise DataError(
            f"{where}: found currents from {current.min():g} to {current.max():g} {unit.name}; they must "
            f"reach from {closed:g} (closed) to {wide:g} (open)"
        )
    return np.asarray(command)


def _check_flow(rows: Sequence[str], command: Array, drop: Array, flow: Array) -> None:
    """Refuse what no throttle does; one message for the first fault."""
    if drop[0] < 0.0:
        raise DataError(f"{rows[0]}: found a pressure drop of {drop[0]:g} Pa; a throttle has them from 0 on")
    if np.any(flow[:, 0] != 0.0):
        raise DataError(f"{rows[0]}: found a flow at pressure drop 0; nothing flows there")
    for k in np.flatnonzero(np.diff(drop) < _CLOSEST)[:1]:
        raise DataError(
            f"{rows[k + 1]}: pressure drops must rise, by {_CLOSEST:g} Pa at least: {drop[k + 1]:g} Pa "
            f"follows {drop[k]:g} Pa"
        )
    for i, k in np.argwhere(np.diff(flow, axis=1) <= 0.0)[:1]:
        raise DataError(
            f"{rows[k + 1]}: the flow must rise with the pressure drop: at current {command[i]:g} "
            f"{flow[i, k + 1]:g} m3/s follows {flow[i, k]:g} m3/s"
        )
    for i, k in np.argwhere(np.diff(flow, axis=0) < 0.0)[:1]:
        raise DataError(
            f"{rows[k]}: the flow must not fall from the closed to the open valve: {flow[i + 1, k]:g} m3/s "
            f"at command {command[i + 1]:g} after {flow[i, k]:g} m3/s at {command[i]:g} (current_range is "
            "the current of the closed valve, then that of the open one)"
        )
