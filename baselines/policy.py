"""What all controllers share: the `predict` protocol, for one vehicle or many."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from sayd_env.config import ConfigError, Model
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.explain import shown
from sayd_env.config.units import Array, Array32, Flags
from sayd_env.envs.interface import BOGIES, DAMPERS, Interface

Parameters = TypeVar("Parameters", bound=Model)
State = TypeVar("State")

LARGEST = float(np.finfo(np.float32).max)
"""Of an observation, which has single precision."""


class Policy(ABC, Generic[Parameters, State]):
    """A controller that uses sensor signals only.

    Parameters
    ----------
    name : str
        Name under which `baselines.make` offers it.
    interface : Interface
        Signals, valves, clock and hardware of the environment.
    parameters : Model
        The controller's parameters.
    sensors : sequence of str
        Names of the signals it reads, in the order in which `_command` receives them.

    Raises
    ------
    ConfigError
        The environment lacks a signal or a valve that the controller needs.
    """

    def __init__(
        self, name: str, interface: Interface, parameters: Parameters, sensors: tuple[str, ...]
    ) -> None:
        self.name = name
        self.parameters = parameters
        self.sensors = sensors
        self.interface = interface
        interface.check(name, {})
        try:
            self._columns = np.array([interface.index(sensor) for sensor in sensors], dtype=np.intp)
        except ConfigError as error:
            raise ConfigError(f"{name}: {error}") from None

    def predict(
        self,
        observation: npt.ArrayLike,
        state: State | None = None,
        episode_start: npt.ArrayLike | None = None,
        deterministic: bool = True,
    ) -> tuple[Array32, State]:
        """Valve commands for the next control period.

        Parameters
        ----------
        observation : array_like, shape (obs) or (N, obs)
            What one vehicle or N vehicles observe, in SI units.
        state : optional
            What the last call returned, changed in place; None starts all vehicles anew.
        episode_start : array_like of bool, shape (N,), optional
            Vehicles that begin a new episode with this observation.
        deterministic : bool
            Without effect: no controller draws random numbers.

        Returns
        -------
        action : ndarray of float32, shape (A,) or (N, A)
            Valve commands V: 0 closed, 1 open.
        state
            For the next call.

        Raises
        ------
        ConfigError
            Shapes that do not fit each other or the environment, or an observation that is not finite.
        """
        rows, single = self._rows(observation)
        if state is None:
            state = self._begin(rows)
        else:
            try:
                count = self._count(state)
            except (AttributeError, TypeError):
                count = None
            if not isinstance(count, int):
                raise ConfigError(
                    f"{self.name}: state: found {shown(state)}; expected what the last call returned"
                )
            if count != len(rows):
                raise ConfigError(
                    f"{self.name}: the state is that of {count} vehicles, "
                    f"the observation that of {len(rows)}; start with state=None"
                )
            if episode_start is not None:
                self._start_again(state, rows, np.atleast_1d(np.asarray(episode_start, dtype=np.bool_)))
        action = self._command(state, rows).astype(np.float32)
        return (action[0] if single else action), state

    def _rows(self, observation: npt.ArrayLike) -> tuple[Array, bool]:
        """Return the newest readings of the sensors, one row a vehicle, and whether it is a single one."""
        values, single = self.interface.rows(observation, self.name)
        newest = values[:, -1] if self.interface.observation == "history" else values
        usable = np.abs(newest) <= LARGEST
        if not usable.all():
            vehicle, place = np.argwhere(~usable)[0]
            found = newest[vehicle, place]
            expected = f"numbers up to {LARGEST:.2g}" if np.isfinite(found) else "finite numbers"
            raise ConfigError(
                f"{self.name}: observation: found {found} for '{self.interface.signals[place].name}'; "
                f"expected {expected}"
            )
        return newest[:, self._columns], single

    def _start_again(self, state: State, rows: Array, starts: Flags) -> None:
        if starts.shape != (len(rows),):
            raise ConfigError(
                f"{self.name}: found episode_start of shape {starts.shape}; expected ({len(rows)},)"
            )
        if starts.any():
            self._restart(state, rows, np.flatnonzero(starts))

    @abstractmethod
    def _count(self, state: State) -> int:
        """Return the number of vehicles of a state."""

    @abstractmethod
    def _begin(self, rows: Array) -> State:
        """Make the state of vehicles that all begin an episode with these readings."""

    @abstractmethod
    def _restart(self, state: State, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        """Reset some vehicles to the start of an episode."""

    @abstractmethod
    def _command(self, state: State, rows: Array) -> Array:
        """Advance by one control period; return the valve commands, shape (N, A)."""


class Memoryless(Policy[Parameters, int]):
    """A policy that remembers nothing; its state is the number of vehicles."""

    def _count(self, state: int) -> int:
        return state

    def _begin(self, rows: Array) -> int:
        return len(rows)

    def _restart(self, state: int, rows: Array, vehicles: npt.NDArray[np.intp]) -> None:
        pass


class BogiePolicy(Policy[Parameters, State]):
    """Two controllers, one for each bogie, whose dampers share one command."""

    def __init__(
        self, name: str, interface: Interface, parameters: Parameters, sensors: tuple[str, ...]
    ) -> None:
        super().__init__(name, interface, parameters, sensors)
        if interface.valves == "vehicle":
            raise ConfigError(
                f"{name}: controls each bogie separately, but valves='vehicle' has one command for both; "
                "make the environment with valves='bogie' or 'damper'"
            )
        self._repeats = interface.actions // len(BOGIES)

    def _command(self, state: State, rows: Array) -> Array:
        command = self._command_bogies(state, rows)
        return command if self._repeats == 1 else np.repeat(command, self._repeats, axis=1)

    @abstractmethod
    def _command_bogies(self, state: State, rows: Array) -> Array:
        """Advance by one control period; return the valve commands of front and rear, shape (N, 2)."""


def semi_active(name: str, interface: Interface) -> SaydDamperConfig:
    """The dampers of an environment, of which a controller needs the characteristic.

    Raises
    ------
    ConfigError
        They are passive.
    """
    if not isinstance(interface.damper, SaydDamperConfig):
        raise ConfigError(
            f"{name}: needs the characteristic of semi-active dampers, the environment has passive ones; "
            "make it with damper='sayd'"
        )
    return interface.damper


def yaw_part(values: Array) -> Array:
    """Half the difference of the sides' means of each bogie, (n, 2), from values of the dampers, (n, 8)."""
    sides = values.reshape(-1, len(BOGIES), 2, 2).mean(axis=3)
    return np.asarray(0.5 * (sides[:, :, 0] - sides[:, :, 1]))


def of_both(signal: str) -> tuple[str, ...]:
    """Names of a bogie's signal at front and rear: ``stroke.{}.left.upper`` gives two."""
    return tuple(signal.format(bogie) for bogie in BOGIES)


def of_all_dampers(quantity: str) -> tuple[str, ...]:
    """Names of a quantity at the eight dampers."""
    return tuple(f"{quantity}.{bogie}.{damper}" for bogie in BOGIES for damper in DAMPERS)
