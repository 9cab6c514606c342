"""Vehicles of a batch arranged so that as many as possible run side by side, in the lanes of vector registers.

Vehicles of one structure and one time step form groups of eight. A group has its own constants, interleaved
once, and its own state and scratch memory; a compiled call interleaves the members' states, runs the group and
puts the states back. Who does not find seven others of his kind runs alone. A vehicle's results do not depend
on that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from sayd_env.physics import sayd
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import (
    LANES,
    NUMBERS,
    RAIL_BASE,
    STEP,
    SUBSTEPS,
    TABLE_BASE,
    WHEEL_ROWS,
    Array,
    Ground,
    Index,
    Plant,
    State,
    Work,
)
from sayd_env.physics.rows import ABREAST, Lanes
from sayd_env.physics.stack import Stack, vehicle_of

Flags = npt.NDArray[np.bool_]

WIDTH = len(ABREAST)
"""Vehicles in a group."""
FEWEST = 5
"""So many vehicles are faster as a group with idle lanes than one after another."""

SHARED = ("start", "column")
"""Ends of the names of fields that are the same for all vehicles of a group."""


class Track(NamedTuple):
    """Where one vehicle runs."""

    irregularity: Array
    """(nodes, 4), as in `Ground`."""


def interleaved(vehicles: Sequence[Array]) -> Array:
    """Arrays (..., k) of W vehicles as one of (..., k * W)."""
    return np.ascontiguousarray(np.stack(vehicles, axis=-1).reshape(*vehicles[0].shape[:-1], -1))


def side_by_side(plants: Sequence[Plant], first_coefficients: Sequence[int]) -> Plant:
    """Constants of vehicles of one kind side by side.

    Parameters
    ----------
    plants : sequence of Plant
        One vehicle each.
    first_coefficients : sequence of int
        Where each one's track begins in the common array of irregularities.
    """
    fields: dict[str, Any] = {}
    for name in Plant._fields:
        values = [getattr(plant, name) for plant in plants]
        if name.endswith(SHARED):
            fields[name] = values[0]
        elif name.endswith("_value") and all(np.array_equal(values[0], other) for other in values[1:]):
            fields[name] = values[0]
        elif name in ("table", "sayd_table"):
            fields[name], offsets = _joined(values)
            fields[f"{name} offsets"] = offsets
        else:
            fields[name] = interleaved(values)
    width = len(plants)
    fields["number"].reshape(NUMBERS, width)[RAIL_BASE] = first_coefficients
    fields["wheel"].reshape(WHEEL_ROWS, LANES, width)[TABLE_BASE] = fields.pop("table offsets")
    offsets = fields.pop("sayd_table offsets")
    if fields["sayd_constant"].size and hasattr(sayd, "TABLE_START"):
        fields["sayd_constant"].reshape(sayd.CONSTANTS, LANES, width)[sayd.TABLE_START] = offsets
    return Plant(**fields)


def _joined(tables: Sequence[Array]) -> tuple[Array, list[int]]:
    """Tables behind one another, each once, and where each vehicle's begins."""
    distinct = list({id(table): table for table in tables}.values())
    starts = np.cumsum([0, *(len(table) for table in distinct)])
    place = {id(table): int(start) for table, start in zip(distinct, starts, strict=False)}
    return np.concatenate(distinct), [place[id(table)] for table in tables]


def kind(plant: Plant) -> tuple[Any, ...]:
    """What vehicles side by side must have in common."""
    structure = (value.tobytes() for name, value in zip(Plant._fields, plant, strict=True) if name.endswith(SHARED))
    lengths = (value.shape for name, value in zip(Plant._fields, plant, strict=True) if "table" not in name)
    return float(plant.number[STEP]), int(plant.number[SUBSTEPS]), *lengths, *structure


@kernel
def interleave(lanes: Lanes, members: Index, values: State, spans: Index, group: State) -> None:
    """Copy the members' states into their group's; lanes without a member get another one's.

    Parameters
    ----------
    members : ndarray, shape (W,)
        The vehicles; negative: no vehicle.
    values, spans
        States of all vehicles, by `Stack`.
    group : State
        Filled.
    """
    w = len(lanes)
    any_member = np.int64(0)
    for k in range(w):
        any_member = max(any_member, members[k])
    for k in range(w):
        one = vehicle_of(values, spans, members[k] if members[k] >= 0 else any_member)
        for field in range(len(one)):
            source, target = one[field], group[field]
            for r in range(source.shape[0]):
                target[r * w + k] = source[r]


@kernel
def put_back(lanes: Lanes, members: Index, values: State, spans: Index, group: State) -> None:
    """Copy a group's state back to its members: the reverse of `interleave`."""
    w = len(lanes)
    for k in range(w):
        if members[k] >= 0:
            one = vehicle_of(values, spans, members[k])
            for field in range(len(one)):
                source, target = group[field], one[field]
                for r in range(target.shape[0]):
                    target[r] = source[r * w + k]


