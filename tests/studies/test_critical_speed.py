"""The critical speed: from known crossings to the printed keys, and the sweep behind it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import Scenario
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.files import json_text
from sayd_env.runs.context import RunContext
from sayd_env.runs.controlled import controlled_runs
from sayd_env.runs.executors import ExecutorChoice
from sayd_env.runs.passive import PassiveRun, Sweep, assessed, sweep
from sayd_env.runs.policies import policy_spec
from sayd_env.stability import Limits
from sayd_env.studies import critical_speed
from sayd_env.studies.critical_speed import (
    CriticalSpeedResult,
    default_speeds,
    find_critical_speed,
    histories,
)

KMH = [320.0, 350.0, 370.0, 395.0, 420.0, 445.0]
NAMES = ("front.leading", "front.trailing", "rear.leading", "rear.trailing")


@pytest.fixture
def result(
    synthetic: Callable[..., Sweep], limits: Limits, short_scenario: Scenario
) -> Callable[..., CriticalSpeedResult]:
    """Make a result with known crossings (km/h) for each seed."""

    def result(acceleration: list[float], force: list[float]) -> CriticalSpeedResult:
        grid = synthetic(KMH, acceleration, force)
        return CriticalSpeedResult(short_scenario, grid, limits, NAMES, ())

    return result


Make = Callable[..., CriticalSpeedResult]


def test_the_lower_criterion_decides_and_seeds_count_by_their_median(result: Make):
    """Medians of lines of one slope: the crossing of the median is the median of the crossings."""
    keys = result([326.0, 331.0, 345.0], [350.0, 361.0, 390.0]).as_dict()
    assert keys["critical_speed_kmh"] == pytest.approx(331.0)
    assert keys["criterion"] == "acceleration"
    by = keys["by_criterion"]
    assert by["track_shift_force"]["critical_speed_kmh"] == pytest.approx(361.0)
    # The quantiles are values of seeds, not between them: a seed without a crossing counts as infinite.
    assert by["acceleration"]["over_seeds_kmh"] == pytest.approx([326.0, 345.0])
    assert not by["acceleration"]["sensitive_to_grid"]


def test_the_track_shift_force_may_decide(result: Make):
    keys = result([380.0], [361.0]).as_dict()
    assert keys["criterion"] == "track_shift_force"
    assert keys["critical_speed_kmh"] == pytest.approx(361.0)


def test_no_crossing_in_the_range_is_null(result: Make):
    keys = result([500.0], [500.0]).as_dict()
    assert keys["critical_speed_kmh"] is None
    assert keys["criterion"] is None
    assert keys["by_criterion"]["acceleration"]["status"] == "not_reached"


def test_a_limit_exceeded_at_the_lowest_speed_is_null_with_its_criterion(result: Make):
    keys = result([310.0], [361.0]).as_dict()
    assert keys["critical_speed_kmh"] is None
    assert keys["criterion"] == "acceleration"
    assert keys["by_criterion"]["acceleration"]["status"] == "below_grid"


def test_keys_of_json_are_those_that_scripts_rely_on(result: Make):
    keys = json.loads(json_text(result([326.0, 331.0, 345.0], [350.0, 361.0, 390.0]).as_dict()))
    assert {"critical_speed_kmh", "criterion", "limits", "speeds", "seeds"} <= set(keys)
    assert keys["limits"] == pytest.approx({"acceleration_rms": 5.44, "track_shift_rms_kn": 30.0})
    assert keys["seeds"] == [0, 1, 2]
    assert [row["speed_kmh"] for row in keys["speeds"]] == pytest.approx(KMH)
    row = keys["speeds"][1]
    assert row["acceleration_rms"] == pytest.approx(
        [5.44 * (1 + 19 / 200) * share for share in (1.0, 0.9, 0.9, 0.9)]
    )
    assert row["track_shift_rms_kn"] == pytest.approx(
        [30.0 * (1 - 11 / 200) * share for share in (0.8, 1.0, 0.8, 1.0)]
    )
    assert row["dominant_frequency_hz"] == [4.0] * 4


def test_a_kink_makes_the_crossing_sensitive_to_the_grid(result: Make):
    """Without its second speed the grid crosses at 349.5 km/h instead of 335: more than 8 km/h away."""
    made = result([330.0], [500.0])
    ratio = np.array([0.9, 1.1, 1.12, 1.13, 1.14, 1.15])
    made.sweep.acceleration[:] = 5.44 * ratio[:, None, None]
    keys = made.as_dict()["by_criterion"]["acceleration"]
    assert keys["critical_speed_kmh"] == pytest.approx(320 + 30 * 0.1 / 0.2)
    thinned = 320 + 50 * 0.1 / 0.22
    assert keys["sensitive_to_grid"] is (thinned - 335 > 8)


def test_the_default_grid_depends_on_the_wear():
    assert np.array(default_speeds(0.0)) * 3.6 == pytest.approx([280, 310, 340, 355, 370, 385, 400])
    assert np.array(default_speeds(1.0)) * 3.6 == pytest.approx(KMH)


def test_limits_of_the_papers_vehicle_are_those_of_the_paper(short_model: VehicleModel):
    """Wang et al. (2022): 30 kN and 5.44 m/s2."""
    limits = model_limits(short_model)
    assert limits.track_shift_force == pytest.approx(30e3, rel=1e-3)
    assert limits.acceleration == pytest.approx(5.44, rel=1e-3)


SPEEDS = (300 / 3.6, 400 / 3.6)


def test_a_sweep_is_its_single_runs_whatever_the_workers(short_scenario: Scenario):
    contexts = (RunContext(ExecutorChoice(workers=n)) for n in (1, 3))
    one, many = (sweep(short_scenario, SPEEDS, (3, 5, 8), context) for context in contexts)
    assert one.acceleration.shape == (2, 3, 4)
    assert one.seeds == (3, 5, 8)
    for name in ("frequency", "frequency_force", "acceleration", "track_shift"):
        assert np.array_equal(getattr(one, name), getattr(many, name))
    (single,) = assessed([PassiveRun(short_scenario, SPEEDS[1], 5)])
    assert np.array_equal(one.track_shift[1, 1], single.track_shift)
    assert np.array_equal(one.frequency[1, 1], single.frequency)


def test_a_policy_commands_semi_active_dampers(short_scenario: Scenario):
    """They replace the passive ones; the history is that of a run of the sweep."""
    found, other = (
        find_critical_speed(short_scenario, [80.0, 100.0], [3], policy=policy_spec(name))
        for name in ("constant:0", "skyhook-onoff")
    )
    assert found.scenario.damper.type == other.scenario.damper.type == "sayd"
    (history,) = found.histories
    assert history.rms.max() == pytest.approx(found.sweep.acceleration[0, 0].max(), rel=1e-9)
    assert found.sweep.acceleration.shape == (2, 1, 4)
    (run,) = controlled_runs(
        short_scenario, load_environment(), [3], [("constant:0", 100.0, 0.0)], RunContext()
    ).runs
    assert (found.sweep.acceleration[1, 0] == run.acceleration).all()
    assert (found.sweep.acceleration != other.sweep.acceleration).all()


def test_where_the_vehicle_derails_the_limit_is_exceeded(result: Make):
    """Its maxima are infinite: the crossing lies just above the last speed without a derailment."""
    derailed = result([900.0] * 3, [900.0] * 3)
    derailed.sweep.acceleration[KMH.index(395.0) :] = np.inf
    speed = derailed.as_dict()["by_criterion"]["acceleration"]["critical_speed_kmh"]
    assert 370.0 < speed < 371.0


def test_the_printed_value_is_the_one_that_is_judged(result: Make):
    """Wheelsets of single runs differ: the median of the largest is no largest median."""
    made = result([330.0] * 3, [360.0] * 3)
    made.sweep.acceleration[0] = np.diag([5.6, 5.6, 5.6, 5.6])[:3]
    row = made._trends()[0]
    assert row["acceleration_rms"] == 5.6
    assert row["acceleration_ratio"] == pytest.approx(5.6 / made.limits.acceleration)


def test_a_history_is_that_of_the_slowest_run_without_a_derailment(
    short_scenario: Scenario, monkeypatch: pytest.MonkeyPatch
):
    policy = policy_spec("constant:0")
    whole = controlled_runs

    def derailed(*args: Any) -> Any:
        runs = whole(*args)
        for run in runs.runs:
            run.acceleration[:] = np.inf if run.speed not in shown else run.acceleration
        return runs

    monkeypatch.setattr(critical_speed, "controlled_runs", derailed)
    for shown in ([100.0], []):
        found = find_critical_speed(short_scenario, [80.0, 100.0], [3], policy=policy)
        assert [history.speed for history in found.histories] == shown
        assert ("time_history" in found.plots()) == bool(shown)


def test_progress_counts_every_run_once(short_scenario: Scenario):
    progress: list[tuple[float, float]] = []
    context = RunContext(
        ExecutorChoice(workers=4), progress=lambda done, total, what="": progress.append((done, total))
    )
    result = find_critical_speed(short_scenario, SPEEDS, (0, 1), context=context)
    assert progress == [(1, 4), (2, 4), (3, 4), (4, 4)]
    # A history shows the wheelset with the highest RMS, of the first seed.
    for history in result.histories:
        shown = result.sweep.acceleration[SPEEDS.index(history.speed), 0]
        assert history.wheelset == result.wheelsets[int(np.argmax(shown))]
        assert history.rms.max() == pytest.approx(shown.max(), rel=1e-12)


def test_a_history_is_shown_below_and_above_the_critical_speed(short_scenario: Scenario):
    """At the lowest speed, and at the first one whose median is above the limit."""
    grid = sweep(short_scenario, SPEEDS, (0, 1))
    peaks = np.median(grid.acceleration.max(axis=-1), axis=1)
    for limit, speeds in ((0.5 * peaks.sum(), SPEEDS), (2.0 * peaks.max(), SPEEDS[:1])):
        shown = histories(short_scenario, grid, Limits(1.0, float(limit)), RunContext())
        assert [(h.speed, h.seed) for h in shown] == [(v, 0) for v in speeds]


def test_a_speed_out_of_range_is_refused_before_any_work(
    short_scenario: Scenario, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delattr(RunContext, "records")
    with pytest.raises(ConfigError, match="speed 900 km/h is outside the range"):
        sweep(short_scenario, (300 / 3.6, 900 / 3.6), (0,))


def test_the_command_prints_the_keys_and_writes_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    command = [
        "critical-speed",
        "--config",
        "estimates",
        "--speeds",
        "300,330",
        "--seed",
        "7",
        "--seeds",
        "2",
    ]
    settings = ["--set", "assessment.run_in=200", "--set", "assessment.length=600"]
    assert main([*command, *settings, "--json", "--out", str(tmp_path)]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["seeds"] == [7, 8]
    assert content["seed"] == 7
    assert content["config"]["assessment"]["length"] == 600
    files = {path.name for path in tmp_path.iterdir()}
    tables = {"runs.csv", "critical_speeds.csv"}
    assert files == {"result.json", *tables, "critical_speed.png", "time_history.png", "runs"}
    runs = np.genfromtxt(tmp_path / "runs.csv", delimiter=",", names=True, dtype=None, encoding=None)
    at = (runs["speed_kmh"] == 300.0) & (runs["wheelset"] == "rear.trailing")
    median = np.median(runs["acceleration_rms"][at])
    assert content["speeds"][0]["acceleration_rms"][3] == pytest.approx(median)


def test_critical_speeds_by_creep_law(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """Each law as a study of its own with contact.creep_law gives it; the study's own law is run once."""
    command = ["critical-speed", "--config", "estimates", "--speeds", "300,400", "--seeds", "1", "--json"]
    settings = ["--set", "assessment.run_in=200", "--set", "assessment.length=600"]
    out = ["--out", str(tmp_path)]
    assert main([*command, *settings, *out, "--creep-laws", "table,polach"]) == 0
    both = capsys.readouterr()
    content = json.loads(both.out)
    assert set(content["by_creep_law"]) == {"table", "polach"}
    assert content["config"]["contact"]["creep_law"] == "table"
    assert content["by_creep_law"]["table"]["by_criterion"] == content["by_criterion"]
    assert "critical speed by creep law" in both.err + both.out
    assert main([*command, *settings, "--set", "contact.creep_law=polach"]) == 0
    alone = json.loads(capsys.readouterr().out)
    for key in ("critical_speed_kmh", "criterion", "by_criterion"):
        assert content["by_creep_law"]["polach"][key] == alone[key]
    assert "by_creep_law" not in alone
    assert alone["speeds"] != content["speeds"]
    laws = np.genfromtxt(tmp_path / "creep_laws.csv", delimiter=",", names=True, dtype=None, encoding=None)
    assert list(laws["creep_law"]) == ["table", "table", "polach", "polach"]


@pytest.mark.parametrize(
    ("laws", "message"),
    [(["kalker"], "kalker: unknown creep law"), (["table"] * 2, "'table' is named twice")],
)
def test_creep_laws_that_are_none_are_refused(short_scenario: Scenario, laws: list[str], message: str):
    with pytest.raises(ConfigError, match=message):
        find_critical_speed(short_scenario, SPEEDS, (0,), creep_laws=laws)
