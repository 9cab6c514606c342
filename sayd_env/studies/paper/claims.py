"""How a statement of the paper is judged, over track seeds.

A row judged by `seed` holds if at least 80 % of the track seeds pass it. A row judged by `median` holds if
the median over the seeds passes and at least 80 % of 1,000 bootstraps over the seeds pass. A row judged
`once` has no randomness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from sayd_env.config.units import Array, Flags, Integers
from sayd_env.report.columns import PERCENT, Column, json_rows

Seeds = Integers
"""A selection of seeds by their places, with repetitions in a bootstrap."""

SHARE = 0.8
"""Share of seeds or bootstraps that must pass."""
BOOTSTRAPS = 1000


@dataclass(frozen=True)
class Verdict:
    """A row that something else than what the row is about went through."""

    measured: str
    fraction: float | None = None
    """None where the row does not apply."""
    holds: bool | None = None


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
    fixed: Mapping[str, Verdict] = field(default_factory=dict)
    """What fixed commands do in the controller's place; empty for a row without one."""

    @property
    def verdict(self) -> Verdict:
        """What came out, alone."""
        return Verdict(self.measured, self.fraction, self.holds)


CLAIMS = (
    Column("id", "row"),
    Column("by", "judged by", wide=True),
    Column("expected", "expected"),
    Column("measured", "measured"),
    Column("fraction", "share", **PERCENT),
    Column("holds", "holds", bad=lambda holds: not holds),
)


def claim_columns(claims: Sequence[Claim]) -> list[Column]:
    """Columns of the rows, then of what each fixed command does in them."""
    commands = dict.fromkeys(command for claim in claims for command in claim.fixed)
    beside = [
        column
        for command in commands
        for column in (
            Column(f"{command} measured", f"{command}: measured", wide=True),
            Column(f"{command} fraction"),
            # Short, for the texts of a row need the room: V 0, V tuned of constant:0, constant-tuned.
            Column(f"{command} holds", f"V {command.removeprefix('constant').lstrip(':-')}"),
        )
    ]
    return [*CLAIMS, *beside]


def claim_rows(claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """One entry for each row of claims, by the names of `claim_columns`; None where a row does not apply."""
    names = [column.name for column in claim_columns(claims)]
    found = []
    for claim in claims:
        beside = {
            f"{command} {key}": value
            for command, verdict in claim.fixed.items()
            for key, value in asdict(verdict).items()
        }
        found.append(dict.fromkeys(names) | {column.name: column.of(claim) for column in CLAIMS} | beside)
    return found


def claims_document(claims: Sequence[Claim]) -> list[dict[str, Any]]:
    """Rows of the JSON document; ``fixed`` has what fixed commands do, where the row applies to them."""
    return [
        row | {"fixed": {command: asdict(verdict) for command, verdict in claim.fixed.items()}}
        for row, claim in zip(json_rows(CLAIMS, claims), claims, strict=True)
    ]


def spread(values: Array, unit: str = "", digits: int = 2) -> str:
    """Median and range over the seeds, as a table shows them: ``0.21 (0.19 to 0.26)``."""
    median, low, high = (f"{f(values):.{digits}f}" for f in (np.median, np.min, np.max))
    return f"{median}{unit and ' ' + unit} ({low} to {high})"


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
