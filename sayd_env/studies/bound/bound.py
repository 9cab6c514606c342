"""What could the best possible controller reach? Candidates, then a search from the best."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from sayd_env.config.bound import BoundConfig, SequenceSearch
from sayd_env.envs.cost import mean_cost
from sayd_env.runs.clairvoyant import Found, check_times
from sayd_env.runs.context import RunContext
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.studies.bound.cases import (
    CONSTANT,
    SCHEDULE,
    CandidateRun,
    Candidates,
    Case,
    SearchRun,
    candidates,
    searches,
)
from sayd_env.studies.bound.result import CLAIRVOYANT, FROM, BoundResult, Converged, Reached


def bound(
    config: BoundConfig,
    policies: Sequence[PolicySpec],
    *,
    convergence: bool = False,
    context: RunContext | None = None,
) -> BoundResult:
    """Find the lowest J that is known for each condition, and how far policies are on the way to it.

    Parameters
    ----------
    policies : sequence of PolicySpec
        MPPT2 joins them where it is not among them.
    convergence : bool
        Also search in some of the conditions with other numbers of samples and other horizons.

    Raises
    ------
    ConfigError
        Conditions or times that cannot be, a policy that does not fit.
    StudyError
        A run that diverged, or one that ends in its run-in.
    """
    absent = all(policy.title != FROM for policy in policies)
    specs = (*([policy_spec(FROM)] if absent else []), *policies)
    runs = [CandidateRun(Case.of(config, each), specs, config.constant) for each in config.conditions]
    others = _others(config) if convergence else []
    for settings, run in product((config.search, *others), runs):  # refused before any work
        check_times(settings, run.case.semi_active.config.control_period)
    few = config.convergence.conditions
    context, count = context or RunContext(), len(runs)
    whole = 2 * count + len(others) * len(runs[:few])
    found = context.part(0, whole, "candidates").records(candidates, runs, Candidates)
    begun = list(zip(runs, found, strict=True))
    planned = [_search_run(*each, config.search) for each in begun]
    planned += [_search_run(*each, settings) for settings in others for each in begun[:few]]
    searched = context.part(count, whole, "searches").records(searches, planned, Found)
    reached = tuple(
        _reached(run, each, end) for (run, each), end in zip(begun, searched[:count], strict=True)
    )
    width = len(runs[:few])
    ends = [searched[first : first + width] for first in range(count, len(searched), width)]
    table = [(config.search, searched[:width]), *zip(others, ends, strict=True)] if convergence else []
    without = [each.without_search for each in reached[:few]]
    return BoundResult(
        reached=reached,
        policies=tuple(spec.title for spec in specs),
        convergence=tuple(sorted(_converged(settings, ends, without) for settings, ends in table)),
    )


def _others(config: BoundConfig) -> list[SequenceSearch]:
    """Settings beside the study's own of which the convergence is shown."""
    grid = product(config.convergence.samples, config.convergence.horizons_s)
    found = [config.with_search(samples=samples, horizon_s=horizon) for samples, horizon in grid]
    return [settings for settings in found if settings != config.search]


def _search_run(run: CandidateRun, found: Candidates, settings: SequenceSearch) -> SearchRun:
    (_, _, plan), *others = found.sequences()
    return SearchRun(run, settings, plan, tuple(commands for _, _, commands in others))


def _reached(run: CandidateRun, found: Candidates, searched: Found) -> Reached:
    titles = [policy.title for policy in run.policies]
    names = [*titles, CONSTANT, SCHEDULE]
    costs = [*map(float, found.J), float(found.J_constant[found.best]), found.J_schedule, searched.J]
    return Reached(
        condition=run.case.condition.text,
        J=dict(zip([*names, CLAIRVOYANT], costs, strict=True)),
        derailed=dict(zip(titles, map(bool, found.derailed), strict=True)),
        current=float(found.currents[found.best]),
        section_currents=tuple(map(float, found.section_currents)),
        start=names[found.sequences()[0][0]],
        changes=searched.changes,
        decisions=searched.decisions,
        seconds=searched.seconds,
        period=run.case.semi_active.config.control_period,
        commands=searched.commands,
    )


def _converged(settings: SequenceSearch, found: Sequence[Found], without: Sequence[float]) -> Converged:
    costs = np.array([each.J for each in found])
    return Converged(
        samples=settings.samples,
        horizon_s=settings.horizon_s,
        conditions=len(found),
        J=mean_cost(costs, "arithmetic"),
        ratio=mean_cost(costs / np.array(without), "geometric"),
        seconds=float(np.mean([each.seconds for each in found])),
    )
