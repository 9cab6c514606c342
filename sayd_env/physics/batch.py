"""Many vehicles in one compiled call: each with its own speed, profiles, track, dampers and state.

A field of all vehicles is one array, their arrays one behind another, so that vehicles may differ in the
length of a table, a curve or a track. The compiled loop cuts one vehicle's `Plant`, `State` and `Work` out of
them and hands these to the same `advance` that serves a single vehicle: the results are the same bits, for
any number of vehicles and threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar, get_type_hints

import numba
import numpy as np
import numpy.typing as npt
from numba.core import config, types
from numba.extending import intrinsic

from sayd_env.config import ConfigError, StudyError
from sayd_env.physics.kernel import kernel
from sayd_env.physics.plant import LANES, Plant, State, Work
from sayd_env.physics.simulator import Simulator
from sayd_env.physics.step import advance

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]
numba_config: Any = config  # its settings are made at run time
Fields = TypeVar("Fields", Plant, State, Work)


def stack(vehicles: Sequence[Fields]) -> tuple[Any, Index]:
    """Put the fields of several vehicles one behind another.

    Parameters
    ----------
    vehicles : sequence of Plant, State or Work
        All of one type; the first lengths of their arrays may differ, the others not.

    Returns
    -------
    values : Plant, State or Work
        Each array's rows of all vehicles, or the (v,) values of a number.
    starts : ndarray, shape (fields, v + 1)
        The rows of each field at which the vehicles begin.

    Raises
    ------
    ConfigError
        Arrays that do not fit: vehicles of different structure.
    """
    kind: Any = type(vehicles[0])
    columns: dict[str, list[Any]] = {
        name: [getattr(vehicle, name) for vehicle in vehicles] for name in kind._fields
    }
    for name, column in columns.items():
        if len({np.shape(value)[1:] for value in column}) > 1:
            raise ConfigError(
                f"a batch needs vehicles with equal numbers of unknowns, dampers and stops; '{name}' differs"
            )
    values = {name: np.concatenate([np.atleast_1d(x) for x in column]) for name, column in columns.items()}
    lengths = [[len(np.atleast_1d(value)) for value in column] for column in columns.values()]
    starts = np.zeros((len(lengths), len(vehicles) + 1), dtype=np.int64)
    np.cumsum(lengths, axis=1, out=starts[:, 1:])
    return kind(**values), starts


def unstack(values: Any, starts: Index) -> list[Any]:
    """Return the named tuples of all vehicles, made of arrays alone, as views of the stack's."""
    fields = list(zip(values, starts, strict=True))
    return [type(values)(*(x[s[i] : s[i + 1]] for x, s in fields)) for i in range(starts.shape[1] - 1)]


def _rows(values: Array, starts: Index, field: int, vehicle: int) -> Array:
    return values[starts[field, vehicle] : starts[field, vehicle + 1]]


def _number(values: Array, starts: Index, field: int, vehicle: int) -> float:
    return float(values[starts[field, vehicle]])


def _vehicle_of(typing_context: Any, values: Any, starts: Any, vehicle: Any) -> Any:
    """Cut one vehicle's named tuple out of a stack, in compiled code (`unstack` is its Python twin).

    A Numba intrinsic, so that a field that somebody adds to `Plant` needs no second list of fields here.
    """
    hints = get_type_hints(values.instance_class)
    numbers = [hints[name] is float for name in values.fields]
    parts = [types.float64 if number else array for number, array in zip(numbers, values, strict=True)]
    result: Any = types.BaseTuple.from_types(parts, values.instance_class)  # type: ignore[no-untyped-call]

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        stacked, begin, index = arguments
        pieces = []
        for k, part in enumerate(parts):
            cut = _number if numbers[k] else _rows
            field = context.get_constant(types.int64, k)
            inputs = [builder.extract_value(stacked, k), begin, field, index]
            pieces.append(
                context.compile_internal(builder, cut, part(values[k], starts, types.int64, vehicle), inputs)
            )
        return context.make_tuple(builder, result, pieces)

    return result(values, starts, vehicle), generate


vehicle_of: Any = intrinsic(_vehicle_of)


