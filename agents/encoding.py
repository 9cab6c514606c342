"""Between a vehicle's signals and a network: fixed maps in physical units, no running statistics."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from sayd_env.agents.config import OutputConfig
from sayd_env.agents.memory import Memory
from sayd_env.agents.state import run_in_periods
from sayd_env.config import ConfigError, nearest
from sayd_env.config.learner import InputConfig
from sayd_env.config.units import KMH, Array, Array32
from sayd_env.envs.interface import Interface, RunIn
from sayd_env.envs.scaled import Scaling


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
    memory : Memory or None
        What it remembers beside the observation.
    speed : int or None
        Place of the newest speed in a flat observation, where the output follows a schedule over it.
    """

    units: int
    size: int
    actions: int
    sensors: tuple[str, ...]
    memory: Memory | None = None

    def __init__(self, interface: Interface, clip: float, output: OutputConfig) -> None:
        self.interface = interface
        self.clip = clip
        self.output = output
        newest = (interface.history - 1) * len(interface.signals)
        self.speed = None if output.schedule is None else newest + interface.index("speed")

    @abstractmethod
    def encode(self, observations: Array32, memory: Array | None = None) -> Array32:
        """Inputs of the network, shape (N units, size).

        Parameters
        ----------
        observations : ndarray, shape (N, *obs)
        memory : ndarray, shape (N, memory.width), optional
            What is remembered, with these observations: `remember`. Needed where there is a memory.
        """

    @property
    def memory_width(self) -> int:
        """Numbers that are remembered of a vehicle."""
        return 0 if self.memory is None else self.memory.width

    def remember(self, memory: Array, observations: Array32) -> Array:
        """What is remembered after these observations of shape (N, *obs), of what was before: a new array.

        Both have the shape (N, memory_width); a vehicle that has seen nothing has zeros.
        """
        if self.memory is None:
            return memory
        return self.memory.remember(memory, flat(observations))

    def memory_after(self, run_in: RunIn) -> Array:
        """What vehicles remember of their run-in, shape (N, memory_width), but for its last observation.

        That one comes with the first call of a policy.
        """
        memory = np.zeros((run_in.observations.shape[1], self.memory_width))
        for own, seen in run_in_periods(run_in, self.interface) if self.memory is not None else ():
            memory[own] = self.remember(memory[own], seen)
        return memory

    def decode(self, outputs: npt.NDArray[Any], observations: Array32) -> Array32:
        """Valve commands, shape (N, A), of the network's outputs for these observations.

        Parameters
        ----------
        outputs : ndarray, shape (N units, actions)
            Cut off at -1 and 1.
        observations : ndarray, shape (N, *obs)
        """
        bounded = np.clip(outputs.astype(np.float64), -1.0, 1.0).reshape(len(observations), -1)
        commands = self.base_command(observations) + self.output.half * bounded
        return np.clip(commands, 0.0, 1.0).astype(np.float32)

    def base_command(self, observations: Array32) -> Array | float:
        """Commands at output 0 for observations of shape (N, *obs): one for all, or shape (N, 1)."""
        schedule = self.output.schedule
        if schedule is None:
            return self.output.middle
        newest = observations.reshape(len(observations), -1)[:, self.speed].astype(np.float64)
        speed = np.nan_to_num(newest) * KMH
        return np.interp(speed, schedule.speeds_kmh, schedule.commands)[:, None]

    def _read(self, names: Iterable[str]) -> tuple[str, ...]:
        """Signals that are read: those of the inputs, and the speed that a schedule follows."""
        return tuple(dict.fromkeys([*names, *(("speed",) if self.output.schedule is not None else ())]))


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
        self.sensors = self._read(interface.signals[i].name for i in self.columns)
        self.scaling = Scaling.of((inputs[quantities[i]] for i in self.columns), clip)
        self.held = _commands(interface) if output.kind == "change" else None
        self.step = output.rate * interface.control_period
        self.size = len(self.columns) * interface.history
        self.actions = interface.actions

    def encode(self, observations: Array32, memory: Array | None = None) -> Array32:
        """Inputs of the network, shape (N, size), of observations of shape (N, *obs)."""
        return self.scaling(observations[..., self.columns]).reshape(len(observations), self.size)

    def decode(self, outputs: npt.NDArray[Any], observations: Array32) -> Array32:
        """Valve commands, shape (N, A), of the network's outputs for these observations."""
        if self.held is None:
            return super().decode(outputs, observations)
        held = observations[..., self.held].astype(np.float64)
        change = self.step * np.clip(outputs.astype(np.float64), -1.0, 1.0)
        return np.clip(held + change, 0.0, 1.0).astype(np.float32)


def flat(observations: Array32) -> Array:
    """Observations as rows of numbers, in double precision; what is missing is 0."""
    values: Array = observations.reshape(len(observations), -1).astype(np.float64)
    return values if np.isfinite(values).all() else np.nan_to_num(values)


def _commands(interface: Interface) -> npt.NDArray[np.intp]:
    """Where an observation has the command that each action holds."""
    places = [i for i, signal in enumerate(interface.signals) if signal.name.startswith("command.")]
    if not places:
        raise ConfigError(
            f"output: 'change' needs the commands, which observation '{interface.observation}' does not "
            "have; use 'features' or output.kind=command"
        )
    return np.array(places[:: len(places) // interface.actions], dtype=np.intp)
