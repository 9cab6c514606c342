"""Best constant commands of made-up costs: where they lie, what one for all costs, no run twice."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from sayd_env.cli import main
from sayd_env.config.environment import charge_a_second, load_environment
from sayd_env.config.map import MapConfig, load_map
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import CostParts
from sayd_env.runs.policies import constant_spec
from sayd_env.runs.rollouts import Run
from sayd_env.studies import adaptation as module
from sayd_env.studies.adaptation import ConstantMap, constant_map, halfway, spread_out
from sayd_env.studies.evaluate import evaluate

CONFIG = load_map(
    overrides=[
        *("speeds_kmh=[200.0, 400.0]", "wheels=[{name: new, wear: 0.0}, {name: worn, wear: 1.0}]"),
        *("friction=[0.35]", "gauges=[1.435]", "levels=[null]", "quick.wheels=[new]"),
        *("openings=[0.5, 1.0]", "refinements=4", "force_weights=[0.5, 1.0]"),
    ]
)


def best_of(run: Run) -> float:
    """Command of the lowest J of the made-up costs: by speed and wear."""
    return {(200.0, 0.0): 0.75, (200.0, 1.0): 0.75, (400.0, 0.0): 0.25, (400.0, 1.0): 0.5}[
        round(run.speed * 3.6, 6), run.scenario.wear
    ]


def made_up(runs: list[Run]) -> list[CostParts]:
    """ln J = (V - V_best)^2 whatever the weight, times ten with the wear."""
    found = []
    for run in runs:
        away = run.policy.parameters["current"] - best_of(run)
        found.append(CostParts((1.0 + 9.0 * run.scenario.wear) * math.exp(away**2), 0.0, 0.0))
    return found


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> ConstantMap:
    monkeypatch.setattr(module, "cost_parts", made_up)
    monkeypatch.setattr(module, "overlap", lambda _: 0.0)
    return constant_map(load_scenario(), CONFIG, load_environment(), RunContext())


def test_the_best_command_of_each_condition_is_found_to_a_64th(found: ConstantMap):
    expected = {(200.0, "new"): 0.75, (200.0, "worn"): 0.75, (400.0, "new"): 0.25, (400.0, "worn"): 0.5}
    for weight in (0.5, 1.0):
        for best in found.best(weight):
            place = expected[best.condition.speed_kmh, best.condition.wheel]
            level = 10.0 if best.condition.wheel == "worn" else 1.0
            assert best.current == pytest.approx(place, abs=1 / 64)
            assert best.J_closed == pytest.approx(level * math.exp(place**2))
            assert best.J_open == pytest.approx(level * math.exp((1.0 - place) ** 2))


def test_losses_are_geometric_means_over_the_conditions(found: ConstantMap):
    """The mean of (V - V_best)^2 is lowest at the mean of the best commands, and is their variance there."""
    adaptation = found.adaptation(0.5)
    places = [0.75, 0.75, 0.25, 0.5]
    middle = sum(places) / 4
    assert adaptation.current == pytest.approx(middle, abs=1 / 64)
    variance = sum((place - middle) ** 2 for place in places) / 4
    assert adaptation.loss == pytest.approx(math.expm1(variance), abs=1e-3)
    by_speed = (0.0 + 2 * 0.125**2) / 4  # the middle of 0.25 and 0.5 at 400 km/h
    assert adaptation.loss_by_speed == pytest.approx(math.expm1(by_speed), abs=1e-3)
    assert adaptation.loss_closed == pytest.approx(math.expm1(sum(p**2 for p in places) / 4), abs=1e-3)
    assert adaptation.worst == pytest.approx(math.exp((middle - 0.25) ** 2), abs=1e-2)


def test_json_keeps_its_keys_and_has_all_weights(found: ConstantMap):
    reported = found.as_dict()
    entry = reported["best_constant"][0]
    assert entry["condition"] == {
        **{"speed_kmh": 200.0, "wheel": "new", "wear": 0.0, "gauge": 1.435, "friction": 0.35, "level": None}
    }
    assert {"current", "J"} <= set(entry)
    assert set(entry["by_force_weight"]) == {"0.5", "1"}
    assert [row["force_weight"] for row in reported["adaptation"]] == [0.5, 1.0]
    assert set(found.tables()) == {"best_constant", "adaptation", "adaptation_by_condition"}
    assert set(found.plots()) == {"map_best_constant", "map_single"}
    console = Console(file=io.StringIO(), width=80)
    for listing in found.listings():
        listing.print(console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "speed 200 km/h" in text
    assert "worn, 1435" in text


def test_one_run_serves_all_weights_and_derailments_are_charged():
    """J by two weights from the same parts: they differ by the force's part, and by the charge."""
    environment = load_environment(overrides=["episode_s=10"])
    scenario = load_scenario(overrides=["damper=sayd"])
    study = module._Study(scenario, CONFIG, environment, RunContext())
    condition = CONFIG.conditions()[0]
    study._parts = {condition: {0.0: [CostParts(0.2, 0.4, 0.0), CostParts(0.4, 0.6, 0.25)]}}
    for weight in (0.5, 1.0):
        cost = scenario.cost.model_copy(update={"force_weight": weight})
        expected = 0.3 + weight * 0.5 + 0.125 * charge_a_second(environment, cost)
        assert study._weighted(weight)[condition][0.0] == pytest.approx(expected, rel=1e-12)


