"""One study over the configurations of a sweep: all results in one, with the swept keys as columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from rich.console import Console

from sayd_env.config.scenario import Scenario
from sayd_env.config.sweep import Variant
from sayd_env.report.columns import Column, Listing, Table
from sayd_env.report.figures import Plot
from sayd_env.report.files import Result
from sayd_env.runs.context import RunContext

MOST_DRAWN = 12
"""Results whose pictures are drawn."""


class Sweepable(Result, Protocol):
    """A result that can be one of many."""

    def overview(self) -> tuple[Sequence[Column], Sequence[Mapping[str, Any]]]:
        """Return columns and rows by which it is compared with others."""


@dataclass(frozen=True)
class SweepResult:
    """Results of all configurations."""

    variants: Sequence[Variant]
    results: Sequence[Sweepable]

    @property
    def keys(self) -> list[str]:
        """What is swept."""
        return list(self.variants[0].swept)

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``--json``: what is swept, and each configuration's values with its result."""
        return {
            "swept": self.keys,
            "results": [{"set": each.swept, **result.as_dict()} for each, result in self._each()],
        }

    def tables(self) -> dict[str, Table]:
        """Tables of all results, one below the other, behind columns of what is swept.

        A result whose columns are others than those of the first one has tables of its own, with its number.
        """
        found: dict[str, tuple[list[str], list[Sequence[Any]]]] = {}
        for number, (variant, result) in enumerate(self._each(), start=1):
            for name, (header, rows) in result.tables().items():
                keys = [key for key in self.keys if key not in header]
                columns = [*keys, *header]
                same = found.get(name, (columns, []))[0] == columns
                _, kept = found.setdefault(name if same else f"{name}_{number}", (columns, []))
                kept.extend([*(variant.swept[key] for key in keys), *row] for row in rows)
        return dict(found)

    def plots(self) -> dict[str, Plot]:
        """Plots of the results, numbered; where there are very many, of the first ones."""
        return {
            f"{name}_{number}": plot
            for number, result in enumerate(self.results[:MOST_DRAWN], start=1)
            for name, plot in result.plots().items()
        }

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the overviews of all results as one table."""
        overviews = [result.overview() for result in self.results]
        every = {column.name: column for columns, _ in overviews for column in columns}
        columns = [column for name, column in every.items() if name not in self.keys]
        rows = [
            {**dict.fromkeys(every), **row, **each.swept}
            for each, (_, found) in zip(self.variants, overviews, strict=True)
            for row in found
        ]
        about = f"{len(self.variants)} configurations"
        Listing(about, [*(Column(key, key) for key in self.keys), *columns], rows).print(console, wide)

    def _each(self) -> Iterator[tuple[Variant, Sweepable]]:
        return zip(self.variants, self.results, strict=True)


def over_variants(
    variants: Sequence[Variant],
    scenarios: Sequence[Scenario],
    runs: int,
    study: Callable[[Scenario, RunContext], Sweepable],
    context: RunContext,
) -> Result:
    """Make a study of each configuration; if nothing is swept, the result is that of the only one.

    Parameters
    ----------
    scenarios : sequence of Scenario
        One for each.
    runs : int
        Runs of each, for the progress.
    study : callable
        Makes the study of one.
    context : RunContext
        Of all.
    """
    if not variants[0].swept:
        return study(scenarios[0], context)
    results = [
        study(scenario, context.part(place * runs, len(variants) * runs, variant.title))
        for place, (variant, scenario) in enumerate(zip(variants, scenarios, strict=True))
    ]
    return SweepResult(variants, results)
