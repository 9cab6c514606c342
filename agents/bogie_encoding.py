"""One network for both bogies: each sees the motions and forces of its own bogie.

Two things that are known of a vehicle need not be learned. Its bogies are alike, so one network serves both,
and each step of a vehicle teaches it twice. And what is good for a motion is good for its mirror image:
inputs that change sign in a mirror are turned so that the newest moment of the dampers is positive. The sign
of the yaw rate then says whether the dampers brake or push, without the network having to multiply.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np

from sayd_env.agents.config import MemoryConfig, OutputConfig, View
from sayd_env.agents.encoding import Encoding, VehicleEncoding, flat
from sayd_env.agents.memory import AVERAGED, MEMORIES, Memory
from sayd_env.agents.products import columns, times
from sayd_env.config import ConfigError, nearest
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.learner import InputConfig
from sayd_env.config.units import Array, Array32
from sayd_env.envs.interface import BOGIES, DAMPERS, Interface

MIRRORED = ("yaw_force", "lateral", "yawing", "yaw_rate", "yaw_stroke")
RATES = ("yaw_rate", "push_rate")
"""Differences of two rows."""
QUANTITIES = {
    "yaw_force": "N, half the difference of left and right: hydraulic force of a damper, mean of the side",
    "push_force": "N, mean of the bogie's dampers",
    "force_level": "N, mean of their magnitudes",
    "lateral": "m/s2, mean of the lateral accelerations above both wheelsets",
    "yawing": "m/s2, half of leading minus trailing",
    "yaw_rate": "m/s, half the difference of left and right: stroke rate of a damper, mean of the side",
    "push_rate": "m/s, mean of the bogie's dampers",
    "yaw_stroke": "m, half the difference of left and right strokes, less its mean over the rows",
    "current": "-, mean of the bogie's valves",
    "speed": "m/s, newest row",
    "place": "-, -1 for the front bogie, 1 for the rear one",
}
"""What the network of a bogie may see. A row is what was observed in one control period."""
LARGEST_MATRIX = 2**24
"""Weights between an observation and the inputs of the networks (128 MiB)."""
ONCE = ("speed", "place")
"""What does not come row by row."""


def make_encoding(
    interface: Interface,
    view: View,
    inputs: Mapping[str, InputConfig],
    clip: float,
    output: OutputConfig,
    memory: MemoryConfig | None = None,
) -> Encoding:
    """The encoding of a view.

    Raises
    ------
    ConfigError
        Inputs or outputs that do not fit the environment.
    """
    if view == "bogie":
        return BogieEncoding(interface, inputs, clip, output, memory)
    if memory is not None:
        raise ConfigError("memory: is that of bogies; it needs view 'bogie'")
    return VehicleEncoding(interface, inputs, clip, output)


class BogieEncoding(Encoding):
    """One network for each bogie.

    Inputs are, for each quantity in the order of `inputs`, its rows, the oldest first, then what comes once;
    behind them those of the memory, if there is one. Of the former, all but `force_level` are linear in the
    observation x, so that the whole is

        values = x M + |x F| P + c,

    with the signs of mirrored ones turned.

    Parameters
    ----------
    interface : Interface
        The environment's: signals or a history of them, one command for each bogie.
    inputs : mapping
        How each of `QUANTITIES` enters; others are left out.
    clip : float
        Inputs are cut off at plus and minus this.
    output : OutputConfig
    memory : MemoryConfig, optional
        What is remembered beside the observation.

    Raises
    ------
    ConfigError
        An unknown quantity, or an environment that does not tell what is asked for.

    Attributes
    ----------
    shown : int
        Inputs that come from the observation; the others are the memory's.
    linear, force, level : ndarray
        M, shape (history * 41, 2 shown); F, shape (history * 41, 2 rows 4); P, shape (2 rows 4, 2 shown).
    constant : ndarray, shape (2 shown)
        c.
    moment : ndarray, shape (history * 41, 2)
        Gives the newest yaw force of each bogie.
    mirrored : ndarray of float, shape (shown)
        1 for what changes sign in a mirror.
    """

    units = len(BOGIES)
    actions = 1

    def __init__(
        self,
        interface: Interface,
        inputs: Mapping[str, InputConfig],
        clip: float,
        output: OutputConfig,
        memory: MemoryConfig | None = None,
    ) -> None:
        super().__init__(interface, clip, output)
        _check(interface, inputs, output, memory)
        self.row_count = interface.history - any(name in RATES for name in inputs)
        slots = [
            (name, row)
            for name in inputs
            for row in range(0 if name not in ONCE else self.row_count - 1, self.row_count)
        ]
        self.shown = len(slots)
        width, signals = self.units * self.shown, interface.history * len(interface.signals)
        if signals * width > LARGEST_MATRIX:
            raise ConfigError(f"history: {interface.history} rows are too many for the view of a bogie")
        forces = self.units * self.row_count * len(DAMPERS)
        self.linear, self.constant = np.zeros((signals, width)), np.zeros(width)
        self.force, self.level = np.zeros((signals, forces)), np.zeros((forces, width))
        for (b, bogie), (j, (name, row)) in product(enumerate(BOGIES), enumerate(slots)):
            column, per_half = b * self.shown + j, 1.0 / inputs[name].half
            self.constant[column] = -inputs[name].middle * per_half
            if name == "place":
                self.constant[column] += (2.0 * b - 1.0) * per_half
            elif name == "force_level":
                for d, damper in enumerate(DAMPERS):
                    k = (b * self.row_count + row) * len(DAMPERS) + d
                    self.force[:, k] = self._placed(_force(interface, bogie, damper), row)
                    self.level[k, column] = per_half / len(DAMPERS)
            else:
                self.linear[:, column] = per_half * self._quantity(name, bogie, row)
        newest = self.row_count - 1
        self.moment = np.stack([self._quantity("yaw_force", bogie, newest) for bogie in BOGIES], axis=1)
        self.mirrored = np.array([float(name in MIRRORED) for name, _ in slots])
        matrices = [self.linear, self.force, self.moment]
        if memory is not None:
            self.memory = self._memory(memory)
            matrices += [self.memory.weights, self.memory.forces]
        self.size = self.shown + (0 if self.memory is None else self.memory.size)
        weights = np.abs(np.concatenate(matrices, axis=1)).sum(axis=1)
        self._linear, self._force = columns(self.linear), columns(self.force)
        self._level, self._moment = columns(self.level), columns(self.moment)
        read = weights.reshape(interface.history, -1).any(axis=0)
        self.sensors = self._read(interface.signals[i].name for i in np.flatnonzero(read))

    def encode(self, observations: Array32, memory: Array | None = None) -> Array32:
        """Inputs of the network, shape (2 N, size): front and rear bogie of each vehicle in turn."""
        seen = flat(observations)
        forces = np.abs(times(seen, self._force))
        values = times(seen, self._linear) + times(forces, self._level) + self.constant
        turned = 1.0 - 2.0 * (times(seen, self._moment) < 0.0)
        values = values.reshape(-1, self.shown) * (1.0 + self.mirrored * (turned.reshape(-1, 1) - 1.0))
        bounded: Array32 = np.clip(values, -self.clip, self.clip).astype(np.float32)
        if self.memory is None:
            return bounded
        assert memory is not None  # `remember` has made it
        return np.concatenate([bounded, self.memory.inputs(memory)], axis=1)

    def _memory(self, config: MemoryConfig) -> Memory:
        newest, period = self.row_count - 1, self.interface.control_period
        linear = np.stack(
            [[self._remembered(name, bogie) for name in AVERAGED[:-1]] for bogie in BOGIES]
        ).transpose(2, 0, 1)
        forces = np.stack(
            [
                [self._placed(_force(self.interface, bogie, damper), newest) for damper in DAMPERS]
                for bogie in BOGIES
            ]
        ).transpose(2, 0, 1)
        return Memory(config.times_s, config.inputs, self.clip, period, linear, forces)

    def _remembered(self, name: str, bogie: str) -> Array:
        """Weights of a quantity's newest value; of a stroke as the sensor tells it."""
        newest = self.row_count - 1
        if name == "yaw_stroke":
            return self._placed(_stroke(self.interface, bogie, name), newest)
        return self._quantity(name, bogie, newest)

    def _quantity(self, name: str, bogie: str, row: int) -> Array:
        """Weights of all signals of all rows in a quantity."""
        if name in RATES:
            weights = _stroke(self.interface, bogie, name) / self.interface.control_period
            return self._placed(weights, row) - self._placed(weights, row - 1)
        if name == "yaw_stroke":  # the mean takes out curves and the sensors' bias
            weights = _stroke(self.interface, bogie, name)
            rows = [self._placed(weights, each) for each in range(self.row_count)]
            apart: Array = rows[row] - np.mean(rows, axis=0)
            return apart
        return self._placed(_weights(self.interface, bogie, name), row)

    def _placed(self, weights: Array, row: int) -> Array:
        """Weights of one row's signals among those of all rows; used rows are the newest."""
        all_rows = np.zeros((self.interface.history, len(weights)))
        all_rows[self.interface.history - self.row_count + row] = weights
        return all_rows.reshape(-1)


