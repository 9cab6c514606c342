"""Tables of test rigs: columns that are known by their units, or by names and units that a user gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from sayd_env.config.errors import DataError
from sayd_env.config.units import Array
from sayd_env.measured.table import TextTable, labelled, physical_numbers
from sayd_env.measured.units import Unit, unit_of


class Role(NamedTuple):
    """What a column holds."""

    name: str
    """Its key in a configuration is this with _unit."""
    units: tuple[str, ...]
    """In which it may stand."""
    names: tuple[str, ...]
    """By which it is known where the file has no unit."""
    size: tuple[float, float] | None = None
    """What its largest number may be (SI): beyond, its unit is not what the file says."""

    @property
    def quantities(self) -> set[str]:
        """What these units measure."""
        return {unit.quantity for name in self.units if (unit := unit_of(name))}

    @property
    def example(self) -> str:
        """A column of it as messages name it."""
        return f"{self.name} [{self.units[0]}]"


# Yaw dampers are tested to 0.1 m/s or so, shock absorbers of cars to 3 m/s; valves of dampers have bores of
# millimetres and stand 350 bar.
VELOCITY = Role("velocity", ("mm/s", "m/s"), ("v", "speed", "piston_velocity", "piston_speed"), (0.005, 5.0))
FORCE = Role("force", ("kN", "N", "daN"), ("f", "damper_force"), (100.0, 1e6))
CURRENT = Role("current", ("A", "mA", "%", "-"), ("i", "command", "signal", "valve_current"))
DROP = Role("drop", ("bar", "Pa", "kPa", "MPa"), ("pressure_drop", "dp", "delta_p", "pressure"), (1e5, 1e8))
FLOW = Role(
    "flow", ("l/min", "m3/s", "l/s", "cm3/s", "m3/h"), ("q", "flow_rate", "volume_flow"), (1e-6, 0.02)
)


def columns(table: TextTable, units: Mapping[Role, str | None]) -> Array:
    """Columns of roles, each of which the file has once, in SI; shape (n, roles).

    Raises
    ------
    DataError
        A column that is missing, unknown or twice there, a unit that is, fewer than two rows, or numbers too
        large or small for their unit.
    """
    places = _places(table, tuple(units))
    factors = [column_unit(table, role, units).factor for role in units]
    numbers = physical_numbers(table, [places[role] for role in units]) * factors
    if len(numbers) < 2:
        raise DataError(f"{table.source}: found {len(numbers)} rows of numbers; at least 2 are needed")
    for role, column in zip(units, numbers.T, strict=True):
        check_size(table.source, role, column)
    return np.asarray(numbers)


def column_unit(table: TextTable, role: Role, units: Mapping[Role, str | None]) -> Unit:
    """Unit of the column of a role.

    Raises
    ------
    DataError
        Columns or units that do not fit the roles, see `columns`.
    """
    place = _places(table, tuple(units))[role]
    unit = labelled(table, place)[1]
    return agreed_unit(
        f"{table.source}: line {table.head.line}: {table.titled(place)}",
        role,
        unit_of(unit) if unit else None,
        units[role],
    )


def _places(table: TextTable, roles: Sequence[Role]) -> dict[Role, int]:
    where = f"{table.source}: line {table.head.line}"
    expected = " and ".join(f"'{role.example}'" for role in roles)
    if not table.names:
        raise DataError(f"{table.no_header()}; expected columns {expected}")
    places: dict[Role, int] = {}
    for k in range(len(table.names)):
        name, unit = labelled(table, k)
        known = unit_of(unit) if unit else None
        if unit and known is None:
            raise DataError(f"{where}: {table.titled(k)}: unknown unit '{unit}'; {allowed(roles)}")
        role = role_of(name, known, roles)
        if role is None:
            raise DataError(f"{where}: {table.titled(k)} is none of {expected}; take it out")
        if role in places:
            raise DataError(
                f"{where}: {table.titled(places[role])} and {table.titled(k)}: expected one {role.name}"
            )
        places[role] = k
    missing = [role for role in roles if role not in places]
    if missing:
        raise DataError(f"{where}: no column '{missing[0].example}'; found {shown(table.names)}")
    return places


def role_of(name: str, unit: Unit | None, roles: Sequence[Role]) -> Role | None:
    """What a column holds, by its unit or, without one, by its name; None for none of the roles."""
    if unit is not None:
        return next((role for role in roles if unit.quantity in role.quantities), None)
    return next((role for role in roles if name in (role.name, *role.names)), None)


def agreed_unit(where: str, role: Role, stated: Unit | None, given: str | None) -> Unit:
    """The unit that the file states or the configuration gives.

    Raises
    ------
    DataError
        There is none, one of another quantity, or two that differ.
    """
    key = f"{role.name}_unit"
    asked = None if given is None else unit_of(given)
    if given is not None and (asked is None or asked.quantity not in role.quantities):
        raise DataError(f"{where}: {key}: found '{given}'; {allowed((role,))}")
    if stated is not None and asked is not None and stated[:2] != asked[:2]:
        raise DataError(f"{where}: states {stated.name}, but {key} is {asked.name}; leave it out")
    unit = stated or asked
    if unit is None:
        raise DataError(
            f"{where}: the unit of {role.name} is missing: write it in the header, for example "
            f"'{role.example}', or give {key}; {allowed((role,))}"
        )
    return unit


def allowed(roles: Sequence[Role]) -> str:
    """Units as messages list them."""
    return f"allowed: {', '.join(unit for role in roles for unit in role.units)}"


def check_size(source: str, role: Role, values: Array) -> None:
    """Refuse numbers (SI) in a unit other than their own.

    Raises
    ------
    DataError
        The largest one lies outside what the role has in practice.
    """
    largest = float(np.max(np.abs(values)))
    if role.size is None or role.size[0] <= largest <= role.size[1]:
        return
    first = unit_of(role.units[0])
    assert first is not None
    low, high, found = (value / first.factor for value in (*role.size, largest))
    raise DataError(
        f"{source}: the {role.name} reaches {found:g} {first.name}; of a damper it reaches {low:g} to "
        f"{high:g} {first.name} (is its unit right?)"
    )


def shown(names: Sequence[str]) -> str:
    """Names of columns as messages list them."""
    first = ", ".join(f"'{name}'" for name in names[:10])
    return f"{first} ..." if len(names) > 10 else first or "no header"


def extended(points: Array, x: Array) -> Array:
    """Values at x of a piecewise-linear curve of points, shape (n, 2); its last slope goes on."""
    (x0, y0), (x1, y1) = points[-2:]
    beyond = np.maximum(0.0, x - x1)
    return np.asarray(np.interp(x, points[:, 0], points[:, 1]) + beyond * (y1 - y0) / (x1 - x0))
