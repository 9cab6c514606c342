"""Maps over wear and friction: crossings of made-up ratios, runs that are not repeated."""

from __future__ import annotations

import io
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.metrics import Row
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.runs.rollouts import Run
from sayd_env.studies import map as module
from sayd_env.studies.map import MapGrid, MapResult, stability_map

GRID = MapGrid(
    wear=(0.0, 1.0),
    friction=(0.2, 0.4),
    speeds=tuple(v / 3.6 for v in (280, 320, 360, 400)),
)


def made_up(run: Run) -> Row:
    """Acceleration reaches its limit at 340 - 40 wear km/h, 300 if worn; track shift force 20 km/h later."""
    kmh, wear = run.speed * 3.6, run.scenario.wear
    ratio = 1.0 + (kmh - (340.0 - 40.0 * wear)) / 100.0 + 0.01 * (run.seed - 1)
    others = dict.fromkeys((field.name for field in fields(Row)), 0.0) | {"ending": None}
    made: dict[str, Any] = {
        "acceleration_ratio": ratio,
        "track_shift_ratio": ratio - 0.2,
    }
    return Row(**others | made | {"policy": run.policy.title})


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, float, float, float, int]]:
    """What is run, with a made-up vehicle in place of the simulation."""
    asked: list[tuple[str, float, float, float, int]] = []

    def rows(runs: list[Run], *_: Any) -> list[Row]:
        for run in runs:
            where = run.scenario.wear, run.scenario.friction, round(run.speed * 3.6, 6)
            asked.append((run.policy.title, *where, run.seed))
        return [made_up(run) for run in runs]

    monkeypatch.setattr(module, "rows", rows)
    return asked


@pytest.fixture
def result(runs: list[Any], short_scenario: Scenario) -> MapResult:
    return stability_map(short_scenario, [policy_spec("mppt1")], range(3), grid=GRID)


def test_the_critical_speed_is_that_of_the_median_seed(result: MapResult):
    found = result.as_dict()
    assert found["critical_speed_kmh"]["mppt1"] == [[pytest.approx(340)] * 2, [pytest.approx(300)] * 2]
    force = found["by_criterion"]["track_shift_force"]["mppt1"]
    assert force == [[pytest.approx(360)] * 2, [pytest.approx(320)] * 2]
    assert found["status"]["mppt1"] == [["found", "found"]] * 2


def test_the_interval_of_the_crossing_is_halved(
    result: MapResult, runs: list[tuple[str, float, float, float, int]]
):
    """At wear 0 acceleration crosses between 320 and 360, force between 320 or 360 and 400 km/h."""
    speeds = sorted(kmh for *where, kmh, seed in runs if (*where, seed) == ("mppt1", 0.0, 0.2, 0))
    assert speeds[:2] == [280, 320]
    assert 340 in speeds
    assert len(runs) == len(set(runs))


def test_few_seeds_are_a_look(runs: list[Any], result: MapResult, short_scenario: Scenario):
    enough = stability_map(short_scenario, [PolicySpec("mppt1")], range(5), grid=GRID)
    for found, is_look in ((result, True), (enough, False)):
        console = Console(file=io.StringIO(), width=120)
        found.summary(console)
        assert ("a look, not a verdict" in console.file.getvalue()) == is_look  # type: ignore[attr-defined]


def test_beyond_the_grid_is_reported(runs: list[Any], short_scenario: Scenario):
    high = MapGrid(wear=(0.0,), friction=(0.3,), speeds=(380 / 3.6, 400 / 3.6))
    low = MapGrid(wear=(0.0,), friction=(0.3,), speeds=(280 / 3.6, 300 / 3.6))
    for grid, status in ((high, "below_grid"), (low, "not_reached")):
        found = stability_map(short_scenario, [PolicySpec("mppt1")], [1], grid=grid)
        assert found.as_dict()["status"] == {"mppt1": [[status]]}
        assert found.as_dict()["critical_speed_kmh"] == {"mppt1": [[None]]}


def test_one_speed_has_no_crossing(short_scenario: Scenario):
    with pytest.raises(ConfigError, match="at least two speeds"):
        stability_map(short_scenario, [PolicySpec("mppt1")], [0], grid=MapGrid(speeds=(100.0,)))


def test_a_repeated_map_runs_nothing_again(tmp_path: Path):
    """Also where the second one asks for more."""
    scenario = load_scenario("estimates", ("assessment.run_in=200", "assessment.length=600"))
    grid = MapGrid(wear=(1.0,), friction=(0.4,), speeds=(100.0, 105.0))
    specs = [policy_spec("constant:1")]
    caches = [RunCache(tmp_path), RunCache(tmp_path)]
    first = stability_map(scenario, specs, [0], grid=grid, context=RunContext(cache=caches[0]))
    stability_map(scenario, specs, [0, 1], grid=grid, context=RunContext(cache=caches[1]))
    assert [cache.reused for cache in caches] == [0, 2]
    alone = stability_map(scenario, specs, [0], grid=grid)
    assert alone.as_dict() == first.as_dict()


def test_the_command_writes_maps(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    settings = ["--set", "assessment.run_in=200", "--set", "assessment.length=600", "--config", "estimates"]
    grid = ["--quick", "--wear", "1", "--friction", "0.4", "--speeds", "300,400", "--no-constants"]
    command = ["map", *settings, *grid, "--policies", "passive", "--json", "--out", str(tmp_path)]
    assert main(command) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["wear"], found["friction"], found["best_constant"]) == ([1.0], [0.4], [])
    kmh, status = found["critical_speed_kmh"]["passive"], found["status"]["passive"]
    assert len(kmh) == len(kmh[0]) == len(status) == 1
    assert (kmh[0][0] is not None) == (status[0][0] == "found")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"runs", "result.json", "critical_speed.csv", "map_critical_speed.png", "report.html"}
