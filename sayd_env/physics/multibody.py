"""Assembly: bodies and linear force elements -> M, C, K and the connection vectors of 1-D force elements.

Rotations are small and the frame moves with the train, so every displacement of a point is linear in the
degrees of freedom: u(p) = u_body + theta x (p - p_body). A force element between two points along a
direction d then has the elongation g.q with the connection vector g = d.(u(b) - u(a)), and acts on the
degrees of freedom with the generalised force -g F.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from sayd_env.config import ConfigError
from sayd_env.config.track import SectionConfig
from sayd_env.config.vehicle import (
    DOFS,
    GROUND,
    Attachment,
    Body,
    Bush,
    Damper,
    Stop,
    Torsion,
    VehicleConfig,
    YawDamper,
)

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
GRAVITY = 9.81
"""Acceleration of gravity (m/s2), the value behind the paper's axle load."""
_ROUNDING = 1e-14  # of a matrix's largest entry
AXES = {"x": 0, "y": 1, "z": 2, "roll": 0, "pitch": 1, "yaw": 2}


@dataclass(frozen=True)
class Instance:
    """One body of the assembled model: where it stands and which unknowns move it."""

    name: str
    body: Body
    position: Array
    columns: dict[str, int]
    carrier: Instance | None = None


@dataclass(frozen=True)
class ForceElement:
    """A non-linear 1-D force element: name, connection vector (n,) and odd piecewise-linear law."""

    name: str
    connection: Array
    curve: Array
    """Points (velocity or displacement, force), shape (k, 2)."""
    series_stiffness: float = 0.0
    """Series stiffness of a Maxwell element (N/m); 0 for a stop."""


@dataclass(frozen=True)
class Multibody:
    """Assembled model of n degrees of freedom, in an order that keeps the matrices' columns compact."""

    dof_names: tuple[str, ...]
    mass: Array
    """Diagonal of the mass matrix, shape (n,), kg and kg m2."""
    damping: Array
    """C, shape (n, n), without the gyroscopic terms."""
    stiffness: Array
    """K, shape (n, n), with the gravity stiffness of the static loads."""
    gyroscopic: Array
    """G, shape (n, n): the gyroscopic force is -(V / r0) G v (spinning wheelsets)."""
    dampers: tuple[ForceElement, ...]
    """Maxwell elements other than yaw dampers."""
    stops: tuple[ForceElement, ...]
    yaw_dampers: tuple[tuple[str, Array, Array], ...]
    """Name, connection vector of the bogie end and of the carbody end (elongation = bogie - carbody)."""
    wheelset_dofs: Index
    """Columns of x, y, z, roll, pitch, yaw of each wheelset, shape (w, 6); -1: not free."""
    section_dofs: Index
    """Columns of y, z, roll of the track section under each wheelset, shape (w or 0, 3)."""
    wheelset_x: Array
    """Longitudinal position of each wheelset, shape (w,), m."""
    wheel_load: Array
    """Static vertical load of one wheel of each wheelset, shape (w,), N; 0 if it cannot move vertically."""
    measuring_points: tuple[tuple[str, Array], ...]
    """Lateral displacement of the bogie frame (of the wheelset, if no frame is there) above each wheelset:
    name and connection vector."""
    bogie_mass: float
    """Frame and its wheelsets (kg), the m_b of EN 14363."""
    total_mass: float
    instances: dict[str, Instance] = field(repr=False)

    @property
    def n(self) -> int:
        """Number of degrees of freedom."""
        return len(self.dof_names)

    def point(self, name: str, position: Array, direction: Array) -> Array:
        """Row that gives the displacement of a body's point along a direction, shape (n,)."""
        return _displacement(self.instances[name], position, self.n).T @ direction


