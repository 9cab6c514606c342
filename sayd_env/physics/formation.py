"""Vehicles of a batch, arranged so that as many as possible run side by side in vector registers.

Vehicles of one structure and one time step form groups of eight. A group has its own constants, interleaved
once, and its own state and scratch memory; a compiled call interleaves the members' states, runs the group
and puts the states back. Who does not find seven others of his kind runs alone. A vehicle's results do not
depend on that.
"""

from __future__ import annotations

import hashlib
import weakref
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from sayd_env.config.units import Array, Flags, Integers
from sayd_env.physics import plant as at
from sayd_env.physics import sayd
from sayd_env.physics.aligned import zeros
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.ragged import RaggedBatch, vehicle_from
from sayd_env.physics.rows import ABREAST, Lanes

References = Integers
"""`RaggedBatch.table`."""

WIDTH = len(ABREAST)
"""Vehicles in a group."""
FEWEST = 5
"""So many vehicles are faster as a group with idle lanes than one after another."""

SHARED = ("start", "column")
"""Ends of the names of fields that are the same for all vehicles of a group."""
_ALONG_THE_WAY = {"irregularity": at.RAIL_BASE, "line": at.LINE_BASE}
"""What is too long to be copied, and the row that says where a vehicle's begins."""
_OF_ANY_LENGTH = ("table", "sayd_table", *_ALONG_THE_WAY)


def interleaved(vehicles: Sequence[Array]) -> Array:
    """Arrays (..., k) of W vehicles as one of (..., k * W)."""
    *rows, count = vehicles[0].shape
    together = zeros(*rows, count, len(vehicles))
    np.stack(vehicles, axis=-1, out=together)
    return together.reshape(*rows, -1)


def side_by_side(plants: Sequence[Plant]) -> Plant:
    """Constants of vehicles of one kind side by side, made of those of one vehicle each.

    Tracks and lines are too long to be copied: the group reads all of them from the address of the first one
    in memory on, and so the vehicles have to keep them alive.
    """
    fields: dict[str, Any] = {}
    for name in Plant._fields:
        values = [getattr(plant, name) for plant in plants]
        if name.endswith(SHARED) or name == "creep":
            fields[name] = values[0]
        elif name in _ALONG_THE_WAY:
            fields[name] = min(values, key=lambda way: way.ctypes.data)
        elif name.endswith("_value") and all(np.array_equal(values[0], other) for other in values[1:]):
            fields[name] = values[0]
        elif name in ("table", "sayd_table"):
            fields[name], offsets = _joined(values)
            fields[f"{name} offsets"] = offsets
        else:
            fields[name] = interleaved(values)
    width = len(plants)
    for name, row in _ALONG_THE_WAY.items():
        first = fields[name].ctypes.data
        fields["number"].reshape(at.NUMBERS, width)[row] = [
            (way.ctypes.data - first) // way.itemsize for way in (getattr(plant, name) for plant in plants)
        ]
    # Behind where the right wheels' table begins in their vehicle's own.
    fields["wheel"].reshape(at.WHEEL_ROWS, LANES, width)[at.TABLE_BASE] += fields.pop("table offsets")
    offsets = fields.pop("sayd_table offsets")
    if fields["sayd_constant"].size:
        fields["sayd_constant"].reshape(sayd.CONSTANTS, LANES, width)[sayd.TABLE_START] = offsets
    return Plant(**fields)


def _joined(tables: Sequence[Array]) -> tuple[Array, list[int]]:
    """Tables behind one another, each once, and where each vehicle's begins."""
    keys = [table.tobytes() for table in tables]
    distinct = dict(zip(keys, tables, strict=True))
    starts = np.cumsum([0, *(len(table) for table in distinct.values())])
    place = dict(zip(distinct, starts.tolist(), strict=False))
    return np.concatenate(list(distinct.values())), [place[key] for key in keys]


def kind(plant: Plant) -> tuple[Any, ...]:
    """What vehicles side by side must have in common."""
    fields = plant._asdict()
    structure = (value.tobytes() for name, value in fields.items() if name.endswith(SHARED))
    lengths = (value.shape for name, value in fields.items() if name not in _OF_ANY_LENGTH)
    common = (*plant.number[[at.STEP, at.SUBSTEPS, at.CREEP_LAW]], plant.wheel[at.SHEAR_MODULUS * LANES])
    common = (*common, plant.line.size > 0, plant.number[at.SHAPES] > 1.0)
    return *common, _digest(plant.creep), *lengths, *structure


