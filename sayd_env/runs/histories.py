"""Time histories of a run: all that is known of it at each sample, by name and unit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product

import numpy as np

from sayd_env.config import ConfigError, nearest
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.explain import shown
from sayd_env.config.sensors import DAMPERS, MOUNTS, POINTS
from sayd_env.config.units import Array
from sayd_env.envs import loop, trace
from sayd_env.envs.interface import ACTIONS, BOGIES
from sayd_env.envs.rollout import Rollout
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.controlled import refuse_divergence
from sayd_env.runs.rollouts import Run, roll_out_runs

WHEELS = tuple(".".join(place) for place in product(POINTS, ("left", "right")))
FLOOR = tuple(".".join(place) for place in product(("front", "middle", "rear"), ("x", "y", "z")))
"""Places on the carbody's floor, above the bogies and mid-way, and directions."""
ALL = "all"
MOTION = {"displacement": ("m", "rad"), "velocity": ("m/s", "rad/s"), "body_acceleration": ("m/s2", "rad/s2")}
"""Motion of the unknowns, with its units along and about an axis, in the order of a wide trace."""


@dataclass(frozen=True)
class SignalGroup:
    """A group of signals that differ in their places."""

    unit: str
    meaning: str
    """With the sense in which it is positive."""
    usual: bool = True
    """Whether it is written unless something else is asked for."""


QUANTITIES: Mapping[str, SignalGroup] = {
    "distance": SignalGroup("m", "of the vehicle's centre from step 0 on; on a line from its start"),
    "speed": SignalGroup("m/s", "speed of the train"),
    "lateral_acceleration": SignalGroup("m/s2", "of the bogie frame above each wheelset, to the left"),
    "longitudinal_acceleration": SignalGroup(
        "m/s2", "of the bogie frame at the yaw dampers' mounts, forward", usual=False
    ),
    "filtered_acceleration": SignalGroup(
        "m/s2", "the lateral acceleration behind the on-line filter of J", usual=False
    ),
    "carbody_acceleration": SignalGroup(
        "m/s2", "of the carbody's floor: x forward, y to the left, z upwards"
    ),
    "track_shift": SignalGroup("N", "sum of Y of a wheelset's wheels, to the left"),
    "Y": SignalGroup("N", "lateral force of a wheel on its rail, to the left"),
    "Q": SignalGroup("N", "vertical force of a wheel on its rail, downwards"),
    "damper_force": SignalGroup("N", "of a yaw damper at the bogie, positive in tension"),
    "hydraulic_force": SignalGroup(
        "N", "A (p_A - p_B) of a yaw damper, positive in compression", usual=False
    ),
    "stroke": SignalGroup("m", "elongation of a yaw damper, of a semi-active one without its mounts"),
    "stroke_rate": SignalGroup(
        "m/s", "rate of the stroke; of a passive damper, of its viscous part", usual=False
    ),
    "pressure_a": SignalGroup("Pa", "in chamber A of a yaw damper"),
    "pressure_b": SignalGroup("Pa", "in chamber B of a yaw damper"),
    "command": SignalGroup("-", "what is asked of a valve, 0 closed to 1 open"),
    "current": SignalGroup("-", "in the coil of a valve, 0 to 1", usual=False),
    "valve": SignalGroup("-", "where the spool of a valve stands, 0 closed to 1 open"),
    "displacement": SignalGroup("m, rad", "of a body from where it stands at rest, by its axes", usual=False),
    "velocity": SignalGroup("m/s, rad/s", "its rate", usual=False),
    "body_acceleration": SignalGroup("m/s2, rad/s2", "the rate of this", usual=False),
}
"""What there can be, by the first part of a signal's name."""
_SEMI_ACTIVE = ("hydraulic_force", "pressure_a", "pressure_b", "command", "current", "valve")


