"""A comparison as tables: on the console, and as CSV."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from sayd_env.report.files import Table
from sayd_env.studies.comparison.entrants import Entrant
from sayd_env.studies.comparison.grid import OWN, Variant
from sayd_env.studies.comparison.result import MATRIX, Comparison
from sayd_env.studies.comparison.scores import Stability
from sayd_env.studies.comparison.statistics import Estimate
from sayd_env.studies.map import RATIO

if TYPE_CHECKING:
    from rich.console import Console

BEST_CONSTANT = "best constant each"
"""How the table calls the best constant command of each condition."""
_AGAINST = (
    *("policy", "filter", "force_weight", "controller", "reduction", "reduction_low", "reduction_high"),
    *("improvement", "improvement_low", "improvement_high"),
)
_SCORES = (
    *("policy", "filter", "force_weight", "training_seeds", "J"),
    *("iqm_to_passive", "iqm_to_passive_low", "iqm_to_passive_high"),
    *("iqm_to_mppt2", "iqm_to_mppt2_low", "iqm_to_mppt2_high"),
    *("improvement_over_mppt2", "improvement_over_mppt2_low", "improvement_over_mppt2_high"),
    *("best_of_paper", "improvement_over_best", "improvement_over_best_low", "improvement_over_best_high"),
    *("reduction", "reduction_low", "reduction_high"),
    *("worst_vs_passive", "conditions_worse_than_passive", "relative_to_best_constant"),
    *("J_best_training_seed", "J_worst_training_seed"),
)


def tables(result: Comparison) -> dict[str, Table]:
    """Tables by file name: scores by policy and way of taking J, pairs, score matrix, targets, bounds."""
    found: dict[str, Table] = {
        "scores": (_SCORES, _scores(result)),
        "against": (_AGAINST, _against(result)),
        "matrix": (*(("policy", "training_seed", *_scenario_header(result), *MATRIX), _matrix(result)),),
        "stability": (
            ("policy", "critical_speed_kmh", "status", *RATIO.values(), "largest_run"),
            [[title, *_stability(each)] for title, each in result.stability.items()],
        ),
        "best_constant": (
            (*_scenario_header(result)[:-1], "current", "J"),
            [
                [*condition.as_dict().values(), current, cost.mean()]
                for condition, current, cost in zip(
                    result.grid.conditions,
                    result.bounds[OWN].currents,
                    result.bounds[OWN].costs[0],
                    strict=True,
                )
            ],
        ),
    }
    if rows := result.targets:
        found["targets"] = (
            ("policy", "asked", "measured", "holds"),
            [[row.policy, row.asked, row.measured, row.holds] for row in rows],
        )
    return found


def show(result: Comparison, console: Console) -> None:
    """Print the scores, the targets, and what a reader has to know about them."""
    if result.quick:
        console.print("--quick: a few of the conditions, one seed of each; a look, no result")
    console.print(_scores_table(result))
    for line in _notes(result):
        console.print(line, markup=False, highlight=False)
    if any(each.learned for each in result.entrants):
        console.print(_against_table(result))
    if rows := result.targets:
        from rich.markup import escape  # noqa: PLC0415 - only who prints pays for it
        from rich.table import Table as Printed  # noqa: PLC0415

        table = Printed(title="learned policies: what was asked")
        for name in ("policy", "asked", "measured", "holds"):
            table.add_column(name)
        for i, row in enumerate(rows):
            last = i + 1 == len(rows) or rows[i + 1].policy != row.policy
            verdict = "yes" if row.holds else "[bold red]no[/]"
            cells = [escape(text) for text in (row.policy, row.asked, row.measured)]
            table.add_row(*cells, verdict, end_section=last)
        console.print(table)


def _scores_table(result: Comparison) -> Any:
    from rich.table import Table as Printed  # noqa: PLC0415 - only who prints pays for it

    config = result.config
    table = Printed(
        title=f"{len(result.grid.conditions)} conditions x {len(config.seeds)} seeds: J on line, IQM of its "
        "ratio to the passive vehicle's and to MPPT2's"
    )
    headers = (
        *("policy", "J", "/ passive", "/ MPPT2 (95 %)", "P below MPPT2", "worst / passive", "J off line"),
        *("acc. / limit", "shift / limit", "crit. km/h"),
    )
    for name in headers:
        whole = name in ("policy", "/ MPPT2 (95 %)")
        table.add_column(name, justify="left" if name == "policy" else "right", no_wrap=whole)
    for each in result.entrants:
        table.add_row(*_line(result, each))
    offline = result.bounds[Variant("offline", 1.0)].costs.mean()
    table.add_section()
    table.add_row(
        BEST_CONSTANT, f"{result.bounds[OWN].costs.mean():.4f}", *[""] * 4, f"{offline:.4f}", *[""] * 3
    )
    return table


def _against_table(result: Comparison) -> Any:
    """Mean J of the learned policies beside that of each controller."""
    from rich.markup import escape  # noqa: PLC0415 - only who prints pays for it
    from rich.table import Table as Printed  # noqa: PLC0415

    learned = [each.name for each in result.entrants if each.learned]
    headers = map(escape, learned)
    table = Printed("controller", *headers, title="mean J of learned policies below the controller's (95 %)")
    for other in (each.name for each in result.entrants if not each.learned):
        gains = [result.scores[OWN][name].reductions[other] for name in learned]
        cells = [f"{100 * g.value:.1f} % ({100 * g.low:.1f} to {100 * g.high:.1f})" for g in gains]
        table.add_row(escape(other), *cells)
    return table


def _line(result: Comparison, entrant: Entrant) -> list[str]:
    from rich.markup import escape  # noqa: PLC0415 - only who prints pays for it

    own = result.scores[OWN][entrant.name]
    offline = result.scores[Variant("offline", 1.0)][entrant.name]
    count = len(entrant.members)
    return [
        escape(entrant.name) + (f" ({count} seeds)" if count > 1 else ""),
        f"{own.mean:.4f}",
        f"{own.to_passive.value:.2f}",
        f"{own.to_mppt2.value:.2f} ({own.to_mppt2.low:.2f}-{own.to_mppt2.high:.2f})",
        f"{own.improvement['mppt2'].value:.2f}",
        f"{own.worst_vs_passive:.2f}",
        f"{offline.mean:.4f}",
        *(_ratio(value) for value in result.largest_ratios(entrant)),
        _critical(result.stability_of(entrant), result.config.critical_speed.speeds_kmh),
    ]


def _notes(result: Comparison) -> list[str]:
    worn = result.config.critical_speed
    notes = [
        "ratios: largest of all runs, to the limits of EN 14363; km/h: critical speed at wear "
        f"{worn.wear:g}, medians of {len(worn.seeds)} track seeds, of training seeds the lowest"
    ]
    notes += [
        f"{each.name}: {count} of {result.field(each, 'lost').size} runs derailed; they count with infinite "
        "ratios, and in J with the environment's charge for what is missing, off line of the whole length"
        for each in result.entrants
        if (count := result.derailed(each))
    ]
    notes += [
        f"{each.name}, mean J of each training seed: "
        + ", ".join(f"{cost:.4f}" for cost in result.scores[OWN][each.name].by_training)
        for each in result.entrants
        if len(each.members) > 1
    ]
    if result.missing and any(each.learned for each in result.entrants):
        notes.append(f"no targets are judged without {', '.join(result.missing)}")
    return notes


def _scores(result: Comparison) -> list[list[Any]]:
    rows = []
    for variant, found in result.scores.items():
        for each in result.entrants:
            own = found[each.name]
            best = own.best_of_paper
            rows.append(
                [
                    *(each.name, variant.filter, variant.factor, len(each.members), own.mean),
                    *_numbers(own.to_passive),
                    *_numbers(own.to_mppt2),
                    *_numbers(own.improvement["mppt2"]),
                    *(best, *_numbers(own.improvement[best])),
                    *_numbers(own.reduction),
                    *(own.worst_vs_passive, own.worse_than_passive, own.to_best_constant),
                    *(own.by_training.min(), own.by_training.max()),
                ]
            )
    return rows


def _against(result: Comparison) -> list[list[Any]]:
    controllers = [each.name for each in result.entrants if not each.learned]
    rows = []
    for variant, found in result.scores.items():
        for name, own in found.items():
            for other in controllers:
                gain, chance = own.reductions[other], own.improvement[other]
                rows.append([name, *variant, other, *_numbers(gain), *_numbers(chance)])
    return rows


def _scenario_header(result: Comparison) -> tuple[str, ...]:
    return (*result.grid.conditions[0].as_dict(), "seed")


def _matrix(result: Comparison) -> list[list[Any]]:
    rows = []
    for each in result.entrants:
        columns = result.columns(each)
        for r, title in enumerate(each.titles):
            for c, condition in enumerate(result.grid.conditions):
                for s, seed in enumerate(result.config.seeds):
                    cells = [columns[name][r, c, s] for name in MATRIX]
                    rows.append([each.name, title, *condition.as_dict().values(), seed, *cells])
    return rows


def _stability(found: Stability) -> list[Any]:
    return [found.critical_speed_kmh, found.status, *found.ratios.values(), found.largest_run]


def _critical(found: Stability, grid: tuple[float, ...]) -> str:
    if found.critical_speed_kmh is not None:
        return f"{found.critical_speed_kmh:.0f}"
    return f"> {grid[-1]:g}" if found.status == "not reached" else f"< {grid[0]:g}"


def _numbers(estimate: Estimate) -> tuple[float, float, float]:
    return estimate.value, estimate.low, estimate.high


def _ratio(value: float) -> str:
    if math.isinf(value):
        return "[bold red]derailed[/]"
    return f"[red]{value:.2f}[/]" if value > 1.0 else f"{value:.2f}"
