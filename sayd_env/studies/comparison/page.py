"""A comparison as tables: on the console, and as CSV."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sayd_env.report.columns import Column, Table, csv_table, print_table
from sayd_env.studies.comparison.grid import OWN, Variant
from sayd_env.studies.comparison.result import MATRIX, Comparison
from sayd_env.studies.comparison.scores import Stability
from sayd_env.studies.comparison.statistics import Estimate
from sayd_env.studies.map import RATIO

if TYPE_CHECKING:
    from rich.console import Console

BEST_CONSTANT = "best constant each"
"""How the table calls the best constant command of each condition."""
OFFLINE = Variant("offline", 1.0)


def _estimate(
    name: str,
    header: str = "",
    unit: str = "",
    scale: float = 1.0,
    digits: int | None = None,
    *,
    wide: bool = False,
) -> tuple[Column, ...]:
    """Columns of an estimate and of the ends of its interval, which are not printed where it is `wide`."""
    ends = {"low": "from", "high": "to"} if header and not wide else {"low": "", "high": ""}
    return (
        Column(name, header, unit, scale, digits, wide=wide),
        *(Column(f"{name}_{end}", words, unit, scale, digits) for end, words in ends.items()),
    )


_COSTS = (
    Column("policy", "policy"),
    Column("filter"),
    Column("force_weight"),
    Column("training_seeds", "trainings", wide=True),
    Column("J", "J", digits=4, best=True),
    *_estimate("iqm_to_passive", "/ passive", "", 1.0, 2, wide=True),
    *_estimate("iqm_to_mppt2", "/ MPPT2", "", 1.0, 2),
    *_estimate("improvement_over_mppt2", "P below MPPT2", "", 1.0, 2, wide=True),
    Column("best_of_paper"),
    *_estimate("improvement_over_best"),
    *_estimate("reduction"),
    Column("worst_vs_passive", "worst / passive", digits=2),
    Column("conditions_worse_than_passive"),
    Column("relative_to_best_constant"),
    Column("J_best_training_seed"),
    Column("J_worst_training_seed"),
)
_BESIDE = (
    Column("J_offline", "J off line", digits=4, best=True, wide=True),
    Column("acceleration_ratio", "acc. / limit", digits=2, limit=1.0, infinite="derailed", wide=True),
    Column("track_shift_ratio", "shift / limit", digits=2, limit=1.0, infinite="derailed", wide=True),
    Column("largest_ratio", "largest ratio", digits=2, limit=1.0, infinite="derailed"),
    Column("critical", "crit. km/h"),
)
"""Printed beside the scores of J on line."""
_GAINS = (
    Column("policy", "policy"),
    Column("filter"),
    Column("force_weight"),
    Column("controller", "below that of"),
    *_estimate("reduction", "by", "%", 100.0, 1),
    *_estimate("improvement", "P below", "", 1.0, 2, wide=True),
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


def tables(result: Comparison) -> dict[str, Table]:
    """Tables by file name: scores by policy and way of taking J, pairs, score matrix, targets, bounds."""
    condition = [Column(name) for name in result.grid.conditions[0].as_dict()]
    run = [Column("policy"), Column("training_seed"), *condition, *map(Column, ("seed", *MATRIX))]
    bound = result.bounds[OWN]
    best = zip(result.grid.conditions, bound.currents, bound.costs[0], strict=True)
    found = {
        "scores": csv_table(_COSTS, _scores(result)),
        "against": csv_table(_GAINS, _gains(result)),
        "matrix": csv_table(run, _matrix(result)),
        "stability": csv_table(_STABILITY, _stabilities(result)),
        "best_constant": csv_table(
            [*condition, Column("current"), Column("J")],
            [each.as_dict() | {"current": current, "J": cost.mean()} for each, current, cost in best],
        ),
    }
    return found | ({"targets": csv_table(_TARGETS, result.targets)} if result.targets else {})


def show(result: Comparison, console: Console, wide: bool = False) -> None:
    """Print the scores, the targets, and what a reader has to know about them."""
    title = (
        f"{len(result.grid.conditions)} conditions x {len(result.config.seeds)} seeds: J on line, "
        "and IQM of its ratio to MPPT2's (95 %)"
    )
    print_table(console, title, (*_COSTS, *_BESIDE), _lines(result), wide=wide, section="bound")
    for line in _notes(result):
        console.print(line, markup=False, highlight=False)
    learned = {each.name for each in result.entrants if each.learned}
    gains = [row for row in _own(_gains(result)) if row["policy"] in learned]
    if gains:
        title = "mean J of learned policies below the controllers' (95 %)"
        print_table(console, title, _GAINS, gains, wide=wide, section="policy")
    if result.targets:
        title = "learned policies: what was asked"
        print_table(console, title, _TARGETS, result.targets, wide=wide, section="policy")


def _lines(result: Comparison) -> list[dict[str, Any]]:
    """What is printed of each entrant, and of the best constant command of each condition."""
    rows = []
    for each, row in zip(result.entrants, _own(_scores(result)), strict=True):
        acceleration, force = result.largest_ratios(each)
        beside = {
            "bound": False,
            "J_offline": result.scores[OFFLINE][each.name].mean,
            "acceleration_ratio": acceleration,
            "track_shift_ratio": force,
            "largest_ratio": max(acceleration, force),
            "critical": _critical(result.stability_of(each), result.config.critical_speed.speeds_kmh),
        }
        rows.append(row | beside)
    costs = {"J": result.bounds[OWN].costs.mean(), "J_offline": result.bounds[OFFLINE].costs.mean()}
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


def _scores(result: Comparison) -> list[dict[str, Any]]:
    """Scores by way of taking J and policy, by `_COSTS`."""
    return [
        {
            **{"policy": each.name, "filter": variant.filter, "force_weight": variant.factor},
            **{"training_seeds": len(each.members), "J": own.mean},
            **_numbers("iqm_to_passive", own.to_passive),
            **_numbers("iqm_to_mppt2", own.to_mppt2),
            **_numbers("improvement_over_mppt2", own.improvement["mppt2"]),
            "best_of_paper": own.best_of_paper,
            **_numbers("improvement_over_best", own.improvement[own.best_of_paper]),
            **_numbers("reduction", own.reduction),
            "worst_vs_passive": own.worst_vs_passive,
            "conditions_worse_than_passive": own.worse_than_passive,
            "relative_to_best_constant": own.to_best_constant,
            "J_best_training_seed": own.by_training.min(),
            "J_worst_training_seed": own.by_training.max(),
        }
        for variant, found in result.scores.items()
        for each in result.entrants
        for own in [found[each.name]]
    ]


def _gains(result: Comparison) -> list[dict[str, Any]]:
    """Reduction of mean J against each controller, and the chance of a lower one, by `_GAINS`."""
    controllers = [each.name for each in result.entrants if not each.learned]
    return [
        {
            **{"policy": name, "filter": variant.filter, "force_weight": variant.factor},
            "controller": other,
            **_numbers("reduction", own.reductions[other]),
            **_numbers("improvement", own.improvement[other]),
        }
        for variant, found in result.scores.items()
        for name, own in found.items()
        for other in controllers
    ]


def _matrix(result: Comparison) -> list[dict[str, Any]]:
    rows = []
    for each in result.entrants:
        columns = result.columns(each)
        for r, title in enumerate(each.titles):
            for c, condition in enumerate(result.grid.conditions):
                for s, seed in enumerate(result.config.seeds):
                    about = {"policy": each.name, "training_seed": title, **condition.as_dict(), "seed": seed}
                    rows.append(about | {name: columns[name][r, c, s] for name in MATRIX})
    return rows


def _stabilities(result: Comparison) -> list[dict[str, Any]]:
    return [
        {"policy": title, "critical_speed_kmh": found.critical_speed_kmh, "status": found.status}
        | {RATIO[name]: ratio for name, ratio in found.ratios.items()}
        | {"largest_run": found.largest_run}
        for title, found in result.stability.items()
    ]


def _critical(found: Stability, grid: tuple[float, ...]) -> str:
    if found.critical_speed_kmh is not None:
        return f"{found.critical_speed_kmh:.0f}"
    return f"> {grid[-1]:g}" if found.status == "not reached" else f"< {grid[0]:g}"


def _numbers(name: str, estimate: Estimate) -> dict[str, float]:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}