def test_commands_that_leave_the_valve_closed_are_tried_once(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "overlap", lambda _: 0.4)
    asked: list[float] = []

    class Noted(RunContext):
        def records(self, work: Any, specs: Any, *_: Any) -> Any:
            asked.extend(run.policy.parameters["current"] for run in specs)
            return made_up(specs)

    constant_map(load_scenario(), CONFIG, load_environment(), Noted())
    assert 0.0 in asked
    assert [current for current in asked if 0.0 < current <= 0.4] == []
    assert len(asked) > 6 * 2 * 3


def test_the_first_commands_lie_at_both_ends_and_beyond_the_overlap():
    assert spread_out([0.0, 0.25, 0.5], 0.4) == {0.0, 0.4, 0.55, 0.7, 1.0}


def test_halves_lie_beyond_the_overlap():
    assert halfway(0.0, [0.0, 0.5, 1.0], 0.4) == [0.45]
    assert halfway(0.5, [0.0, 0.5, 1.0], 0.4) == [0.45, 0.75]
    assert halfway(1.0, [0.0, 0.5, 1.0], 0.0) == [0.75]


@pytest.fixture
def short() -> tuple[Scenario, MapConfig]:
    changes = ["speeds_kmh=[300.0]", "wheels=[{name: LMA, profile: lma, wear: 0.0}]", "gauges=[1.44]"]
    changes += ["friction=[0.35]", "levels=[null]", "seeds=[3]", "openings=[0.5]", "quick.wheels=[LMA]"]
    settings = ("assessment.run_in=100", "assessment.length=600")
    return load_scenario(overrides=settings), load_map(overrides=[*changes, "refinements=0", "episode_s=1.0"])


def test_parts_are_those_of_the_environments_episode(short: tuple[Scenario, MapConfig], tmp_path: Path):
    """Their J is what `evaluate` gives for the same episode; a repeated map runs nothing again."""
    scenario, config = short
    caches = [RunCache(tmp_path), RunCache(tmp_path)]
    environment = load_environment()
    first, again = (constant_map(scenario, config, environment, RunContext(cache=cache)) for cache in caches)
    assert [cache.reused for cache in caches] == [0, 3]
    assert first.as_dict() == again.as_dict()
    (condition,) = config.conditions()
    (row,) = evaluate(
        config.scenario(scenario, condition),
        [300.0 / 3.6],
        [3],
        policies=[constant_spec(1.0)],
        environment=environment.model_copy(update={"episode_s": 1.0}),
    ).rows
    assert first.costs[0.5].by_condition[condition][1.0] == pytest.approx(row.J, rel=1e-9)


def test_the_command_writes_the_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    conditions = tmp_path / "conditions.yaml"
    text = (Path(__file__).parents[2] / "configs/study/map.yaml").read_text(encoding="utf-8")
    text = text.replace("episode_s: 10.0", "episode_s: 1.0").replace(
        "wheels: [LMA, worn], seeds: 1", "wheels: [worn], seeds: 1"
    )
    conditions.write_text(text.replace("openings: [0.12, 0.4, 1.0]", "openings: [0.5]"))
    settings = ["--set", "assessment.run_in=100", "--set", "assessment.length=600", "--config", "estimates"]
    grid = ["--quick", "--wear", "1", "--friction", "0.4", "--speeds", "300,400", "--policies", "passive"]
    command = ["map", *settings, *grid, "--conditions", str(conditions), "--json"]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [entry["condition"]["speed_kmh"] for entry in found["best_constant"]] == [200.0, 400.0]
    assert all(entry["J"] <= min(entry["J_closed"], entry["J_open"]) for entry in found["best_constant"])
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"best_constant.csv", "adaptation.csv", "map_best_constant.png", "map_single.png"} <= names
