"""A valve command over speed: what an engineer would ship who knows the vehicle and nothing of the ride."""

from __future__ import annotations

import numpy as np

from sayd_env.baselines.policy import Memoryless
from sayd_env.config.control import SpeedScheduleConfig
from sayd_env.config.units import KMH, Array
from sayd_env.envs.interface import Interface


class SpeedSchedule(Memoryless[SpeedScheduleConfig]):
    """V over the train's speed, linear between the speeds of a table and constant beyond its ends.

    ==============  ====  ============================================
    parameter       unit  meaning
    ==============  ====  ============================================
    ``speeds_kmh``  km/h  rising speeds of the table
    ``commands``    -     valve command of all dampers at each of them
    ==============  ====  ============================================

    Sensors: the train's ``speed``. Valves: any layout.
    """

    def __init__(self, name: str, interface: Interface, parameters: SpeedScheduleConfig) -> None:
        super().__init__(name, interface, parameters, ("speed",))

    def _command(self, state: int, rows: Array) -> Array:
        commands = np.interp(rows[:, 0] * KMH, self.parameters.speeds_kmh, self.parameters.commands)
        return np.repeat(commands[:, None], self.interface.actions, axis=1)
