"""Between a vehicle's signals and a network: fixed maps in physical units, no running statistics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.agents.config import OutputConfig
from sayd_env.config import ConfigError, nearest
from sayd_env.config.learner import InputConfig
from sayd_env.envs.interface import Interface
from sayd_env.envs.scaled import Observation, Scaling


class Encoding(ABC):
    """What the network of a policy sees, and what its output does to the valves.

    Parameters
    ----------
    interface : Interface
        The environment's.
    clip : float
        Inputs are cut off at plus and minus this.
    output : OutputConfig

    Attributes
    ----------
    units : int
        How often the network works in a vehicle: once, or once for each bogie.
    size : int
        Inputs of the network.
    actions : int
        Outputs of the network.
    sensors : tuple of str
        Signals that it reads.
    """

    units: int
    size: int
    actions: int
    sensors: tuple[str, ...]

    def __init__(self, interface: Interface, clip: float, output: OutputConfig) -> None:
        self.interface = interface
        self.clip = clip
        self.output = output

    @abstractmethod
    def encode(self, observations: Observation) -> Observation:
        """Inputs of the network, shape (N units, size), of observations of shape (N, *obs)."""

    def decode(self, outputs: npt.NDArray[Any], observations: Observation) -> Observation:
        """Valve commands, shape (N, A), of the network's outputs for these observations.

        Parameters
        ----------
        outputs : ndarray, shape (N units, actions)
            Cut off at -1 and 1.
        observations : ndarray, shape (N, *obs)
        """
        bounded = np.clip(outputs.astype(np.float64), -1.0, 1.0).reshape(len(observations), -1)
        commands = self.output.middle + self.output.half * bounded
        return np.clip(commands, 0.0, 1.0).astype(np.float32)


class VehicleEncoding(Encoding):
    """One network for the vehicle, which sees signals as they are.

    Parameters
    ----------
    interface : Interface
        The environment's.
    inputs : mapping
        How each quantity enters; others are left out.
    clip : float
        Inputs are cut off at plus and minus this.
    output : OutputConfig

    Raises
    ------
    ConfigError
        The environment does not have a quantity, or no commands where the output changes them.
    """

    units = 1

    def __init__(
        self, interface: Interface, inputs: Mapping[str, InputConfig], clip: float, output: OutputConfig
    ) -> None:
        super().__init__(interface, clip, output)
        quantities = [signal.name.partition(".")[0] for signal in interface.signals]
        for name in inputs:
            if name not in quantities:
                raise ConfigError(
                    f"inputs: observation '{interface.observation}' has no quantity '{name}'"
                    f"{nearest(name, quantities)}; it has {', '.join(dict.fromkeys(quantities))}"
                )
        self.columns = np.array([i for i, name in enumerate(quantities) if name in inputs], dtype=np.intp)
        self.sensors = tuple(interface.signals[i].name for i in self.columns)
        self.scaling = Scaling.of((interface.signals[i] for i in self.columns), inputs, clip)
        self.held = _commands(interface) if output.kind == "change" else None
        self.step = output.rate * interface.control_period
        self.size = len(self.columns) * interface.history
        self.actions = interface.actions

    def encode(self, observations: Observation) -> Observation:
        """Inputs of the network, shape (N, size), of observations of shape (N, *obs)."""
        return self.scaling(observations[..., self.columns]).reshape(len(observations), self.size)

    def decode(self, outputs: npt.NDArray[Any], observations: Observation) -> Observation:
        """Valve commands, shape (N, A), of the network's outputs for these observations."""
        if self.held is None:
            return super().decode(outputs, observations)
        held = observations[..., self.held].astype(np.float64)
        change = self.step * np.clip(outputs.astype(np.float64), -1.0, 1.0)
        return np.clip(held + change, 0.0, 1.0).astype(np.float32)


def _commands(interface: Interface) -> npt.NDArray[np.intp]:
    """Where an observation has the command that each action holds."""
    places = [i for i, signal in enumerate(interface.signals) if signal.name.startswith("command.")]
    if not places:
        raise ConfigError(
            f"output: 'change' needs the commands, which observation '{interface.observation}' does not "
            "have; use 'features' or output.kind=command"
        )
    return np.array(places[:: len(places) // interface.actions], dtype=np.intp)
