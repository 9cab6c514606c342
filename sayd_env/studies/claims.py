"""What the paper shows about the passive vehicle, as measurements with a verdict (rows P1 to P10).

A row judged by `seed` holds if at least 80 % of the track seeds pass it. A row judged by `median` holds if
the median over the seeds passes and at least 80 % of 1,000 bootstraps over the seeds pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sayd_env.stability import Limits, critical_speed, grid_sensitivity, thinned_grids
from sayd_env.studies.sweep import Sweep

Array = npt.NDArray[np.float64]
Seeds = npt.NDArray[np.int64]

NEW_SPEEDS = tuple(v / 3.6 for v in (280, 310, 340, 370, 400))
"""Speed grid of figure 8, m/s."""
WORN_SPEEDS = tuple(v / 3.6 for v in (320, 350, 370, 395, 420, 445))
"""Speed grid of figure 10, m/s."""
SHARE = 0.8
"""Share of seeds or bootstraps that must pass."""
BOOTSTRAPS = 1000
KMH = 3.6
GRID_TOLERANCE = 8.0 / KMH
"""A critical speed that moves further (m/s) on another speed grid is reported as sensitive."""


@dataclass(frozen=True)
class Claim:
    """One statement of the paper, measured."""

    id: str
    by: str
    """``seed``, ``median`` or ``once``."""
    expected: str
    measured: str
    """What came out, with its spread."""
    fraction: float
    """Share of the seeds, or of the bootstraps, that pass."""
    holds: bool

    def as_dict(self) -> dict[str, object]:
        """Keys of ``sayd reproduce --json``."""
        return {
            "id": self.id,
            "by": self.by,
            "expected": self.expected,
            "measured": self.measured,
            "fraction": self.fraction,
            "holds": self.holds,
        }


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
    spread = m.frequency_spread(m.all)
    return [
        _by_seed("P1", "new, 280 km/h: a_max < 0.5 of the limit", m.stable_280(), lambda r: r < 0.5),
        _by_median(
            "P2",
            "new: critical speed 365 to 385 km/h",
            "km/h",
            m,
            m.critical_new,
            _within(365, 385),
            note=_grid_note(new, new.acceleration, limits.acceleration),
        ),
        _by_median(
            "P3",
            "new: 3.5 to 4.5 Hz at the critical speed",
            "Hz",
            m,
            m.frequency_at_critical,
            _within(3.5, 4.5),
        ),
        _by_seed("P4", "worn, 320 km/h: both ratios < 1", m.ratios_320(), lambda r: r < 1.0),
        _by_median(
            "P5",
            "worn: critical speed 322 to 340 km/h",
            "km/h",
            m,
            m.critical_worn,
            _within(322, 340),
            note=_grid_note(worn, worn.acceleration, limits.acceleration),
        ),
        _by_seed(
            "P6", "worn, >= 350 km/h: acceleration ratio > 1", m.lowest_ratio_above(), lambda r: r > 1.0
        ),
        _by_median(
            "P7",
            "worn: a_max and Y_max rise with speed",
            "smallest rise",
            m,
            m.smallest_rise,
            lambda x: x > 0.0,
        ),
        _by_median(
            "P8",
            "worn: track shift force crosses in (350, 370] km/h, after P5",
            "km/h",
            m,
            m.critical_worn_force,
            lambda v: 350.0 < v <= 370.0,
            also=lambda seeds: m.critical_worn_force(seeds) > m.critical_worn(seeds),
            note=_grid_note(worn, worn.track_shift, limits.track_shift_force),
        ),
        _by_seed(
            "P9",
            "worn, >= 350 km/h: trailing > 1.1 leading track shift force",
            m.trailing_ratio(),
            lambda r: r > 1.1,
        ),
        _judged(
            "P10",
            "worn: one rising frequency at >= 350 km/h (spread <= 0.3 Hz), scatter at 320 km/h",
            f"spread {np.max(spread[m.high]):.2f} Hz at >= 350, {spread[m.low]:.2f} Hz at 320 km/h, "
            f"smallest rise {m.frequency_rise(m.all):+.2f} Hz",
            m,
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


def _within(low: float, high: float) -> Callable[[float], bool]:
    return lambda value: low <= value <= high


def _by_seed(
    id_: str, expected: str, values: Array, passes: Callable[[Array], npt.NDArray[np.bool_]]
) -> Claim:
    fraction = float(np.mean(passes(values)))
    measured = f"{np.median(values):.2f} ({np.min(values):.2f} to {np.max(values):.2f})"
    return Claim(id_, "seed", expected, measured, fraction, fraction >= SHARE)


def _by_median(
    id_: str,
    expected: str,
    unit: str,
    m: PassiveMeasures,
    statistic: Callable[[Seeds], float],
    passes: Callable[[float], bool],
    also: Callable[[Seeds], bool] = lambda seeds: True,
    note: str = "",
) -> Claim:
    draws = _bootstrap(m.count)
    values = np.array([statistic(seeds) for seeds in draws])
    finite = values[np.isfinite(values)]
    low, high = np.quantile(finite, (0.1, 0.9)) if finite.size else (np.nan, np.nan)
    digits = 0 if unit == "km/h" else 3
    measured = (
        f"{statistic(m.all):.{digits}f} {unit} (bootstraps {low:.{digits}f} to {high:.{digits}f}){note}"
    )
    fraction = float(np.mean([passes(v) and also(s) for v, s in zip(values, draws, strict=True)]))
    holds = bool(passes(statistic(m.all)) and also(m.all) and fraction >= SHARE)
    return Claim(id_, "median", expected, measured, fraction, holds)


def _judged(
    id_: str, expected: str, measured: str, m: PassiveMeasures, passes: Callable[[Seeds], bool]
) -> Claim:
    fraction = float(np.mean([passes(seeds) for seeds in _bootstrap(m.count)]))
    return Claim(id_, "median", expected, measured, fraction, bool(passes(m.all) and fraction >= SHARE))


def _bootstrap(count: int) -> Sequence[Seeds]:
    """Resampled selections of seeds, the same for every row."""
    return list(np.random.default_rng(0).integers(0, count, (BOOTSTRAPS, count)))
