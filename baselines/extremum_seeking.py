"""What controllers that seek the smallest J share: the cost of eq. (27), its seconds, the command's range."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sayd_env.baselines.rms_meter import CURRENTS
from sayd_env.baselines.second_by_second import Measured, SecondBySecond
from sayd_env.config.control import ExtremumConfig
from sayd_env.config.units import Array, Flags
from sayd_env.envs.interface import BOGIES, DAMPERS, Interface

SeekingParameters = TypeVar("SeekingParameters", bound=ExtremumConfig)


@dataclass
class Search(Measured):
    """State of n vehicles' controllers, two bogies each."""

    cost: Array
    """(n, 2) J of the last second; NaN before there is one."""
    direction: Array
    """(n, 2) of the last move of V, +1 or -1; only for controllers that use it."""


class ExtremumSeeking(SecondBySecond[SeekingParameters, Search]):
    """A controller that changes its bogie's command once a second, by J of eq. (27)."""

    def __init__(self, name: str, interface: Interface, parameters: SeekingParameters) -> None:
        super().__init__(name, interface, parameters, CURRENTS if parameters.initial is None else ())

    def costs(self, rms: Array) -> Array:
        """J of eq. (27) of RMS values of acceleration (m/s2) and force (N), shape (..., 2)."""
        acceleration, force = self.parts(rms)
        return acceleration + force

    @abstractmethod
    def _move(self, command: Array, previous: Array, cost: Array, rms: Array, direction: Array) -> Array:
        """Commands for the next second, before they are clipped to their range; may change `direction`.

        All arrays have shape (m, 2): the commands V^n, J^n (NaN in the first second), J^(n+1), the RMS of the
        acceleration (m/s2), and the directions.
        """

    def _first_direction(self) -> float:
        return -1.0

    def _begin(self, rows: Array) -> Search:
        return Search(
            readings=self._meter.begin(rows),
            command=self._initial(rows),
            cost=np.full((len(rows), 2), np.nan),
            direction=np.full((len(rows), 2), self._first_direction()),
        )

    def _restart(self, state: Search, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        super()._restart(state, rows, vehicles)
        state.command[vehicles] = self._initial(rows[vehicles])
        state.cost[vehicles] = np.nan
        state.direction[vehicles] = self._first_direction()

    def _initial(self, rows: Array) -> Array:
        if self.parameters.initial is not None:
            return np.full((len(rows), 2), max(self.parameters.initial, self.parameters.v_min))
        currents = rows[:, -len(CURRENTS) :].reshape(-1, len(BOGIES), len(DAMPERS)).mean(axis=2)
        return np.asarray(np.clip(currents, self.parameters.v_min, 1.0))

    def _decide(self, state: Search, ended: Flags, rms: Array, rows: Array) -> None:
        cost, direction = self.costs(rms), state.direction[ended]
        moved = self._move(state.command[ended], state.cost[ended], cost, rms[:, :, 0], direction)
        state.command[ended] = np.clip(moved, self.parameters.v_min, 1.0)
        state.cost[ended] = cost
        state.direction[ended] = direction