def _check(
    interface: Interface,
    inputs: Mapping[str, InputConfig],
    output: OutputConfig,
    memory: MemoryConfig | None,
) -> None:
    """Refuse what the view of a bogie cannot show or command."""
    for name, each in inputs.items():
        if name not in QUANTITIES:
            raise ConfigError(
                f"inputs: the view of a bogie has no quantity '{name}'{nearest(name, QUANTITIES)}; it has "
                f"{', '.join(QUANTITIES)}"
            )
        if each.scale != "linear":
            raise ConfigError(
                f"inputs.{name}.scale: the view of a bogie takes 'linear', found '{each.scale}'"
            )
        if name in MIRRORED and each.middle != 0.0:
            raise ConfigError(f"inputs.{name}.middle: must be 0, because its sign is turned")
    if interface.observation == "features":
        raise ConfigError("view: that of a bogie needs observation 'history' or 'signals', found 'features'")
    if interface.valves != "bogie":
        raise ConfigError(f"view: that of a bogie needs valves 'bogie', found '{interface.valves}'")
    if output.kind != "command":
        raise ConfigError(f"output.kind: the view of a bogie takes 'command', found '{output.kind}'")
    if not isinstance(interface.damper, SaydDamperConfig):
        raise ConfigError("view: that of a bogie needs semi-active dampers, found passive ones")
    rates = [f"inputs.{name}" for name in RATES if name in inputs] + ["memory"] * (memory is not None)
    if rates and interface.history < 2:
        raise ConfigError(f"{rates[0]}: needs a history of 2 rows or more")
    for name in () if memory is None else memory.inputs:
        if name not in MEMORIES:
            raise ConfigError(
                f"memory.inputs: a bogie remembers no quantity '{name}'{nearest(name, MEMORIES)}; it may "
                f"remember {', '.join(MEMORIES)}"
            )


