"""How much is measured, several measurements of one quantity, and measuring many quantities in turn."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    repetitions: int = 9
    """Of the simulator's figures."""
    span: float = 20.0
    """Simulated time of a vehicle in one repetition (s)."""
    evaluations: int = 100_000
    """Evaluations of a part of the step in one repetition."""
    reference_span: float = 2.0
    """Simulated time of SciPy's integration (s)."""
    first_starts: int = 2
    later_starts: int = 5
    rounds: int = 5
    """Repetitions of the environments' rates and of the runs by executor."""
    window: float = 0.5
    """Wall time of a rate of an environment (s): some thousand steps, less than an episode of the batch."""
    pairs: int = 1500
    """Steps of which the compiled call is timed too, less than one episode's."""
    training_rounds: int = 3
    training_steps: int = 1500
    """Steps of all vehicles in one repetition, rounded up to what the algorithm does at a time."""
    uncapped: bool = True
    """Measure trainings with all threads for torch, too."""

    @property
    def total(self) -> int:
        """Steps of progress; SciPy's tolerance is one."""
        starts = self.first_starts + self.later_starts
        return starts + 1 + self.repetitions + 2 * self.rounds + self.training_rounds


@dataclass(frozen=True)
class Spread:
    """Several measurements of one quantity."""

    median: float
    minimum: float
    maximum: float
    count: int

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Summarise measurements."""
        return cls(float(np.median(values)), float(min(values)), float(max(values)), len(values))


@dataclass(frozen=True)
class Measurement:
    """What was measured, in words, and how it came out."""

    label: str
    unit: str
    spread: Spread


def quantities(
    measured: Mapping[str, Sequence[float]], labels: Mapping[str, str], unit: str
) -> dict[str, Measurement]:
    """Quantities of one unit by name, in the order of their labels, without what was not measured."""
    return {
        name: Measurement(label, unit, Spread.of(measured[name]))
        for name, label in labels.items()
        if name in measured
    }


def in_turn(
    probes: Iterable[Callable[[], Mapping[str, float]]],
    repetitions: int,
    did: Callable[[], None] = lambda: None,
) -> dict[str, list[float]]:
    """Measure all in turn, several times, after a round that nobody counts: it compiles and fills caches.

    Parameters
    ----------
    probes : iterable of callable
        Measure one or several quantities, by their names.
    repetitions : int
        Rounds that count.
    did : callable
        Called after each of them.
    """
    measured: dict[str, list[float]] = {}
    every = list(probes)
    for probe in every:
        probe()
    for _ in range(repetitions):
        for probe in every:
            for name, value in probe().items():
                measured.setdefault(name, []).append(value)
        did()
    return measured


class Timed:
    """Times every call of an object's method, in whose place it stands until `stop`.

    Attributes
    ----------
    seconds : list of float
        Wall time of each call.
    """

    def __init__(self, owner: Any, name: str) -> None:
        self.owner, self.name, self.method = owner, name, getattr(owner, name)
        self.seconds: list[float] = []
        setattr(owner, name, self)

    def __call__(self, *arguments: Any) -> Any:
        """Call the method."""
        begin = time.perf_counter()
        result = self.method(*arguments)
        self.seconds.append(time.perf_counter() - begin)
        return result

    def stop(self) -> None:
        """Put the method back."""
        setattr(self.owner, self.name, self.method)