def _digest(table: Array) -> bytes:
    """Digest of a creep table: copies of it are as good. Vehicles mostly share one, so it is kept."""
    key = id(table)
    known, digest = _DIGESTS.get(key, (None, b""))
    if known is None or known() is not table:
        digest = hashlib.blake2b(table.data, digest_size=16).digest()
        _DIGESTS[key] = weakref.ref(table, partial(_forget, key)), digest
    return digest


def _forget(key: int, _: object) -> None:
    _DIGESTS.pop(key, None)


_DIGESTS: dict[int, tuple[weakref.ref[Array], bytes]] = {}
"""Weak reference and digest of each creep table that is in use, by its identity."""


plant_of = vehicle_from(Plant)
state_of = vehicle_from(State)
work_of = vehicle_from(Work)


@kernel(allocates=False)
def interleave(lanes: Lanes, members: Integers, states: References, group: State) -> None:
    """Copy the members' states into their group's; lanes without a member get another one's.

    Parameters
    ----------
    members : ndarray, shape (W,)
        The vehicles; negative: no vehicle.
    states
        Of all vehicles, by `RaggedBatch`.
    group : State
        Filled.
    """
    w = len(lanes)
    any_member = np.int64(0)
    for k in range(w):
        any_member = max(any_member, members[k])
    for k in range(w):
        one = state_of(states, members[k] if members[k] >= 0 else any_member)
        for field in range(len(one)):
            source, target = one[field], group[field]
            # Delay lines may differ in length: their last rows, the newest, stand side by side.
            first = target.shape[0] // w - source.shape[0]
            for r in range(source.shape[0]):
                target[(first + r) * w + k] = source[r]


@kernel(allocates=False)
def put_back(lanes: Lanes, k: int, states: References, vehicle: int, group: State) -> None:
    """Copy the state of a group's lane k back to its vehicle; alone, a vehicle works on its own state."""
    w = len(lanes)
    if w > 1:
        one = state_of(states, vehicle)
        for field in range(len(one)):
            source, target = group[field], one[field]
            first = source.shape[0] // w - target.shape[0]
            for r in range(target.shape[0]):
                target[r] = source[(first + r) * w + k]


class Units(NamedTuple):
    """Who runs in a compiled call: groups first, then vehicles alone."""

    groups: Integers
    """(g,) groups that run."""
    members: Integers
    """(g, W) their vehicles; -1 for a lane whose results nobody wants."""
    alone: Integers
    """(a,) vehicles that run alone."""


Call = tuple[Integers | None, Integers | None, Integers | None]
"""Groups, their members and vehicles alone as a kernel takes them; None: none, and no code for them."""


def calls(units: Units, threads: int) -> list[Call]:
    """How compiled loops are called for all units.

    On one thread groups and vehicles alone have a call each, so that a program compiles only what it runs. On
    several, one call lets the threads share both.
    """
    if threads > 1:
        return [units]
    found: list[Call] = []
    if len(units.groups):
        found.append((units.groups, units.members, None))
    if len(units.alone):
        found.append((None, None, units.alone))
    return found


