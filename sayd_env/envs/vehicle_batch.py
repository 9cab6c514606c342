"""Vehicles under control, many at once: each on its track, with its sensors and its cost.

The Python face of the compiled control loop. A vehicle's results are the same bits alone and among others,
for any number of threads.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError
from sayd_env.config.units import Array, Flags, Integers
from sayd_env.envs.loop import (
    FEATURES,
    LOG,
    RUNNING,
    SIGNALS,
    TERMS,
    Loop,
    LoopState,
    OnBoard,
    Period,
    run_units,
    run_units_in_parallel,
)
from sayd_env.envs.trace import DAMPERS, MOTIONS, POSITION, SPEED, TRACE
from sayd_env.envs.vehicle import LoopSettings, Vehicle
from sayd_env.physics.aligned import copied
from sayd_env.physics.batch import checked_threads
from sayd_env.physics.formation import Call, Formation, Units, calls
from sayd_env.physics.kernel import compiled_threads, specialised
from sayd_env.physics.plant import State
from sayd_env.physics.ragged import RaggedBatch
from sayd_env.physics.track.realisation import TrackRealisation
from sayd_env.stability.online import Band, BandState

ON_BOARD = ("loop", "memory", "passed", "felt")
"""What looks at a vehicle, in the order of the compiled loop's arguments."""
CHANGING = ("state", *ON_BOARD)
"""What changes while a vehicle runs; of its constants, only the stiffness of a damper that is lost does."""
RESULTS = ("command", "trace", "signals", "features", "terms", "rewards", "status")
"""What is known of its last control period."""


@dataclass(frozen=True, eq=False)
class VehicleState:
    """All of one vehicle at an instant: put back to it, it goes on bit for bit."""

    built: Vehicle
    """The vehicle as it was built, without its source of noise."""
    fields: dict[str, Any]
    """Copies of what has changed since, by `CHANGING`."""
    stiffness: Array
    """Of the plant's Maxwell dampers, N/m."""
    noise: Mapping[str, Any] | None
    """State of the source of noise."""
    results: dict[str, Any]
    """Copies of the last control period's results, by `RESULTS`."""


