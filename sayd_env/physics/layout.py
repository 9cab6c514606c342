"""Where a vehicle's bodies and elements stand and what they connect: all that its numbers leave as it is.

Vehicles of one design differ in masses, stiffnesses and curves. Their unknowns, connection vectors and the
places of each element in the matrices are the same: they are found once for a design.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from sayd_env.config.errors import ConfigError
from sayd_env.config.units import Array, Integers
from sayd_env.config.vehicle import (
    DOFS,
    GROUND,
    Attachment,
    Body,
    Bush,
    Damper,
    Element,
    Stop,
    Torsion,
    VehicleConfig,
    YawDamper,
)

AXES = {"x": 0, "y": 1, "z": 2, "roll": 0, "pitch": 1, "yaw": 2}
SECTION_DOFS = ("y", "z", "roll")
"""Degrees of freedom of a track section."""


@dataclass(frozen=True)
class Instance:
    """One body of the assembled model: where it stands and which unknowns move it."""

    name: str
    body: Body
    position: Array
    columns: dict[str, int]
    carrier: Instance | None = None


class Entries(NamedTuple):
    """Contributions to a matrix, each ``factor * numbers[number]``, in the order in which they are added."""

    place: Integers
    """(e,) place in the flat matrix."""
    factor: Array
    """(e,)."""
    number: Integers
    """(e,) which of the numbers."""

    def added_up(self, numbers: Array, n: int, *more: tuple[Entries, Array]) -> Array:
        """The matrix of shape (n, n), with more entries and their own numbers added after these."""
        every = [(self, numbers), *more]
        places = np.concatenate([entries.place for entries, _ in every])
        values = np.concatenate([entries.factor * of[entries.number] for entries, of in every])
        total = np.bincount(places, values, n * n)  # one after another; of nothing it makes whole numbers
        return np.asarray(total, dtype=np.float64).reshape(n, n)


class Place(NamedTuple):
    """A force element of a law of its own."""

    name: str
    element: int
    """Its place in the vehicle's list of elements."""
    connection: Array
    """(n,) connection vector."""


class Carrier(NamedTuple):
    """A spring that carries static weight."""

    connection: Array
    """(n,) of its vertical elongation."""
    number: int
    """Which of the numbers its vertical stiffness is."""


@dataclass(frozen=True, eq=False)
class Layout:
    """A design: its unknowns, n of them, in the order of its bodies, and what acts on which.

    Attributes
    ----------
    n : int
        Number of degrees of freedom.
    instances : dict of Instance
        Its bodies, with the numbers of the vehicle for which the layout was made.
    wheelsets : tuple of str
        Names of the wheelsets.
    sections : dict of int
        First column of each track section (y, z, roll).
    mass : ndarray, shape (n,)
        Where each unknown's mass stands in a table of six numbers for each body, and two for a section.
    linear : Entries
        Springs and dampers: stiffness and damping matrix alike.
    carriers : tuple of Carrier
    vertical : Entries
        Their stiffness against vertical motion, the numbers being those of `linear`.
    gravity : Entries
        Gravity stiffness, the numbers being the static forces of the carriers.
    dampers, stops : tuple of Place
    yaw_dampers : tuple
        Name, connection vector of the bogie end and of the carbody end.
    measuring_height : float
    """

    n: int
    instances: dict[str, Instance]
    wheelsets: tuple[str, ...]
    sections: dict[str, int]
    mass: Integers
    linear: Entries
    carriers: tuple[Carrier, ...]
    vertical: Entries
    gravity: Entries
    dampers: tuple[Place, ...]
    stops: tuple[Place, ...]
    yaw_dampers: tuple[tuple[str, Array, Array], ...]
    measuring_height: float


@dataclass(frozen=True, eq=False)
class Arrangement:
    """A layout with its unknowns in another order; fields as in `multibody.Multibody`."""

    layout: Layout
    order: Integers
    """(n,) column of the layout for each unknown."""
    dof_names: tuple[str, ...]
    dampers: tuple[Place, ...]
    stops: tuple[Place, ...]
    yaw_dampers: tuple[tuple[str, Array, Array], ...]
    wheelset_dofs: Integers
    section_dofs: Integers
    wheelset_x: Array
    measuring_points: tuple[tuple[str, Array], ...]
    instances: dict[str, Instance]
    """With the numbers of the layout's vehicle."""

    def instances_of(self, vehicle: VehicleConfig) -> dict[str, Instance]:
        """The instances of a vehicle of this layout, with its own bodies."""
        bodies = {body.name: body for body in vehicle.bodies}
        own: dict[str, Instance] = {}
        for name, i in self.instances.items():  # carriers stand before what they carry
            carrier = None if i.carrier is None else own[i.carrier.name]
            own[name] = Instance(name, bodies[i.body.name], i.position, i.columns, carrier)
        return own


