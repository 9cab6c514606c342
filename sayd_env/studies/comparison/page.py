"""How a comparison is shown: tables on the console and as CSV, and a page of plots."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from rich.console import Console

from sayd_env.config.reward import REPORTED
from sayd_env.report.columns import LIMITED, Column, Listing, Table, csv_table
from sayd_env.report.figures import Plot
from sayd_env.report.html import Grid, Page, Picture, Section, Text, Verdict
from sayd_env.runs.metrics import RATIOS
from sayd_env.stability.critical import Crossing
from sayd_env.studies.comparison.figures import draw
from sayd_env.studies.comparison.grid import OFFLINE, OWN, TOGETHER, Variant
from sayd_env.studies.comparison.result import MATRIX, Comparison
from sayd_env.studies.comparison.scores import Stability
from sayd_env.studies.comparison.statistics import Estimate
from sayd_env.studies.map import RATIO
from sayd_env.studies.standing import Standing, verdict

BEST_CONSTANT = "best constant each"
"""How the table calls the best constant command of each condition."""


def _estimate(name: str, header: str = "", *, wide: bool = False, **shown: Any) -> tuple[Column, ...]:
    """Columns of an estimate and of the ends of its interval, which are not printed where it is `wide`."""
    low, high = ("from", "to") if header and not wide else ("", "")
    return (
        Column(name, header, wide=wide, **shown),
        Column(f"{name}_low", low, **shown),
        Column(f"{name}_high", high, **shown),
    )


_COSTS = (
    Column("part"),
    Column("policy", "policy"),
    Column("filter"),
    Column("force_weight"),
    Column("training_seeds", "trainings", wide=True),
    Column("J", "J", digits=4, best=True),
    *_estimate("geometric", "geom. / best const.", digits=3, wide=True),
    *_estimate("iqm_to_passive", "/ passive", digits=2, wide=True),
    *_estimate("iqm_to_mppt2", "/ MPPT2", digits=2),
    *_estimate("improvement_over_mppt2", "P below MPPT2", digits=2, wide=True),
    Column("best_of_paper"),
    *_estimate("improvement_over_best"),
    *_estimate("reduction"),
    Column("worst_vs_passive", "worst / passive", digits=2, wide=True),
    Column("conditions_worse_than_passive"),
    Column("relative_to_best_constant"),
    Column("J_best_training_seed"),
    Column("J_worst_training_seed"),
)
_BESIDE = (
    *(Column(column, f"J {name}", digits=4, best=True) for column, name in REPORTED.items()),
    Column("J_offline", "J off line", digits=4, best=True, wide=True),
    Column("largest_acceleration_ratio", "acc. / limit", wide=True, **LIMITED),
    Column("largest_track_shift_ratio", "shift / limit", wide=True, **LIMITED),
    Column("largest_ratio", "largest ratio", **LIMITED),
    Column("critical", "crit. km/h"),
)
"""Printed beside the scores of J on line."""
_GAINS = (
    Column("part"),
    Column("policy", "policy"),
    Column("filter"),
    Column("force_weight"),
    Column("controller", "below that of"),
    *_estimate("geometric_reduction", "by", unit="%", scale=100.0, digits=1),
    Column("reduction", "mean by", unit="%", scale=100.0, digits=1),
    *(Column(f"reduction_{end}", unit="%", scale=100.0, digits=1) for end in ("low", "high")),
    *_estimate("improvement", "P below", digits=2, wide=True),
)
_RELATIVE = (
    Column("part", "on"),
    Column("policy", "policy"),
    *_estimate("geometric", "J / best", digits=3),
    Column("J", "mean J", digits=4),
    Column("worst_vs_passive", "worst / passive", digits=2),
)
_TARGETS = (
    Column("policy", "policy"),
    Column("asked", "asked"),
    Column("measured", "measured"),
    Column("holds", "holds", bad=lambda holds: not holds),
)
_STABILITY = [
    Column(name) for name in ("policy", "critical_speed_kmh", "status", *RATIO.values(), "largest_run")
]


class CompareResult(Comparison):
    """A comparison and how it is shown."""

    def tables(self) -> dict[str, Table]:
        """Tables by file name: scores by policy and way of taking J, pairs, score matrix, bounds, targets."""
        condition = [Column(name) for name in self.grid.conditions[0].as_dict()]
        run = [Column("policy"), Column("training_seed"), *condition, *map(Column, ("seed", *MATRIX))]
        bounds = [row["condition"] | row for row in self.best_constants()]
        found = {
            "scores": csv_table(_COSTS, _scores(self)),
            "against": csv_table(_GAINS, _gains(self)),
            "matrix": csv_table(run, _matrix(self)),
            "stability": csv_table(_STABILITY, _stabilities(self)),
            "best_constant": csv_table([*condition, Column("current"), Column("J")], bounds),
        }
        return found | ({"targets": csv_table(_TARGETS, self.targets)} if self.targets else {})

    def plots(self) -> dict[str, Plot]:
        """One page."""
        return {"compare": lambda figure: draw(self, figure)}

    def page(self) -> Page:
        """What was asked and reached, the scores, and the figure."""
        scores, relative, *others = (Grid.of(each, lambda _: "compare") for each in _listings(self))
        notes = map(Text, _notes(self))
        picture = Picture(
            "compare", "J over speed, distribution, intervals, training seeds, bound, reductions"
        )
        sections = [
            Section("Scores", [scores, *notes, relative]),
            Section("Figures", [picture]),
            *([Section("Learned policies", others)] if others else []),
        ]
        return Page("Policies compared on held-out conditions", _verdict(self), sections)

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the scores, the targets, and what a reader has to know about them."""
        scores, *others = _listings(self)
        scores.print(console, wide)
        for line in _notes(self):
            console.print(line, markup=False, highlight=False)
        for listing in others:
            listing.print(console, wide)