def assemble(vehicle: VehicleConfig, section: SectionConfig | None) -> Multibody:
    """Assemble a vehicle on co-moving track sections.

    Parameters
    ----------
    vehicle : VehicleConfig
        Bodies and force elements.
    section : SectionConfig or None
        The track section under each wheelset: lateral, vertical and roll (paper reference 13); None for a
        rigid track.

    Raises
    ------
    ConfigError
        The vehicle's elements do not fit together (a weight that nothing carries, for example).
    """
    instances = _instantiate(vehicle)
    wheelsets = [i for i in instances.values() if i.body.role == "wheelset"]
    n = 1 + max(max(i.columns.values()) for i in instances.values() if i.columns)
    sections = {}
    if section is not None:
        sections = {f"track.{w.name}": n + 3 * k for k, w in enumerate(wheelsets)}
        n += 3 * len(wheelsets)

    builder = _Builder(vehicle, instances, n)
    for element in vehicle.elements:
        builder.add(element)
    mass = _mass(instances, n)
    if section is not None:
        for first in sections.values():
            builder.add_section(first, section)
            mass[first : first + 3] = section.mass, section.mass, section.roll_inertia
    loads = builder.add_gravity(wheelsets)
    names = _dof_names(instances, sections, n)
    stiffness, damping = _without_rounding(builder.stiffness), _without_rounding(builder.damping)

    order = _compact_order(stiffness, damping)
    rank = np.argsort(order)
    instances = {k: _renumbered(i, rank) for k, i in instances.items()}
    dofs = np.array([[instances[w.name].columns.get(d, -1) for d in DOFS] for w in wheelsets])
    frames = [i for i in instances.values() if i.body.role == "frame"]
    shuffle = np.ix_(order, order)
    return Multibody(
        dof_names=tuple(names[i] for i in order),
        mass=mass[order],
        damping=damping[shuffle],
        stiffness=stiffness[shuffle],
        gyroscopic=_gyroscopic(instances, n),
        dampers=tuple(_permuted(e, order) for e in builder.dampers),
        stops=tuple(_permuted(e, order) for e in builder.stops),
        yaw_dampers=tuple((name, a[order], b[order]) for name, a, b in builder.yaw_dampers),
        wheelset_dofs=dofs,
        section_dofs=np.array([rank[first : first + 3] for first in sections.values()]).reshape(-1, 3),
        wheelset_x=np.array([w.position[0] for w in wheelsets]),
        wheel_load=loads,
        measuring_points=_measuring_points(vehicle, instances, frames, n),
        bogie_mass=_bogie_mass(wheelsets, frames),
        total_mass=sum(i.body.mass for i in instances.values()),
        instances=instances,
    )


def _members(vehicle: VehicleConfig, per: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Array, Array]]:
    """Every combination of the sets' members: names, origin and sign of the local frame."""
    for combination in itertools.product(*(vehicle.sets[s].items() for s in per)):
        origin = np.sum([m.origin for _, m in combination], axis=0) if combination else np.zeros(3)
        sign = np.prod([m.sign for _, m in combination], axis=0) if combination else np.ones(3)
        yield tuple(name for name, _ in combination), origin, sign


def _instantiate(vehicle: VehicleConfig) -> dict[str, Instance]:
    instances: dict[str, Instance] = {}
    column = itertools.count()
    depth = {body.name: len(body.per) for body in vehicle.bodies}
    for body in sorted(vehicle.bodies, key=lambda b: b.role == "hinged"):  # carriers first
        for members, origin, sign in _members(vehicle, body.per):
            name = ".".join((body.name, *members))
            carrier = None
            if body.carrier is not None:
                carrier = instances[".".join((body.carrier, *members[: depth[body.carrier]]))]
            columns: dict[str, int] = {dof: next(column) for dof in body.dofs}
            instances[name] = Instance(name, body, origin + sign * np.array(body.position), columns, carrier)
    return instances


def _displacement(instance: Instance, position: Array, n: int) -> Array:
    """Map from the unknowns to the displacement of a point of a body, shape (3, n)."""
    rows = np.zeros((3, n))
    if instance.carrier is not None:
        # Carried along by its carrier's translation, roll and yaw; its pitch is its own.
        rows += _displacement(instance.carrier, instance.position, n)
        arm = position - instance.position
        carried = {d: c for d, c in instance.carrier.columns.items() if d in ("roll", "yaw")}
        _add_rotation(rows, carried, arm)
        _add_rotation(rows, instance.columns, arm)
        pitch = instance.carrier.columns.get("pitch")
        if pitch is not None:  # the hinge is on the carrier's axle: its own pitch moves nothing
            rows[:, pitch] = 0.0
        return rows
    for dof, row in (("x", 0), ("y", 1), ("z", 2)):
        if dof in instance.columns:
            rows[row, instance.columns[dof]] = 1.0
    _add_rotation(rows, instance.columns, position - instance.position)
    return rows


def _add_rotation(rows: Array, columns: dict[str, int], arm: Array) -> None:
    """Add theta x arm for the rotations among the columns."""
    x, y, z = arm
    for dof, turned in (("roll", (0.0, -z, y)), ("pitch", (z, 0.0, -x)), ("yaw", (-y, x, 0.0))):
        if dof in columns:
            rows[:, columns[dof]] += turned


def _rotation(instance: Instance, axis: str, n: int) -> Array:
    row = np.zeros(n)
    if axis in instance.columns:
        row[instance.columns[axis]] = 1.0
    elif instance.carrier is not None and axis in instance.carrier.columns:
        row[instance.carrier.columns[axis]] = 1.0
    return row