@dataclass(frozen=True)
class HistorySignal:
    """One signal of a run, and where a rollout has it."""

    name: str
    """Quantity and place, for example ``damper_force.front.left.upper``."""
    unit: str
    kept: str
    """``true``, ``traced`` or ``actions``: attribute of the rollout."""
    column: int

    @property
    def quantity(self) -> str:
        """Key of `QUANTITIES`."""
        return self.name.partition(".")[0]

    @property
    def full_name(self) -> str:
        """Name with the unit, where a file has no other place for it: ``damper_force.front.left.upper_n``."""
        unit = self.unit.replace("/", "_").lower()
        return self.name if unit == "-" else f"{self.name}_{unit}"


@dataclass(frozen=True, eq=False)
class History:
    """Signals of one run over t samples, from the start of the run-in."""

    signals: tuple[HistorySignal, ...]
    time: Array
    """(t,) from step 0, where the policy begins, s; negative in the run-in."""
    values: tuple[Array, ...]
    """(t,) of each signal, in its unit."""
    sample_rate: float
    """Hz."""
    ending: str | None
    """Why the run ended early; None if it did not."""

    def __getitem__(self, name: str) -> Array:
        """Values of a signal."""
        return self.values[[signal.name for signal in self.signals].index(name)]

    def behind_run_in(self) -> History:
        """The same from step 0 on; all of it, if the run did not come so far."""
        first = int(np.searchsorted(self.time, 0.0, side="right"))
        first = first if first < len(self.time) else 0
        return replace(self, time=self.time[first:], values=tuple(each[first:] for each in self.values))


def signals_of(run: Run) -> tuple[HistorySignal, ...]:
    """All signals that a run has: those of valves and pressures only with semi-active dampers."""
    model = VehicleModel(run.scenario)
    valves = run.policy.environment(run.environment).valves
    commands = {1: ("",), len(BOGIES): BOGIES, len(DAMPERS): DAMPERS}[ACTIONS[valves]]
    true = {
        "lateral_acceleration": (loop.LOG_ACCELERATION, POINTS),
        "track_shift": (loop.LOG_TRACK_SHIFT, POINTS),
        "damper_force": (loop.LOG_FORCE, DAMPERS),
        "hydraulic_force": (loop.LOG_HYDRAULIC, DAMPERS),
        "filtered_acceleration": (loop.LOG_FILTERED, POINTS),
        "carbody_acceleration": (loop.LOG_BODY, FLOOR),
        "valve": (loop.LOG_CURRENT, DAMPERS),
    }
    traced = {
        "distance": (trace.POSITION, ("",)),
        "speed": (trace.SPEED, ("",)),
        "longitudinal_acceleration": (trace.LONGITUDINAL, MOUNTS),
        "Y": (trace.WHEEL_LATERAL, WHEELS),
        "Q": (trace.WHEEL_VERTICAL, WHEELS),
        "stroke": (trace.STROKE, DAMPERS),
        "stroke_rate": (trace.STROKE_RATE, DAMPERS),
        "pressure_a": (trace.PRESSURE_A, DAMPERS),
        "pressure_b": (trace.PRESSURE_B, DAMPERS),
        "current": (trace.COIL_CURRENT, DAMPERS),
    }
    places = {name: ("true", *place) for name, place in true.items()}
    places |= {name: ("traced", *place) for name, place in traced.items()}
    places |= {"command": ("actions", 0, commands)}
    if model.scenario.vehicle.floor_height is None:
        del places["carbody_acceleration"]
    if not isinstance(run.scenario.damper, SaydDamperConfig):
        places = {name: place for name, place in places.items() if name not in _SEMI_ACTIVE}
    found = [
        HistorySignal(f"{name}.{place}".rstrip("."), QUANTITIES[name].unit, kept, first + k)
        for name in QUANTITIES
        if name in places
        for kept, first, each in [places[name]]
        for k, place in enumerate(each)
    ]
    return (*found, *_motion(model.multibody.dof_names))


