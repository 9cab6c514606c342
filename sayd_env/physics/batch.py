"""Many vehicles in one compiled call: each with its own speed, profiles, track, dampers and state.

Vehicles of one kind run side by side (`sayd_env.physics.formation`), the others one by one. The results are
the same bits as those of a vehicle alone, for any number of vehicles and threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.units import Array, Integers
from sayd_env.physics.formation import (
    Formation,
    References,
    calls,
    interleave,
    plant_of,
    put_back,
    state_of,
    work_of,
)
from sayd_env.physics.kernel import compiled_threads, kernel, named
from sayd_env.physics.kernel_cache import numba_config
from sayd_env.physics.plant import Plant, State, Work
from sayd_env.physics.rows import ABREAST, SINGLE, Lanes
from sayd_env.physics.simulator import Simulator
from sayd_env.physics.step import largest_shift, measure, record, steps


@kernel(allocates=False)
def _advance(
    lanes: Lanes,
    plant: Plant,
    states: References,
    together: State,
    work: Work,
    members: Integers,
    substeps: int,
    samples: Integers,
    signals: Array,
    done: Integers,
) -> None:
    """`sayd_env.physics.step.advance` for vehicles side by side, into the rows of the batch's arrays.

    `members` loses those that have arrived or whose run has ended: their states are put back at once.
    """
    running = 0
    for k in range(len(lanes)):
        running += 1 if members[k] >= 0 else 0
    for t in range(signals.shape[1]):
        if running > 0:
            steps(lanes, plant, together, work, substeps, t == 0)
            measure(lanes, plant, together, work)
        for k in range(len(lanes)):
            i = members[k]
            if i >= 0:
                record(lanes, k, plant, together, work, signals[i, t])
                finite = math.isfinite(signals[i, t, 0] + together.v[k])
                goes_on = finite and largest_shift(lanes, k, plant, work) < 1.0
                done[i] += 1 if goes_on else 0
                if not goes_on or t + 1 == samples[i]:
                    put_back(lanes, k, states, i, together)
                    members[k] = -1
                    running -= 1


def _advance_units(
    groups: Integers | None,
    members: Integers | None,
    alone: Integers | None,
    plants: References,
    states: References,
    works: References,
    group_plants: References,
    group_states: References,
    group_works: References,
    substeps: Integers,
    samples: Integers,
    signals: Array,
    done: Integers,
) -> None:
    """Advance v vehicles, each by its own number of samples.

    Parameters
    ----------
    groups, members, alone
        Who runs, one of `sayd_env.physics.formation.calls`: where groups or vehicles alone are None, their
        half of the loop is not compiled.
    plants, states, works, group_plants, group_states, group_works
        From `Formation.arguments`.
    substeps : ndarray, shape (v,)
        Steps between two samples of each vehicle.
    samples : ndarray, shape (v,)
        At least 1 each.
    signals : ndarray, shape (v, largest of samples, 2 w + d)
        Receives the signals of `sayd_env.physics.step.record`, in a vehicle's first rows.
    done : ndarray, shape (v,)
        Zeros; receives the number of samples taken: fewer if a state is no longer finite or a wheel has
        left the contact table.
    """
    first_alone = 0 if groups is None else groups.shape[0]
    count = first_alone + (0 if alone is None else alone.shape[0])
    for u in numba.prange(count):
        if u < first_alone:
            if groups is not None and members is not None:
                g, who = groups[u], members[u].copy()
                together = state_of(group_states, g)
                interleave(ABREAST, who, states, together)
                plant, work = plant_of(group_plants, g), work_of(group_works, g)
                each = substeps[np.max(who)]
                _advance(ABREAST, plant, states, together, work, who, each, samples, signals, done)
        elif alone is not None:
            who = alone[u - first_alone : u - first_alone + 1].copy()
            i = who[0]
            plant, together, work = plant_of(plants, i), state_of(states, i), work_of(works, i)
            _advance(SINGLE, plant, states, together, work, who, substeps[i], samples, signals, done)


advance_units = kernel(announce="the simulator of groups or of single vehicles (first use of each)")(
    named(_advance_units, "advance_units")
)
"""`_advance_units`, one unit after another."""
advance_units_in_parallel = kernel(
    parallel=True, announce="the simulator of many vehicles (first use, one to three minutes)"
)(named(_advance_units, "advance_units_in_parallel"))
"""`_advance_units` on all threads: the results are the same bits."""


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
        if len({id(s.state) for s in self.simulators}) < len(self.simulators):
            raise ConfigError("a batch needs different simulators: found one twice")
        rates = {s.model.scenario.assessment.sample_rate for s in self.simulators}
        if len(rates) > 1:
            raise ConfigError(f"a batch needs one sample rate, found {sorted(rates)} Hz")
        channels = {s.channels for s in self.simulators}
        if len(channels) > 1:
            raise ConfigError(f"a batch needs equal numbers of signals, found {sorted(channels)}")
        self.num_threads = checked_threads(num_threads)
        self._channels = channels.pop()
        self._substeps = np.array([s.model.step(s.speed)[1] for s in self.simulators])
        self._formation = Formation(
            [s.plant for s in self.simulators],
            [s.state for s in self.simulators],
            [s.work for s in self.simulators],
        )

    def advance(self, samples: int | Sequence[int]) -> Array:
        """Run all vehicles on for a number of samples.

        Parameters
        ----------
        samples : int or sequence of int
            Number of samples at the scenario's sample rate: for all vehicles, or of each.

        Returns
        -------
        ndarray, shape (vehicles, largest of samples, 2 w + d)
            Lateral acceleration of the bogie frame above each wheelset (m/s2), track shift force of each
            wheelset (N), force of each yaw damper (N), as in `Telemetry`. Rows behind a vehicle's own last
            sample are NaN.

        Raises
        ------
        ConfigError
            No sample for one of the vehicles, or not one number for each.
        StudyError
            The state of a vehicle did not stay finite, or a wheel has left the contact table.
        """
        count = len(self.simulators)
        wanted = np.array(samples, dtype=np.int64)
        wanted = np.full(count, wanted) if wanted.ndim == 0 else wanted
        if wanted.shape != (count,) or wanted.min() < 1:
            raise ConfigError(f"a batch of {count} vehicles needs 1 sample or more of each, found {samples}")
        signals = np.full((count, wanted.max(), self._channels), np.nan)
        done = np.zeros(count, dtype=np.int64)
        kernel = advance_units if self.num_threads == 1 else advance_units_in_parallel
        units = self._formation.units()
        arguments = self._formation.arguments()
        with compiled_threads(self.num_threads):
            for who in calls(units, self.num_threads):
                kernel(*who, *arguments, self._substeps, wanted, signals, done)
        for simulator, taken, own in zip(self.simulators, done, wanted, strict=True):
            if taken < own:
                raise StudyError(simulator.divergence())
        return signals


def checked_threads(wanted: int | None) -> int:
    """Number of threads for parallel kernels: all cores if none is wanted.

    Raises
    ------
    ConfigError
        Fewer than one, or more than there are.
    """
    most: int = numba_config.NUMBA_NUM_THREADS
    if wanted is None:
        return most
    if not 1 <= wanted <= most:
        raise ConfigError(f"num_threads: found {wanted}; expected a whole number from 1 to {most}")
    return wanted