class _Builder:
    """Collects the elements' contributions."""

    def __init__(self, vehicle: VehicleConfig, instances: dict[str, Instance], n: int) -> None:
        self.vehicle = vehicle
        self.instances = instances
        self.n = n
        self.stiffness = np.zeros((n, n))
        self.damping = np.zeros((n, n))
        self.dampers: list[ForceElement] = []
        self.stops: list[ForceElement] = []
        self.yaw_dampers: list[tuple[str, Array, Array]] = []
        self.carriers: list[tuple[Array, float, Instance | None, Array, Instance | None, Array]] = []
        self.depth = {body.name: len(body.per) for body in vehicle.bodies}

    def add(self, element: Bush | Torsion | Damper | Stop | YawDamper) -> None:
        for members, origin, sign in _members(self.vehicle, element.per):
            name = ".".join((element.name, *members))
            a, at = self._end(element.a, members, origin, sign)
            b, bt = self._end(element.b, members, origin, sign)
            if isinstance(element, Torsion):
                g = self._rotate(b, element.axis) - self._rotate(a, element.axis)
                self._add_linear(g, element.stiffness, element.damping)
                continue
            move = self._move(b, bt) - self._move(a, at)
            if isinstance(element, Bush):
                for axis in range(3):
                    self._add_linear(move[axis], element.stiffness[axis], element.damping[axis])
                if element.carries_weight:
                    self.carriers.append((move[2], element.stiffness[2], a, at, b, bt))
            elif isinstance(element, YawDamper):
                self.yaw_dampers.append((name, self._move(a, at)[0], self._move(b, bt)[0]))
            elif isinstance(element, Damper):
                curve = np.array(element.curve)
                g = move[AXES[element.axis]]
                self.dampers.append(ForceElement(name, g, curve, element.series_stiffness))
            else:
                self.stops.append(ForceElement(name, move[AXES[element.axis]], np.array(element.curve)))

    def add_section(self, first: int, section: SectionConfig) -> None:
        """Springs and dampers of a track section (y, z, roll) against the ground."""
        arm = section.seat_half_spacing
        k = (
            section.lateral_stiffness,
            2 * section.vertical_stiffness,
            2 * section.vertical_stiffness * arm**2,
        )
        c = (section.lateral_damping, 2 * section.vertical_damping, 2 * section.vertical_damping * arm**2)
        for i in range(3):
            self.stiffness[first + i, first + i] += k[i]
            self.damping[first + i, first + i] += c[i]

    def add_gravity(self, wheelsets: list[Instance]) -> Array:
        """Static loads, their gravity (geometric) stiffness, and the wheel loads (N).

        A weight-carrying spring's static force P acts at its ends, which move with their bodies, so a
        rotation theta of a body changes the moment about its centre by (theta x r) x P (pendulum terms). The
        force follows the mean rotation of both ends: a body on a canted base slides down by m g theta / k.
        """
        weight = np.zeros(self.n)
        vertical = np.zeros((self.n, self.n))
        for i in self.instances.values():
            if "z" in i.columns:
                weight[i.columns["z"]] = -GRAVITY * i.body.mass
        for g, k, *_ in self.carriers:
            place = np.flatnonzero(g)
            vertical[np.ix_(place, place)] += k * np.outer(g[place], g[place])
        support = [w.columns["z"] for w in wheelsets if "z" in w.columns]
        stiff = 1e3 * max(float(np.max(np.diag(vertical))), 1.0)
        vertical[support, support] += stiff
        rows = np.flatnonzero(np.any(vertical != 0.0, axis=1) | (weight != 0.0))
        settled = np.zeros(self.n)
        if len(rows):
            settled[rows] = np.linalg.lstsq(vertical[np.ix_(rows, rows)], weight[rows], rcond=1e-12)[0]
        if not np.allclose(vertical @ settled, weight, atol=1e-6 * np.max(np.abs(weight))):
            raise ConfigError(
                f"{self.vehicle.name}: the static weight is not carried; "
                "mark the springs that carry it with carries_weight: true"
            )
        for g, k, a, at, b, bt in self.carriers:
            force = -k * float(g @ settled)  # on b, upwards; the opposite on a
            self._add_geometric(b, bt, force)
            self._add_geometric(a, at, -force)
            self._add_following(a, at, b, bt, force)
        sinking = [settled[w.columns["z"]] if "z" in w.columns else 0.0 for w in wheelsets]
        return -0.5 * stiff * np.array(sinking)

    def _add_geometric(self, instance: Instance | None, position: Array, force: float) -> None:
        if instance is None or instance.carrier is not None:
            return  # a spring on a hinged part stands at its hinge: no lever
        x, y, z = position - instance.position
        moment = {  # (theta x r) x P for P along z
            "roll": {"roll": -z * force, "yaw": x * force},
            "pitch": {"pitch": -z * force, "yaw": y * force},
        }
        for row, entries in moment.items():
            for column, value in entries.items():
                if row in instance.columns and column in instance.columns:
                    self.stiffness[instance.columns[row], instance.columns[column]] -= value

    def _add_following(
        self, a: Instance | None, at: Array, b: Instance | None, bt: Array, force: float
    ) -> None:
        """Turn the force with the mean rotation: potential P (roll dy - pitch dx), d from a's end to b's."""
        roll = 0.5 * (self._rotate(a, "roll") + self._rotate(b, "roll"))
        pitch = 0.5 * (self._rotate(a, "pitch") + self._rotate(b, "pitch"))
        dx, dy, _ = self._move(b, bt) - self._move(a, at)
        half = np.outer(roll, dy) - np.outer(pitch, dx)
        self.stiffness += force * (half + half.T)

    def _end(
        self, end: Attachment, members: tuple[str, ...], origin: Array, sign: Array
    ) -> tuple[Instance | None, Array]:
        position = origin + sign * np.array(end.at)
        if end.body == GROUND:
            return None, position
        return self.instances[".".join((end.body, *members[: self.depth[end.body]]))], position

    def _move(self, instance: Instance | None, position: Array) -> Array:
        return np.zeros((3, self.n)) if instance is None else _displacement(instance, position, self.n)

    def _rotate(self, instance: Instance | None, axis: str) -> Array:
        return np.zeros(self.n) if instance is None else _rotation(instance, axis, self.n)

    def _add_linear(self, g: Array, stiffness: float, damping: float) -> None:
        place = np.flatnonzero(g)
        block, outer = np.ix_(place, place), np.outer(g[place], g[place])
        self.stiffness[block] += stiffness * outer
        self.damping[block] += damping * outer


