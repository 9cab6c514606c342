"""How much each bogie hunts, from its sensors while the vehicle runs.

From sensor signals the acceleration passes the on-line band-pass filter f_0 +- 2 Hz of eq. (27) at the
control rate, and its mean square slides exponentially: e += (1 - exp(-dt / tau)) (y^2 - e). From features the
RMS comes measured over the last second. The indicator is the larger RMS of a frame's two points over the
limit of EN 14363, eq. (26), by which the vehicle is judged: 1 is the limit.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from sayd_env.baselines.rms_meter import control_band, periods_of_a_second
from sayd_env.config.safe import SafeConfig
from sayd_env.config.units import Array, Integers
from sayd_env.envs.interface import BOGIES, POINTS, Interface
from sayd_env.stability.online import BandState, band_state, follow_speed, push, restart, retune_group


@dataclass
class Hunting:
    """State of n vehicles' indicators."""

    count: Integers
    """(n,) control periods of the current second."""
    squares: Array
    """(n, 4) sliding mean squares at the points of both bogies, m2/s4."""
    filters: BandState | None
    """Of these points, a group for each bogie; None for features."""


class HuntingIndicator(ABC):
    """Indicators of n vehicles, two bogies each.

    Attributes
    ----------
    sensors : tuple of str
        Signals that it reads, the columns of `rows`.
    """

    sensors: tuple[str, ...]

    def __init__(self, interface: Interface) -> None:
        self._limit = interface.acceleration_limit

    @abstractmethod
    def begin(self, rows: Array) -> Hunting:
        """State of vehicles that begin with these readings, which are not yet taken."""

    @abstractmethod
    def restart(self, state: Hunting, rows: Array, vehicle: int) -> None:
        """Put one vehicle back to the start of an episode."""

    @abstractmethod
    def take(self, state: Hunting, rows: Array) -> None:
        """Take the readings of one control period."""

    def values(self, state: Hunting) -> Array:
        """Indicators of front and rear bogie, shape (n, 2): RMS over its limit."""
        larger = np.maximum(state.squares[:, :: len(POINTS)], state.squares[:, 1 :: len(POINTS)])
        return np.asarray(np.sqrt(larger) / self._limit)


def hunting_indicator(name: str, interface: Interface, parameters: SafeConfig) -> HuntingIndicator:
    """Make the indicator that fits an environment's observation.

    Raises
    ------
    ConfigError
        Control periods too long for the band.
    """
    if interface.observation == "features":
        return _OfFeatures(interface)
    return _OfSignals(name, interface, parameters)


class _OfFeatures(HuntingIndicator):
    """Reads the RMS values that the environment has measured."""

    def __init__(self, interface: Interface) -> None:
        super().__init__(interface)
        self.sensors = _at_all_points("acceleration_rms")

    def begin(self, rows: Array) -> Hunting:
        """State before the first readings."""
        return Hunting(np.zeros(len(rows), dtype=np.int64), np.zeros((len(rows), 4)), None)

    def restart(self, state: Hunting, rows: Array, vehicle: int) -> None:
        """Forget the last readings of a vehicle."""
        state.squares[vehicle] = 0.0

    def take(self, state: Hunting, rows: Array) -> None:
        """Square them."""
        state.squares[:] = rows**2


class _OfSignals(HuntingIndicator):
    """Filters and squares sensor signals at the control rate."""

    def __init__(self, name: str, interface: Interface, parameters: SafeConfig) -> None:
        super().__init__(interface)
        self._period, self._slowest = periods_of_a_second(interface), parameters.slowest
        self._share = -math.expm1(-interface.control_period / parameters.smoothing)
        self._band = control_band(name, interface)
        self.sensors = (*_at_all_points("lateral_acceleration"), "speed")

    def begin(self, rows: Array) -> Hunting:
        """Filters at rest."""
        count, groups = len(rows), len(BOGIES) * len(rows)
        speeds = np.repeat(self._speed(rows[:, -1]), len(BOGIES))
        filters = band_state(self._band, speeds, len(POINTS) * groups, groups, self._slowest)
        return Hunting(np.zeros(count, dtype=np.int64), np.zeros((count, 4)), filters)

    def restart(self, state: Hunting, rows: Array, vehicle: int) -> None:
        """Filters of one vehicle at rest."""
        assert state.filters is not None  # signals always have filters
        (speed,) = self._speed(rows[vehicle : vehicle + 1, -1])
        state.count[vehicle], state.squares[vehicle] = 0, 0.0
        for group in range(len(BOGIES) * vehicle, len(BOGIES) * (vehicle + 1)):
            restart(self._band, state.filters, group, float(speed))

    def take(self, state: Hunting, rows: Array) -> None:
        """Filter them; once a second look for f_0."""
        filters, filtered = state.filters, np.empty(4 * len(rows))
        assert filters is not None  # signals always have filters
        push(self._band, filters, np.ascontiguousarray(rows[:, :4]).reshape(-1), filtered)
        state.squares += self._share * (filtered.reshape(-1, 4) ** 2 - state.squares)
        state.count += 1
        for vehicle in np.flatnonzero(state.count == self._period):
            state.count[vehicle] = 0
            for group in range(len(BOGIES) * vehicle, len(BOGIES) * (vehicle + 1)):
                follow_speed(self._band, filters, group, float(rows[vehicle, -1]))
                retune_group(self._band, filters, group)

    def _speed(self, readings: Array) -> Array:
        """Speeds that the filters accept, also where a sensor is dead."""
        return np.maximum(readings, self._slowest)


def _at_all_points(quantity: str) -> tuple[str, ...]:
    return tuple(f"{quantity}.{bogie}.{point}" for bogie in BOGIES for point in POINTS)
