"""Rows S1 to S6 at several control periods: judged as in the table of claims, each run once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from sayd_env.config import ConfigError
from sayd_env.config.environment import load_environment
from sayd_env.config.reproduction import load_reproduction
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.controlled import ControlledRuns
from sayd_env.stability import Limits
from sayd_env.studies.paper.control_periods import period_claims, period_rows
from sayd_env.studies.paper.controlled_claims import controlled_claims, skyhook_claims, skyhook_runs
from sayd_env.studies.paper.judged import Vehicle


def test_the_skyhook_rows_need_both_skyhooks_and_mppt_at_400():
    runs = skyhook_runs()
    assert {policy for policy, *_ in runs} == {"mppt1", "mppt2", "skyhook-onoff", "skyhook-continuous"}
    assert len(runs) == len(set(runs)) == 2 * 5 + 2
    assert {current for *_, current in runs} == {0.0}


def test_the_rows_are_judged_as_among_all_others(paper_runs: Callable[..., ControlledRuns], limits: Limits):
    everything = paper_runs()
    wanted = {(policy, round(speed * 3.6), current) for policy, speed, current in skyhook_runs()}
    few = ControlledRuns(
        run for run in everything.runs if (run.policy, round(run.speed * 3.6), run.initial_current) in wanted
    )
    among_all = [claim for claim in controlled_claims(everything, limits) if claim.id.startswith("S")]
    assert skyhook_claims(few, limits) == among_all


@pytest.mark.slow
def test_periods_stand_side_by_side_and_are_run_once(tmp_path: Path):
    scenario = load_scenario("estimates", ("assessment.run_in=200", "assessment.length=600"))
    caches = [RunCache(tmp_path), RunCache(tmp_path)]
    vehicle, study = Vehicle(scenario, load_environment()), load_reproduction()
    first = period_claims(vehicle, study, [0], (0.005, 0.01), RunContext(cache=caches[0]))
    rows = [(row["id"], row["control_period_s"]) for row in period_rows(first)]
    assert rows[:4] == [("S1", 0.005), ("S1", 0.01), ("S2", 0.005), ("S2", 0.01)]
    second = period_claims(vehicle, study, [0], (0.01, 0.02), RunContext(cache=caches[1]))
    assert [cache.reused for cache in caches] == [0, len(skyhook_runs())]
    assert second[0.01] == first[0.01]


@pytest.mark.parametrize(
    ("periods", "problem"), [((0.01, 0.01), "different ones"), ((0.003,), "divides a second"), ((), "one")]
)
def test_periods_that_cannot_be_are_refused(
    periods: tuple[float, ...], problem: str, short_scenario: Scenario
):
    with pytest.raises(ConfigError, match=problem):
        period_claims(Vehicle(short_scenario, load_environment()), load_reproduction(), [0], periods)