@dataclass(frozen=True)
class _Design:
    """A vehicle that is equal to all others of its layout."""

    key: tuple[Any, ...]
    vehicle: VehicleConfig = field(compare=False, repr=False)
    with_sections: bool


def layout(vehicle: VehicleConfig, with_sections: bool) -> Layout:
    """The layout of a vehicle with or without track sections; vehicles of one design have the same object."""
    return _layout(_Design(_key(vehicle), vehicle, with_sections))


def arrange(made: Layout, order: Integers) -> Arrangement:
    """The layout with its unknowns in the order of these columns; made once for each."""
    return _arrangement(made, order.tobytes())


def _key(vehicle: VehicleConfig) -> tuple[Any, ...]:
    """What the layout is made of."""
    sets = tuple(
        (name, tuple((member, each.origin, each.sign) for member, each in members.items()))
        for name, members in vehicle.sets.items()
    )
    bodies = tuple((b.name, b.role, b.per, b.position, b.dofs, b.carrier) for b in vehicle.bodies)
    elements = tuple(
        (e.type, e.name, e.per, e.a, e.b, getattr(e, "axis", None), getattr(e, "carries_weight", None))
        for e in vehicle.elements
    )
    return sets, bodies, elements, vehicle.measuring_height


@lru_cache(maxsize=32)
def _layout(design: _Design) -> Layout:
    vehicle = design.vehicle
    instances = _instantiate(vehicle)
    wheelsets = tuple(i.name for i in instances.values() if i.body.role == "wheelset")
    n = 1 + max(max(i.columns.values()) for i in instances.values() if i.columns)
    sections = {}
    if design.with_sections:
        sections = {f"track.{name}": n + 3 * k for k, name in enumerate(wheelsets)}
        n += 3 * len(wheelsets)
    builder = _Builder(vehicle, instances, n)
    for element in vehicle.elements:
        builder.add(element)
    for first in sections.values():
        builder.add_section(first)
    builder.add_gravity()
    return Layout(
        n=n,
        instances=instances,
        wheelsets=wheelsets,
        sections=sections,
        mass=_mass_places(vehicle, instances, sections, n),
        linear=builder.linear.entries(),
        carriers=tuple(Carrier(c.move[2], c.number) for c in builder.carriers),
        vertical=builder.vertical.entries(),
        gravity=builder.gravity.entries(),
        dampers=tuple(builder.dampers),
        stops=tuple(builder.stops),
        yaw_dampers=tuple(builder.yaw_dampers),
        measuring_height=vehicle.measuring_height,
    )


