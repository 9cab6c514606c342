"""What the paper shows about the passive vehicle, as measurements with a verdict (rows P1 to P10)."""

from __future__ import annotations

import numpy as np

from sayd_env.config.assessment import AssessmentConfig, load_assessment
from sayd_env.config.units import KMH, Array
from sayd_env.runs.passive import Criterion, Sweep
from sayd_env.stability import Limits
from sayd_env.studies.paper.claims import Claim, Seeds, bootstrapped, by_median, by_seed, spread


class PassiveMeasures:
    """The quantities behind rows P1 to P10, for each seed or any selection of seeds.

    Parameters
    ----------
    new, worn : Sweep
        The passive vehicle on new and on worn wheels, at least on the grids of figures 8 and 10.
    """

    def __init__(self, new: Sweep, worn: Sweep, limits: Limits) -> None:
        self.new, self.worn = new, worn
        self.new_acceleration, _ = new.criteria(limits).values()
        self.worn_acceleration, self.worn_force = worn.criteria(limits).values()
        self.count = len(new.seeds)
        self.all = np.arange(self.count)
        self.high = np.flatnonzero(worn.speeds >= 350 / KMH - 1e-6)
        self.low = int(np.argmin(np.abs(worn.speeds - 320 / KMH)))

    def stable_280(self) -> Array:
        """a_max over its limit at 280 km/h on new wheels, for each seed (P1)."""
        at = int(np.argmin(np.abs(self.new.speeds - 280 / KMH)))
        return np.asarray(self.new_acceleration.ratios[at])

    def frequency_at_critical(self, seeds: Seeds) -> float:
        """Dominant frequency at the critical speed on new wheels, Hz (P3)."""
        f = np.median(self.new.frequency[:, seeds], axis=(1, 2))
        return float(np.interp(self.new_acceleration.kmh(seeds) / KMH, self.new.speeds, f))

    def ratios_320(self) -> Array:
        """Larger ratio to the limits at 320 km/h on worn wheels, for each seed (P4)."""
        ratios = [each.ratios[self.low] for each in (self.worn_acceleration, self.worn_force)]
        return np.asarray(np.max(ratios, axis=0))

    def lowest_ratio_above(self) -> Array:
        """Smallest acceleration ratio over the speeds from 350 km/h, for each seed (P6)."""
        return np.asarray(self.worn_acceleration.ratios[self.high].min(axis=0))

    def smallest_rise(self, seeds: Seeds) -> float:
        """Smallest relative rise of the medians of a_max and Y_max between neighbouring speeds (P7)."""
        medians = [criterion.medians(seeds) for criterion in (self.worn_acceleration, self.worn_force)]
        return float(min(np.min(np.diff(median) / median[:-1]) for median in medians))

    def trailing_ratio(self) -> Array:
        """Smallest track-shift ratio of trailing to leading wheelset from 350 km/h, each seed (P9)."""
        force = self.worn.track_shift[self.high]
        return np.asarray((force[..., 1::2] / force[..., 0::2]).min(axis=(0, 2)))

    def frequency_spread(self, seeds: Seeds) -> Array:
        """Median spread of the dominant frequencies of all quantities at each worn speed, Hz (P10)."""
        return np.asarray(np.median(np.ptp(self._frequencies(seeds), axis=-1), axis=1))

    def frequency_rise(self, seeds: Seeds) -> float:
        """Smallest rise of the median dominant frequency between speeds from 350 km/h, Hz (P10)."""
        median = np.median(self._frequencies(seeds)[self.high], axis=(1, 2))
        return float(np.min(np.diff(median)))

    def one_frequency(self, seeds: Seeds) -> bool:
        """Whether row P10 passes."""
        spread = self.frequency_spread(seeds)
        above = float(np.max(spread[self.high]))
        return above <= 0.3 and self.frequency_rise(seeds) > 0.0 and bool(spread[self.low] > above)

    def _frequencies(self, seeds: Seeds) -> Array:
        return np.concatenate([self.worn.frequency, self.worn.frequency_force], axis=-1)[:, seeds]


def passive_claims(
    new: Sweep, worn: Sweep, limits: Limits, assessment: AssessmentConfig | None = None
) -> list[Claim]:
    """Judge rows P1 to P10, from the passive vehicle on new and on worn wheels, on the same seeds.

    The assessment says what is sensitive to the grid of speeds; the packaged one does by default.
    """
    tolerance = (assessment or load_assessment()).grid_tolerance
    m = PassiveMeasures(new, worn, limits)
    apart, stable, low = m.frequency_spread(m.all), m.stable_280(), m.ratios_320()
    above, trailing = m.lowest_ratio_above(), m.trailing_ratio()

    def crossing(criterion: Criterion) -> str:
        moves = ", sensitive to the speed grid" if criterion.sensitive(tolerance) else ""
        spread = f"; 80 % of the seeds {criterion.over_seeds_text()}"
        none = f"no crossing from {criterion.speeds[0] * KMH:.0f} to {criterion.speeds[-1] * KMH:.0f} km/h"
        found = not np.isnan(criterion.kmh())
        return (bootstrapped(criterion.kmh, m.count, "km/h") if found else none) + spread + moves

    return [
        by_seed("P1", "new, 280 km/h: a_max < 0.5 of the limit", stable < 0.5, spread(stable)),
        by_median(
            "P2",
            "new: critical speed 365 to 385 km/h",
            m.count,
            lambda seeds: 365.0 <= m.new_acceleration.kmh(seeds) <= 385.0,
            crossing(m.new_acceleration),
        ),
        by_median(
            "P3",
            "new: 3.5 to 4.5 Hz at the critical speed",
            m.count,
            lambda seeds: 3.5 <= m.frequency_at_critical(seeds) <= 4.5,
            bootstrapped(m.frequency_at_critical, m.count, "Hz"),
        ),
        by_seed("P4", "worn, 320 km/h: both ratios < 1", low < 1.0, spread(low)),
        by_median(
            "P5",
            "worn: critical speed 322 to 340 km/h",
            m.count,
            lambda seeds: 322.0 <= m.worn_acceleration.kmh(seeds) <= 340.0,
            crossing(m.worn_acceleration),
        ),
        by_seed("P6", "worn, >= 350 km/h: acceleration ratio > 1", above > 1.0, spread(above)),
        by_median(
            "P7",
            "worn: a_max and Y_max rise with speed",
            m.count,
            lambda seeds: m.smallest_rise(seeds) > 0.0,
            bootstrapped(m.smallest_rise, m.count, "smallest rise"),
        ),
        by_median(
            "P8",
            "worn: track shift force crosses in (350, 370] km/h, after P5",
            m.count,
            lambda seeds: (
                350.0 < m.worn_force.kmh(seeds) <= 370.0
                and m.worn_force.kmh(seeds) > m.worn_acceleration.kmh(seeds)
            ),
            crossing(m.worn_force),
        ),
        by_seed(
            "P9",
            "worn, >= 350 km/h: trailing > 1.1 leading track shift force",
            trailing > 1.1,
            spread(trailing),
        ),
        by_median(
            "P10",
            "worn: one rising frequency at >= 350 km/h (spread <= 0.3 Hz), scatter at 320 km/h",
            m.count,
            m.one_frequency,
            f"spread {np.max(apart[m.high]):.2f} Hz at >= 350, {apart[m.low]:.2f} Hz at 320 km/h, "
            f"smallest rise {m.frequency_rise(m.all):+.2f} Hz",
        ),
    ]
