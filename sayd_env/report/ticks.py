"""Ticks of logarithmic axes that have enough plain numbers, however far the axis reaches."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator

NARROW, MIDDLE, WIDE = 3.5, 15.0, 2e3
"""Ratios of an axis' ends: to the first its numbers are evenly spaced, since 1-2-5 would leave one of them,
to the second they are closer than 1-2-5, to the last 1-2-5, and beyond powers of ten alone."""


class PlainTicks(LogLocator):
    """Ticks at numbers that are easily read: evenly spaced, 1-2-5, or powers of ten.

    Parameters
    ----------
    minor : bool
        Ticks between those, without numbers; evenly spaced ones have none.
    """

    def __init__(self, *, minor: bool = False) -> None:
        super().__init__()
        self.minor = minor

    def tick_values(self, vmin: float, vmax: float) -> Any:
        """Places within, and one beyond, the ends of the axis."""
        low, high = sorted((vmin, vmax))
        ratio = high / low if low > 0.0 else np.inf
        if ratio < NARROW:
            if self.minor:
                return np.array([])
            even = np.asarray(MaxNLocator(nbins=7, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
            return even[even > 0.0]
        if ratio >= WIDE:
            subs: Any = "all" if self.minor else (1.0,)
        elif self.minor:
            subs = np.arange(1.0, 10.0)
        else:
            subs = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0) if ratio < MIDDLE else (1.0, 2.0, 5.0)
        self.set_params(subs=subs)
        return super().tick_values(vmin, vmax)
