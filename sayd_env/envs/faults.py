"""Faults of a running vehicle: how each kind changes its state when it occurs."""

from __future__ import annotations

from sayd_env.config.fault import (
    DamperLost,
    Fault,
    PowerLost,
    SensorBiased,
    SensorDead,
    SensorFrozen,
    SensorNoisy,
    ValveStuck,
)
from sayd_env.config.sensors import DAMPERS, SIGNALS
from sayd_env.envs.vehicle_batch import VehicleBatch
from sayd_env.physics import sayd
from sayd_env.physics.plant import LANES

_PLACES = {name: place for place, name in enumerate(SIGNALS)}


class FaultSchedule:
    """The faults of one episode, each of which occurs once.

    Parameters
    ----------
    faults : sequence of Fault
        In any order.
    """

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        self._ahead = sorted(faults, key=lambda fault: fault.start_s)

    def apply(self, time: float, vehicles: VehicleBatch, vehicle: int) -> None:
        """Apply all faults that are due (time in s after step 0)."""
        while self._ahead and self._ahead[0].start_s <= time + 1e-9:
            strike(self._ahead.pop(0), vehicles, vehicle)


def strike(fault: Fault, vehicles: VehicleBatch, vehicle: int) -> None:
    """Apply a fault to a vehicle. A passive damper has no valve that could fail."""
    match fault:
        case ValveStuck() | PowerLost() | DamperLost():
            _strike_damper(fault, vehicles, vehicle)
        case SensorDead():
            memory, place = vehicles.memory.view(vehicle), _PLACES[fault.signal]
            memory.gain[place] = 0.0
        case SensorFrozen():
            vehicles.memory.view(vehicle).frozen[_PLACES[fault.signal]] = 1.0
        case SensorBiased():
            vehicles.memory.view(vehicle).bias[_PLACES[fault.signal]] += fault.bias
        case SensorNoisy():
            vehicles.loop.view(vehicle).noise[_PLACES[fault.signal]] = fault.noise


def _strike_damper(fault: ValveStuck | PowerLost | DamperLost, vehicles: VehicleBatch, vehicle: int) -> None:
    damper, state = DAMPERS.index(fault.damper), vehicles.state.view(vehicle)
    if state.sayd.size == 0:
        if isinstance(fault, DamperLost):
            vehicles.lose_damper(vehicle, damper)
        return
    rows = state.sayd.reshape(-1, LANES)
    match fault:
        case ValveStuck():
            rows[sayd.STUCK, damper] = fault.current
        case PowerLost():
            rows[sayd.POWERED, damper] = 0.0
        case DamperLost():
            rows[sayd.ATTACHED, damper] = 0.0
