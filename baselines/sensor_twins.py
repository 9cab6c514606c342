"""Do a bogie's sensors contradict each other? Two that measure the same motion agree in RMS and mean.

A dead or frozen sensor has no RMS beside its living twin, a noisy one too much, a biased one another mean.
The bogie frame is rigid: the accelerations above its two wheelsets, or at its two sides, are those of one
motion; so are the strokes of the two dampers of a side, and the pressures of the two chambers that a piston
fills in turn.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sayd_env.config.safe import SafeConfig, TwinConfig
from sayd_env.config.units import Array, Flags, Integers
from sayd_env.envs.interface import BOGIES, DAMPERS, POINTS, Interface

SIDES = ("left", "right")


class Twin(NamedTuple):
    """Two sensors that must agree."""

    bogie: int
    signals: tuple[str, ...]
    bounds: TwinConfig


@dataclass
class Agreement:
    """State of n vehicles' p pairs."""

    mean: Array
    """(n, p, 2) sliding means."""
    square: Array
    """(n, p, 2) sliding mean squares of what is beside them; of features the square of what is read."""
    contradicting: Integers
    """(n, p) control periods for which they have contradicted each other without a break."""
    agreeing: Integers
    """(n, p) control periods, since then, in which they were lively and agreed."""
    untrusted: Flags
    """(n, p) whether the pair is trusted no more."""


class SensorTwins:
    """Watches the pairs of n vehicles.

    Parameters
    ----------
    interface : Interface
    parameters : SafeConfig
    read : collection of str, optional
        Signals that count; None: all. The accelerometers of the hunting indicator always do.

    Attributes
    ----------
    sensors : tuple of str
        Signals that it reads, the columns of `rows`: pair by pair.
    """

    def __init__(
        self, interface: Interface, parameters: SafeConfig, read: Collection[str] | None = None
    ) -> None:
        self._measured = interface.observation == "features"
        pairs = [
            pair
            for pair in (_features(parameters) if self._measured else _signals(parameters))
            if read is None
            or pair.bounds is parameters.lateral_acceleration
            or any(signal in read for signal in pair.signals)
        ]
        self.sensors = tuple(signal for pair in pairs for signal in pair.signals)
        self._members = np.array([[pair.bogie == bogie for bogie in range(len(BOGIES))] for pair in pairs])
        """(p, 2) which pairs are of which bogie."""
        self._floor = np.array([pair.bounds.floor**2 for pair in pairs])
        self._ratio = np.array([pair.bounds.ratio**2 for pair in pairs])
        self._offset = np.array([pair.bounds.offset for pair in pairs])
        period = interface.control_period
        self._share = -math.expm1(-period / parameters.smoothing)
        self._confirmation = max(1, round(parameters.confirmation / period))
        self._trust = max(1, round(parameters.hold / period))

    def begin(self, rows: Array) -> Agreement:
        """State of vehicles that begin with these readings: at their means."""
        shape = (len(rows), len(self._members))
        return Agreement(
            mean=rows.reshape(*shape, 2).copy(),
            square=np.zeros((*shape, 2)),
            contradicting=np.zeros(shape, dtype=np.int64),
            agreeing=np.zeros(shape, dtype=np.int64),
            untrusted=np.zeros(shape, dtype=np.bool_),
        )

    def restart(self, state: Agreement, rows: Array, vehicle: int) -> None:
        """Put one vehicle back to the start of an episode."""
        fresh = self.begin(rows[vehicle : vehicle + 1])
        for name, values in vars(fresh).items():
            getattr(state, name)[vehicle] = values[0]

    def take(self, state: Agreement, rows: Array) -> None:
        """Take the readings of one control period."""
        readings = rows.reshape(state.mean.shape)
        if self._measured:
            state.square[:] = readings**2
        else:
            state.mean += self._share * (readings - state.mean)
            state.square += self._share * ((readings - state.mean) ** 2 - state.square)
        first, second = state.square[..., 0], state.square[..., 1]
        larger, smaller = np.maximum(first, second), np.minimum(first, second)
        lively = larger > self._floor
        contradict = lively & (larger > self._ratio * smaller)
        if not self._measured:
            contradict |= np.abs(state.mean[..., 0] - state.mean[..., 1]) > self._offset
        state.contradicting += 1
        state.contradicting *= contradict
        state.agreeing += lively
        state.agreeing *= ~contradict
        state.untrusted &= state.agreeing < self._trust
        state.untrusted |= state.contradicting >= self._confirmation

    def untrusted(self, state: Agreement) -> Flags:
        """Bogies of which some pair is not trusted, shape (n, 2)."""
        found: Flags = np.matmul(state.untrusted, self._members)
        return found


def _signals(parameters: SafeConfig) -> Iterator[Twin]:
    for bogie, name in enumerate(BOGIES):
        lateral = tuple(f"lateral_acceleration.{name}.{point}" for point in POINTS)
        yield Twin(bogie, lateral, parameters.lateral_acceleration)
        longitudinal = tuple(f"longitudinal_acceleration.{name}.{side}" for side in SIDES)
        yield Twin(bogie, longitudinal, parameters.longitudinal_acceleration)
        for damper in DAMPERS:
            chambers = tuple(f"pressure_{chamber}.{name}.{damper}" for chamber in "ab")
            yield Twin(bogie, chambers, parameters.pressure)
        for side in SIDES:
            strokes = tuple(f"stroke.{name}.{side}.{level}" for level in ("upper", "lower"))
            yield Twin(bogie, strokes, parameters.stroke)


def _features(parameters: SafeConfig) -> Iterator[Twin]:
    for bogie, name in enumerate(BOGIES):
        points = tuple(f"acceleration_rms.{name}.{point}" for point in POINTS)
        yield Twin(bogie, points, parameters.lateral_acceleration)