class VehicleBatch:
    """v vehicles in lockstep: one compiled call for a control period of all.

    Parameters
    ----------
    settings : LoopSettings
        Control period, filters and limits, the same for all.
    band : Band
        Constants of the on-line filter.
    vehicles : sequence of Vehicle
        The vehicles, by `make_vehicle`: any speeds, profiles, tracks, dampers' numbers; one structure.
    num_threads : int, optional
        Threads; 1 runs the vehicles one after another without numba's threads. Default: all cores for several
        vehicles, one for a single vehicle. The results do not depend on it.
    motion : bool
        Write the motion of all unknowns into the trace, too.

    Attributes
    ----------
    signals : ndarray, shape (v, SIGNALS)
        Means of the sensors' readings over the last control period.
    features : ndarray, shape (v, FEATURES)
        What a controller computes on board of them, if the settings ask for it.
    terms : ndarray, shape (v, TERMS)
        Cost of the last period, by the places of `sayd_env.envs.loop`.
    rewards : ndarray, shape (v,)
        Minus the mean of the bogies' J of the last period.
    origin : ndarray, shape (v,)
        Each vehicle's position on its track at step 0, m.
    status : ndarray, shape (v,)
        RUNNING, or how a vehicle's run ended; it then stands still until another one takes its place.
    """

    def __init__(
        self,
        settings: LoopSettings,
        band: Band,
        vehicles: Sequence[Vehicle],
        num_threads: int | None = None,
        *,
        motion: bool = False,
    ) -> None:
        if not vehicles:
            raise ConfigError("a batch needs at least one vehicle")
        count = len(vehicles)
        self.settings = settings
        self.band = band
        self.num_threads = 1 if count == 1 and num_threads is None else checked_threads(num_threads)
        self._vehicles = list(vehicles)
        self.formation = Formation(
            [vehicle.plant for vehicle in vehicles],
            [vehicle.state for vehicle in vehicles],
            [copied(vehicle.work) for vehicle in vehicles],  # other environments may have the same vehicles
        )
        self.loop = RaggedBatch(Loop, [vehicle.loop for vehicle in vehicles])
        self.memory = RaggedBatch(LoopState, [vehicle.memory for vehicle in vehicles])
        self.passed = RaggedBatch(BandState, [vehicle.passed for vehicle in vehicles])
        self.felt = RaggedBatch(BandState, [vehicle.felt for vehicle in vehicles])
        self._substeps = np.array([vehicle.substeps for vehicle in vehicles])
        self.origin = np.array([vehicle.origin for vehicle in vehicles])
        self.command = np.zeros((count, DAMPERS))
        self._noise = np.zeros((count, settings.samples, SIGNALS))
        self._silent = np.zeros((count, 0, SIGNALS))
        width = TRACE + motion * MOTIONS * len(vehicles[0].state.q)
        self.trace = np.zeros((count, settings.samples, width))
        self.signals = np.zeros((count, SIGNALS))
        self.features = np.zeros((count, FEATURES))
        self.terms = np.zeros((count, TERMS))
        self.rewards = np.zeros(count)
        self.status = np.zeros(count, dtype=np.int64)
        self._no_log = np.zeros((count, 0, LOG))
        self._noisy = any(vehicle.noise is not None for vehicle in vehicles)
        self._loops: dict[tuple[bool, ...], Any] = {}
        for i in range(count):
            self._begin(i)

    def __len__(self) -> int:
        return len(self._vehicles)

    def vehicle(self, i: int) -> Vehicle:
        """A vehicle as it was built."""
        return self._vehicles[i]

    def put(self, i: int, vehicle: Vehicle) -> None:
        """Replace vehicle i; `run_in` must follow before it is stepped."""
        self._place(i, vehicle)
        self.formation.put(i, vehicle.plant, vehicle.state, copied(vehicle.work))
        for name in ON_BOARD:
            getattr(self, name).put(i, getattr(vehicle, name))
        self.status[i] = RUNNING
        self._begin(i)

    def _begin(self, i: int) -> None:
        """What is known of a vehicle before its first period: nothing of the one that was there before."""
        self.signals[i] = self.features[i] = self.terms[i] = self.rewards[i] = 0.0
        self.trace[i] = 0.0
        self.trace[i, -1, POSITION] = self._vehicles[i].state.clock[1]
        self.trace[i, -1, SPEED] = self._vehicles[i].speed

    def _place(self, i: int, vehicle: Vehicle) -> None:
        self._vehicles[i] = vehicle
        self._substeps[i], self.origin[i] = vehicle.substeps, vehicle.origin
        self._noisy = any(each.noise is not None for each in self._vehicles)

    @property
    def state(self) -> RaggedBatch[State]:
        """States of the vehicles."""
        return self.formation.state

    def choice(self) -> Integers:
        """Indices of f_0 of each vehicle's bogies, a new array of shape (v, BOGIES)."""
        return np.array([filters.choice for filters in self.passed])

    def lose_damper(self, i: int, damper: int) -> None:
        """Take a vehicle's Maxwell damper away: from now on it has no stiffness and no force."""
        stiffness = self.formation.plant.view(i).damper_stiffness.copy()
        stiffness[damper] = self.state.view(i).force[damper] = 0.0
        self._put_stiffness(i, stiffness)

    def _put_stiffness(self, i: int, stiffness: Array) -> None:
        plant = self.formation.plant.view(i)
        if not np.array_equal(plant.damper_stiffness, stiffness):
            self.formation.change(i, plant._replace(damper_stiffness=stiffness.copy()))

    def get_state(self, i: int) -> VehicleState:
        """All of a vehicle, as copies; it can be pickled."""
        vehicle = self._vehicles[i]
        return VehicleState(
            built=replace(vehicle, noise=None),
            fields={name: copied(getattr(self, name).view(i)) for name in CHANGING},
            stiffness=self.formation.plant.view(i).damper_stiffness.copy(),
            noise=None if vehicle.noise is None else copy.deepcopy(vehicle.noise.bit_generator.state),
            results={name: getattr(self, name)[i].copy() for name in RESULTS},
        )

    def track(self, i: int) -> TrackRealisation:
        """The irregularities on which a vehicle runs."""
        return self._vehicles[i].track

    def set_state(self, i: int, saved: VehicleState) -> None:
        """Put a vehicle back to a state of this one or of another one of the same structure."""
        noise = None
        if saved.noise is not None:
            noise = np.random.default_rng()
            noise.bit_generator.state = copy.deepcopy(saved.noise)
        vehicle = saved.built
        if self._vehicles[i].plant is not vehicle.plant:  # another vehicle or another track
            self.formation.put(i, vehicle.plant, vehicle.state, copied(vehicle.work))
        self._put_stiffness(i, saved.stiffness)
        self._place(i, replace(vehicle, noise=noise))
        for name, fields in saved.fields.items():
            getattr(self, name).put(i, copied(fields))
        for name, value in saved.results.items():
            getattr(self, name)[i] = value

    def run_in(
        self, which: Sequence[int], *, log: bool = False, each_period: Callable[[int], None] | None = None
    ) -> list[Array]:
        """Run fresh vehicles to their step 0, with their initial commands.

        Parameters
        ----------
        which : sequence of int
            The vehicles; the others stand still.
        log : bool
            Return the true signals.
        each_period : callable, optional
            Called after each control period with its number; all vehicles arrive at step 0 with the last one,
            so some begin later than others. The results are the same bits with and without it.

        Returns
        -------
        list of ndarray, each of shape (samples of the run-in or 0, LOG)
        """
        periods = np.zeros(len(self), dtype=np.int64)
        for i in which:
            periods[i] = self._vehicles[i].run_in
            self.command[i] = self._vehicles[i].current
        rows = self._no_log
        if log:
            rows = np.zeros((len(self), int(periods.max()) * self.settings.samples, LOG))
        # Run-ins differ in length: a group takes as long as its longest one.
        formation = self.formation.only(sorted(which, key=lambda i: -int(periods[i])))
        if each_period is None:
            self._run(periods, self._silent, rows, formation)
        else:
            self._run_in_by_periods(periods, rows, each_period, formation)
        return [rows[i, : periods[i] * self.settings.samples if log else 0] for i in which]

    def _run_in_by_periods(
        self, periods: Integers, rows: Array, each_period: Callable[[int], None], formation: Formation
    ) -> None:
        """Run vehicles in, one control period in a call."""
        samples, longest = self.settings.samples, int(periods.max())
        log = np.zeros((len(self), samples, LOG)) if rows.size else self._no_log
        for p in range(longest):
            own = p - (longest - periods)  # each vehicle's own number of the period
            active = (own >= 0) & (periods > 0) & (self.status == RUNNING)
            log.fill(0.0)
            self._run(active.astype(np.int64), self._silent, log, formation)
            for i in np.flatnonzero(active) if rows.size else ():
                rows[i, own[i] * samples : (own[i] + 1) * samples] = log[i]
            each_period(p)

    def step(
        self,
        commands: npt.ArrayLike,
        *,
        log: Array | None = None,
        active: Flags | None = None,
    ) -> None:
        """Run all vehicles that are still running over one control period.

        Parameters
        ----------
        commands : array_like, shape (v, DAMPERS)
            Valve commands from 0 to 1, checked by the caller.
        log : ndarray, shape (v, samples, LOG), optional
            Receives the true signals; of float64, rows behind one another.
        active : ndarray of bool, shape (v,), optional
            Vehicles that run; all by default.

        Raises
        ------
        ConfigError
            A log of another form, which the compiled loop would not notice.
        """
        if log is not None:
            self._check_log(log)
        self.command[:] = commands
        running = self.status == RUNNING
        if active is not None:
            running &= active
        if self._noisy:
            # A vehicle that stands still draws nothing: its noise must not depend on the others.
            for vehicle, runs, noise in zip(self._vehicles, running, self._noise, strict=True):
                if vehicle.noise is not None and runs:
                    vehicle.noise.standard_normal(out=noise)
        noise = self._noise if self._noisy else self._silent
        rows = self._no_log if log is None else log
        self._run(running.astype(np.int64), noise, rows, self.formation)

    def _check_log(self, log: Array) -> None:
        shape = (len(self), self.settings.samples, LOG)
        if log.shape != shape or log.dtype != np.float64 or not log.flags.c_contiguous:
            raise ConfigError(
                f"log: found {log.dtype} of shape {log.shape}; expected contiguous float64 of shape {shape}"
            )

    def _run(self, periods: Integers, noise: Array, log: Array, formation: Formation) -> None:
        period = Period(
            self.command,
            noise,
            self.trace,
            self.signals,
            self.features,
            self.terms,
            self.rewards,
            log,
            self.status,
        )
        units = formation.units(periods > 0)  # first: it may arrange the vehicles anew
        on_board = OnBoard(*(getattr(self, name).table for name in ON_BOARD))
        arguments = (
            *formation.arguments(),
            self._substeps,
            periods,
            on_board,
            self.band,
            self.settings.per_second,
            period,
        )
        with compiled_threads(self.num_threads):
            self._compiled(units, arguments)

    def _compiled(self, units: Units, arguments: tuple[Any, ...]) -> None:
        """All compiled code of a control period, which `sayd bench` measures."""
        for who in calls(units, self.num_threads):
            self._loop(who, arguments)(*who, *arguments)

    def _loop(self, who: Call, arguments: tuple[Any, ...]) -> Any:
        """The compiled loop for who runs, groups, vehicles alone or both, and these arguments' types.

        Numba would find it anew in each call, by the types of some hundred arrays: an eighth of the time of a
        step. They do not change.
        """
        which = tuple(each is not None for each in who)
        if which not in self._loops:
            kernel = run_units if self.num_threads == 1 else run_units_in_parallel
            self._loops[which] = specialised(kernel, (*who, *arguments))
        return self._loops[which]

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_loops": {}}
