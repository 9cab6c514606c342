"""What a bogie's controller measures over a second: RMS values of acceleration and force, eq. (27), (28).

From sensor signals the acceleration passes the on-line band-pass filter f_0 +- 2 Hz at the control rate, and
the force is A (p_A - p_B); from features both come measured. The observation with which an episode starts
belongs to the time before it: seconds are counted from there.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from sayd_env.baselines.policy import of_all_dampers, of_both
from sayd_env.config import ConfigError
from sayd_env.config.control import BogieCostConfig
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.units import Array, Flags, Integers
from sayd_env.envs.interface import Interface
from sayd_env.physics.kernel import kernel
from sayd_env.stability.online import (
    Band,
    BandState,
    band,
    band_state,
    follow_speed,
    push,
    restart,
    retune_group,
)

SECOND = 1.0
"""Time over which J is taken (s), the paper's step (section 4.1), and RMS values of features."""

CURRENTS = of_all_dampers("current")


@dataclass
class Readings:
    """State of the meters of n vehicles."""

    count: Integers
    """(n,) control periods of the current second; -1 before the first observation."""
    rms: Array
    """(n, 2, 2) the last second's RMS at front and rear: acceleration (m/s2), force (N)."""
    squares: Array
    """(n, 2, 2) sums of squares of the current second."""
    sample: Array
    """(2 n,) scratch: accelerations."""
    filtered: Array
    """(2 n,) scratch: filtered accelerations."""
    filters: BandState | None
    """Of the accelerations, front and rear in turn; None for features."""


class RmsMeter(ABC):
    """Measures n vehicles, two bogies each.

    Attributes
    ----------
    sensors : tuple of str
        Signals that it reads, the first columns of `rows`.
    """

    sensors: tuple[str, ...]
    _period: int

    def begin(self, rows: Array) -> Readings:
        """State of vehicles whose episodes begin with these readings, which are not yet measured."""
        vehicles = len(rows)
        return Readings(
            count=np.full(vehicles, -1, dtype=np.int64),
            rms=np.zeros((vehicles, 2, 2)),
            squares=np.zeros((vehicles, 2, 2)),
            sample=np.empty(2 * vehicles),
            filtered=np.empty(2 * vehicles),
            filters=self._filters(rows),
        )

    def restart(self, readings: Readings, rows: Array, vehicle: int) -> None:
        """Reset one vehicle's meters to the start of an episode."""
        readings.count[vehicle] = -1
        readings.squares[vehicle] = 0.0
        self._restart_filters(readings, rows, vehicle)

    @abstractmethod
    def run_in(self, readings: Readings, rows: Array, begins: Integers) -> None:
        """Take the readings before step 0, without measuring.

        Parameters
        ----------
        readings : Readings
            Made for the vehicles' speeds at step 0.
        rows : ndarray, shape (T, n, sensors)
            Readings of each control period but the last, which is the first to be measured.
        begins : ndarray, shape (n,)
            Row with which each vehicle's begin.
        """

    @abstractmethod
    def measure(self, readings: Readings, rows: Array) -> bool:
        """Take one control period's readings.

        Returns
        -------
        bool
            Whether a second of some vehicle ended; `ended` says of which.
        """

    def ended(self, readings: Readings) -> Flags:
        """Vehicles whose second ended with the last readings, shape (n,)."""
        return np.equal(readings.count, self._period)

    @abstractmethod
    def _filters(self, rows: Array) -> BandState | None:
        """Make filters at rest."""

    @abstractmethod
    def _restart_filters(self, readings: Readings, rows: Array, vehicle: int) -> None:
        """Reset one vehicle's filters to rest."""


def make_rms_meter(name: str, interface: Interface, parameters: BogieCostConfig) -> RmsMeter:
    """Make the meter that fits an environment's observation.

    Raises
    ------
    ConfigError
        Control periods too long for the band, or passive dampers where a force is to be measured.
    """
    kind = FeatureRmsMeter if interface.observation == "features" else SignalRmsMeter
    return kind(name, interface, parameters)


class FeatureRmsMeter(RmsMeter):
    """Reads the RMS values that the environment has measured."""

    def __init__(self, name: str, interface: Interface, parameters: BogieCostConfig) -> None:
        self._period = periods_of_a_second(interface)
        self._force = parameters.k_F > 0.0
        acceleration = of_both(f"acceleration_rms.{{}}.{parameters.accelerometer}")
        self.sensors = acceleration + (of_both(f"force_rms.{{}}.{parameters.damper}") if self._force else ())

    def run_in(self, readings: Readings, rows: Array, begins: Integers) -> None:
        """Take nothing: the environment computes the features."""

    def measure(self, readings: Readings, rows: Array) -> bool:
        """Take one control period's readings."""
        count = readings.count
        count[count == self._period] = 0
        count += 1
        ended = self.ended(readings)
        if not ended.any():
            return False
        readings.rms[ended, :, 0] = rows[ended, :2]
        if self._force:
            readings.rms[ended, :, 1] = rows[ended, 2:4]
        return True

    def _filters(self, rows: Array) -> None:
        return None

    def _restart_filters(self, readings: Readings, rows: Array, vehicle: int) -> None:
        pass


