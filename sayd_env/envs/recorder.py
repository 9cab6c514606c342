"""What a picture of a vehicle shows: its motion, forces and readings.

The environment fills a recorder, the recorder makes a `Frame`, and drawing needs nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sayd_env.config.conditions import Line
from sayd_env.config.fault import DamperLost, Fault, PowerLost, ValveStuck
from sayd_env.config.scenario import Scenario
from sayd_env.config.sensors import DAMPERS as DAMPER_NAMES
from sayd_env.config.track import NoIrregularityConfig, SpectrumConfig
from sayd_env.config.units import Array
from sayd_env.envs import trace
from sayd_env.envs.draw import Episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.loop import BOGIES, COST_ACCELERATION, COST_FORCE, NOT_FINITE, RUNNING
from sayd_env.envs.trace import DAMPERS
from sayd_env.physics import sayd
from sayd_env.physics.layout import Instance
from sayd_env.physics.multibody import Multibody
from sayd_env.physics.plant import LANES
from sayd_env.physics.simulator import VehicleModel

WINDOW = 10.0
"""Time that a frame looks back unless more is asked for, s."""
SECOND = 1.0
"""Time over which sliding RMS values are taken, s: a step of the paper's MPPT."""
STRAIGHT = 1e5
"""Radius from which on a curve is drawn and called straight, m."""
BEHIND, AHEAD, SPACING = 40.0, 80.0, 0.25
"""Track that a frame shows around the vehicle's centre, and the distance of its points, m."""

# Columns of what is kept of each control period.
_TIME = 0
_ACCELERATION = 1
_FORCE = _ACCELERATION + BOGIES
_VALVE = _FORCE + BOGIES
_COLUMNS = _VALVE + BOGIES


@dataclass(frozen=True)
class Pose:
    """How far a body is from where it stands at rest."""

    x: float
    """m, forward."""
    y: float
    """m, to the left."""
    yaw: float
    """rad, to the left."""


@dataclass(frozen=True)
class Place:
    """Where a vehicle is on its line."""

    line: Line
    distance: float
    """From the line's start, m."""

    @property
    def section(self) -> str:
        """Name of the section."""
        return self.line.section_at(self.distance).name

    @property
    def curve(self) -> str:
        """Radius and side of the curve in words."""
        curvature = float(self.line.curvature.at(self.distance))
        if abs(curvature) < 1.0 / STRAIGHT:
            return "straight"
        return f"R {1.0 / abs(curvature):,.0f} m {'left' if curvature > 0.0 else 'right'}"

    @property
    def cant(self) -> float:
        """m, positive where the right rail is higher."""
        return float(self.line.cant.at(self.distance))


@dataclass(frozen=True, eq=False)
class Frame:
    """A vehicle at an instant, and the last seconds before it."""

    time: float
    """s after step 0."""
    speed: float
    """m/s."""
    position: float
    """Of the vehicle's centre along the track, m; on a line from its start."""
    place: Place | None
    """On the line; None where nothing changes along the way."""
    wear: float
    friction: float
    track: str
    poses: Mapping[str, Pose]
    """Carbody, bogie frames and wheelsets by their names in the vehicle's model."""
    rail_x: Array
    """(k,) places along the track, seen from the vehicle's centre, m."""
    alignment: Array
    """(k,) lateral position of the track's centre line there, m."""
    largest_alignment: float
    """Largest absolute value of it on the whole ride, m."""
    gauge: Array
    """(k,) widening of the gauge there, m."""
    damper_force: Array
    """(DAMPERS,) on the bogie, positive in tension, N."""
    opening: Array | None
    """(DAMPERS,) acting valve commands, 0 closed to 1 open; None for passive dampers."""
    command: Array | None
    """(DAMPERS,) commands that were asked for; None for passive dampers."""
    damper_faults: Mapping[int, str]
    """What has happened to dampers and their valves, by damper."""
    faults: tuple[str, ...]
    """All faults that have happened, in words."""
    ending: str | None
    """Why the run has ended early; None if it has not."""
    dominant_frequency: Array
    """(BOGIES,) f_0 of the on-line filter, Hz."""
    times: Array
    """(t,) times of what follows, s after step 0."""
    acceleration: Array
    """(t, BOGIES) psi_y of eq. (27): RMS over the last second behind the on-line filter, m/s2."""
    force: Array
    """(t, BOGIES) psi_F: RMS over the last second, N."""
    valve: Array | None
    """(t, BOGIES) mean acting valve command of each bogie; None for passive dampers."""
    cost: Array
    """(t,) mean of the bogies' J over the last second."""
    acceleration_limit: float
    """y_lim of eq. (26), m/s2."""
    force_reference: float
    """F_max of eq. (27), N."""

    @property
    def above_limit(self) -> bool:
        """Whether the sliding RMS of a bogie's acceleration is above its limit."""
        return bool(np.any(self.acceleration[-1:] > self.acceleration_limit))