def _listings(result: CompareResult) -> Iterator[Listing]:
    """Scores, J over the best constant's; gains of learned policies and what was asked of them, if any."""
    count = f"{_count(result)} x {len(result.config.seeds)} seeds"
    title = f"{count}: J on line, and IQM of its ratio to MPPT2's (95 %)"
    lines = _lines(result)
    columns = [column for column in (*_COSTS, *_BESIDE) if column.name in lines[0]]
    yield Listing(title, columns, lines, "bound")
    title = "J over that of the best constant command of each condition: geometric mean (95 %)"
    yield Listing(title, _RELATIVE, _own(_scores(result)), "part")
    learned = {each.name for each in result.entrants if each.learned}
    gains = [row for row in _own(_gains(result)) if row["policy"] in learned]
    for part in result.by_part if gains else ():
        rows = [row for row in gains if row["part"] == part]
        title = f"{part}: geometric and plain mean of J of learned policies below the controllers' (95 %)"
        yield Listing(title, _GAINS, rows, "policy")
    if result.targets:
        yield Listing("learned policies: what was asked", _TARGETS, result.targets, "policy")


def _verdict(result: CompareResult) -> Verdict:
    """The best policy and who keeps the limits; how many targets hold, where there are any."""
    lines = {row["policy"]: row for row in _lines(result) if not row["bound"]}
    standings = [
        Standing(name, row["J"], row["largest_ratio"], row["derailed"]) for name, row in lines.items()
    ]
    found = verdict(standings, f"{_count(result)} of the held-out list")
    if not result.targets:
        return found
    held = sum(target.holds for target in result.targets)
    words = f"{held} of {len(result.targets)} targets of the learned policies hold."
    return Verdict([words, *found.words], held == len(result.targets))


def _count(result: Comparison) -> str:
    lines = sum(each.line is not None for each in result.grid.conditions)
    straight = f"{len(result.grid.conditions) - lines} conditions"
    return f"{straight} and {lines} lines" if lines else straight


def _lines(result: Comparison) -> list[dict[str, Any]]:
    """What is printed of each entrant, and of the best constant command of each condition."""
    rows = []
    together = [row for row in _own(_scores(result)) if row["part"] == TOGETHER]
    for each, scores in zip(result.entrants, together, strict=True):
        row = scores | result.overview(each) | {"bound": False}
        row["largest_ratio"] = max(row[f"largest_{name}"] for name in RATIOS)
        row["critical"] = _critical(result.stability_of(each), result.config.critical_speed.speeds_kmh)
        rows.append(row)
    ways = {"J": OWN, "J_offline": OFFLINE}
    ways |= {column: Variant("online", factor) for column, factor in result.grid.reported.items()}
    costs = {column: result.bounds[way].costs.mean() for column, way in ways.items()}
    return [*rows, dict.fromkeys(rows[0]) | {"policy": BEST_CONSTANT, "bound": True} | costs]


