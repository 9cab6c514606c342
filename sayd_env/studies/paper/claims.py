"""How a statement of the paper is judged, over track seeds.

A row judged by `seed` holds if at least 80 % of the track seeds pass it. A row judged by `median` holds if
the median over the seeds passes and at least 80 % of 1,000 bootstraps over the seeds pass. A row judged
`once` has no randomness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sayd_env.config.units import Array
from sayd_env.report.columns import Column

Flags = npt.NDArray[np.bool_]
Seeds = npt.NDArray[np.int64]
"""A selection of seeds by their places, with repetitions in a bootstrap."""

SHARE = 0.8
"""Share of seeds or bootstraps that must pass."""
BOOTSTRAPS = 1000


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


CLAIMS = (
    Column("id", "row"),
    Column("by", "judged by", wide=True),
    Column("expected", "expected"),
    Column("measured", "measured"),
    Column("fraction", "share", "%", 100.0, 0),
    Column("holds", "holds", bad=lambda holds: not holds),
)


def spread(values: Array, unit: str = "", digits: int = 2) -> str:
    """Median and range over the seeds, as a table shows them: ``0.21 (0.19 to 0.26)``."""
    middle, low, high = (f"{f(values):.{digits}f}" for f in (np.median, np.min, np.max))
    return f"{middle}{unit and ' ' + unit} ({low} to {high})"


def bootstrapped(statistic: Callable[[Seeds], float], count: int, unit: str) -> str:
    """A number that comes from all seeds together, with its 80 % interval of bootstraps; NaN is left out."""
    values = np.array([statistic(seeds) for seeds in bootstraps(count)])
    finite = values[np.isfinite(values)]
    low, high = np.quantile(finite, (0.1, 0.9)) if finite.size else (np.nan, np.nan)
    digits = 0 if unit == "km/h" else 3
    middle = statistic(np.arange(count))
    return f"{middle:.{digits}f} {unit} (bootstraps {low:.{digits}f} to {high:.{digits}f})"


def by_seed(id_: str, expected: str, passed: Flags, measured: str, by: str = "seed") -> Claim:
    """Judge a row that each seed passes or not."""
    fraction = float(np.mean(passed))
    return Claim(id_, by, expected, measured, fraction, fraction >= SHARE)


def once(id_: str, expected: str, holds: bool, measured: str) -> Claim:
    """Judge a row without randomness."""
    return by_seed(id_, expected, np.array([holds]), measured, "once")


def by_median(id_: str, expected: str, count: int, passes: Callable[[Seeds], bool], measured: str) -> Claim:
    """Judge a row by medians over the seeds: `passes` decides on a selection of them."""
    fraction = float(np.mean([passes(seeds) for seeds in bootstraps(count)]))
    holds = bool(passes(np.arange(count)) and fraction >= SHARE)
    return Claim(id_, "median", expected, measured, fraction, holds)


def bootstraps(count: int) -> Sequence[Seeds]:
    """Resampled selections of seeds, the same for every row."""
    return list(np.random.default_rng(0).integers(0, count, (BOOTSTRAPS, count)))