@dataclass
class Recorder:
    """Watches one vehicle of a batch.

    Parameters
    ----------
    batch : EpisodeBatch
    vehicle : int
        Its place in the batch.
    window : float
        Time that a frame looks back, s.
    """

    batch: EpisodeBatch
    vehicle: int = 0
    window: float = WINDOW
    model: Multibody = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.model = VehicleModel(self.batch.scenario).multibody
        self._second = round(SECOND / self.batch.config.control_period)
        kept = round(self.window / self.batch.config.control_period) + self._second
        self._rows = np.zeros((kept, _COLUMNS))
        self.begin()

    def begin(self) -> None:
        """Clear the history: an episode has begun, or the vehicle has been set to another state."""
        self._count = 0
        self._last = -1
        self._largest = 0.0

    def take(self) -> None:
        """Keep what the charts show of the last control period; a vehicle at standstill adds nothing."""
        batch, i = self.batch, self.vehicle
        elapsed = int(batch.elapsed[i])
        if elapsed == self._last or int(batch.vehicles.status[i]) == NOT_FINITE:
            return
        self._last = elapsed
        row, terms = self._rows[self._count % len(self._rows)], batch.vehicles.terms[i]
        row[_TIME] = elapsed * batch.config.control_period
        row[_ACCELERATION:_FORCE] = terms[COST_ACCELERATION : COST_ACCELERATION + BOGIES]
        row[_FORCE:_VALVE] = terms[COST_FORCE : COST_FORCE + BOGIES]
        opening = self._opening()
        row[_VALVE:] = 0.0 if opening is None else opening.reshape(BOGIES, -1).mean(axis=1)
        self._count += 1

    @property
    def time(self) -> float:
        """Seconds after step 0."""
        return float(self.batch.elapsed[self.vehicle]) * self.batch.config.control_period

    def _damper_force(self) -> Array:
        """Forces that act: a lost damper has none, although its hydraulics are still computed."""
        vehicles, i = self.batch.vehicles, self.vehicle
        force = vehicles.trace[i, -1, trace.FORCE : trace.FORCE + DAMPERS].copy()
        states = vehicles.state.view(i).sayd
        return force if states.size == 0 else force * states.reshape(-1, LANES)[sayd.ATTACHED, :DAMPERS]

    def _opening(self) -> Array | None:
        states = self.batch.vehicles.state.view(self.vehicle).sayd
        return None if states.size == 0 else states.reshape(-1, LANES)[sayd.CURRENT, :DAMPERS].copy()

    def frame(self) -> Frame:
        """The vehicle as it is now.

        Raises
        ------
        ConfigError
            Before the first reset.
        """
        batch, i, vehicles = self.batch, self.vehicle, self.batch.vehicles
        episode, scenario = batch.episodes[i], batch.scenario
        assert episode is not None  # the batch has vehicles, so it has been reset
        state = vehicles.state.view(i)
        position = float(state.clock[1])
        rail_x = np.arange(-BEHIND, AHEAD + 0.5 * SPACING, SPACING)
        rails, _ = vehicles.vehicle(i).track.evaluate(position + rail_x)
        time, place, friction = self.time, self._place(position), scenario.friction
        if place is not None and place.line.friction is not None:
            friction = float(place.line.friction.at(place.distance))
        elif episode.friction is not None:
            friction = episode.friction
        happened = [fault for fault in episode.faults if fault.start_s <= time + 1e-9]
        rows, cost, ended = self._history(), scenario.cost, int(vehicles.status[i]) != RUNNING
        opening = self._opening()
        limit = batch.limits[i].acceleration
        both = cost.acceleration_weight * rows[:, _ACCELERATION:_FORCE]
        both = both + cost.force_weight * rows[:, _FORCE:_VALVE]
        return Frame(
            time=time,
            speed=_speed(episode, place),
            position=position if place is None else place.distance,
            place=place,
            wear=scenario.wear if episode.wear is None else episode.wear,
            friction=friction,
            track=_track_name(episode, scenario),
            poses=poses(self.model, np.nan_to_num(state.q)),
            rail_x=rail_x,
            alignment=rails[:, 0],
            largest_alignment=self._largest_alignment(position, rails[:, 0]),
            gauge=rails[:, 3],
            damper_force=np.nan_to_num(self._damper_force()),
            opening=None if opening is None else np.nan_to_num(opening),
            command=None if opening is None else vehicles.command[i].copy(),
            damper_faults=_of_dampers(happened),
            faults=tuple(in_words(fault) for fault in happened),
            ending=batch.ending(i) if ended else None,
            dominant_frequency=batch.dominant_frequency()[i],
            times=rows[:, _TIME],
            acceleration=limit * np.sqrt(rows[:, _ACCELERATION:_FORCE]),
            force=cost.force_reference * np.sqrt(rows[:, _FORCE:_VALVE]),
            valve=None if opening is None else rows[:, _VALVE:],
            cost=both.mean(axis=1),
            acceleration_limit=limit,
            force_reference=cost.force_reference,
        )

    def _largest_alignment(self, position: float, seen: Array) -> float:
        """Largest lateral position of the track's centre line, m: of the whole ride, looked for once."""
        if not self._largest:
            batch, i = self.batch, self.vehicle
            episode, line = batch.episodes[i], batch.lines[i]
            assert episode is not None  # as in `frame`
            length = episode.speed * batch.config.episode_s if line is None else line.length
            along = position + np.arange(-BEHIND, length + AHEAD, SPACING)
            seen = batch.vehicles.vehicle(i).track.evaluate(along)[0][:, 0]
        # A ride may go on behind the end of its episode.
        self._largest = max(self._largest, float(np.max(np.abs(seen))))
        return self._largest

    def _place(self, position: float) -> Place | None:
        line = self.batch.lines[self.vehicle]
        origin = self.batch.vehicles.vehicle(self.vehicle).origin
        return None if line is None else Place(line, position - origin)

    def _history(self) -> Array:
        """What is kept, oldest first; the terms of the cost as sums over the last second.

        Where less than a second is known, the sum is that of a second like the known part.
        """
        size, count = len(self._rows), self._count
        kept = self._rows[:count] if count <= size else np.roll(self._rows, -(count % size), axis=0)
        kept = kept.copy()
        terms = kept[:, _ACCELERATION:_VALVE]
        total = np.vstack([np.zeros(terms.shape[1]), np.cumsum(terms, axis=0)])
        last = np.arange(1, len(kept) + 1)
        first = np.maximum(last - self._second, 0)
        known = (last - first)[:, None]
        kept[:, _ACCELERATION:_VALVE] = np.maximum(total[last] - total[first], 0.0) * self._second / known
        return kept if count <= size else kept[self._second :]


