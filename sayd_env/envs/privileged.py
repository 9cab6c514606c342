"""The true conditions of episodes, which no sensor measures: for critics, targets of estimators and analyses.

They are the simulator's, kept apart from observations and `info`: a policy must not see them. What changes
along a line is taken where the vehicle is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sayd_env.config import ConfigError, nearest
from sayd_env.config.conditions import Knots, Line, amplitude, cant_deficiency
from sayd_env.config.track import CHANNELS
from sayd_env.config.units import Array
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.physics.contact.conicity import AMPLITUDE, equivalent_conicity
from sayd_env.physics.contact.geometry import ContactTable
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.track.realisation import TrackRealisation

CONDITIONS = {
    "speed": "m/s, the true one",
    "wear": "-, 0 new to 1 worn",
    "conicity": "-, equivalent conicity at 3 mm of wheels, rails and gauge (EN 15302)",
    "friction": "-, coefficient of friction",
    "track_level": "-, factor on the amplitudes of the irregularities' spectrum",
    "gauge": "m",
    "payload": "-, change of the carbody's mass as a share of it",
    "curvature": "1/m, without its sign",
    "deficiency": "m, cant that is missing or in excess, without its sign",
    "versine_1s": "m, RMS of the alignment's versines in the second to come",
    "versine_3s": "m, the same of three seconds",
}
"""What `Conditions` tells, and its unit."""
AHEAD = {"versine_1s": 1.0, "versine_3s": 3.0}
"""Time over which those look ahead (s).

What comes does not depend on what a policy does, so that a critic may know it, and is then less surprised
by the track (Mao and others, Variance Reduction for Reinforcement Learning in Input-Driven Environments,
2019).
"""
HALF_CHORD = 10.0
"""Versines on chords of 20 m (m): most of waves about 20 m long, which excite hunting."""
ALIGNMENT = CHANNELS.index("alignment")
FINE = 2.5
"""Distance of the versines (m)."""
STEP = 10.0
"""Distance of the places of a line at which conditions are taken (m)."""


class Conditions:
    """True conditions of the vehicles of a batch.

    Parameters
    ----------
    batch : EpisodeBatch
    names : sequence of str
        Some of `CONDITIONS`, in the order of the columns.

    Raises
    ------
    ConfigError
        An unknown name.
    """

    def __init__(self, batch: EpisodeBatch, names: Sequence[str]) -> None:
        check_conditions(names)
        self.names = tuple(names)
        self._batch = batch
        self._along = np.full((batch.count, 1, len(self.names)), np.nan)
        self._last = np.zeros(batch.count, dtype=np.intp)

    def begin(self, which: Sequence[int]) -> None:
        """Take over the episodes of vehicles that have just begun."""
        for i in which:
            table = self._table(i)
            if len(table) > self._along.shape[1]:
                more = len(table) - self._along.shape[1]
                self._along = np.pad(self._along, ((0, 0), (0, more), (0, 0)))
            self._along[i, : len(table)], self._last[i] = table, len(table) - 1

    def __call__(self) -> Array:
        """Conditions where the vehicles are, shape (count, names); NaN of one for which nothing began."""
        place = np.clip(np.nan_to_num(self._batch.distance()) / STEP, 0.0, self._last).astype(np.intp)
        found: Array = self._along[np.arange(self._batch.count), place]
        return found

    def _table(self, i: int) -> Array:
        """Conditions of vehicle i every `STEP` from step 0 on, shape (places or 1, names)."""
        batch, episode, line = self._batch, self._batch.episodes[i], self._batch.lines[i]
        assert episode is not None  # it has begun
        model = batch.model(i)
        scenario = model.scenario
        ahead = {name: seconds for name, seconds in AHEAD.items() if name in self.names}
        changing = line is not None or ahead
        reach = batch.mean_speed(i) * batch.config.episode_s if changing else 0.0
        s: Array = STEP * np.arange(int(reach / STEP) + 1, dtype=np.float64) + 0.5 * STEP
        single = {
            "speed": episode.speed,
            "wear": scenario.wear,
            "friction": scenario.friction,
            "track_level": amplitude(scenario.track.irregularity),
            "gauge": scenario.track.gauge,
            "payload": episode.payload,
            "curvature": 0.0,
            "deficiency": 0.0,
        }
        found = {name: np.full(len(s), float(value)) for name, value in single.items()}
        if line is not None:
            found |= _along(line, s, episode.speed, single["track_level"])
        if ahead:
            track, origin = batch.vehicles.track(i), batch.vehicles.origin[i]
            found |= _versines(track, origin + s, found["speed"], ahead)
        if "conicity" in self.names:
            found["conicity"] = _conicity(model, line, s, found["gauge"])
        return np.stack([found[name] for name in self.names], axis=1) if self.names else np.zeros((1, 0))


def check_conditions(names: Sequence[str]) -> None:
    """Refuse names that are none of `CONDITIONS`.

    Raises
    ------
    ConfigError
        The message says which there are.
    """
    for name in names:
        if name not in CONDITIONS:
            raise ConfigError(
                f"there is no condition '{name}'{nearest(name, CONDITIONS)}; expected some of "
                f"{', '.join(CONDITIONS)}"
            )


def _along(line: Line, s: Array, speed: float, level: float) -> dict[str, Array]:
    """What a line itself says at distances s (m), given the episode's speed (m/s) and track level."""
    found: dict[str, Array] = {"curvature": np.abs(line.curvature.at(s))}
    squared = line.speed_squared or Knots((0.0,), (speed**2,))
    found["speed"] = np.sqrt(squared.at(s))
    places, lacking = cant_deficiency(line, squared)
    found["deficiency"] = np.abs(np.interp(s, places, lacking))
    for name in ("gauge", "friction"):
        knots = getattr(line, name)
        if knots is not None:
            found[name] = knots.at(s)
    if line.tracks:
        ends = np.array([piece.end for piece in line.tracks[:-1]])
        levels = np.array([piece.level(level) for piece in line.tracks])
        found["track_level"] = levels[np.searchsorted(ends, s, side="right")]
    return found


