"""Faults of a running vehicle: what each kind does to its state, from the moment at which it happens."""

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
from sayd_env.envs.lanes import Lanes
from sayd_env.physics import sayd
from sayd_env.physics.plant import LANES

_PLACES = {name: place for place, name in enumerate(SIGNALS)}


class FaultSchedule:
    """The faults of one episode, each of which happens once.

    Parameters
    ----------
    faults : sequence of Fault
        In any order.
    """

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        self._ahead = sorted(faults, key=lambda fault: fault.start_s)

    def apply(self, time: float, lanes: Lanes, lane: int) -> None:
        """Let all faults happen whose time (s after step 0) has come."""
        while self._ahead and self._ahead[0].start_s <= time + 1e-9:
            strike(self._ahead.pop(0), lanes, lane)


def strike(fault: Fault, lanes: Lanes, lane: int) -> None:
    """Let a fault happen now to a vehicle. A passive damper has no valve that could fail."""
    match fault:
        case ValveStuck() | PowerLost() | DamperLost():
            _strike_damper(fault, lanes, lane)
        case SensorDead():
            memory, place = lanes.memory.view(lane), _PLACES[fault.signal]
            memory.gain[place] = 0.0
        case SensorFrozen():
            lanes.memory.view(lane).frozen[_PLACES[fault.signal]] = 1.0
        case SensorBiased():
            lanes.memory.view(lane).bias[_PLACES[fault.signal]] += fault.bias
        case SensorNoisy():
            lanes.loop.view(lane).noise[_PLACES[fault.signal]] = fault.noise


def _strike_damper(fault: ValveStuck | PowerLost | DamperLost, lanes: Lanes, lane: int) -> None:
    damper, state = DAMPERS.index(fault.damper), lanes.state.view(lane)
    if state.sayd.size == 0:
        if isinstance(fault, DamperLost):
            lanes.lose_damper(lane, damper)
        return
    rows = state.sayd.reshape(-1, LANES)
    match fault:
        case ValveStuck():
            rows[sayd.STUCK, damper] = fault.current
        case PowerLost():
            rows[sayd.POWERED, damper] = 0.0
        case DamperLost():
            rows[sayd.ATTACHED, damper] = 0.0