def _own(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows by the way of taking J that is printed."""
    return [row for row in rows if (row["filter"], row["force_weight"]) == OWN]


def _notes(result: Comparison) -> list[str]:
    worn = result.config.critical_speed
    notes = [
        "ratios: largest of all runs, to the limits of EN 14363; km/h: critical speed at wear "
        f"{worn.wear:g}, medians of {len(worn.seeds)} track seeds, of training seeds the lowest"
    ]
    notes += [
        f"{each.name}: {count} of {result.costs[OWN][each.name].size} runs derailed; they count with "
        "infinite ratios, and in J with the environment's charge for what is missing, off line of the "
        "whole length"
        for each in result.entrants
        if (count := result.overview(each)["derailed"])
    ]
    notes += [
        f"{each.name}, mean J of each training seed: "
        + ", ".join(f"{cost:.4f}" for cost in result.scores[OWN][each.name].J_by_training_seed)
        for each in result.entrants
        if len(each.members) > 1
    ]
    if result.missing and any(each.learned for each in result.entrants):
        notes.append(f"no targets are judged without {', '.join(result.missing)}")
    return notes


def _scores(result: Comparison) -> list[dict[str, Any]]:
    """Scores by way of taking J and policy, by `_COSTS`."""
    return [
        {
            **{"part": part, "policy": each.name},
            **{"filter": variant.filter, "force_weight": variant.factor},
            **{"training_seeds": len(each.members), **vars(own)},
            **_numbers("geometric", own.geometric),
            **_numbers("iqm_to_passive", own.relative_to_passive),
            **_numbers("iqm_to_mppt2", own.relative_to_mppt2),
            **_numbers("improvement_over_mppt2", own.probability_of_improvement["mppt2"]),
            **_numbers("improvement_over_best", own.probability_of_improvement[own.best_of_paper]),
            **_numbers("reduction", own.reduction),
            "J_best_training_seed": own.J_by_training_seed.min(),
            "J_worst_training_seed": own.J_by_training_seed.max(),
        }
        for part, scores in result.by_part.items()
        for variant, found in scores.items()
        for each, own in ((each, found[each.name]) for each in result.entrants)
    ]


def _gains(result: Comparison) -> list[dict[str, Any]]:
    """Reduction of mean J against each controller, and the chance of a lower one, by `_GAINS`."""
    return [
        {
            **{"part": part, "policy": name},
            **{"filter": variant.filter, "force_weight": variant.factor, "controller": other},
            **_numbers("geometric_reduction", own.geometric_by_controller[other]),
            **_numbers("reduction", own.reduction_by_controller[other]),
            **_numbers("improvement", own.probability_of_improvement[other]),
        }
        for part, scores in result.by_part.items()
        for variant, found in scores.items()
        for name, own in found.items()
        for other in (each.name for each in result.entrants if not each.learned)
    ]


def _matrix(result: Comparison) -> list[dict[str, Any]]:
    rows = []
    for each in result.entrants:
        columns = result.columns(each)
        places = product(each.titles, result.grid.conditions, result.config.seeds)
        for place, (title, condition, seed) in zip(np.ndindex(columns["J"].shape), places, strict=True):
            about = {"policy": each.name, "training_seed": title, **condition.as_dict(), "seed": seed}
            rows.append(about | {name: values[place] for name, values in columns.items()})
    return rows


def _stabilities(result: Comparison) -> list[dict[str, Any]]:
    return [
        vars(found) | {"policy": title} | {RATIO[name]: ratio for name, ratio in found.ratios.items()}
        for title, found in result.stability.items()
    ]


def _critical(found: Stability, grid: tuple[float, ...]) -> str:
    if found.critical_speed_kmh is not None:
        return f"{found.critical_speed_kmh:.0f}"
    return f"> {grid[-1]:g}" if found.status == Crossing.NOT_REACHED.value else f"< {grid[0]:g}"


def _numbers(name: str, estimate: Estimate) -> dict[str, float]:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