def _versines(
    track: TrackRealisation, x: Array, speed: Array, ahead: Mapping[str, float]
) -> dict[str, Array]:
    """RMS of versines (m) over times ahead (s) of positions x (m) at speeds (m/s), up to the track's end."""
    last = float(np.max(x + speed * max(ahead.values())))
    places: Array = np.arange(x[0], last + FINE, FINE)
    around = places + np.array([[-HALF_CHORD], [0.0], [HALF_CHORD]])
    values = track.evaluate(np.clip(around, 0.0, track.length).ravel())[0][:, ALIGNMENT].reshape(around.shape)
    squares = np.square(values[1] - 0.5 * (values[0] + values[2]))
    total = np.concatenate([[0.0], np.cumsum(squares)])
    first = np.floor((x - x[0]) / FINE).astype(np.intp)
    known = np.searchsorted(places, track.length - HALF_CHORD, side="right")
    found = {}
    for name, seconds in ahead.items():
        count = np.maximum(np.ceil(speed * seconds / FINE), 1.0).astype(np.intp)
        end = np.minimum(first + count, np.maximum(known, first + 1))
        found[name] = np.sqrt((total[end] - total[first]) / (end - first))
    return found


def _conicity(model: VehicleModel, line: Line | None, s: Array, gauge: Array) -> Array:
    """Conicity at distances s (m): between two rail profiles as their share."""
    if line is None or line.rail_blend is None or line.rails is None:
        return _of_gauges(model, gauge)
    ends = [_with_rail(model, rail) for rail in line.rails]
    share = line.rail_blend.at(s)
    return np.asarray((1.0 - share) * _of_gauges(ends[0], gauge) + share * _of_gauges(ends[1], gauge))


def _with_rail(model: VehicleModel, rail: object) -> VehicleModel:
    return model if rail is None else VehicleModel(model.scenario.model_copy(update={"rail": rail}))


def _of_gauges(model: VehicleModel, gauge: Array) -> Array:
    """Conicity of a vehicle's wheels on its rails at gauges (m), which move the rails sideways."""
    values, place = np.unique(np.round(gauge, 5), return_inverse=True)
    wider, tables = values - model.scenario.track.gauge, (model.table, model.right_table)
    found = np.array([_at_gauge(*tables, float(each)) for each in wider])
    return np.asarray(found[place])


def _at_gauge(table: ContactTable, right: ContactTable | None, wider: float) -> float:
    """Conicity on rails that stand wider apart (m) than those of the tables; 0 where there is no such motion.

    Each wheel then stands half of it further from its rail than the tables' shift says.
    """
    other, y = (right or table).delta_r, table.dy
    delta_r = np.interp(y - 0.5 * wider, y, table.delta_r) - np.interp(-y - 0.5 * wider, y, other)
    inside = np.abs(y) <= y[-1] - 0.5 * abs(wider)
    found = float(equivalent_conicity(y[inside], delta_r[inside], [AMPLITUDE])[0])
    return found if np.isfinite(found) else 0.0