class Formation:
    """Vehicles of a batch and their groups.

    Parameters
    ----------
    plants, states, works : sequences of Plant, State, Work
        The vehicles, one each: constants, states, scratch memory, by reference.

    Attributes
    ----------
    plant, state, work : RaggedBatch
        All vehicles.
    """

    def __init__(self, plants: Sequence[Plant], states: Sequence[State], works: Sequence[Work]) -> None:
        self.plant = RaggedBatch(Plant, plants)
        self.state = RaggedBatch(State, states)
        self.work = RaggedBatch(Work, works)
        self._kinds = [kind(plant) for plant in plants]
        self._arrange()

    def __getstate__(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("plant", "state", "work")}

    def __setstate__(self, batches: dict[str, Any]) -> None:
        """The arrays of a copy are elsewhere: its groups are formed anew."""
        self.__dict__.update(batches)
        self._kinds = [kind(plant) for plant in self.plant]
        self._arrange()

    def __len__(self) -> int:
        return len(self.plant)

    def put(self, i: int, plant: Plant, state: State, work: Work) -> None:
        """Replace a vehicle."""
        self.state.put(i, state)
        self.work.put(i, work)
        self.change(i, plant)

    def change(self, i: int, plant: Plant) -> None:
        """Replace a vehicle's constants."""
        self.plant.put(i, plant)
        before, self._kinds[i] = self._kinds[i], kind(plant)
        self._stale |= self._kinds[i] != before
        self._changed.update(int(g) for g in np.flatnonzero((self._all.members == i).any(axis=1)))

    def units(self, active: Flags | None = None) -> Units:
        """Who runs in a call for these vehicles (by default all)."""
        if self._stale:
            self._arrange()
        for g in self._changed:
            self._form(g)
        self._changed.clear()
        if active is None or active.all():
            return self._all
        groups, members, alone = [], [], list(self._all.alone[active[self._all.alone]])
        for g, of_group in zip(self._all.groups, self._all.members, strict=True):
            run = np.where((of_group >= 0) & active[of_group], of_group, -1)
            if np.count_nonzero(run >= 0) >= FEWEST:
                groups.append(g)
                members.append(run)
            else:
                alone += list(run[run >= 0])
        return _units(groups, members, alone)

    def arguments(self) -> tuple[References, References, References, References, References, References]:
        """Vehicles and groups as a compiled call takes them, after `units`.

        Raises
        ------
        RuntimeError
            A vehicle has been replaced since: its group would read what may be gone.
        """
        if self._stale or self._changed:
            raise RuntimeError("vehicles have been replaced: call units first")
        return (
            self.plant.table,
            self.state.table,
            self.work.table,
            self._group_plant.table,
            self._group_state.table,
            self._group_work.table,
        )

    def only(self, vehicles: Sequence[int]) -> Formation:
        """Some of these vehicles in groups of their own: for a call in which the others stand still.

        Parameters
        ----------
        vehicles : sequence of int
            Neighbours in this order run side by side: those that run equally long should be neighbours.

        Returns
        -------
        Formation
            Of the same arrays, good until a vehicle is replaced.
        """
        some = object.__new__(Formation)
        some.plant, some.state, some.work, some._kinds = self.plant, self.state, self.work, self._kinds
        some._arrange(vehicles)
        return some

    def _arrange(self, vehicles: Sequence[int] | None = None) -> None:
        """Form groups of vehicles of one kind, in this order, by default that of the batch."""
        by_kind: dict[Any, list[int]] = {}
        for i in range(len(self)) if vehicles is None else vehicles:
            by_kind.setdefault(self._kinds[i], []).append(i)
        teams, alone = [], []
        for alike in by_kind.values():
            for first in range(0, len(alike), WIDTH):
                team = alike[first : first + WIDTH]
                if len(team) >= FEWEST:
                    teams.append(team)
                else:
                    alone += team
        self._all = _units(range(len(teams)), [team + [-1] * (WIDTH - len(team)) for team in teams], alone)
        self._teams = [team + [team[0]] * (WIDTH - len(team)) for team in teams]
        self._group_plant = RaggedBatch(Plant, [self._constants(team) for team in self._teams])
        self._group_state = RaggedBatch(State, [_room(self.state, team) for team in self._teams])
        self._group_work = RaggedBatch(Work, [_room(self.work, team) for team in self._teams])
        self._stale = False
        self._changed: set[int] = set()

    def _form(self, g: int) -> None:
        """Form a group anew in which a vehicle has been replaced; a delay line may have become longer."""
        team = self._teams[g]
        self._group_plant.put(g, self._constants(team))
        self._group_state.put(g, _room(self.state, team))
        self._group_work.put(g, _room(self.work, team))

    def _constants(self, team: Sequence[int]) -> Plant:
        return side_by_side([self.plant.view(i) for i in team])


def _units(groups: Sequence[int] | range, members: Sequence[Any], alone: Sequence[int]) -> Units:
    return Units(
        np.array(groups, dtype=np.int64),
        np.array(members, dtype=np.int64).reshape(-1, WIDTH),
        np.array(alone, dtype=np.int64),
    )


def _room(batch: RaggedBatch[Any], team: Sequence[int]) -> Any:
    """Memory for a group: each field as long as the longest member's, for all lanes."""
    views = [batch.view(i) for i in team]
    return type(views[0])(*(zeros(max(map(len, column)) * WIDTH) for column in zip(*views, strict=True)))
