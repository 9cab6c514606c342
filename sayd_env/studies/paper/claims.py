"""How a statement of the paper is judged, over track seeds.

A row judged by `seed` holds if at least 80 % of the track seeds pass it. A row judged by `median` holds if
the median over the seeds passes and at least 80 % of 1,000 bootstraps over the seeds pass. A row judged
`once` has no randomness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

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

    def as_dict(self) -> dict[str, object]:
        """Keys of ``sayd reproduce --json``."""
        return asdict(self)


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


def within(low: float, high: float) -> Callable[[float], bool]:
    """Whether a value lies between two bounds, both included; NaN does not."""
    return lambda value: low <= value <= high


def once(id_: str, expected: str, measured: str, holds: bool) -> Claim:
    """Judge a row without randomness."""
    return Claim(id_, "once", expected, measured, float(holds), holds)


def by_seed(id_: str, expected: str, passed: Flags, measured: str) -> Claim:
    """Judge a row that each seed passes or not.

    Parameters
    ----------
    id_, expected : str
        Name of the row and what the paper says.
    passed : ndarray of bool, shape (seeds,)
        Which seeds pass.
    measured : str
        What came out, see `spread`.
    """
    fraction = float(np.mean(passed))
    return Claim(id_, "seed", expected, measured, fraction, fraction >= SHARE)


def by_median(
    id_: str,
    expected: str,
    unit: str,
    count: int,
    statistic: Callable[[Seeds], float],
    passes: Callable[[float], bool],
    also: Callable[[Seeds], bool] = lambda seeds: True,
    note: str = "",
) -> Claim:
    """Judge a row by a number that comes from all seeds together.

    Parameters
    ----------
    id_, expected : str
        Name of the row and what the paper says.
    unit : str
        Unit of the number.
    count : int
        Number of seeds.
    statistic : callable
        The number from a selection of seeds; NaN where there is none.
    passes : callable
        Whether a number passes.
    also : callable
        A further condition on a selection of seeds.
    note : str
        What to add to the measured number.
    """
    draws, everything = bootstraps(count), np.arange(count)
    values = np.array([statistic(seeds) for seeds in draws])
    finite = values[np.isfinite(values)]
    low, high = np.quantile(finite, (0.1, 0.9)) if finite.size else (np.nan, np.nan)
    digits = 0 if unit == "km/h" else 3
    measured = (
        f"{statistic(everything):.{digits}f} {unit} (bootstraps {low:.{digits}f} to {high:.{digits}f}){note}"
    )
    fraction = float(np.mean([passes(v) and also(s) for v, s in zip(values, draws, strict=True)]))
    holds = bool(passes(statistic(everything)) and also(everything) and fraction >= SHARE)
    return Claim(id_, "median", expected, measured, fraction, holds)


def by_selection(
    id_: str, expected: str, measured: str, count: int, passes: Callable[[Seeds], bool]
) -> Claim:
    """Judge a row by medians that make more than one number: `passes` decides on a selection of seeds."""
    fraction = float(np.mean([passes(seeds) for seeds in bootstraps(count)]))
    holds = bool(passes(np.arange(count)) and fraction >= SHARE)
    return Claim(id_, "median", expected, measured, fraction, holds)


def bootstraps(count: int) -> Sequence[Seeds]:
    """Resampled selections of seeds, the same for every row."""
    return list(np.random.default_rng(0).integers(0, count, (BOOTSTRAPS, count)))