def _weights(interface: Interface, bogie: str, name: str) -> Array:
    """Weights of a row's signals in a quantity that is linear in them."""
    if name in ("yaw_force", "push_force"):
        turning = name == "yaw_force"
        parts = [_share(damper, turning) * _force(interface, bogie, damper) for damper in DAMPERS]
        total: Array = np.stack(parts).sum(axis=0)
        return total
    if name in ("lateral", "yawing"):
        other = -0.5 if name == "yawing" else 0.5
        accelerations = {f"lateral_acceleration.{bogie}.leading": 0.5}
        return _row(interface, accelerations | {f"lateral_acceleration.{bogie}.trailing": other})
    if name == "current":
        return _row(interface, {f"current.{bogie}.{damper}": 1.0 / len(DAMPERS) for damper in DAMPERS})
    return _row(interface, {"speed": 1.0})


def _stroke(interface: Interface, bogie: str, name: str) -> Array:
    return _row(
        interface, {f"stroke.{bogie}.{damper}": _share(damper, name.startswith("yaw")) for damper in DAMPERS}
    )


def _force(interface: Interface, bogie: str, damper: str) -> Array:
    """Weights of the pressures in a damper's hydraulic force A (p_A - p_B)."""
    assert isinstance(interface.damper, SaydDamperConfig)  # `_check` has made sure
    area = interface.damper.cylinder.area
    return _row(interface, {f"pressure_a.{bogie}.{damper}": area, f"pressure_b.{bogie}.{damper}": -area})


def _share(damper: str, turning: bool) -> float:
    """Part of a damper in a mean, or in half the difference of left and right."""
    return (-1.0 if turning and damper.startswith("right") else 1.0) / len(DAMPERS)


def _row(interface: Interface, weights: Mapping[str, float]) -> Array:
    row = np.zeros(len(interface.signals))
    for name, weight in weights.items():
        row[interface.index(name)] = weight
    return row
