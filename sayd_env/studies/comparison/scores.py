"""What the runs of a comparison say about each policy: J against the references, bounds, stability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sayd_env.config.units import Array
from sayd_env.runs.policies import PAPER, TUNED
from sayd_env.stability import Crossing
from sayd_env.studies.comparison.entrants import REFERENCES, Entrant
from sayd_env.studies.comparison.grid import Condition, Variant
from sayd_env.studies.comparison.statistics import (
    Bootstrap,
    Estimate,
    difference,
    geometric_mean,
    geometric_ratio,
    geometric_reduction,
    improvement,
    iqm,
    reduction,
)
from sayd_env.studies.map import Cell, rank

CostsByPolicy = Mapping[str, Array]
"""J by policy, over training seeds, conditions and seeds: shape (R, C, S)."""
STABLE_TO = 400.0
"""Speed up to which a policy has to keep the vehicle stable, km/h: the paper's."""


OPPONENTS = {"paper": PAPER, "tuned": TUNED}
"""Groups of controllers, the best of which a learned policy is to beat."""


class Best(NamedTuple):
    """The best controllers of a group."""

    geometric: str
    """With the lowest geometric mean of J."""
    plain: str
    """With the lowest mean J."""


@dataclass(frozen=True)
class Score:
    """How a policy did by one way of taking J."""

    J: float
    J_by_condition: Array
    """(C,) means over training seeds and seeds."""
    J_by_training_seed: Array
    """(R,)."""
    geometric: Estimate
    """Geometric mean over the conditions of J over that of the best constant command of each."""
    relative_to_passive: Estimate
    """Interquartile mean of J over the passive vehicle's in the same scenario."""
    relative_to_mppt2: Estimate
    """The same over MPPT2's."""
    probability_of_improvement: Mapping[str, Estimate]
    """Probability of a lower J than each controller, MPPT2 and the best of the paper's among them."""
    best_of_paper: str
    """The one of the paper's controllers that take part with the lowest mean J."""
    reduction: Estimate
    """Of mean J against that one, as a share."""
    reduction_by_controller: Mapping[str, Estimate]
    """The same against each controller."""
    difference: Estimate
    """Mean J minus that one's."""
    geometric_by_controller: Mapping[str, Estimate]
    """How far the geometric mean of J lies below that of each controller, as a share."""
    best_of: Mapping[str, Best]
    """The best of the paper's controllers and of the tuned ones, by `OPPONENTS`."""
    worst_vs_passive: float
    """Largest J of a condition over the passive vehicle's."""
    worst_condition: Condition
    conditions_worse_than_passive: int
    """Conditions with a larger J than the passive vehicle's."""
    conditions_of_training_seeds_worse_than_passive: int
    """The same counted for each training seed by itself."""
    relative_to_best_constant: float
    """Mean J over that of the best constant command of each condition."""

    def as_dict(self) -> dict[str, Any]:
        """Keys of a variant in the result."""
        return {name: _plain(value) for name, value in vars(self).items()}


def _plain(value: Any) -> Any:
    """Estimates and conditions, alone or by name, as the result has them."""
    if isinstance(value, Mapping):
        return {name: _plain(each) for name, each in value.items()}
    if isinstance(value, Best):
        return value._asdict()
    return value.as_dict() if isinstance(value, Estimate | Condition) else value


