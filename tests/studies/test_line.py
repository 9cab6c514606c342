"""Policies along lines: sections against the episode, straight lines against none, curves against hand."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.cli.options import VehicleOptions
from sayd_env.cli.policies import drawn_conditions
from sayd_env.config import ConfigError
from sayd_env.config.environment import load_environment
from sayd_env.config.line import LineConfig
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.units import GRAVITY
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.trace import WHEEL_VERTICAL
from sayd_env.physics.plant import LANES
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.along import LineRecord, Trip, along_lines, line_runs, resolved
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import RunContext
from sayd_env.runs.policies import constant_spec, policy_spec
from sayd_env.runs.rollouts import Run
from sayd_env.runs.schedule import schedule_spec
from sayd_env.studies.evaluate import evaluate
from sayd_env.studies.line import WHOLE, LineResult, _described, evaluate_line

SPEED = 100.0
ENVIRONMENT = load_environment()
CURVE: dict[str, Any] = {
    "sections": [
        {"name": "straight", "length": 600.0, "speed_kmh": 290.0},
        {
            "name": "curve",
            "length": 500.0,
            "speed_kmh": 300.0,
            "radius": 6000.0,
            "turn": "right",
            "cant": 0.06,
            "transition": 200.0,
            "friction": 0.3,
        },
        {"name": "out", "length": 400.0, "speed_kmh": 300.0, "transition": 200.0},
    ]
}
SLOW: dict[str, Any] = {
    "sections": [
        {"name": "approach", "length": 100.0, "speed_kmh": 120.0},
        {
            "name": "curve",
            "length": 700.0,
            "speed_kmh": 120.0,
            "radius": 800.0,
            "turn": "left",
            "cant": 0.1,
            "transition": 120.0,
        },
    ]
}
SMOOTH = "track.irregularity={type: none}"


def lined(content: dict[str, Any]) -> LineConfig:
    return LineConfig.model_validate(content)


@pytest.fixture(scope="module")
def result(short_scenario: Scenario) -> LineResult:
    policies = [policy_spec("constant:0.3"), policy_spec("mppt2")]
    return evaluate_line(short_scenario, lined(CURVE), [SPEED], [3, 4], policies=policies, name="test")


def test_a_straight_as_long_as_a_segment_of_the_spectrum_is_assessed() -> None:
    """At a speed at which its 500 m are no whole number of samples, with more track around for the filter."""
    sections = [
        {"name": "approach", "length": 500.0},
        {
            "name": "curve",
            "length": 300.0,
            "radius": 9000.0,
            "turn": "left",
            "cant": 0.05,
            "transition": 100.0,
        },
    ]
    scenario = load_scenario("nominal", ["assessment.run_in=500"])
    constant = [policy_spec("constant:0.3")]
    found = evaluate_line(scenario, lined({"sections": sections}), [287.0 / 3.6], [3], policies=constant)
    ratios = {row["section"]: row["acceleration_ratio"] for row in found.medians}
    assert 0.0 < ratios["approach"] < 1.0
    assert math.isnan(ratios["curve"])


def test_a_section_is_described_where_it_is_tightest(tmp_path: Path, short_scenario: Scenario) -> None:
    """The curve of R = 800 m in the middle of a measured section; what follows a curve is straight."""
    path = tmp_path / "curve.csv"
    rows = ("0,0,0", "200,0,0", "300,800,100", "600,800,100", "700,0,0", "900,0,0")
    path.write_text("\n".join(("x_m,radius_m,cant_mm", *rows)), encoding="utf-8")
    measured = Trip(resolved(str(path), short_scenario, 30.0), 30.0)
    made = Trip(resolved(lined(CURVE), short_scenario, SPEED), SPEED)
    (section,) = [_described(measured, k, 1.435, 0.3) for k in range(len(measured.line.sections))]
    assert (section["radius_m"], section["cant_m"]) == pytest.approx((800.0, 0.1))
    radii = [_described(made, k, 1.435, 0.3)["radius_m"] for k in range(3)]
    assert radii == [None, pytest.approx(-6000.0), None]


def test_sections_add_up_to_the_environments_rewards(result: LineResult) -> None:
    """J of the whole line, and of the sections over time, is minus the mean reward of the same episode."""
    run = result.runs[0]
    batch = EpisodeBatch(run.environment, 1, scenario=run.scenario, num_threads=1)
    options = {"line": CURVE, "initial_current": 0.0}
    batch.reset([0], [draw_episode(run.environment, run.seed, 0, options)])
    rewards = [float(batch.step(np.full((1, 2), 0.3, np.float32))[1][0]) for _ in range(batch.steps)]
    rows = [row for row in result.rows if (row.policy, row.seed) == ("constant:0.3", run.seed)]
    *sections, whole = rows
    mean = -sum(rewards) / run.environment.episode_s
    assert [row.section for row in rows] == ["straight", "curve", "out", WHOLE]
    assert mean == pytest.approx(whole.J, rel=1e-9)
    assert sum(each.J * each.time_s for each in sections) == pytest.approx(
        mean * run.environment.episode_s, rel=1e-9
    )
    assert sum(row.time_s for row in sections) == pytest.approx(whole.time_s, abs=1e-9)


def test_a_straight_line_is_judged_as_no_line(short_scenario: Scenario) -> None:
    """What a line leaves out is as without one: the first 600 m are those of `evaluate`."""
    line = lined({"sections": [{"length": 600.0}, {"length": 300.0}]})
    policies, environment = [policy_spec("constant:0.2")], load_environment(overrides=["episode_s=6"])
    along = evaluate_line(short_scenario, line, [SPEED], [0], policies=policies).rows[0]
    plain = evaluate(short_scenario, [SPEED], [0], policies=policies, environment=environment).rows[0]
    for name in ("J", "J_acceleration", "J_force"):
        assert getattr(along, name) == pytest.approx(getattr(plain, name), rel=1e-12)
    for name in ("acceleration_ratio", "track_shift_ratio"):
        assert getattr(along, name) == pytest.approx(getattr(plain, name), rel=1e-3)


def test_curves_have_no_sliding_rms_and_all_sections_the_rest(result: LineResult) -> None:
    straight, curve, out, _ = result.rows[:4]
    assert math.isfinite(straight.acceleration_ratio)
    # Behind its transition the last section is straight, but for less than a segment of the spectrum.
    assert math.isnan(curve.acceleration_ratio)
    assert math.isnan(out.track_shift_ratio)
    for row in (straight, curve, out):
        assert 0.0 < row.quotient_ratio < 1.0
        assert 0.0 < row.mean_shift_ratio < 1.0
        assert 0.0 < row.unloading < 1.0
        assert row.derailed == 0.0


def smooth_curve(radius: float, kmh: float, length: float) -> tuple[Run, LineRecord]:
    """A run over a left curve with 100 mm of cant on even track, with closed valves."""
    speed = {"speed_kmh": kmh}
    curve = {"radius": radius, "turn": "left", "cant": 0.1, "transition": 0.3 * length}
    line = lined({"sections": [{"length": 100.0} | speed, {"length": length} | speed | curve]})
    scenario = load_scenario("estimates", ["assessment.run_in=100", "assessment.length=600", SMOOTH])
    (run,) = line_runs([constant_spec(0.0)], scenario, line, [SPEED], [0], ENVIRONMENT)
    return run, along_lines([run])[0]


def test_a_smooth_curve_costs_the_force_that_it_needs() -> None:
    """Without irregularities nothing but the curve moves a damper, and nothing is in the band of hunting."""
    run, record = smooth_curve(800.0, 120.0, 800.0)
    force, curve = record.mean(record.force), record.mean(record.curve_force)
    assert curve > 1e-5
    assert curve == pytest.approx(force, rel=0.05)
    assert record.mean(record.acceleration) < 0.05 * run.scenario.cost.force_weight * force


def test_wheels_unload_as_by_hand() -> None:
    """Moments about the middle of the track: m (a_q h + g y) = 2 dQ b / 2, y of the bodies from the chord.

    The contact points stand up to 10 mm off the 0.75 m of the hand calculation.
    """
    run, record = smooth_curve(5000.0, 300.0, 1600.0)
    assert run.line is not None
    batch = EpisodeBatch(run.environment, 1, scenario=run.scenario, num_threads=1)
    batch.reset([0], [replace(draw_episode(run.environment, 0, 0, {"speed_kmh": 300.0}), line=run.line)])
    model, worst = VehicleModel(run.scenario).multibody, 0.0
    static = np.repeat(model.wheel_load, 2)
    for _ in range(batch.steps):
        batch.step(np.zeros((1, 2), np.float32))
        load = batch.vehicles.trace[0, -1, WHEEL_VERTICAL : WHEEL_VERTICAL + LANES]
        worst = max(worst, float(np.max(1.0 - load / static)))
    q = batch.vehicles.state.view(0).q
    bodies = [each for each in model.instances.values() if each.body.role != "hinged"]
    mass, chord = sum(each.body.mass for each in bodies), np.mean(model.wheelset_x**2) / 2.0 / 5000.0
    lateral = (300.0 / 3.6) ** 2 / 5000.0 - GRAVITY * 0.1 / 1.5
    moment = sum(
        each.body.mass * (lateral * each.position[2] - GRAVITY * (q[each.columns["y"]] - chord))
        for each in bodies
        if each.body.role == "carbody"
    ) + sum(each.body.mass * lateral * each.position[2] for each in bodies if each.body.role != "carbody")
    lost = moment / (mass * GRAVITY * 0.75)
    assert 1.0 - (load / static)[0::2].mean() == pytest.approx(lost, rel=0.08)
    # On a smooth curve the mean over 2 m is the load itself; the leading wheelsets lose more than the mean.
    assert record.unloading[1] == pytest.approx(worst, abs=0.002)


def test_the_train_is_where_the_trip_says(short_scenario: Scenario) -> None:
    line = resolved(lined(CURVE), short_scenario, SPEED)
    trip = Trip(line, 290.0 / 3.6)
    config = load_environment(overrides=[f"episode_s={trip.seconds}", "damper=passive", "run_in=200"])
    batch = EpisodeBatch(config, 1, scenario=short_scenario, num_threads=1)
    batch.reset([0], [draw_episode(config, 0, 0, {"line": CURVE})])
    for _ in range(batch.steps):
        batch.step(np.zeros((1, 2), np.float32))
    assert batch.distance()[0] == pytest.approx(float(trip.distance(trip.seconds)), abs=0.2)
    assert trip.seconds == math.ceil(float(line.time_at(line.length)))  # type: ignore[arg-type]


def test_a_schedule_gives_its_commands_in_turn(short_scenario: Scenario) -> None:
    schedule = schedule_spec([0.1, 0.9], [6.0, 20.0], "by section")
    (run,) = line_runs([schedule], short_scenario, lined(CURVE), [SPEED], [0], ENVIRONMENT)
    (record,) = along_lines([run])
    given = record.command[:, 0]
    assert given[:6] == pytest.approx(0.1)
    assert given[6:] == pytest.approx(0.9)


def test_a_line_is_part_of_what_a_kept_run_depends_on(short_scenario: Scenario, tmp_path: Path) -> None:
    def judged(cant: float) -> RunCache:
        content = json.loads(json.dumps(SLOW))
        content["sections"][1]["cant"] = cant
        cache = RunCache(tmp_path)
        line, context = lined(content), RunContext(cache=cache)
        evaluate_line(short_scenario, line, [SPEED], [0], context=context)
        return cache

    assert [judged(cant).reused for cant in (0.1, 0.1, 0.11)] == [0, 1, 0]


def test_what_a_derailment_cuts_off_is_charged(result: LineResult) -> None:
    """A made-up end in the middle of the second section: the charge of a second for each that is lost."""
    run, record = result.runs[0], result.records[0]
    lost = np.array([0.0, 0.5, 1.0])
    ended = replace(record, lost=lost, ending="derailment")
    charge = run.environment.termination_cost
    more = ended.cost(run.environment, run.scenario.cost) - record.cost(run.environment, run.scenario.cost)
    weight = max(run.scenario.cost.acceleration_weight, 2.0 * run.scenario.cost.force_weight)
    assert more == pytest.approx(charge * weight * lost)


def test_tables_fit_into_80_columns(result: LineResult, printed: Callable[[Any], str]) -> None:
    assert "whole line" in printed(result)
    assert set(result.tables()) == {"runs", "medians", "sections", "seconds"}
    assert result.tables()["sections"][1][1][4] == pytest.approx(-6000.0)
    assert json.dumps(result.as_dict())


def test_speeds_of_a_line_are_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", "--line", "highspeed", "--speeds", "300", "--json"]) == 2
    assert "has speeds of its own" in capsys.readouterr().err
    assert main(["evaluate", "--line", "highsped", "--json"]) == 2
    assert "highspeed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["evaluate", "--track", "german_high"], "--track: has no effect: line '{}' says track itself"),
        (["evaluate", "--friction", "0.2,0.5"], "--friction: has no effect: line '{}' says friction itself"),
        (["simulate", "--gauge", "1440"], "--gauge: has no effect: line '{}' says gauge itself"),
        (["render", "--set", "friction=0.2"], "--set friction: has no effect: line '{}' says friction"),
    ],
)
def test_options_that_a_line_says_itself(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "line.yaml"
    path.write_text("sections: [{length: 500.0, friction: 0.3, gauge: 1.434, track: china}]\n")
    folder = ["--out", str(tmp_path / "out")]
    assert main([*options, "--line", str(path), *folder]) == 2
    assert message.format(path) in " ".join(capsys.readouterr().err.split())


def test_pictures_of_drawn_lines_do_not_draw_what_options_set() -> None:
    setup = load_environment("line")
    left = drawn_conditions(VehicleOptions(friction=0.3), setup)
    assert setup.lines is not None
    assert left.lines == setup.lines.without(["friction"])
    assert left.lines != setup.lines


def test_frictions_beside_a_line_that_has_its_own(short_scenario: Scenario) -> None:
    line = lined({"sections": [{"length": 500.0, "friction": 0.3}]})
    with pytest.raises(ConfigError, match="friction: has no effect: the line says friction itself"):
        evaluate_line(short_scenario, line, [SPEED], friction=[0.2, 0.5])


def test_a_policy_is_named_once(short_scenario: Scenario) -> None:
    with pytest.raises(ConfigError, match="duplicate"):
        evaluate_line(short_scenario, lined(SLOW), [SPEED], policies=[constant_spec(0.1)] * 2)
