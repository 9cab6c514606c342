"""Results of a sweep: swept keys are columns wherever the result is shown."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from rich.console import Console

from sayd_env.cli import main
from sayd_env.config.scenario import Scenario
from sayd_env.config.sweep import variants
from sayd_env.report.columns import Column
from sayd_env.report.files import csv_bytes, document
from sayd_env.runs.context import RunContext
from sayd_env.studies.sweep import SweepResult, over_variants


@dataclass(frozen=True)
class Plain:
    """A result of one number, which has a column of its own for one of the swept keys."""

    scenario: Scenario

    def as_dict(self) -> dict[str, Any]:
        return {"friction": self.scenario.friction, "product": self.scenario.wear * self.scenario.friction}

    def tables(self) -> dict[str, Any]:
        return {"runs": (list(self.as_dict()), [list(self.as_dict().values())])}

    def plots(self) -> dict[str, Callable[[Any], None]]:
        return {"nothing": lambda figure: None}

    def overview(self) -> Any:
        """Worn wheels have a column more."""
        more = {"worn": 1.0} if self.scenario.wear else {}
        columns = [Column("friction", "friction"), Column("product", "product")]
        return [*columns, *(Column(name, name) for name in more)], [self.as_dict() | more]

    def summary(self, console: Console, wide: bool = False) -> None:
        console.print("alone")


def swept(scenario: Scenario, *assignments: str) -> Any:
    found = variants(assignments)
    scenarios = [scenario.model_copy(update=dict(each.swept)) for each in found]
    done: list[tuple[float, float, str]] = []

    def study(chosen: Scenario, run: RunContext) -> Plain:
        run.progress(1, 1)
        return Plain(chosen)

    context = RunContext(progress=lambda *state: done.append(state))
    result = over_variants(found, scenarios, 1, study, context)
    return result, done


def test_swept_keys_are_columns_in_console_csv_and_json(short_scenario: Scenario) -> None:
    result, done = swept(short_scenario, "wear=0,1", "friction=0.2,0.4")
    assert isinstance(result, SweepResult)
    header, rows = result.tables()["runs"]
    assert list(header) == ["wear", "friction", "product"]  # friction once, although the result has it, too
    assert [tuple(row) for row in rows] == [(w, f, w * f) for w in (0, 1) for f in (0.2, 0.4)]
    assert csv_bytes(header, rows).decode().splitlines()[4] == "1,0.4,0.4"
    content = document(result, short_scenario, 0)
    assert content["swept"] == ["wear", "friction"]
    assert [each["set"] for each in content["results"]][3] == {"wear": 1, "friction": 0.4}
    assert content["results"][3]["product"] == pytest.approx(0.4)
    text = io.StringIO()
    result.summary(Console(file=text, width=80))
    lines = [line.split() for line in text.getvalue().splitlines()]
    assert ["wear", "friction", "product", "worn"] in lines
    assert ["0", "0.2", "0", "-"] in lines
    assert ["1", "0.2", "0.2", "1"] in lines
    assert list(result.plots()) == [f"nothing_{k}" for k in range(1, 5)]
    assert done == [(k, 4, f"wear={w}, friction={f}") for k, (w, f) in enumerate(ALL, start=1)]


ALL = [(w, f) for w in (0, 1) for f in (0.2, 0.4)]


def test_nothing_swept_is_the_result_itself(short_scenario: Scenario) -> None:
    result, _ = swept(short_scenario, "friction=0.2")
    assert isinstance(result, Plain)


def test_a_value_that_is_not_allowed_is_refused_before_any_run(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["critical-speed", "--config", "estimates", "--json"]
    assert main([*command, "--set", "wear=0,2"]) == 2
    assert "--set: wear: found 2" in capsys.readouterr().err
    assert main([*command, "--set", "wear=0,1", "--wear", "0.5"]) == 2
    assert "--wear: sets what --set wear does; give one" in capsys.readouterr().err
    many = ",".join(str(k / 1000) for k in range(1000))
    assert main([*command, "--set", f"wear={many}", "--speeds", "300", "--seeds", "20"]) == 2
    assert "make 20,000 runs; at most 10,000 are allowed" in capsys.readouterr().err
    # A line with a speed of its own is run at this one, not at the three by default.
    command = ["evaluate", "--json", "--line", "curve_400", "--set", f"wear={many}", "--seeds", "20"]
    assert main(command) == 2
    assert "make 20,000 runs; at most 10,000 are allowed" in capsys.readouterr().err


def test_evaluate_and_critical_speed_over_a_sweep_are_their_single_runs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    short = ["--config", "estimates", "--set", "assessment.run_in=200", "--set", "assessment.length=600"]

    def shown(*arguments: str) -> Any:
        assert main([*arguments, *short, "--seeds", "1", "--workers", "1", "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    command = ("evaluate", "--speeds", "250")
    both = shown(*command, "--set", "wear=0.25,0.75")
    for value, found in zip((0.25, 0.75), both["results"], strict=True):
        assert found["set"] == {"wear": value}
        assert found["rows"] == shown(*command, "--set", f"wear={value}")["rows"]
    command = ("critical-speed", "--speeds", "250,300")
    both = shown(*command, "--set", "friction=0.2,0.3")
    single = shown(*command, "--set", "friction=0.3")
    assert both["results"][1]["speeds"] == single["speeds"]
    assert both["results"][0]["speeds"] != single["speeds"]