def _mass(instances: dict[str, Instance], n: int) -> Array:
    mass = np.zeros(n)
    for i in instances.values():
        values: dict[str, float] = dict(zip(DOFS, (*(3 * [i.body.mass]), *i.body.inertia), strict=True))
        for dof, column in i.columns.items():
            mass[column] = values[dof]
    return mass


def _gyroscopic(instances: dict[str, Instance], n: int) -> Array:
    """Matrix G of the spinning wheelsets: I_y omega couples roll and yaw (force -(V / r0) G v)."""
    matrix = np.zeros((n, n))
    for i in instances.values():
        if i.body.role == "wheelset" and {"roll", "yaw"} <= i.columns.keys():
            roll, yaw, spin = i.columns["roll"], i.columns["yaw"], i.body.inertia[1]
            matrix[roll, yaw] = -spin
            matrix[yaw, roll] = spin
    return matrix


def _dof_names(instances: dict[str, Instance], sections: dict[str, int], n: int) -> list[str]:
    names = [""] * n
    for i in instances.values():
        for dof, column in i.columns.items():
            names[column] = f"{i.name}.{dof}"
    for name, first in sections.items():
        names[first : first + 3] = [f"{name}.{dof}" for dof in ("y", "z", "roll")]
    return names


def _without_rounding(matrix: Array) -> Array:
    """The matrix with zeros for what rounding leaves of sums that cancel.

    Else its pattern, and with it the order of the unknowns, would change with any number of the vehicle, and
    vehicles that differ in numbers alone could not stand side by side.
    """
    return np.where(np.abs(matrix) > _ROUNDING * np.max(np.abs(matrix), initial=0.0), matrix, 0.0)


def _compact_order(*matrices: Array) -> Index:
    """Order of the unknowns that keeps the non-zero rows of each column close together."""
    pattern = csr_matrix(sum(np.abs(m) for m in matrices) != 0.0)
    return np.asarray(reverse_cuthill_mckee(pattern, symmetric_mode=True), dtype=np.int64)


def _renumbered(instance: Instance, rank: Index) -> Instance:
    columns = {dof: int(rank[c]) for dof, c in instance.columns.items()}
    carrier = None if instance.carrier is None else _renumbered(instance.carrier, rank)
    return Instance(instance.name, instance.body, instance.position, columns, carrier)


def _permuted(element: ForceElement, order: Index) -> ForceElement:
    return ForceElement(element.name, element.connection[order], element.curve, element.series_stiffness)


def _frame_of(wheelset: Instance, frames: list[Instance]) -> Instance | None:
    return min(frames, key=lambda f: abs(f.position[0] - wheelset.position[0]), default=None)


def _measuring_points(
    vehicle: VehicleConfig, instances: dict[str, Instance], frames: list[Instance], n: int
) -> tuple[tuple[str, Array], ...]:
    points = []
    for w in (i for i in instances.values() if i.body.role == "wheelset"):
        position = np.array([w.position[0], 0.0, vehicle.measuring_height])
        points.append((w.name, _displacement(_frame_of(w, frames) or w, position, n)[1]))
    return tuple(points)


def _bogie_mass(wheelsets: list[Instance], frames: list[Instance]) -> float:
    if not frames:
        return wheelsets[0].body.mass
    own = [w.body.mass for w in wheelsets if _frame_of(w, frames) is frames[0]]
    return frames[0].body.mass + sum(own)
