"""Controllers without feedback: passive dampers, and a constant valve command."""

from __future__ import annotations

import numpy as np

from sayd_env.baselines.policy import Memoryless
from sayd_env.config import ConfigError
from sayd_env.config.control import ConstantConfig, PassiveControlConfig
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.units import Array
from sayd_env.envs.interface import Interface


class OpenLoop(Memoryless[ConstantConfig | PassiveControlConfig]):
    """A policy with a constant command."""

    def __init__(
        self,
        name: str,
        interface: Interface,
        parameters: ConstantConfig | PassiveControlConfig,
        current: float,
    ) -> None:
        super().__init__(name, interface, parameters, ())
        self._current = current

    def _command(self, state: int, rows: Array) -> Array:
        return np.full((state, self.interface.actions), self._current)


class Constant(OpenLoop):
    """Constant valve command: V = current.

    ===========  ====  ==========================================
    parameter    unit  meaning
    ===========  ====  ==========================================
    ``current``  -     valve command of every damper, 0 closed
    ===========  ====  ==========================================

    Sensors: none. Valves: any layout.
    """

    def __init__(self, name: str, interface: Interface, parameters: ConstantConfig) -> None:
        super().__init__(name, interface, parameters, parameters.current)


class Passive(OpenLoop):
    """Passive dampers, which ignore commands: V = 0.

    No parameters, no sensors, any layout of valves.

    Raises
    ------
    ConfigError
        The environment has semi-active dampers.
    """

    def __init__(self, name: str, interface: Interface, parameters: PassiveControlConfig) -> None:
        if not isinstance(interface.damper, PassiveDamperConfig):
            raise ConfigError(
                f"{name}: needs passive dampers, but the environment has semi-active ones; "
                "make it with damper='passive'"
            )
        super().__init__(name, interface, parameters, 0.0)
