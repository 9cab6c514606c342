"""What a bound came to: J by condition and rule, shares of the way to the reference, convergence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sayd_env.config.palette import policy_style
from sayd_env.config.units import Array
from sayd_env.report.columns import PERCENT, Column, Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot, ratio_rows
from sayd_env.report.html import Grid, Page, Picture, Section, Verdict
from sayd_env.studies.bound.cases import CONSTANT, SCHEDULE

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

CLAIRVOYANT = "clairvoyant"
"""The search with the simulator as its model and the future track as its forecast."""
REFERENCE = "reference"
"""The lowest J of all in each condition."""
FROM = "mppt2"
"""From where the way to the reference is counted."""
ROUNDING = 1e-9
"""Costs that differ by less, relatively, are the same: sums of the same numbers in another order."""


@dataclass(frozen=True)
class Reached:
    """One condition."""

    condition: str
    J: Mapping[str, float]
    """By policy, then of the best constant, of the best by section and of the search."""
    derailed: Mapping[str, bool]
    """Policies whose run ended early."""
    current: float
    """Best constant command."""
    section_currents: tuple[float, ...]
    start: str
    """From whose commands the search started."""
    changes: int
    """Decisions at which the search found something better than its plan."""
    decisions: int
    seconds: float
    """Simulated time of the search, s."""
    period: float
    """Control period, s."""
    commands: Array
    """(n, A) commands of the search, as the environment's valves are: of the bogies, front and rear."""

    @property
    def reference(self) -> float:
        """The lowest J of all."""
        return min(self.J.values())

    @property
    def winner(self) -> str:
        """Whose it is; where several are as good, the first."""
        return min(self.J, key=lambda name: self.J[name])

    @property
    def without_search(self) -> float:
        """The lowest J of all but the search."""
        return min(J for name, J in self.J.items() if name != CLAIRVOYANT)

    def cost(self, rule: str) -> float:
        """J of a rule, which may be the reference."""
        return self.reference if rule == REFERENCE else self.J[rule]


class Share(NamedTuple):
    """How far a rule is on the way from MPPT2 to the reference."""

    rule: str
    J: float
    """Mean over the conditions."""
    gap: float
    """Geometric mean over the conditions of J over the reference's, less 1."""
    share: float
    """Of the way in the logarithm of J, that of its geometric mean: 0 as MPPT2, 1 as the reference."""
    share_of_mean: float
    """Of the way in the mean of J."""
    least: float
    """Smallest share of a condition, in J."""
    lowest: int
    """Conditions in which its J is the lowest of all."""
    derailed: int


class Converged(NamedTuple):
    """What the search reaches with other settings."""

    samples: int
    horizon_s: float
    conditions: int
    J: float
    """Mean over the conditions."""
    ratio: float
    """Geometric mean of J over the lowest J without the search."""
    seconds: float
    """Simulated time of a condition, s."""


