"""What the paper shows about the passive vehicle, as measurements with a verdict (rows P1 to P10)."""

from __future__ import annotations

import numpy as np

from sayd_env.config.units import KMH, Array
from sayd_env.runs.passive import Sweep
from sayd_env.stability import Limits, critical_speed, grid_sensitivity, thinned_grids
from sayd_env.studies.paper.claims import (
    Claim,
    Seeds,
    by_median,
    by_seed,
    by_selection,
    spread,
    within,
)

NEW_SPEEDS = tuple(v / 3.6 for v in (280, 310, 340, 370, 400))
"""Speed grid of figure 8, m/s."""
WORN_SPEEDS = tuple(v / 3.6 for v in (320, 350, 370, 395, 420, 445))
"""Speed grid of figure 10, m/s."""
GRID_TOLERANCE = 8.0 / KMH
"""A critical speed that moves further (m/s) on another speed grid is reported as sensitive."""


class PassiveMeasures:
    """The quantities behind rows P1 to P10, for any selection of seeds.

    Parameters
    ----------
    new, worn : Sweep
        The passive vehicle on new and on worn wheels, at least on the grids of figures 8 and 10.
    limits : Limits
        Limits of EN 14363.
    """

    def __init__(self, new: Sweep, worn: Sweep, limits: Limits) -> None:
        self.new, self.worn, self.limits = new, worn, limits
        self.count = len(new.seeds)
        self.all = np.arange(self.count)
        self.high = np.flatnonzero(worn.speeds >= 350 / KMH - 1e-6)
        self.low = int(np.argmin(np.abs(worn.speeds - 320 / KMH)))

    def stable_280(self) -> Array:
        """a_max over its limit at 280 km/h on new wheels, for each seed (P1)."""
        at = int(np.argmin(np.abs(self.new.speeds - 280 / KMH)))
        return np.asarray(self.new.acceleration[at].max(axis=-1) / self.limits.acceleration)

    def critical_new(self, seeds: Seeds) -> float:
        """Critical speed by acceleration on new wheels, km/h; NaN if there is none (P2)."""
        return _crossing(self.new, self.new.acceleration, self.limits.acceleration, seeds)

    def critical_worn(self, seeds: Seeds) -> float:
        """The same on worn wheels (P5)."""
        return _crossing(self.worn, self.worn.acceleration, self.limits.acceleration, seeds)

    def critical_worn_force(self, seeds: Seeds) -> float:
        """Critical speed by track shift force on worn wheels, km/h (P8)."""
        return _crossing(self.worn, self.worn.track_shift, self.limits.track_shift_force, seeds)

    def frequency_at_critical(self, seeds: Seeds) -> float:
        """Dominant frequency at the critical speed on new wheels, Hz (P3)."""
        f = np.median(self.new.frequency[:, seeds], axis=(1, 2))
        return float(np.interp(self.critical_new(seeds) / KMH, self.new.speeds, f))

    def ratios_320(self) -> Array:
        """Larger ratio to the limits at 320 km/h on worn wheels, for each seed (P4)."""
        return np.asarray(self._ratios(self.low).max(axis=0))

    def lowest_ratio_above(self) -> Array:
        """Smallest acceleration ratio over the speeds from 350 km/h, for each seed (P6)."""
        peak = self.worn.acceleration[self.high].max(axis=-1)
        return np.asarray(peak.min(axis=0) / self.limits.acceleration)

    def smallest_rise(self, seeds: Seeds) -> float:
        """Smallest relative rise of the medians of a_max and Y_max between neighbouring speeds (P7)."""
        rises = []
        for values in (self.worn.acceleration, self.worn.track_shift):
            median = np.median(values[:, seeds].max(axis=-1), axis=1)
            rises.append(np.min(np.diff(median) / median[:-1]))
        return float(min(rises))

    def trailing_ratio(self) -> Array:
        """Smallest track-shift ratio of trailing to leading wheelset from 350 km/h, each seed (P9)."""
        force = self.worn.track_shift[self.high]
        return np.asarray((force[..., 1::2] / force[..., 0::2]).min(axis=(0, 2)))

    def frequency_spread(self, seeds: Seeds) -> Array:
        """Median spread of the dominant frequencies of all quantities at each worn speed, Hz (P10)."""
        both = np.concatenate([self.worn.frequency, self.worn.frequency_force], axis=-1)
        return np.asarray(np.median(np.ptp(both[:, seeds], axis=-1), axis=1))

    def frequency_rise(self, seeds: Seeds) -> float:
        """Smallest rise of the median dominant frequency between speeds from 350 km/h, Hz (P10)."""
        both = np.concatenate([self.worn.frequency, self.worn.frequency_force], axis=-1)
        median = np.median(both[self.high][:, seeds], axis=(1, 2))
        return float(np.min(np.diff(median)))

    def one_frequency(self, seeds: Seeds) -> bool:
        """Whether row P10 passes."""
        spread = self.frequency_spread(seeds)
        above = float(np.max(spread[self.high]))
        return above <= 0.3 and self.frequency_rise(seeds) > 0.0 and spread[self.low] > above

    def _ratios(self, at: int) -> Array:
        acceleration = self.worn.acceleration[at].max(axis=-1) / self.limits.acceleration
        return np.array(
            [acceleration, self.worn.track_shift[at].max(axis=-1) / self.limits.track_shift_force]
        )


