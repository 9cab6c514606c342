"""Dampers as test rigs print them: force over velocity, and flow over a valve's pressure drop and current."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RegularGridInterpolator

from sayd_env.config.damper import PassiveDamperConfig, TableThrottle
from sayd_env.config.errors import DataError
from sayd_env.config.units import Array
from sayd_env.config.vehicle import MaxwellLaw, MeasuredCurve
from sayd_env.measured.dialect import decimal_mark, is_number
from sayd_env.measured.table import TextTable, labelled, read_text_table
from sayd_env.measured.units import Unit, name_and_unit, unit_of


class _Role(NamedTuple):
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
VELOCITY = _Role("velocity", ("mm/s", "m/s"), ("v", "speed", "piston_velocity", "piston_speed"), (0.005, 5.0))
FORCE = _Role("force", ("kN", "N", "daN"), ("f", "damper_force"), (100.0, 1e6))
CURRENT = _Role("current", ("A", "mA", "%", "-"), ("i", "command", "signal", "valve_current"))
DROP = _Role("drop", ("bar", "Pa", "kPa", "MPa"), ("pressure_drop", "dp", "delta_p", "pressure"), (1e5, 1e8))
FLOW = _Role(
    "flow", ("l/min", "m3/s", "l/s", "cm3/s", "m3/h"), ("q", "flow_rate", "volume_flow"), (1e-6, 0.02)
)
_CURVE, _MAP = (VELOCITY, FORCE), (CURRENT, DROP, FLOW)

# Closer than any rig resolves, and so close that slopes between them grow beyond all numbers.
_CLOSEST_VELOCITIES = 1e-6  # m/s
_CLOSEST_DROPS = 1.0  # Pa
# Both directions of a symmetric damper differ by its scatter and its friction.
_SYMMETRY = 0.05
_MOST_NODES = 1000
_CELL = re.compile(r"(?:[A-Za-z_ ]+[=:])?\s*(?P<number>[-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*(?P<unit>\D*)")
_ROUNDING = 1e-9


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


def force_velocity(law: MaxwellLaw) -> Array:
    """Points of a damper's curve, from its configuration or from the file that this names.

    Returns
    -------
    ndarray, shape (n, 2)
        Velocity (m/s), rising from 0, and force (N).

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        See `read_curve`.
    """
    return read_curve(law.curve) if isinstance(law.curve, MeasuredCurve) else np.array(law.curve)


def with_points(damper: PassiveDamperConfig) -> PassiveDamperConfig:
    """The same damper with the points of its curve in place of a file; raises as `force_velocity`."""
    points = tuple((float(v), float(f)) for v, f in force_velocity(damper))
    return damper.model_copy(update={"curve": points})


def damper_settings(file: str) -> list[str]:
    """What has to be set to have a measured file in the yaw dampers of a scenario.

    Parameters
    ----------
    file : str
        A force-velocity curve, which the packaged passive damper gets, or a valve map, which the packaged
        semi-active one gets: what stands in the header decides.

    Returns
    -------
    list of str
        ``key=value`` assignments, as `sayd_env.config.scenario.load_scenario` takes them.

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        It is neither.
    """
    table = read_text_table(file, "force-velocity curve or valve map")
    named = {"name": Path(file).stem, "description": f"measured: {file}"}
    if _is_grid(table) or _any_column(table, (DROP, FLOW)):
        return _assignments("sayd", {"throttle": {"type": "table", "file": file}} | named)
    if _any_column(table, _CURVE):
        return _assignments("passive", {"curve": {"file": file}} | named)
    raise DataError(
        f"{table.source}: line {table.head.line}: found {_shown(table.names)}; expected columns of a curve "
        "('velocity [mm/s]', 'force [kN]') or of a valve map ('current [A]', 'drop [bar]', 'flow [l/min]')"
    )


def _assignments(base: str, values: Mapping[str, object]) -> list[str]:
    values = {**values, "provenance": {"base": base}}
    return [f"damper={base}", *(f"damper.{key}={json.dumps(value)}" for key, value in values.items())]


def _any_column(table: TextTable, roles: Sequence[_Role]) -> bool:
    heads = (labelled(table, k) for k in range(len(table.names)))
    return any(_role(name, unit_of(unit), roles) for name, unit in heads)


def read_curve(curve: MeasuredCurve) -> Array:
    """Read force over velocity.

    Parameters
    ----------
    curve : MeasuredCurve
        Names the file: a column of velocities and one of forces in any order, with their units in the header
        or in `curve`. Forces have the sign of their velocities. Where both directions are there, the curve is
        their mean if they agree to 5 % of the largest force, else what `direction` says.

    Returns
    -------
    ndarray, shape (n, 2)
        Velocity (m/s), rising from 0, and force (N), times the curve's scale. The first point is (0, 0).

    Raises
    ------
    ConfigError
        The file cannot be read.
    DataError
        Units that are missing or unknown; other columns; numbers that no damper has; a force that does not
        rise with the velocity or is not 0 at standstill; directions that differ.
    """
    points, _ = _directions(curve)
    return points * (1.0, curve.scale)


def curve_note(curve: MeasuredCurve) -> str:
    """What `read_curve` found in a file."""
    points, sides = _directions(curve)
    (v, f), both = points[-1], curve.direction or ("mean" if len(sides) > 1 else "")
    direction = {"": "", "mean": ", the mean of both directions"}.get(both, f", {both} velocities")
    return f"{curve.file}: force over velocity to {1e3 * v:.4g} mm/s and {1e-3 * f:.4g} kN{direction}"


def _directions(curve: MeasuredCurve) -> tuple[Array, Mapping[str, Array]]:
    """Points of the curve without its scale, and those of each direction that the file has."""
    table = read_text_table(curve.file, "force-velocity curve")
    units = {VELOCITY: curve.velocity_unit, FORCE: curve.force_unit}
    velocity, force = _columns(table, units).T
    order = np.argsort(velocity, kind="stable")
    for before, row in pairwise(order):
        if velocity[row] - velocity[before] < _CLOSEST_VELOCITIES:
            raise DataError(
                f"{table.where(int(row))}: velocity {velocity[row]:g} m/s appears twice; a curve has one "
                "force for each velocity (of a loop give the forces at its highest velocities)"
            )
    for row in np.flatnonzero((velocity == 0.0) & (force != 0.0))[:1]:
        raise DataError(
            f"{table.where(int(row))}: the force at standstill is {force[row]:g} N; a curve begins at 0: "
            "take friction or preload from all forces, or this row out"
        )
    sides = {
        name: _side(table, sign * velocity, sign * force, order[::sign])
        for name, sign in (("positive", 1), ("negative", -1))
    }
    sides = {name: side for name, side in sides.items() if len(side) > 1}
    return _folded(table.source, sides, curve.direction), sides


def _side(table: TextTable, velocity: Array, force: Array, order: npt.NDArray[np.int64]) -> Array:
    """Points of one direction from (0, 0) on, in rising order."""
    rows = [int(row) for row in order if velocity[row] > 0.0]
    below = 0.0
    for row in rows:
        if force[row] <= below:
            hint = (
                "a damper's force has the sign of its velocity"
                if force[row] < 0.0
                else "smooth the curve, give a saturated one a small slope; of a loop give the forces at its "
                "highest velocities"
            )
            raise DataError(
                f"{table.where(row)}: the force must rise with the velocity: {force[row]:g} N at "
                f"{velocity[row]:g} m/s follows {below:g} N; {hint}"
            )
        below = force[row]
    return np.array([(0.0, 0.0), *((velocity[row], force[row]) for row in rows)])


def _folded(source: str, sides: Mapping[str, Array], direction: str | None) -> Array:
    """The one curve of both directions."""
    if direction in sides:
        return sides[direction]
    if direction in ("positive", "negative") or (direction == "mean" and len(sides) < 2):
        raise DataError(
            f"{source}: direction: found '{direction}', but velocities are all {next(iter(sides))}"
        )
    if len(sides) == 1:
        return next(iter(sides.values()))
    velocity = np.unique(np.concatenate([side[:, 0] for side in sides.values()]))
    one, other = (_along(side, velocity) for side in sides.values())
    most = int(np.argmax(np.abs(one - other)))
    if direction is None and abs(one[most] - other[most]) > _SYMMETRY * max(one.max(), other.max()):
        raise DataError(
            f"{source}: at {velocity[most]:g} m/s the forces of both directions are {one[most]:.4g} and "
            f"{other[most]:.4g} N; the dampers here are the same in both: give direction: positive, negative "
            "or mean"
        )
    return np.column_stack([velocity, 0.5 * (one + other)])


def _along(points: Array, velocity: Array) -> Array:
    """Forces of a curve; the last slope goes on."""
    (v0, f0), (v1, f1) = points[-2:]
    beyond = np.maximum(0.0, velocity - v1)
    return np.asarray(np.interp(velocity, points[:, 0], points[:, 1]) + beyond * (f1 - f0) / (v1 - v0))


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
    )


def _map(throttle: TableThrottle) -> tuple[ThrottleField, Array, Unit]:
    """Field of a file, and its currents in their unit."""
    table = read_text_table(throttle.file, "valve map")
    units = {CURRENT: throttle.current_unit, DROP: throttle.drop_unit, FLOW: throttle.flow_unit}
    grid = _is_grid(table)
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


def _is_grid(table: TextTable) -> bool:
    """Whether the header holds currents."""
    return len(table.names) > 1 and all(_CELL.fullmatch(name) for name in table.names[1:])


def _grid(table: TextTable, units: Mapping[_Role, str | None]) -> tuple[Array, Array, Array, Unit, list[str]]:
    """Currents (c,) in their unit, drops (p,), flows (c, p), that unit, and where each drop stands."""
    cells = [found.groupdict() for name in table.names[1:] if (found := _CELL.fullmatch(name))]
    mark = decimal_mark({cell["number"] for cell in cells}, f"{table.source}: line {table.head.line}")
    texts = [cell["number"].replace(mark, ".") for cell in cells]
    for text in texts:
        if not is_number(text):
            raise DataError(f"{table.source}: line {table.head.line}: found '{text}'; expected a current")
    corner = table.names[0]
    stated = re.findall(r"[\[(]([^])]*)[])]", corner) or [
        unit for part in re.split(r"[\s\\|;,]+", corner) if (unit := name_and_unit(part)[1])
    ]
    stated += sorted({cell["unit"].strip(" []()") for cell in cells} - {""})
    where = f"{table.source}: line {table.head.line}: first cell '{corner}'"
    for text in stated:
        if (unit := unit_of(text)) is None or _role("", unit, _MAP) is None:
            raise DataError(f"{where}: found '{text}' as a unit; {_allowed(_MAP)}")
    found = {role: _stated(where, role, stated, units[role]) for role in units}
    numbers = table.numbers(range(len(table.names)))
    if len(numbers) < 2 or len(texts) < 2:
        raise DataError(
            f"{table.source}: found {len(numbers)} pressure drops and {len(texts)} currents; "
            "at least 2 of each are needed"
        )
    drop, flow = numbers[:, 0] * found[DROP].factor, numbers[:, 1:].T * found[FLOW].factor
    rows = [table.where(row) for row in range(len(table))]
    _check_size(table.source, DROP, drop)
    _check_size(table.source, FLOW, flow)
    if drop[0] > 0.0:  # nothing flows without a pressure drop
        drop, flow, rows = np.r_[0.0, drop], np.pad(flow, ((0, 0), (1, 0))), [where, *rows]
    return np.array([float(text) for text in texts]), drop, flow, found[CURRENT], rows


def _stated(where: str, role: _Role, stated: Sequence[str], given: str | None) -> Unit:
    found = {unit for text in stated if (unit := unit_of(text)) and unit.quantity in role.quantities}
    if len(found) > 1:
        raise DataError(f"{where}: found {' and '.join(unit.name for unit in found)}; expected one unit")
    return _agreed(where, role, found.pop() if found else None, given)


def _listed(
    table: TextTable, units: Mapping[_Role, str | None]
) -> tuple[Array, Array, Array, Unit, list[str]]:
    """As `_grid`, of a file with a column of currents, drops and flows each."""
    i, drop, flow = _columns(table, units).T
    unit = _unit(table, CURRENT, units)
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
        flows[k] = _along(np.column_stack([np.sqrt(dp), q]), np.sqrt(nodes))
    if len(currents) < 2:
        raise DataError(f"{table.source}: found one current; at least 2 are needed")
    return currents / unit.factor, nodes, flows, unit, [table.source] * len(nodes)


def _commands(table: TextTable, current: Array, unit: Unit, limits: tuple[float, float] | None) -> Array:
    """Currents as a share of the way from the closed to the open valve, all of which they have to cover."""
    where = f"{table.source}: line {table.head.line}"
    if unit.quantity == "ratio":
        closed, wide = limits or (0.0, 1.0 / unit.factor)
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
    for k in np.flatnonzero(np.diff(drop) < _CLOSEST_DROPS)[:1]:
        raise DataError(
            f"{rows[k + 1]}: pressure drops must rise, by {_CLOSEST_DROPS:g} Pa at least: {drop[k + 1]:g} Pa "
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


def _columns(table: TextTable, units: Mapping[_Role, str | None]) -> Array:
    """Columns of roles, each of which the file has once, in SI; shape (n, roles)."""
    places = _places(table, tuple(units))
    factors = [_unit(table, role, units).factor for role in units]
    numbers = table.numbers([places[role] for role in units]) * factors
    if len(numbers) < 2:
        raise DataError(f"{table.source}: found {len(numbers)} rows of numbers; at least 2 are needed")
    for role, column in zip(units, numbers.T, strict=True):
        _check_size(table.source, role, column)
    return np.asarray(numbers)


def _unit(table: TextTable, role: _Role, units: Mapping[_Role, str | None]) -> Unit:
    place = _places(table, tuple(units))[role]
    unit = labelled(table, place)[1]
    return _agreed(
        f"{table.source}: line {table.head.line}: {table.titled(place)}",
        role,
        unit_of(unit) if unit else None,
        units[role],
    )


def _places(table: TextTable, roles: Sequence[_Role]) -> dict[_Role, int]:
    where = f"{table.source}: line {table.head.line}"
    expected = " and ".join(f"'{role.example}'" for role in roles)
    if not table.names:
        raise DataError(f"{where}: found no header; expected columns {expected}")
    places: dict[_Role, int] = {}
    for k in range(len(table.names)):
        name, unit = labelled(table, k)
        known = unit_of(unit) if unit else None
        if unit and known is None:
            raise DataError(f"{where}: {table.titled(k)}: unknown unit '{unit}'; {_allowed(roles)}")
        role = _role(name, known, roles)
        if role is None:
            raise DataError(f"{where}: {table.titled(k)} is none of {expected}; take it out")
        if role in places:
            raise DataError(
                f"{where}: {table.titled(places[role])} and {table.titled(k)}: expected one {role.name}"
            )
        places[role] = k
    missing = [role for role in roles if role not in places]
    if missing:
        raise DataError(f"{where}: no column '{missing[0].example}'; found {_shown(table.names)}")
    return places


def _role(name: str, unit: Unit | None, roles: Sequence[_Role]) -> _Role | None:
    if unit is not None:
        return next((role for role in roles if unit.quantity in role.quantities), None)
    return next((role for role in roles if name in (role.name, *role.names)), None)


def _agreed(where: str, role: _Role, stated: Unit | None, given: str | None) -> Unit:
    """The unit that the file states or the configuration gives."""
    key = f"{role.name}_unit"
    asked = None if given is None else unit_of(given)
    if given is not None and (asked is None or asked.quantity not in role.quantities):
        raise DataError(f"{where}: {key}: found '{given}'; {_allowed((role,))}")
    if stated is not None and asked is not None and stated != asked:
        raise DataError(f"{where}: states {stated.name}, but {key} is {asked.name}; leave it out")
    unit = stated or asked
    if unit is None:
        raise DataError(
            f"{where}: the unit of {role.name} is missing: write it in the header, for example "
            f"'{role.example}', or give {key}; {_allowed((role,))}"
        )
    return unit


def _allowed(roles: Sequence[_Role]) -> str:
    return f"allowed: {', '.join(unit for role in roles for unit in role.units)}"


def _check_size(source: str, role: _Role, values: Array) -> None:
    """Refuse numbers in a unit other than their own."""
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


def _shown(names: Sequence[str]) -> str:
    shown = ", ".join(f"'{name}'" for name in names[:10])
    return f"{shown} ..." if len(names) > 10 else shown or "no header"