@dataclass(frozen=True)
class BoundResult:
    """J of policies, constant commands and the search in all conditions."""

    reached: tuple[Reached, ...]
    policies: tuple[str, ...]
    convergence: tuple[Converged, ...] = ()

    @property
    def rules(self) -> tuple[str, ...]:
        """What is compared."""
        return (*self.policies, CONSTANT, SCHEDULE, CLAIRVOYANT, REFERENCE)

    @property
    def won(self) -> int:
        """Conditions in which the search itself has the lowest J."""
        return sum(each.J[CLAIRVOYANT] < (1.0 - ROUNDING) * each.without_search for each in self.reached)

    def shares(self) -> list[Share]:
        """How far each rule is on the way from MPPT2 to the reference."""
        return [self._share(rule) for rule in self.rules]

    def _share(self, rule: str) -> Share:
        start, own, end = (
            np.array([each.cost(name) for each in self.reached]) for name in (FROM, rule, REFERENCE)
        )
        way = start - end
        shares = (start - own)[way > 0.0] / way[way > 0.0]
        return Share(
            rule=rule,
            J=float(own.mean()),
            gap=math.expm1(float(np.mean(np.log(own / end)))),
            share=_part(np.log(start / own), np.log(start / end)),
            share_of_mean=_part(start - own, way),
            least=float(shares.min()) if len(shares) else math.nan,
            lowest=int(np.count_nonzero(own <= end)),
            derailed=sum(each.derailed.get(rule, False) for each in self.reached),
        )

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd bound --json``."""
        return {
            "shares": [share._asdict() for share in self.shares()],
            "search_won": self.won,
            "conditions": [
                {
                    "condition": each.condition,
                    "J": each.J,
                    "reference": each.reference,
                    "winner": each.winner,
                    "best_constant": each.current,
                    "best_by_section": each.section_currents,
                    **{name: getattr(each, name) for name in _SEARCH},
                    "mean_command": each.commands.mean(axis=0),
                }
                for each in self.reached
            ],
            "convergence": json_rows(_CONVERGENCE, self.convergence),
        }

    def tables(self) -> dict[str, Table]:
        """Shares; J by condition and rule; the searches and their commands; convergence."""
        conditions = [
            {"condition": each.condition, "rule": rule, "J": each.cost(rule)}
            | {"derailed": each.derailed.get(rule, False)}
            for each in self.reached
            for rule in self.rules
        ]
        found = {
            "shares": csv_table(_SHARES, self.shares()),
            "conditions": csv_table([Column(name) for name in conditions[0]], conditions),
            "searches": csv_table(_CONDITIONS, self.reached),
            "commands": (("condition", "time_s", "valve", "command"), self._commands()),
        }
        if self.convergence:
            found["convergence"] = csv_table(_CONVERGENCE, self.convergence)
        return found

    def _commands(self) -> Iterator[tuple[str, float, int, float]]:
        """Commands of the search, at the start of each control period."""
        for each in self.reached:
            for n, row in enumerate(each.commands):
                for valve, command in enumerate(row):
                    yield each.condition, round(n * each.period, 9), valve, float(command)

    def plots(self) -> dict[str, Plot]:
        """J of each rule over the reference, condition by condition."""
        return {"bound": partial(self._draw)}

    def page(self) -> Page:
        """What could be reached, and how far each rule is on the way."""
        known = [each for each in self.shares() if math.isfinite(each.share)]
        words = [
            f"{each.rule}: {100.0 * each.share:.0f} % of the way from MPPT2 to the reference."
            for each in sorted(known, key=lambda each: -each.share)
        ]
        picture = Picture("bound", "J of each rule over the reference, condition by condition")
        tables = [Grid.of(each, lambda _: "bound") for each in self._listings()]
        sections = [Section("Rules", [picture]), Section("In numbers", tables)]
        return Page("What the best possible controller could reach", Verdict(words), sections)

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print shares, conditions and convergence."""
        for listing in self._listings():
            listing.print(console, wide)

    def _listings(self) -> Iterator[Listing]:
        count = len(self.reached)
        title = f"way from MPPT2 to the reference, the lowest J of all: {count} conditions"
        yield Listing(title, _SHARES, self.shares())
        yield Listing(
            f"the search alone is the lowest in {self.won} of {count} conditions", _CONDITIONS, self.reached
        )
        if self.convergence:
            few = self.convergence[0].conditions
            about = f"the search by samples and horizon: {few} condition{'s' * (few > 1)}"
            yield Listing(about, _CONVERGENCE, self.convergence)

    def _draw(self, figure: Figure) -> None:
        ratios = {rule: [each.J[rule] / each.reference for each in self.reached] for rule in self.rules[:-1]}
        colours = {rule: policy_style(rule).colour if rule in self.policies else "0.1" for rule in ratios}
        about = "J over the reference's; points: conditions, bar: geometric mean"
        ratio_rows(figure, ratios, colours, about)


def _part(way: Array, whole: Array) -> float:
    """Sum over sum; not a number where there is no way to go."""
    total = float(whole.sum())
    return float(way.sum()) / total if total > 0.0 else math.nan


_SEARCH = ("start", "changes", "decisions", "seconds")
_SHARES = (
    Column("rule", "commands"),
    Column("J", "mean J"),
    Column("gap", "over it", **PERCENT),
    Column("share", "of the way", **PERCENT),
    Column("share_of_mean", "in mean J", **PERCENT),
    Column("least", "least", wide=True, **PERCENT),
    Column("lowest", "lowest"),
    Column("derailed", "derailed", limit=0.0, wide=True),
)
_CONDITIONS = (
    Column("condition", "condition"),
    Column("current", "constant", digits=3),
    Column("without_search", "J without"),
    Column("reference", "reference"),
    Column("winner", "lowest"),
    Column("start", "from", wide=True),
    Column("changes", "changes", wide=True),
    Column("decisions", "of", wide=True),
    Column("seconds", "simulated", unit="s", digits=0, wide=True),
)
_CONVERGENCE = (
    Column("samples", "samples"),
    Column("horizon_s", "horizon", unit="s", digits=1),
    Column("conditions"),
    Column("J", "mean J", best=True),
    Column("ratio", "of J without", digits=4),
    Column("seconds", "simulated", unit="s", digits=0),
)
