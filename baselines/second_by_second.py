"""What controllers share that decide once a second by what their bogie has measured in it."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sayd_env.baselines.policy import BogiePolicy
from sayd_env.baselines.rms_meter import Readings, make_rms_meter
from sayd_env.config.control import BogieCostConfig
from sayd_env.config.units import Array, Flags
from sayd_env.envs.interface import Interface, RunIn


@dataclass
class Measured:
    """State of n vehicles' controllers, two bogies each."""

    readings: Readings
    command: Array
    """(n, 2) valve commands V."""


CostParameters = TypeVar("CostParameters", bound=BogieCostConfig)
State = TypeVar("State", bound=Measured)


class SecondBySecond(BogiePolicy[CostParameters, State]):
    """A controller that changes its bogie's command once a second.

    Parameters
    ----------
    name : str
    interface : Interface
    parameters : CostParameters
    further : tuple of str
        Signals that it reads beside its meter's, the last columns of `rows`.
    """

    def __init__(
        self, name: str, interface: Interface, parameters: CostParameters, further: tuple[str, ...]
    ) -> None:
        self._meter = make_rms_meter(name, interface, parameters)
        super().__init__(name, interface, parameters, self._meter.sensors + further)

    def parts(self, rms: Array) -> tuple[Array, Array]:
        """Both parts of J of eq. (27), weighted, of RMS of acceleration (m/s2) and force (N), (..., 2)."""
        scale = np.array([self.interface.acceleration_limit, self.interface.force_reference])
        squares = (rms / scale) ** 2
        return self.parameters.k_y * squares[..., 0], self.parameters.k_F * squares[..., 1]

    def state_after(self, run_in: RunIn) -> State | None:
        """State at step 0 of controllers that ran during the run-in: filters and f_0 include it.

        Parameters
        ----------
        run_in : RunIn
            What the vehicles observed before step 0.

        Returns
        -------
        State or None
            For the first call of `predict`; None if there was no run-in.
        """
        if not len(run_in.observations):
            return None
        rows = run_in.observations[:, :, self._columns].astype(np.float64)
        state = self._begin(rows[-1])
        # The last observation is that of the reset: `predict` gets it.
        self._meter.run_in(state.readings, rows[:-1], run_in.begins)
        return state

    @abstractmethod
    def _decide(self, state: State, ended: Flags, rms: Array, rows: Array) -> None:
        """Set the commands of m vehicles whose second has ended.

        Parameters
        ----------
        state : State
        ended : ndarray of bool, shape (n,)
            These vehicles.
        rms : ndarray, shape (m, 2, 2)
            Of their last second at front and rear: acceleration (m/s2), force (N).
        rows : ndarray, shape (m, sensors)
            What they read now.
        """

    def _count(self, state: State) -> int:
        return len(state.command)

    def _restart(self, state: State, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        for vehicle in vehicles:
            self._meter.restart(state.readings, rows, int(vehicle))

    def _command_bogies(self, state: State, rows: Array) -> Array:
        if self._meter.measure(state.readings, rows):
            ended = self._meter.ended(state.readings)
            self._decide(state, ended, state.readings.rms[ended], rows[ended])
        return state.command