def _speed(episode: Episode, place: Place | None) -> float:
    along = None if place is None else place.line.speed_at(place.distance)
    return episode.speed if along is None else float(along)


def _track_name(episode: Episode, scenario: Scenario) -> str:
    own = scenario.track.irregularity
    irregularity = own if episode.irregularity is None else episode.irregularity
    name = irregularity.density.type if isinstance(irregularity, SpectrumConfig) else irregularity.type
    if isinstance(irregularity, NoIrregularityConfig):
        return "even"
    scale = irregularity.scale if episode.track_scale is None else episode.track_scale
    return f"{Path(episode.track).stem if episode.track else name} \u00d7 {scale:.2f}"


def poses(model: Multibody, q: Array) -> dict[str, Pose]:
    """Displacements of carbody, frames and wheelsets.

    Parameters
    ----------
    model : Multibody
    q : ndarray, shape (n,)
        Displacements of all degrees of freedom, m and rad.
    """
    shown = {
        name: instance
        for name, instance in model.instances.items()
        if instance.body.role in ("carbody", "frame", "wheelset")
    }

    def along(body: Instance, dof: str) -> float:
        return float(q[body.columns[dof]]) if dof in body.columns else 0.0

    return {
        name: Pose(along(body, "x"), along(body, "y"), along(body, "yaw")) for name, body in shown.items()
    }


_WORDS = {
    "valve_stuck": "valve stuck",
    "power_lost": "no power",
    "damper_lost": "damper lost",
    "sensor_dead": "sensor dead",
    "sensor_frozen": "sensor frozen",
    "sensor_biased": "sensor biased",
    "sensor_noisy": "sensor noisy",
}


def in_words(fault: Fault) -> str:
    """A fault in a few words, with its place."""
    place = fault.damper if isinstance(fault, ValveStuck | PowerLost | DamperLost) else fault.signal
    return f"{_WORDS[fault.kind]}: {place}"


def _of_dampers(faults: list[Fault]) -> dict[int, str]:
    return {
        DAMPER_NAMES.index(fault.damper): _WORDS[fault.kind]
        for fault in faults
        if isinstance(fault, ValveStuck | PowerLost | DamperLost)
    }