@kernel(parallel=True, announce="the simulator of many vehicles (first use, about 15 s)")
def advance_batch(
    plant: Plant,
    plant_starts: Index,
    state: State,
    state_starts: Index,
    work: Work,
    work_starts: Index,
    substeps: Index,
    signals: Array,
    done: Index,
) -> None:
    """Advance v vehicles by as many samples as `signals` has, in parallel.

    Parameters
    ----------
    plant, plant_starts, state, state_starts, work, work_starts
        The vehicles, by `stack`. (A parallel loop takes no nested tuples.)
    substeps : ndarray, shape (v,)
        Steps between two samples of each vehicle.
    signals : ndarray, shape (v, samples, 2 w + d)
        Receives the signals of `sayd_env.physics.step.record`.
    done : ndarray, shape (v,)
        Receives the number of samples taken: fewer if a state is no longer finite.
    """
    for i in numba.prange(signals.shape[0]):
        none = np.empty((0, LANES))
        done[i] = advance(
            vehicle_of(plant, plant_starts, i),
            vehicle_of(state, state_starts, i),
            vehicle_of(work, work_starts, i),
            substeps[i],
            signals[i],
            none,
            none,
            none,
        )


class BatchSimulator:
    """Vehicles that run at the same time, each as its own simulator would.

    The batch takes over the simulators' states: afterwards both see the same memory, so a single vehicle can
    be looked at, or run on, through its own simulator.

    Parameters
    ----------
    simulators : sequence of Simulator
        The vehicles: any speeds, tracks, contact tables and damper curves; equal numbers of unknowns,
        wheelsets and dampers, and one sample rate. They keep their own substeps.
    num_threads : int, optional
        Threads to use; all cores by default. The results do not depend on it.

    Raises
    ------
    ConfigError
        No vehicle, vehicles of different structure or sample rate, or an impossible number of threads.

    Examples
    --------
    >>> from sayd_env.config.scenario import load_scenario
    >>> from sayd_env.physics.simulator import VehicleModel
    >>> model = VehicleModel(load_scenario())
    >>> batch = BatchSimulator([Simulator(model, speed, 0) for speed in (70.0, 80.0, 90.0)])
    >>> batch.advance(100).shape
    (3, 100, 16)
    """

    def __init__(self, simulators: Sequence[Simulator], num_threads: int | None = None) -> None:
        self.simulators = tuple(simulators)
        if not self.simulators:
            raise ConfigError("a batch needs at least one vehicle")
        rates = {s.model.scenario.assessment.sample_rate for s in self.simulators}
        if len(rates) > 1:
            raise ConfigError(f"a batch needs one sample rate, found {sorted(rates)} Hz")
        channels = {s.channels for s in self.simulators}
        if len(channels) > 1:
            raise ConfigError(f"a batch needs equal numbers of signals, found {sorted(channels)}")
        self.num_threads = _checked_threads(num_threads)
        self._channels = channels.pop()
        self._substeps = np.array([s.model.step(s.speed)[1] for s in self.simulators])
        self._plant = stack([s.plant for s in self.simulators])
        self._state = stack([s.state for s in self.simulators])
        self._work = stack([s.work for s in self.simulators])
        for simulator, state, work in zip(
            self.simulators, unstack(*self._state), unstack(*self._work), strict=True
        ):
            simulator.state, simulator.work = state, work

    def advance(self, samples: int) -> Array:
        """Run all vehicles on for a number of samples.

        Parameters
        ----------
        samples : int
            Number of samples at the scenario's sample rate.

        Returns
        -------
        ndarray, shape (vehicles, samples, 2 w + d)
            Lateral acceleration of the bogie frame above each wheelset (m/s2), track shift force of each
            wheelset (N), force of each yaw damper (N), as in `Telemetry`.

        Raises
        ------
        StudyError
            The state of a vehicle did not stay finite.
        """
        count = len(self.simulators)
        signals = np.empty((count, samples, self._channels))
        done = np.zeros(count, dtype=np.int64)
        before = numba.get_num_threads()
        numba.set_num_threads(self.num_threads)
        try:
            # Vehicles differ in their substeps: a thread that is free takes the next one.
            with numba.parallel_chunksize(1):
                advance_batch(*self._plant, *self._state, *self._work, self._substeps, signals, done)
        finally:
            numba.set_num_threads(before)
        for simulator, taken in zip(self.simulators, done, strict=True):
            if taken < samples:
                raise StudyError(simulator.divergence())
        return signals


def _checked_threads(wanted: int | None) -> int:
    most: int = numba_config.NUMBA_NUM_THREADS
    if wanted is None:
        return most
    if not 1 <= wanted <= most:
        raise ConfigError(f"{wanted} threads, expected 1 to {most}")
    return wanted
