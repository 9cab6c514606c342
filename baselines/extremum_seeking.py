"""What controllers that seek the smallest J share: the cost of eq. (27), its seconds, the command's range."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sayd_env.baselines.policy import BogiePolicy
from sayd_env.baselines.rms_meter import CURRENTS, Readings, make_rms_meter
from sayd_env.config.control import BogieCostConfig
from sayd_env.config.units import Array
from sayd_env.envs.interface import BOGIES, DAMPERS, Interface, RunIn

CostParameters = TypeVar("CostParameters", bound=BogieCostConfig)


@dataclass
class Search:
    """State of n vehicles' controllers, two bogies each."""

    readings: Readings
    command: Array
    """(n, 2) valve commands V."""
    cost: Array
    """(n, 2) J of the last second; NaN before there is one."""
    direction: Array
    """(n, 2) of the last move of V, +1 or -1; only for controllers that use it."""


class ExtremumSeeking(BogiePolicy[CostParameters, Search]):
    """A controller that changes its bogie's command once a second, by J of eq. (27)."""

    def __init__(self, name: str, interface: Interface, parameters: CostParameters) -> None:
        self._meter = make_rms_meter(name, interface, parameters)
        self._reads_currents = parameters.initial is None
        sensors = self._meter.sensors + (CURRENTS if self._reads_currents else ())
        super().__init__(name, interface, parameters, sensors)

    def costs(self, rms: Array) -> Array:
        """J of eq. (27) of RMS values of acceleration (m/s2) and force (N), shape (..., 2)."""
        scale = np.array([self.interface.acceleration_limit, self.interface.force_reference])
        weights = np.array([self.parameters.k_y, self.parameters.k_F])
        return np.asarray((rms / scale) ** 2 @ weights)

    def listen(self, run_in: RunIn) -> Search | None:
        """State at step 0 of controllers that ran during the run-in: filters and f_0 include it.

        Parameters
        ----------
        run_in : RunIn
            What the vehicles observed before step 0.

        Returns
        -------
        Search or None
            For the first call of `predict`; None if there was no run-in.
        """
        if not len(run_in.observations):
            return None
        rows = run_in.observations[:, :, self._columns].astype(np.float64)
        state = self._begin(rows[-1])
        # The last observation is that of the reset: `predict` gets it.
        self._meter.listen(state.readings, rows[:-1], run_in.begins)
        return state

    @abstractmethod
    def _move(self, command: Array, previous: Array, cost: Array, rms: Array, direction: Array) -> Array:
        """Commands for the next second, before they are clipped to their range; may change `direction`.

        All arrays have shape (m, 2): the commands V^n, J^n (NaN in the first second), J^(n+1), the RMS of the
        acceleration (m/s2), and the directions.
        """

    def _first_direction(self) -> float:
        return -1.0

    def _count(self, state: Search) -> int:
        return len(state.command)

    def _begin(self, rows: Array) -> Search:
        return Search(
            readings=self._meter.begin(rows),
            command=self._initial(rows),
            cost=np.full((len(rows), 2), np.nan),
            direction=np.full((len(rows), 2), self._first_direction()),
        )

    def _restart(self, state: Search, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        for vehicle in vehicles:
            self._meter.restart(state.readings, rows, int(vehicle))
        state.command[vehicles] = self._initial(rows[vehicles])
        state.cost[vehicles] = np.nan
        state.direction[vehicles] = self._first_direction()

    def _initial(self, rows: Array) -> Array:
        if self.parameters.initial is not None:
            return np.full((len(rows), 2), max(self.parameters.initial, self.parameters.v_min))
        currents = rows[:, -len(CURRENTS) :].reshape(-1, len(BOGIES), len(DAMPERS)).mean(axis=2)
        return np.asarray(np.clip(currents, self.parameters.v_min, 1.0))

    def _command_bogies(self, state: Search, rows: Array) -> Array:
        if self._meter.measure(state.readings, rows):
            ended = self._meter.ended(state.readings)
            rms = state.readings.rms[ended]
            cost, direction = self.costs(rms), state.direction[ended]
            moved = self._move(state.command[ended], state.cost[ended], cost, rms[:, :, 0], direction)
            state.command[ended] = np.clip(moved, self.parameters.v_min, 1.0)
            state.cost[ended] = cost
            state.direction[ended] = direction
        return state.command