def score(
    name: str,
    costs: CostsByPolicy,
    bound: Array,
    conditions: Sequence[Condition],
    bootstrap: Bootstrap,
    controllers: Sequence[str] = REFERENCES,
) -> Score:
    """Judge a policy by the costs of all, ``passive`` and ``mppt2`` among them.

    `bound` is J of the best constant command of each condition, shape (1, C, S); `controllers` are all that
    were not trained, with which the policy is compared one by one.
    """
    mine, passive, mppt2 = costs[name], costs["passive"], costs["mppt2"]
    groups = best_of(costs, bound)
    best = groups["paper"].plain
    others = (*controllers, *(name for each in groups.values() for name in each))
    against = {other: costs[other] for other in dict.fromkeys(("mppt2", *others))}
    reductions = {other: reduction(mine, theirs, bootstrap) for other, theirs in against.items()}
    by_condition = mine.mean(axis=(0, 2))
    allowed = passive.mean(axis=(0, 2))
    worst = int(np.argmax(by_condition / allowed))
    return Score(
        J=float(mine.mean()),
        J_by_condition=by_condition,
        J_by_training_seed=mine.mean(axis=(1, 2)),
        geometric=geometric_ratio(mine, bound, bootstrap),
        relative_to_passive=iqm(mine / passive, bootstrap),
        relative_to_mppt2=iqm(mine / mppt2, bootstrap),
        probability_of_improvement={
            other: improvement(mine, theirs, bootstrap) for other, theirs in against.items()
        },
        best_of_paper=best,
        reduction=reductions[best],
        reduction_by_controller=reductions,
        difference=difference(mine, costs[best], bootstrap),
        geometric_by_controller={
            other: geometric_reduction(mine, theirs, bootstrap) for other, theirs in against.items()
        },
        best_of=groups,
        worst_vs_passive=float(by_condition[worst] / allowed[worst]),
        worst_condition=conditions[worst],
        conditions_worse_than_passive=int(np.count_nonzero(by_condition > allowed)),
        conditions_of_training_seeds_worse_than_passive=int(np.count_nonzero(mine.mean(axis=2) > allowed)),
        relative_to_best_constant=float(mine.mean() / bound.mean()),
    )


def best_of(costs: CostsByPolicy, bound: Array) -> dict[str, Best]:
    """The best of those controllers of each group that take part; a group without any is left out.

    A controller with parameters of one's own, ``lqg-tuned@folder``, is of the group of its name.
    """
    found = {}
    for group, names in OPPONENTS.items():
        inside = [name for name in costs if name.partition("@")[0] in names]
        if inside:
            found[group] = Best(
                min(inside, key=lambda name: geometric_mean(costs[name], bound)),
                min(inside, key=lambda name: float(costs[name].mean())),
            )
    return found


@dataclass(frozen=True)
class Bound:
    """The best constant command of each condition: what no slower policy can be expected to beat."""

    currents: Array
    """(C,)."""
    costs: Array
    """(1, C, S)."""


def best_constants(currents: Sequence[float], costs: Sequence[Array]) -> Bound:
    """Choose in each condition the command with the lowest mean over its seeds; costs: (1, C, S) of each."""
    table = np.concatenate(costs)
    best = np.argmin(table.mean(axis=2), axis=0)
    chosen = table[best, np.arange(table.shape[1])]
    return Bound(np.asarray(currents, dtype=float)[best], chosen[None])


@dataclass(frozen=True)
class Stability:
    """How stable a policy keeps the vehicle, by EN 14363, medians over the seeds of tracks."""

    critical_speed_kmh: float | None
    """None above or below the speeds that were run."""
    status: str
    """Value of a `Crossing`."""
    by_criterion: Mapping[str, float | None]
    speeds_kmh: tuple[float, ...]
    """Speeds up to `STABLE_TO` that were run."""
    ratios: Mapping[str, float]
    """Largest median at these speeds over each limit."""
    largest_run: float
    """Largest ratio of a single run at these speeds to either limit."""

    @property
    def stable(self) -> bool:
        """Whether no median exceeds a limit at any of these speeds."""
        return bool(self.speeds_kmh) and max(self.ratios.values()) <= 1.0

    def as_dict(self) -> dict[str, Any]:
        """Keys of a policy's stability in the result."""
        return {
            "critical_speed_kmh": self.critical_speed_kmh,
            "status": self.status,
            "by_criterion": self.by_criterion,
            "stable": self.stable,
            "up_to_kmh": max(self.speeds_kmh, default=None),
            "largest_ratios": self.ratios,
            "largest_ratio_of_a_run": self.largest_run,
        }


def stability_of(cell: Cell) -> Stability:
    """Stability of one policy."""
    kmh, crossing = cell.lowest
    low = {
        name: {speed: seeds for speed, seeds in table.items() if speed <= STABLE_TO}
        for name, table in cell.ratios.items()
    }
    return Stability(
        critical_speed_kmh=kmh,
        status=crossing.value,
        by_criterion={name: found[0] for name, found in cell.by_criterion.items()},
        speeds_kmh=tuple(next(iter(low.values()))),
        ratios={
            name: max((float(np.median(seeds)) for seeds in table.values()), default=np.nan)
            for name, table in low.items()
        },
        largest_run=max((max(seeds) for table in low.values() for seeds in table.values()), default=np.nan),
    )