class Units(NamedTuple):
    """Who runs in a compiled call: groups first, then vehicles alone."""

    groups: Index
    """(g,) groups that run."""
    members: Index
    """(g, W) their vehicles; -1 for a lane whose results nobody wants."""
    alone: Index
    """(a,) vehicles that run alone."""


class Formation:
    """Vehicles of a batch and their groups.

    Parameters
    ----------
    plants, tracks, states, works : sequences of Plant, Array, State, Work
        The vehicles, one each: constants, irregularities, states, scratch memory. The formation takes over the
        states: `state.view(i)` is a vehicle's from now on.

    Attributes
    ----------
    plant, track, state, work : Stack
        All vehicles.
    group_plant, group_state, group_work : Stack
        All groups; of one that is never run if there is none.
    """

    def __init__(
        self,
        plants: Sequence[Plant],
        tracks: Sequence[Array],
        states: Sequence[State],
        works: Sequence[Work],
    ) -> None:
        self._plants = list(plants)
        self._kinds = [kind(plant) for plant in plants]
        self.plant: Stack[Plant] = Stack(self._plants)
        self.track: Stack[Track] = Stack([Track(track) for track in tracks])
        self.state: Stack[State] = Stack(states)
        self.work: Stack[Work] = Stack(works)
        self._arrange()

    def __len__(self) -> int:
        return len(self._plants)

    def put(self, i: int, plant: Plant, track: Array, state: State, work: Work) -> None:
        """Replace a vehicle."""
        self.state.put(i, state)
        self.work.put(i, work)
        self.track.put(i, Track(track))
        self.change(i, plant)

    def change(self, i: int, plant: Plant) -> None:
        """Replace a vehicle's constants."""
        self._plants[i] = plant
        self.plant.put(i, plant)
        self._kinds[i] = kind(plant)
        self._stale = True

    def constants(self, i: int) -> Plant:
        """A vehicle's constants."""
        return self._plants[i]

    def units(self, active: Flags | None = None) -> Units:
        """Who runs in a call for these vehicles (by default all)."""
        if self._stale:
            self._arrange()
        if active is None or active.all():
            return self._all
        groups, members, alone = [], [], list(self._all.alone[active[self._all.alone]])
        for g, of_group in zip(self._all.groups, self._all.members, strict=True):
            present = of_group >= 0
            run = np.where(present & active[of_group], of_group, -1)
            count = np.count_nonzero(run >= 0)
            if count >= FEWEST:
                groups.append(g)
                members.append(run)
            else:
                alone += list(run[run >= 0])
        return _units(groups, members, alone)

    def arguments(self) -> tuple[Any, ...]:
        """Vehicles and groups as a compiled call takes them; valid until a vehicle is replaced."""
        own = (self.plant, self.state, self.work, self.group_plant, self.group_state, self.group_work)
        return tuple(part for stack in own for part in (stack.values, stack.spans))

    def ground(self, creep: Array) -> tuple[Ground, Index]:
        """What all vehicles read, and where each one's track stands in it."""
        return Ground(self.track.values.irregularity, creep), self.track.spans

    def _arrange(self) -> None:
        """Form groups of vehicles of one kind, in the order of the batch."""
        by_kind: dict[Any, list[int]] = {}
        for i, key in enumerate(self._kinds):
            by_kind.setdefault(key, []).append(i)
        teams, alone = [], []
        for vehicles in by_kind.values():
            for first in range(0, len(vehicles), WIDTH):
                team = vehicles[first : first + WIDTH]
                if len(team) >= FEWEST:
                    teams.append(team)
                else:
                    alone += team
        full = [team + [team[0]] * (WIDTH - len(team)) for team in teams]
        members = [team + [-1] * (WIDTH - len(team)) for team in teams]
        self._all = _units(range(len(teams)), members, alone)
        built = full or [[0] * WIDTH]  # compiled code wants an array of the right type
        starts = self.track.spans[0, :, 0]
        self.group_plant: Stack[Plant] = Stack(
            [side_by_side([self._plants[i] for i in team], starts[team]) for team in built]
        )
        self.group_state: Stack[State] = Stack([_room(self.state, team) for team in built])
        self.group_work: Stack[Work] = Stack([_room(self.work, team) for team in built])
        self._stale = False


def _units(groups: Sequence[int] | range, members: Sequence[Any], alone: Sequence[int]) -> Units:
    return Units(
        np.array(groups, dtype=np.int64),
        np.array(members, dtype=np.int64).reshape(-1, WIDTH),
        np.array(alone, dtype=np.int64),
    )


def _room(stack: Stack[Any], team: Sequence[int]) -> Any:
    """Memory for a group: each field as long as the longest member's, for all lanes."""
    views = [stack.view(i) for i in team]
    return type(views[0])(*(np.zeros(max(map(len, column)) * WIDTH) for column in zip(*views, strict=True)))