def passive_claims(new: Sweep, worn: Sweep, limits: Limits) -> list[Claim]:
    """Judge rows P1 to P10.

    Parameters
    ----------
    new, worn : Sweep
        The passive vehicle on `NEW_SPEEDS` and `WORN_SPEEDS`, on the same seeds.
    limits : Limits
        Limits of EN 14363.
    """
    m = PassiveMeasures(new, worn, limits)
    apart, stable, low = m.frequency_spread(m.all), m.stable_280(), m.ratios_320()
    above, trailing = m.lowest_ratio_above(), m.trailing_ratio()
    return [
        by_seed("P1", "new, 280 km/h: a_max < 0.5 of the limit", stable < 0.5, spread(stable)),
        by_median(
            "P2",
            "new: critical speed 365 to 385 km/h",
            "km/h",
            m.count,
            m.critical_new,
            within(365, 385),
            note=_grid_note(new, new.acceleration, limits.acceleration),
        ),
        by_median(
            "P3",
            "new: 3.5 to 4.5 Hz at the critical speed",
            "Hz",
            m.count,
            m.frequency_at_critical,
            within(3.5, 4.5),
        ),
        by_seed("P4", "worn, 320 km/h: both ratios < 1", low < 1.0, spread(low)),
        by_median(
            "P5",
            "worn: critical speed 322 to 340 km/h",
            "km/h",
            m.count,
            m.critical_worn,
            within(322, 340),
            note=_grid_note(worn, worn.acceleration, limits.acceleration),
        ),
        by_seed("P6", "worn, >= 350 km/h: acceleration ratio > 1", above > 1.0, spread(above)),
        by_median(
            "P7",
            "worn: a_max and Y_max rise with speed",
            "smallest rise",
            m.count,
            m.smallest_rise,
            lambda x: x > 0.0,
        ),
        by_median(
            "P8",
            "worn: track shift force crosses in (350, 370] km/h, after P5",
            "km/h",
            m.count,
            m.critical_worn_force,
            lambda v: 350.0 < v <= 370.0,
            also=lambda seeds: m.critical_worn_force(seeds) > m.critical_worn(seeds),
            note=_grid_note(worn, worn.track_shift, limits.track_shift_force),
        ),
        by_seed(
            "P9",
            "worn, >= 350 km/h: trailing > 1.1 leading track shift force",
            trailing > 1.1,
            spread(trailing),
        ),
        by_selection(
            "P10",
            "worn: one rising frequency at >= 350 km/h (spread <= 0.3 Hz), scatter at 320 km/h",
            f"spread {np.max(apart[m.high]):.2f} Hz at >= 350, {apart[m.low]:.2f} Hz at 320 km/h, "
            f"smallest rise {m.frequency_rise(m.all):+.2f} Hz",
            m.count,
            m.one_frequency,
        ),
    ]


def _crossing(sweep: Sweep, values: Array, limit: float, seeds: Seeds) -> float:
    median = np.median(values[:, seeds].max(axis=-1), axis=1)
    found = critical_speed(sweep.speeds, median, limit).speed
    return float("nan") if found is None else found * KMH


def _grid_note(grid: Sweep, values: Array, limit: float, tolerance: float = GRID_TOLERANCE) -> str:
    """Say so if a critical speed moves with the speed grid."""
    peak = np.median(values.max(axis=-1), axis=1)
    reference = critical_speed(grid.speeds, peak, limit)
    moved = grid_sensitivity(reference, thinned_grids(grid.speeds, peak, limit), tolerance)
    return ", sensitive to the speed grid" if moved.sensitive else ""
