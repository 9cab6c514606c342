"""Several measurements of one quantity, and measuring many quantities in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np


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


def in_turn(
    probes: Mapping[str, Callable[[], float]], repetitions: int, did: Callable[[], None]
) -> dict[str, list[float]]:
    """Measure all in turn, several times, after a round that nobody counts: it compiles and fills caches.

    Parameters
    ----------
    probes : mapping
        Functions that measure, by name.
    repetitions : int
        Rounds that count.
    did : callable
        Told after each of them.
    """
    measured: dict[str, list[float]] = {name: [] for name in probes}
    for probe in probes.values():
        probe()
    for _ in range(repetitions):
        for name, probe in probes.items():
            measured[name].append(probe())
        did()
    return measured
