"""What adaptation is worth along lines: bounds that hold by construction, and one that has to be run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config.hindsight import load_hindsight
from sayd_env.runs.policies import policy_spec
from sayd_env.studies.hindsight import FOR_ALL, HINDSIGHT, SINGLE, HindsightResult, OnLine, hindsight

LINE = """
sections:
  - {name: calm, length: 700.0, speed_kmh: 200.0, friction: 0.25, gauge: 1.44}
  - {name: fast, length: 1500.0, speed_kmh: 250.0, acceleration: 0.7, friction: 0.5, gauge: 1.432}
"""


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> HindsightResult:
    path = tmp_path_factory.mktemp("lines") / "line.yaml"
    path.write_text(LINE)
    changes = [f"lines=[{path}]", "drawn.seeds=[]", "openings=[0.12, 0.4]", "refinements=0"]
    return hindsight(load_hindsight(overrides=changes), [policy_spec("mppt2")])


def test_hindsight_is_a_bound(result: HindsightResult) -> None:
    """The sections' lowest costs bound every constant command; run as a schedule, they do within 2 %."""
    (line,) = result.lines
    assert line.composed <= line.costs[SINGLE] <= line.costs[FOR_ALL]
    assert line.costs[HINDSIGHT] == pytest.approx(line.composed, rel=0.02)
    assert line.costs[HINDSIGHT] <= 1.02 * line.costs[SINGLE]
    for costs in line.constants.values():
        assert np.dot(costs, line.time) / line.time.sum() >= line.costs[SINGLE] * (1.0 - 1e-12)


def test_gaps_are_geometric_means(printed: Callable[[Any], str]) -> None:
    """Made-up lines: 10 % and 60 % more make sqrt(1.1 * 1.6) - 1."""
    time = np.array([10.0, 30.0])

    def made(name: str, factor: float) -> OnLine:
        J = {HINDSIGHT: np.array([0.1, 0.2]), SINGLE: factor * np.array([0.1, 0.2])}
        J |= {FOR_ALL: J[SINGLE], "mppt2": J[SINGLE]}
        constants = {0.0: J[SINGLE], 1.0: np.array([0.5, 0.15])}
        return OnLine(name, ("a", "b"), time, constants, (0.0, 1.0), J, dict.fromkeys(J, 0))

    result = HindsightResult((made("first", 1.1), made("second", 1.6)), 0.0, ("mppt2",))
    gaps = {gap.rule: gap for gap in result.gaps()}
    assert gaps[HINDSIGHT].gap == pytest.approx(0.0)
    assert gaps[SINGLE].gap == pytest.approx((1.1 * 1.6) ** 0.5 - 1.0)
    assert gaps["mppt2"].worst == pytest.approx(0.6)
    assert gaps["mppt2"].by_section == pytest.approx((1.1 * 1.6) ** 0.5 - 1.0)
    assert result.lines[0].costs[HINDSIGHT] == pytest.approx((0.1 * 10 + 0.2 * 30) / 40)
    # By hand: 0.11 of the first section, 0.15 of the second.
    assert result.lines[0].composed == pytest.approx((0.11 * 10 + 0.15 * 30) / 40)
    assert "mppt2" in printed(result)
    assert result.notes == []
    (note,) = HindsightResult((made("calm", 0.9), made("rough", 1.1)), 0.0, ("mppt2",)).notes
    assert note.startswith("calm: one command costs less")


def test_lines_that_cannot_be_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for change, said in (
        ("lines=[nowhere]", "nowhere"),
        ("drawn.environment=nominal", "draws no lines"),
        ("speed_kmh=5000", "speed_kmh"),
        ("seeds=[1, 1]", "duplicate"),
    ):
        assert main(["hindsight", "--set", change, "--json"]) == 2
        assert said in capsys.readouterr().err