class SignalRmsMeter(RmsMeter):
    """Filters and squares sensor signals at the control rate."""

    def __init__(self, name: str, interface: Interface, parameters: BogieCostConfig) -> None:
        self._period = periods_of_a_second(interface)
        self._slowest = parameters.slowest
        self._band = control_band(name, interface)
        pressures: tuple[str, ...] = ()
        self._area = 0.0
        if parameters.k_F > 0.0:
            self._area = _area(name, interface)
            pressures = of_both(f"pressure_a.{{}}.{parameters.damper}")
            pressures += of_both(f"pressure_b.{{}}.{parameters.damper}")
        self.sensors = (
            "speed",
            *of_both(f"lateral_acceleration.{{}}.{parameters.accelerometer}"),
            *pressures,
        )

    def measure(self, readings: Readings, rows: Array) -> bool:
        """Take one control period's readings."""
        assert readings.filters is not None  # signals always have filters
        return _measure(
            self._band,
            readings.filters,
            rows,
            self._area,
            self._period,
            readings.count,
            readings.squares,
            readings.rms,
            readings.sample,
            readings.filtered,
        )

    def run_in(self, readings: Readings, rows: Array, begins: Integers) -> None:
        """Fill the filters and the spectra behind f_0."""
        filters, vehicles = readings.filters, len(begins)
        assert filters is not None  # signals always have filters
        # A speed sensor rises slowly to its reading: the length of the spectrum is that of the last one.
        speeds = self._speed(rows[-1, :, 0]) if len(rows) else np.zeros(vehicles)
        for t, row in enumerate(rows):
            for vehicle in np.flatnonzero(begins == t):
                self._rest(filters, int(vehicle), float(speeds[vehicle]))
            readings.sample[:] = row[:, 1:3].reshape(-1)
            push(self._band, filters, readings.sample, readings.filtered)

    def _rest(self, filters: BandState, vehicle: int, speed: float) -> None:
        for group in (2 * vehicle, 2 * vehicle + 1):
            restart(self._band, filters, group, speed)

    def _filters(self, rows: Array) -> BandState:
        # One group each bogie, for each has its own f_0.
        speed = np.repeat(self._speed(rows[:, 0]), 2)
        groups = len(speed)
        return band_state(self._band, speed, groups, groups, self._slowest)

    def _restart_filters(self, readings: Readings, rows: Array, vehicle: int) -> None:
        (speed,) = self._speed(rows[vehicle : vehicle + 1, 0])
        assert readings.filters is not None
        self._rest(readings.filters, vehicle, float(speed))

    def _speed(self, readings: Array) -> Array:
        """Speeds that the filters accept, also where a sensor is dead."""
        return np.maximum(readings, self._slowest)


def control_band(name: str, interface: Interface) -> Band:
    """Filters of the on-line band at the control rate.

    Raises
    ------
    ConfigError
        Control periods too long for the band; the message begins with the name of the policy.
    """
    try:
        return band(interface.online, interface.assessment, 1.0 / interface.control_period)
    except ConfigError as error:
        raise ConfigError(
            f"{name}: a control period of {1e3 * interface.control_period:g} ms is too long to filter "
            f"the acceleration ({error}); shorten it, or use observation='features'"
        ) from None


def periods_of_a_second(interface: Interface) -> int:
    """Control periods of a second.

    Raises
    ------
    ConfigError
        They do not divide it.
    """
    count = round(SECOND / interface.control_period)
    if count < 1 or abs(count * interface.control_period - SECOND) > 1e-9:
        raise ConfigError(
            f"control_period: found {interface.control_period:g} s; expected one that divides a second"
        )
    return count


def _area(name: str, interface: Interface) -> float:
    if not isinstance(interface.damper, SaydDamperConfig):
        raise ConfigError(
            f"{name}: weighs the force by pressures in semi-active dampers (k_F > 0), but the environment "
            "has passive ones; make it with damper='sayd'"
        )
    return interface.damper.cylinder.area


# An edit of `push` or `retune_group` is noticed, for their sources name the kernels' cache; a kernel of
# another file of this package would not be, so this one calls none.
@kernel(allocates=False)
def _measure(
    constants: Band,
    filters: BandState,
    rows: Array,
    area: float,
    period: int,
    count: Integers,
    squares: Array,
    rms: Array,
    sample: Array,
    filtered: Array,
) -> bool:
    """One control period of all vehicles; rows hold speed, two accelerations and, with an area, p_A and p_B.

    A vehicle whose second ends keeps `period` as its count until the next call.
    """
    vehicles, some = rows.shape[0], False
    for i in range(vehicles):
        for b in range(2):
            sample[2 * i + b] = rows[i, 1 + b]
    push(constants, filters, sample, filtered)
    for i in range(vehicles):
        count[i] = count[i] + 1 if count[i] < period else 1
        if count[i] == 0:
            for b in range(2):
                retune_group(constants, filters, 2 * i + b)
            continue
        for b in range(2):
            squares[i, b, 0] += filtered[2 * i + b] * filtered[2 * i + b]
            if area > 0.0:
                force = area * (rows[i, 3 + b] - rows[i, 5 + b])
                squares[i, b, 1] += force * force
        if count[i] < period:
            continue
        some = True
        for b in range(2):
            for k in range(2):
                rms[i, b, k] = math.sqrt(squares[i, b, k] / period)
                squares[i, b, k] = 0.0
            follow_speed(constants, filters, 2 * i + b, rows[i, 0])
            retune_group(constants, filters, 2 * i + b)
    return some
