"""What a policy remembers: averages of its bogie's signals over the past seconds.

What is the best command depends on conditions that no sensor tells: conicity, friction, the class of track.
They show in how fast and how strongly a bogie moves over seconds. A quarter of a second of signals does not
tell it. So each bogie keeps exponential averages of a few signals and of their squares over several times;
out of them come levels about the average (its variance: what is slower than the time, a curve or a sensor's
error, falls out of it), mean levels, and the mean frequency of the hunting by Rice's formula (1944),

    f = sqrt(var(x') / var(x)) / (2 pi),

with the yaw stroke x and its rate. None of them changes in a mirror. An average is divided by that of the
number one, which began at 0 with it, so that it is one of what has been seen from the first period on.

The averages are numbers of the policy's state: they go in and out with each call, and the policy itself
stays a function.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sayd_env.agents.products import columns, times
from sayd_env.config.learner import InputConfig
from sayd_env.config.units import Array, Array32
from sayd_env.envs.scaled import FLOOR, Scaling

AVERAGED = ("yaw_force", "lateral", "yawing", "yaw_stroke", "yaw_rate", "current", "force_level")
"""Quantities of a bogie of which averages are kept, with those of their squares, in this order."""


class Remembered(NamedTuple):
    """How a number comes from the averages of a quantity."""

    kind: str
    """``mean``; ``size``, the mean without its sign; ``level``, the root of the variance; ``frequency``."""
    quantity: str
    meaning: str


MEMORIES = {
    "yaw_force_level": Remembered("level", "yaw_force", "N, RMS about the average"),
    "lateral_level": Remembered("level", "lateral", "m/s2, RMS about the average"),
    "yawing_level": Remembered("level", "yawing", "m/s2, RMS about the average"),
    "yaw_stroke_level": Remembered("level", "yaw_stroke", "m, RMS about the average"),
    "yaw_rate_level": Remembered("level", "yaw_rate", "m/s, RMS about the average"),
    "current_level": Remembered("level", "current", "-, RMS about the average: how much the policy moves"),
    "lateral_size": Remembered("size", "lateral", "m/s2, average without its sign: a curve"),
    "current_mean": Remembered("mean", "current", "-, average: the policy's own command"),
    "force_mean": Remembered("mean", "force_level", "N, average of the magnitudes"),
    "frequency": Remembered("frequency", "yaw_stroke", "Hz, of the hunting: that of yaw stroke and rate"),
}
"""What a policy may remember, over each of its times."""
WIDTH = 2 * len(AVERAGED) + 1
"""Averages of a bogie over one time: of one, of the quantities, of their squares."""
STILL = 1e-12
"""Yaw strokes below this variance (m2) have no frequency."""


class Memory:
    """Averages of the bogies' signals, and the inputs that come from them.

    Parameters
    ----------
    times_s : sequence of float
        Times of the averages (s).
    inputs : mapping
        How each of `MEMORIES` enters.
    clip : float
        Inputs are cut off at plus and minus this.
    period : float
        Control period (s).
    weights : ndarray, shape (signals of an observation, units, AVERAGED - 1)
        Gives each bogie's newest `AVERAGED` but the last one.
    forces : ndarray, shape (signals of an observation, units, dampers)
        Gives the newest forces, whose mean magnitude is the last of `AVERAGED`.

    Attributes
    ----------
    size : int
        Inputs of a network.
    width : int
        Numbers of a vehicle's state.
    """

    def __init__(
        self,
        times_s: tuple[float, ...],
        inputs: dict[str, InputConfig],
        clip: float,
        period: float,
        weights: Array,
        forces: Array,
    ) -> None:
        self.names = tuple(inputs)
        self.keep = np.exp(-period / np.array(times_s))
        self.units, self.dampers = weights.shape[1], forces.shape[2]
        self.weights, self.forces = (matrix.reshape(len(matrix), -1) for matrix in (weights, forces))
        self._weights, self._forces = columns(self.weights), columns(self.forces)
        self.size, self.width = len(times_s) * len(inputs), self.units * len(times_s) * WIDTH
        self.scaling = Scaling.of((config for _ in times_s for config in inputs.values()), clip)

    def remember(self, state: Array, seen: Array) -> Array:
        """State after a control period, a new array, of that before and a flat observation, (N, signals)."""
        values, keep = self.values(seen), self.keep[:, None]
        newest = np.concatenate([np.ones((len(values), 1)), values, values * values], axis=1)
        before = state.reshape(len(values), len(keep), WIDTH)
        after: Array = keep * before + (1.0 - keep) * newest[:, None]
        return after.reshape(len(state), self.width)

    def values(self, seen: Array) -> Array:
        """The newest `AVERAGED` of each bogie, shape (N units, AVERAGED)."""
        linear = times(seen, self._weights).reshape(len(seen) * self.units, -1)
        level = np.abs(times(seen, self._forces)).reshape(len(linear), self.dampers).sum(axis=1)
        return np.concatenate([linear, level[:, None] / self.dampers], axis=1)

    def inputs(self, state: Array) -> Array32:
        """Inputs of the networks, shape (N units, size): time by time."""
        return self.scaling(self.numbers(state).reshape(-1, self.size))

    def numbers(self, state: Array) -> Array:
        """What is remembered, in physical units, shape (N units, times, names)."""
        averages = state.reshape(-1, len(self.keep), WIDTH)
        ratio = averages / np.maximum(averages[:, :, :1], FLOOR)
        mean, square = ratio[:, :, 1 : len(AVERAGED) + 1], ratio[:, :, len(AVERAGED) + 1 :]
        variance = np.maximum(square - mean * mean, 0.0)
        return np.stack([_number(MEMORIES[name], mean, variance) for name in self.names], axis=2)


def _number(how: Remembered, mean: Array, variance: Array) -> Array:
    place = AVERAGED.index(how.quantity)
    if how.kind == "mean":
        return np.asarray(mean[:, :, place])
    if how.kind == "size":
        return np.abs(mean[:, :, place])
    if how.kind == "level":
        return np.sqrt(variance[:, :, place])
    rate = variance[:, :, AVERAGED.index("yaw_rate")]
    return np.sqrt(rate / np.maximum(variance[:, :, place], STILL)) / (2.0 * math.pi)
