"""A valve command over speed that follows the hunting: it adapts to conicity, friction and wear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sayd_env.baselines.second_by_second import Measured, SecondBySecond
from sayd_env.config.control import HuntingScheduleConfig
from sayd_env.config.units import KMH, Array, Flags
from sayd_env.envs.interface import Interface

LARGEST_BALANCE = 5.0
"""Of the logarithm of the ratio; a bogie at rest, or one whose pressures are dead, has none."""


@dataclass
class Corrected(Measured):
    """State of n vehicles' controllers, two bogies each."""

    correction: Array
    """(n, 2) of the table's command."""


class HuntingSchedule(SecondBySecond[HuntingScheduleConfig, Corrected]):
    """A table over speed, corrected once a second by how much of J is hunting, one controller for each bogie.

        r = ln( k_y (psi_y / y_lim)^2 / (k_F (psi_F / F_max)^2) )         of the second just ended
        C^(n+1) = C^n - gain (r - balance(v))
        V = command(v) + C, in [V_min, V_max]

    Where the part of the acceleration falls with V as V^m and that of the force rises as V^-n, their sum is
    smallest where m times the one is n times the other, whatever the track's roughness, which is a factor on
    both: so r has a value for the best command, here a table over speed. What the ends of the range cut off
    the command is cut off C as well, so that nothing winds up there; where the table lies within the range,
    gain = 0 is the plain schedule.

    =================  =====  ==========================================================================
    parameter          unit   meaning
    =================  =====  ==========================================================================
    ``speeds_kmh``     km/h   rising speeds of the tables
    ``commands``       -      valve command at each of them
    ``balances``       -      wanted r at each of them
    ``gain``           -      closing of the valve in a second for an r too high by 1
    ``v_min``          -      smallest command
    ``v_max``          -      largest command
    ``k_y``            -      weight of the acceleration in r
    ``k_F``            -      weight of the force in r
    ``accelerometer``  -      ``leading`` or ``trailing``: wheelset above which the bogie's sensor is mounted
    ``damper``         -      the bogie's damper whose pressures are read, for example ``left.upper``
    ``slowest``        m/s    speed below which the spectrum behind f_0 covers less than 500 m
    =================  =====  ==========================================================================

    psi_y and psi_F are MPPT's, see `Mppt`. Sensors: one accelerometer of each bogie
    (``lateral_acceleration``), both pressures of one of its dampers, the train's ``speed``; from
    ``features``: ``acceleration_rms``, ``force_rms``, ``speed``. Valves: ``bogie`` or ``damper``.
    """

    def __init__(self, name: str, interface: Interface, parameters: HuntingScheduleConfig) -> None:
        super().__init__(name, interface, parameters, ("speed",))

    def balance(self, rms: Array) -> Array:
        """Logarithm r of RMS values of acceleration (m/s2) and force (N), shape (..., 2)."""
        acceleration, force = self.parts(rms)
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.log(acceleration) - np.log(force)
        return np.asarray(np.clip(np.nan_to_num(found, nan=0.0), -LARGEST_BALANCE, LARGEST_BALANCE))

    def _begin(self, rows: Array) -> Corrected:
        return Corrected(
            readings=self._meter.begin(rows),
            command=self._limited(self._table(rows, self.parameters.commands)),
            correction=np.zeros((len(rows), 2)),
        )

    def _restart(self, state: Corrected, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        super()._restart(state, rows, vehicles)
        state.command[vehicles] = self._limited(self._table(rows[vehicles], self.parameters.commands))
        state.correction[vehicles] = 0.0

    def _decide(self, state: Corrected, ended: Flags, rms: Array, rows: Array) -> None:
        table = self._table(rows, self.parameters.commands)
        excess = self.balance(rms) - self._table(rows, self.parameters.balances)
        wanted = table + state.correction[ended] - self.parameters.gain * excess
        state.command[ended] = self._limited(wanted)
        state.correction[ended] = state.command[ended] - table

    def _table(self, rows: Array, values: tuple[float, ...]) -> Array:
        """Values at the vehicles' speeds, for both bogies."""
        found = np.interp(rows[:, -1] * KMH, self.parameters.speeds_kmh, values)
        return np.repeat(found[:, None], 2, axis=1)

    def _limited(self, command: Array) -> Array:
        return np.asarray(np.clip(command, self.parameters.v_min, self.parameters.v_max))
