"""The bound: the lowest J that is known, by construction, and shares of the way to it by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config.bound import load_bound, load_conditions
from sayd_env.runs.policies import policy_specs
from sayd_env.studies.bound.bound import bound
from sayd_env.studies.bound.cases import CONSTANT, SCHEDULE, _held
from sayd_env.studies.bound.result import CLAIRVOYANT, REFERENCE, BoundResult, Reached

LINE = """
sections:
  - {name: calm, length: 60.0, speed_kmh: 250.0, friction: 0.2}
  - {name: fast, length: 100.0, speed_kmh: 250.0, friction: 0.5}
"""
CHANGES = (
    "episode_s=1.0",
    "constant={abreast: 5, rounds: 3, refinements: 1}",
    "search.samples=6",
    "search.iterations=1",
    "search.horizon_s=1.0",
    "search.window_s=0.5",
    "convergence={conditions: 1, samples: [6, 8], horizons_s: [1.0]}",
)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> BoundResult:
    """A stationary condition and a line, of uncalibrated parts, a second each."""
    folder = tmp_path_factory.mktemp("bound")
    (folder / "study.yaml").write_text("base: estimates\n")
    (folder / "line.yaml").write_text(LINE)
    (folder / "toy.yaml").write_text("base: nominal\nstudy: study.yaml\nrun_in: 20.0\n")
    (folder / "conditions.yaml").write_text(
        "conditions:\n  - {seed: 1, speed_kmh: 350.0}\n  - {seed: 2, line: line.yaml}\n"
    )
    config = load_bound(overrides=[*CHANGES, f"environment={folder / 'toy.yaml'}"])
    config = config.of(load_conditions(str(folder / "conditions.yaml")))
    return bound(config, policy_specs(["passive", "constant:0.3"]), convergence=True)


def test_the_search_is_no_worse_than_where_it_starts(
    result: BoundResult,
) -> None:
    assert result.rules == ("mppt2", "passive", "constant:0.3", CONSTANT, SCHEDULE, CLAIRVOYANT, REFERENCE)
    for each in result.reached:
        start = min(each.J[name] for name in (CONSTANT, SCHEDULE, "mppt2", "constant:0.3"))
        assert each.J[CLAIRVOYANT] <= start * (1.0 + 1e-12)


def test_the_best_constant_is_that_of_a_policy(result: BoundResult) -> None:
    """No worse than a constant command that a policy gives, by more than the last step of the search."""
    first, second = result.reached
    assert first.J[CONSTANT] <= first.J["constant:0.3"] * (1.0 + 1e-3)
    assert first.section_currents == (first.current,)
    assert first.J[SCHEDULE] == first.J[CONSTANT]
    assert len(second.section_currents) == 2


def test_convergence_has_a_row_for_each_setting(result: BoundResult) -> None:
    assert [(row.samples, row.horizon_s) for row in result.convergence] == [(6, 1.0), (8, 1.0)]
    assert all(row.ratio <= 1.0 + 1e-12 for row in result.convergence)
    own = result.convergence[0]
    assert pytest.approx(result.reached[0].J[CLAIRVOYANT]) == own.J


def test_commands_of_a_slower_clock_hold() -> None:
    slow = np.array([[0.1, 0.2], [0.3, 0.4]])
    np.testing.assert_array_equal(
        _held(slow, 0.02, 0.01, (5, 2)), [[0.1, 0.2], [0.1, 0.2], [0.3, 0.4], [0.3, 0.4], [np.nan, np.nan]]
    )
    np.testing.assert_array_equal(_held(slow, 0.02, 0.02, (1, 2)), [[0.1, 0.2]])
    for period in (0.025, 0.005):
        assert np.isnan(_held(slow, period, 0.01, (2, 2))).all()


def made(name: str, costs: dict[str, float]) -> Reached:
    return Reached(
        condition=name,
        J=costs,
        derailed={},
        current=0.3,
        section_currents=(0.3,),
        start=CONSTANT,
        changes=1,
        decisions=2,
        seconds=1.0,
        period=0.01,
        commands=np.full((2, 2), 0.3),
    )


def test_shares_by_hand(printed: Callable[[Any], str]) -> None:
    """From 4 and 2 to 1 and 1; a policy at 2 and 1 has log 4 of log 8 and 3 of 4 in the mean."""
    lowest = {CONSTANT: 3.0, SCHEDULE: 3.0, CLAIRVOYANT: 1.0}
    reached = (
        made("first", {"mppt2": 4.0, "own": 2.0, **lowest}),
        made("second", {"mppt2": 2.0, "own": 1.0, **lowest, CLAIRVOYANT: 1.5}),
    )
    result = BoundResult(reached, ("mppt2", "own"))
    shares = {share.rule: share for share in result.shares()}
    assert shares["own"].share == pytest.approx(np.log(4.0) / np.log(8.0))
    assert shares["own"].share_of_mean == pytest.approx(3.0 / 4.0)
    assert shares["own"].least == pytest.approx(2.0 / 3.0)
    assert shares["own"].gap == pytest.approx(2.0**0.5 - 1.0)
    assert shares["own"].lowest == 1
    assert result.won == 1  # in the second, a policy is better than the search
    assert (reached[1].winner, reached[1].reference) == ("own", 1.0)
    assert "the search alone is the lowest in 1 of 2 conditions" in printed(result)


def test_what_cannot_be_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "twice.yaml").write_text("conditions: [{seed: 1}, {seed: 1}]\n")
    (tmp_path / "more.yaml").write_text("conditions: [{seed: 1}]\nsearch: {samples: 3}\n")
    for arguments, said in (
        (["--conditions", str(tmp_path / "twice.yaml")], "duplicate"),
        (["--conditions", str(tmp_path / "more.yaml")], "search"),
        (["--conditions", str(tmp_path / "none.yaml")], "none.yaml"),
        (["--set", "conditions=[{seed: 1, speed_kmh: 5000.0}]"], "5000"),
        (["--set", "search.replan_s=0.123"], "search.replan_s"),
        (["--set", "search.window_s=0.4"], "window_s"),
        (["--set", "convergence.horizons_s=[0.2]"], "convergence.horizons_s"),
    ):
        assert main(["bound", *arguments, "--json"]) == 2
        assert said in capsys.readouterr().err