def _motion(unknowns: Sequence[str]) -> Iterable[HistorySignal]:
    """Signals of the unknowns, body by body."""
    for group, (name, units) in enumerate(MOTION.items()):
        for unknown in sorted(unknowns):
            turns = unknown.rpartition(".")[2] in ("roll", "pitch", "yaw")
            column = trace.TRACE + group * len(unknowns) + unknowns.index(unknown)
            yield HistorySignal(f"{name}.{unknown}", units[turns], "traced", column)


def chosen(signals: Sequence[HistorySignal], patterns: Sequence[str] = ()) -> tuple[HistorySignal, ...]:
    """Signals by quantity, by name, or by a pattern with ``*``, in the order in which there are such.

    Parameters
    ----------
    signals : sequence of HistorySignal
        What there is.
    patterns : sequence of str
        ``Y``, ``damper_force.front.*``, ``carbody_acceleration.middle.y``, or ``all``; by default the usual
        quantities.

    Raises
    ------
    ConfigError
        A pattern that fits nothing.
    """
    if not patterns:
        return tuple(signal for signal in signals if QUANTITIES[signal.quantity].usual)
    found: set[HistorySignal] = set()
    for pattern in patterns:
        fitting = {signal for signal in signals if _fits(signal, pattern)}
        if not fitting:
            present = list(dict.fromkeys(signal.quantity for signal in signals))
            near = nearest(pattern, [*present, *(signal.name for signal in signals)])
            known = pattern.partition(".")[0] in _SEMI_ACTIVE and pattern.partition(".")[0] not in present
            why = "passive yaw dampers have none" if known else f"no such signal{near}"
            raise ConfigError(
                f"--signals {shown(pattern)}: {why}; expected {', '.join(present)}, one of their signals "
                f"such as {signals[-1].name}, a pattern such as Y.front.*, or {ALL}"
            )
        found |= fitting
    return tuple(signal for signal in signals if signal in found)


def _fits(signal: HistorySignal, pattern: str) -> bool:
    return pattern in (ALL, signal.quantity) or fnmatchcase(signal.name, pattern)


def history(run: Run, signals: Sequence[HistorySignal], *, episode: bool = False) -> History:
    """Make a run and keep its signals.

    Parameters
    ----------
    signals : sequence of HistorySignal
        Some of `signals_of`.
    episode : bool
        The environment's episode in place of run-in and assessed length.

    Raises
    ------
    ConfigError
        A policy that does not fit.
    StudyError
        A run that diverged.
    """
    columns = sorted({signal.column for signal in signals if signal.kept == "traced"} | {trace.POSITION})
    (rollout,) = roll_out_runs([run], episode=episode, keep=columns)
    if rollout.ending is not None:
        refuse_divergence(rollout)
    place = {column: k for k, column in enumerate(columns)}
    return History(
        signals=tuple(signals),
        time=rollout.times[: rollout.samples],
        values=tuple(_values(rollout, signal, place) for signal in signals),
        sample_rate=rollout.sample_rate,
        ending=rollout.ending,
    )


def _values(rollout: Rollout, signal: HistorySignal, place: Mapping[int, int]) -> Array:
    """A signal of a rollout, so far as the run goes."""
    if signal.kept == "actions":
        before = np.full(rollout.run_in, rollout.episode.initial_current)
        samples = round(rollout.control_period * rollout.sample_rate)
        asked = np.repeat(rollout.actions[:, signal.column].astype(np.float64), samples)
        return np.concatenate([before, asked])[: rollout.samples]
    if signal.kept == "true":
        return rollout.true[: rollout.samples, signal.column]
    found = rollout.traced[: rollout.samples, place[signal.column]]
    return found - _origin(found, rollout) if signal.column == trace.POSITION else found


def _origin(position: Array, rollout: Rollout) -> float:
    """Position at step 0, the last instant of the run-in, which a run may not reach."""
    last = rollout.run_in - 1
    known = min(max(last, 0), len(position) - 1)
    return float(position[known]) + (last - known) * rollout.episode.speed / rollout.sample_rate