@lru_cache(maxsize=64)
def _arrangement(made: Layout, order_bytes: bytes) -> Arrangement:
    order = np.frombuffer(order_bytes, dtype=np.int64)
    rank, n = np.argsort(order), made.n
    names = _dof_names(made.instances, made.sections, n)
    instances = {k: _renumbered(i, rank) for k, i in made.instances.items()}
    wheelsets = [instances[name] for name in made.wheelsets]
    frames = [i for i in instances.values() if i.body.role == "frame"]

    def moved(places: tuple[Place, ...]) -> tuple[Place, ...]:
        return tuple(place._replace(connection=place.connection[order]) for place in places)

    return Arrangement(
        layout=made,
        order=order,
        dof_names=tuple(names[i] for i in order),
        dampers=moved(made.dampers),
        stops=moved(made.stops),
        yaw_dampers=tuple((name, a[order], b[order]) for name, a, b in made.yaw_dampers),
        wheelset_dofs=np.array([[w.columns.get(d, -1) for d in DOFS] for w in wheelsets]),
        section_dofs=np.array([rank[k : k + 3] for k in made.sections.values()]).reshape(-1, 3),
        wheelset_x=np.array([w.position[0] for w in wheelsets]),
        measuring_points=_measuring_points(made.measuring_height, wheelsets, frames, n),
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
            position = origin + sign * np.array(body.position)
            if carrier is not None and np.any(np.abs(position - carrier.position)[[0, 2]] > 1e-9):
                raise ConfigError(
                    f"{vehicle.name}: body '{name}' is hinged beside the axle of '{carrier.name}', whose "
                    "pitch would move the hinge; expected the same x and z"
                )
            instances[name] = Instance(name, body, position, columns, carrier)
    return instances


def displacement(instance: Instance, position: Array, n: int) -> Array:
    """Map from the unknowns to the displacement of a point of a body, shape (3, n)."""
    rows = np.zeros((3, n))
    if instance.carrier is not None:
        # Carried along by its carrier's translation, roll and yaw; its pitch is its own.
        rows += displacement(instance.carrier, instance.position, n)
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


class _Entries:
    """`Entries` under way."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.place: list[Integers] = []
        self.factor: list[Array] = []
        self.number: list[Integers] = []

    def add(self, rows: Any, columns: Any, factor: Any, number: int) -> None:
        """Add factors at the places (row, column)."""
        place = np.atleast_1d(np.asarray(rows) * self.n + np.asarray(columns))
        self.place.append(place.astype(np.int64))
        self.factor.append(np.broadcast_to(factor, place.shape).astype(np.float64))
        self.number.append(np.full(place.shape, number, dtype=np.int64))

    def add_square(self, g: Array, number: int) -> None:
        """Add the square of a connection vector, g g^T."""
        (at,) = np.nonzero(g)
        rows, columns = np.repeat(at, len(at)), np.tile(at, len(at))
        self.add(rows, columns, g[rows] * g[columns], number)

    def entries(self) -> Entries:
        """All of them."""
        if not self.place:
            return Entries(np.zeros(0, np.int64), np.zeros(0), np.zeros(0, np.int64))
        return Entries(np.concatenate(self.place), np.concatenate(self.factor), np.concatenate(self.number))


class _Carrier(NamedTuple):
    """A spring that carries weight: its elongation (3, n), its number, and its ends."""

    move: Array
    number: int
    a: Instance | None
    at: Array
    b: Instance | None
    bt: Array


class _Builder:
    """Collects the elements' contributions."""

    def __init__(self, vehicle: VehicleConfig, instances: dict[str, Instance], n: int) -> None:
        self.vehicle = vehicle
        self.instances = instances
        self.n = n
        self.linear, self.vertical, self.gravity = _Entries(n), _Entries(n), _Entries(n)
        self.dampers: list[Place] = []
        self.stops: list[Place] = []
        self.yaw_dampers: list[tuple[str, Array, Array]] = []
        self.carriers: list[_Carrier] = []
        self.depth = {body.name: len(body.per) for body in vehicle.bodies}
        self.numbers = 0
        """Of linear elements so far: `linear_numbers` lists them in this order."""
        self._elements = 0

    def add(self, element: Element) -> None:
        """Add an element at all its places."""
        for members, origin, sign in _members(self.vehicle, element.per):
            name = ".".join((element.name, *members))
            a, at = self._end(element.a, members, origin, sign)
            b, bt = self._end(element.b, members, origin, sign)
            move = self._move(b, bt) - self._move(a, at)
            match element:
                case Torsion():
                    self.linear.add_square(
                        self._rotate(b, element.axis) - self._rotate(a, element.axis), self.numbers
                    )
                case Bush():
                    for axis in range(3):
                        self.linear.add_square(move[axis], self.numbers + axis)
                    if element.carries_weight:
                        self.carriers.append(_Carrier(move, self.numbers + 2, a, at, b, bt))
                case YawDamper():
                    self.yaw_dampers.append((name, self._move(a, at)[0], self._move(b, bt)[0]))
                case Damper():
                    self.dampers.append(Place(name, self._elements, move[AXES[element.axis]]))
                case Stop():
                    self.stops.append(Place(name, self._elements, move[AXES[element.axis]]))
        self.numbers += 3 if isinstance(element, Bush) else 1 if isinstance(element, Torsion) else 0
        self._elements += 1

    def add_section(self, first: int) -> None:
        """Springs and dampers of a track section (y, z, roll) against the ground; all sections are alike."""
        for k in range(len(SECTION_DOFS)):
            self.linear.add(first + k, first + k, 1.0, self.numbers + k)

    def add_gravity(self) -> None:
        """Gravity (geometric) stiffness of the springs' static forces.

        A weight-carrying spring's static force P acts at its ends, which move with their bodies, so a
        rotation theta of a body changes the moment about its centre by (theta x r) x P (pendulum terms). The
        force follows the mean rotation of both ends: a body on a canted base slides down by m g theta / k.
        """
        for k, carrier in enumerate(self.carriers):
            self.vertical.add_square(carrier.move[2], carrier.number)
            self._add_pendulum(carrier.b, carrier.bt, 1.0, k)
            self._add_pendulum(carrier.a, carrier.at, -1.0, k)
            self._add_following(carrier, k)

    def _add_pendulum(self, instance: Instance | None, position: Array, sign: float, k: int) -> None:
        if instance is None or instance.carrier is not None:
            return  # a spring on a hinged part stands at its hinge: no lever
        x, y, z = sign * (position - instance.position)
        moment = {  # (theta x r) x P for P along z
            "roll": {"roll": -z, "yaw": x},
            "pitch": {"pitch": -z, "yaw": y},
        }
        columns = instance.columns
        for row, entries in moment.items():
            for column, value in entries.items():
                if row in columns and column in columns:
                    self.gravity.add(columns[row], columns[column], -value, k)

    def _add_following(self, carrier: _Carrier, k: int) -> None:
        """Turn the force with the mean rotation: potential P (roll dy - pitch dx), d from a's end to b's."""
        roll = 0.5 * (self._rotate(carrier.a, "roll") + self._rotate(carrier.b, "roll"))
        pitch = 0.5 * (self._rotate(carrier.a, "pitch") + self._rotate(carrier.b, "pitch"))
        dx, dy, _ = carrier.move
        half = np.outer(roll, dy) - np.outer(pitch, dx)
        both = half + half.T
        rows, columns = np.nonzero(both)
        self.gravity.add(rows, columns, both[rows, columns], k)

    def _end(
        self, end: Attachment, members: tuple[str, ...], origin: Array, sign: Array
    ) -> tuple[Instance | None, Array]:
        position = origin + sign * np.array(end.at)
        if end.body == GROUND:
            return None, position
        return self.instances[".".join((end.body, *members[: self.depth[end.body]]))], position

    def _move(self, instance: Instance | None, position: Array) -> Array:
        return np.zeros((3, self.n)) if instance is None else displacement(instance, position, self.n)

    def _rotate(self, instance: Instance | None, axis: str) -> Array:
        return np.zeros(self.n) if instance is None else _rotation(instance, axis, self.n)


def _mass_places(
    vehicle: VehicleConfig, instances: dict[str, Instance], sections: dict[str, int], n: int
) -> Integers:
    places = np.zeros(n, dtype=np.int64)
    row = {body.name: k * len(DOFS) for k, body in enumerate(vehicle.bodies)}
    for i in instances.values():
        for dof, column in i.columns.items():
            places[column] = row[i.body.name] + DOFS.index(dof)
    beyond = len(vehicle.bodies) * len(DOFS)
    for first in sections.values():
        places[first : first + 3] = beyond, beyond, beyond + 1
    return places


def _dof_names(instances: dict[str, Instance], sections: dict[str, int], n: int) -> list[str]:
    names = [""] * n
    for i in instances.values():
        for dof, column in i.columns.items():
            names[column] = f"{i.name}.{dof}"
    for name, first in sections.items():
        names[first : first + 3] = [f"{name}.{dof}" for dof in SECTION_DOFS]
    return names


def _renumbered(instance: Instance, rank: Integers) -> Instance:
    columns = {dof: int(rank[c]) for dof, c in instance.columns.items()}
    carrier = None if instance.carrier is None else _renumbered(instance.carrier, rank)
    return Instance(instance.name, instance.body, instance.position, columns, carrier)


def frame_of(wheelset: Instance, frames: list[Instance]) -> Instance | None:
    """The bogie frame over a wheelset."""
    return min(frames, key=lambda f: abs(f.position[0] - wheelset.position[0]), default=None)


def longitudinal_rows(design: Arrangement) -> Array:
    """Rows that give the longitudinal motion of the frames at the dampers' mounts, shape (sides, n).

    Front and rear bogie, left and right side; each the mean of the mounts of the side's dampers.
    """
    sides: dict[str, list[Array]] = {}
    for name, bogie, _ in design.yaw_dampers:
        sides.setdefault(name.rpartition(".")[0], []).append(bogie)
    return np.array([np.mean(mounts, axis=0) for mounts in sides.values()])


def _measuring_points(
    height: float, wheelsets: list[Instance], frames: list[Instance], n: int
) -> tuple[tuple[str, Array], ...]:
    points = []
    for w in wheelsets:
        position = np.array([w.position[0], 0.0, height])
        points.append((w.name, displacement(frame_of(w, frames) or w, position, n)[1]))
    return tuple(points)