def least_stable(members: Sequence[Stability]) -> Stability:
    """Stability of several trainings together: the lowest critical speed, the largest ratios."""
    lowest = min(members, key=lambda member: rank(member.critical_speed_kmh, Crossing(member.status)))
    return replace(
        lowest,
        speeds_kmh=max((member.speeds_kmh for member in members), key=len),
        ratios={name: max(member.ratios[name] for member in members) for name in lowest.ratios},
        largest_run=max(member.largest_run for member in members),
    )


@dataclass(frozen=True)
class Target:
    """What a learned policy was to reach, and what it did."""

    policy: str
    asked: str
    measured: str
    holds: bool


LEAST_REDUCTION = {"paper": 0.2, "tuned": 0.08}
"""Share by which J of a learned policy is to lie below that of the best controller of each of `OPPONENTS`."""
MOST_ABOVE_PASSIVE = 1.02
"""Largest J of a condition over the passive vehicle's that a learned policy may have."""
GROUP = {"paper": "the best of the paper's four", "tuned": "the best tuned classical controller"}
Parts = Mapping[str, Mapping[Variant, Score]]
"""Scores of a policy by part of the comparison and way of taking J."""


def targets(entrant: Entrant, scores: Parts, stability: Stability, largest: float) -> list[Target]:
    """Judge a learned policy, the mean of its training seeds, by what it was to reach.

    `largest` is the largest ratio to a limit of EN 14363 of all runs in the comparison's conditions,
    reported beside it.
    """
    trainings = len(entrant.members)
    rows = [
        _reduced(part, group, variant, found)
        for group in OPPONENTS
        for part, variants in scores.items()
        for variant, found in variants.items()
    ]
    rows += [
        _never_worse(part, variant, found, trainings)
        for part, variants in scores.items()
        for variant, found in variants.items()
        if variant.factor == 1.0
    ]
    rows.append(_stable(stability, largest))
    return [Target(entrant.name, *row) for row in rows]


def _reduced(part: str, group: str, variant: Variant, found: Score) -> tuple[str, str, bool]:
    asked, best = LEAST_REDUCTION[group], found.best_of[group]
    gain, plain = found.geometric_by_controller[best.geometric], found.reduction_by_controller[best.plain]
    return (
        f"geometric mean of J {100 * asked:g} % below {GROUP[group]}, interval above 0: {part}, "
        f"{_FILTER[variant.filter]}, k_F x {variant.factor:g}",
        f"{100 * gain.value:.1f} % ({100 * gain.low:.1f} to {100 * gain.high:.1f} %) below {best.geometric}; "
        f"plain mean {100 * plain.value:.1f} % ({100 * plain.low:.1f} to {100 * plain.high:.1f} %) below "
        f"{best.plain}",
        gain.value >= asked and gain.low > 0.0,
    )


def _never_worse(part: str, variant: Variant, found: Score, trainings: int) -> tuple[str, str, bool]:
    count, worse = len(found.J_by_condition), found.conditions_of_training_seeds_worse_than_passive
    return (
        f"J of no condition above {MOST_ABOVE_PASSIVE:g} times the passive vehicle's: {part}, "
        f"{_FILTER[variant.filter]}",
        f"worst {found.worst_vs_passive:.2f} times, at {found.worst_condition.text}; above it in "
        f"{found.conditions_worse_than_passive} of {count} conditions, single training seeds in {worse} of "
        f"{count * trainings}",
        found.worst_vs_passive <= MOST_ABOVE_PASSIVE,
    )


def _stable(stability: Stability, largest: float) -> tuple[str, str, bool]:
    speeds = stability.speeds_kmh
    span = f"{min(speeds):g} to {max(speeds):g} km/h" if speeds else f"no speed up to {STABLE_TO:g} km/h"
    return (
        f"stable by EN 14363 up to {STABLE_TO:g} km/h on worn wheels, each training seed",
        f"{span}: largest median {max(stability.ratios.values()):.2f} of a limit, largest run "
        f"{stability.largest_run:.2f}; largest run in the comparison's conditions {largest:.2f}",
        stability.stable and max(speeds) == STABLE_TO,
    )


_FILTER = {"online": "on-line filter", "offline": "off-line filter"}
