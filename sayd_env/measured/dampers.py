"""Dampers as test rigs print them: force over velocity, and which damper a file is of."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.errors import DataError
from sayd_env.config.units import Array, Integers
from sayd_env.config.vehicle import MaxwellLaw, MeasuredCurve
from sayd_env.measured.rig_tables import DROP, FLOW, FORCE, VELOCITY, Role, columns, extended, role_of, shown
from sayd_env.measured.table import TextTable, labelled, read_text_table
from sayd_env.measured.units import unit_of
from sayd_env.measured.valves import is_grid

# Closer than any rig resolves, and so close that slopes between them grow beyond all numbers.
_CLOSEST = 1e-6  # m/s
# Both directions of a symmetric damper differ by its scatter and its friction.
_SYMMETRY = 0.05


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
    named: dict[str, object] = {"name": Path(file).stem, "description": f"measured: {file}"}
    if is_grid(table) or _any_column(table, (DROP, FLOW)):
        return _assignments("sayd", named | {"throttle": {"type": "table", "file": file}})
    if _any_column(table, (VELOCITY, FORCE)):
        return _assignments("passive", named | {"curve": {"file": file}})
    found = f"{table.source}: line {table.head.line}: found {shown(table.names)}"
    raise DataError(
        f"{found if table.names else table.no_header()}; expected columns of a curve "
        "('velocity [mm/s]', 'force [kN]') or of a valve map ('current [A]', 'drop [bar]', 'flow [l/min]')"
    )


def _assignments(base: str, values: Mapping[str, object]) -> list[str]:
    values = {**values, "provenance": {"base": base}}
    return [f"damper={base}", *(f"damper.{key}={json.dumps(value)}" for key, value in values.items())]


def _any_column(table: TextTable, roles: Sequence[Role]) -> bool:
    heads = (labelled(table, k) for k in range(len(table.names)))
    return any(role_of(name, unit_of(unit), roles) for name, unit in heads)


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
    velocity, force = columns(table, units).T
    order = np.argsort(velocity, kind="stable")
    for before, row in pairwise(order):
        if velocity[row] - velocity[before] < _CLOSEST:
            raise DataError(
                f"{table.where(int(row))}: velocity {velocity[row]:g} m/s appears twice; a curve has one "
                "force for each velocity (of a loop give the forces at its highest velocities)"
            )
    for row in np.flatnonzero((np.abs(velocity) < _CLOSEST) & ((velocity != 0.0) | (force != 0.0)))[:1]:
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


def _side(table: TextTable, velocity: Array, force: Array, order: Integers) -> Array:
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
    if direction is not None and direction in sides:
        return sides[direction]
    if direction in ("positive", "negative") or (direction == "mean" and len(sides) < 2):
        raise DataError(
            f"{source}: direction: found '{direction}', but velocities are all {next(iter(sides))}"
        )
    if len(sides) == 1:
        return next(iter(sides.values()))
    velocity = np.unique(np.concatenate([side[:, 0] for side in sides.values()]))
    one, other = (extended(side, velocity) for side in sides.values())
    most = int(np.argmax(np.abs(one - other)))
    if direction is None and abs(one[most] - other[most]) > _SYMMETRY * max(one.max(), other.max()):
        raise DataError(
            f"{source}: at {velocity[most]:g} m/s the forces of both directions are {one[most]:.4g} and "
            f"{other[most]:.4g} N; the dampers here are the same in both: give direction: positive, negative "
            "or mean"
        )
    return np.column_stack([velocity, 0.5 * (one + other)])
