"""Evaluation of policies: cost against SciPy and against the environment's rewards, valves, derailments."""

from __future__ import annotations

import io
import json
import math
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from rich.console import Console
from scipy.signal import butter, get_window, sosfiltfilt

import sayd_env  # noqa: F401 - registers the environments
from sayd_env import baselines
from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.environment import load_environment
from sayd_env.config.reward import with_reward
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.units import Array
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.simulator import RUN_OUT, Simulator, Telemetry, VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.runs.executors import ExecutorChoice
from sayd_env.runs.metrics import switchings
from sayd_env.runs.passive import assessed_run
from sayd_env.runs.policies import policy_spec
from sayd_env.studies.evaluate import AVERAGED, EvaluateResult, Row, evaluate

SPEED = 360 / 3.6
RUN_IN, LENGTH, RATE = 200.0, 600.0, 1000.0
SAMPLES = 9490
"""What the environment simulates: one control period less than the simulator, behind the assessed length."""


def spectrum(signal: Array, grid: Array) -> Array:
    """Mean square of the harmonic at each frequency: Hann windows of 500 m, half overlapping."""
    distance = np.arange(len(signal)) * SPEED / RATE
    power = np.zeros(len(grid))
    starts = np.arange(RUN_IN, RUN_IN + LENGTH - 500 + 1e-6, 250.0)
    for start in starts:
        piece = signal[(distance >= start - 1e-9) & (distance < start + 500 - 1e-9)]
        window = get_window("hann", len(piece))
        piece = piece - np.average(piece, weights=window)
        wave = np.exp(-2j * np.pi * np.outer(grid, np.arange(len(piece))) / RATE)
        power += 2 * np.abs(wave @ (piece * window) / window.sum()) ** 2
    return power / len(starts)


def acceleration_cost(signals: Array, limit: float) -> float:
    """Eq. (27): (psi_y / y_lim)^2, one f_0 for a bogie's two points, f_0 +- 2 Hz, mean of both bogies."""
    grid = np.linspace(1.5, 12.0, 211)
    distance = np.arange(len(signals)) * SPEED / RATE
    inside = (distance >= RUN_IN) & (distance < RUN_IN + LENGTH)
    costs = []
    for bogie in (0, 1):
        pair = signals[:, 2 * bogie : 2 * bogie + 2]
        f0 = grid[np.argmax(sum(spectrum(channel, grid) for channel in pair.T))]
        band = (max(f0 - 2.0, 0.5), f0 + 2.0)
        sections = butter(4, band, "bandpass", fs=RATE, output="sos")
        filtered = sosfiltfilt(sections, pair, axis=0, padtype="even", padlen=3000)
        costs.append(np.mean(filtered[inside] ** 2) / limit**2)
    return float(np.mean(costs))


@pytest.fixture(scope="module")
def result(short_scenario: Scenario) -> EvaluateResult:
    # Episodes short enough for the track of a short assessed run.
    environment = load_environment(overrides=["episode_s=4"])
    return evaluate(short_scenario, [SPEED], range(2), environment=environment)


def telemetry(model: VehicleModel, seed: int) -> Telemetry:
    """All signals of the run, by the simulator of a vehicle by itself."""
    return Simulator(model, SPEED, seed).run(RUN_IN + LENGTH + RUN_OUT)


def test_the_cost_off_line_is_that_of_eq_27_from_the_telemetry(
    result: EvaluateResult, short_model: VehicleModel
):
    cost = short_model.scenario.cost
    for row in result.rows:
        signals = telemetry(short_model, row.seed)
        limit = model_limits(short_model).acceleration
        acceleration = acceleration_cost(signals.acceleration[:SAMPLES], limit)
        distance = np.arange(len(signals.time)) * SPEED / RATE
        force = signals.damper_force[(distance >= RUN_IN) & (distance < RUN_IN + LENGTH)]
        assert force.shape[1] == 8
        assert row.force_rms_n == pytest.approx(np.sqrt(np.mean(force**2)), rel=1e-12)
        assert row.force_peak_n == np.abs(force).max()
        forces = np.mean(force**2) / cost.force_reference**2
        total = cost.acceleration_weight * acceleration + cost.force_weight * forces
        assert row.J_offline == pytest.approx(total, rel=1e-9)


def test_the_ratios_are_those_of_the_assessment(result: EvaluateResult, short_model: VehicleModel):
    bounds = model_limits(short_model)
    for row in result.rows:
        signals = telemetry(short_model, row.seed)
        both = signals.acceleration[:SAMPLES], signals.track_shift[:SAMPLES]
        run = assessed_run(*both, SPEED, row.seed, short_model.scenario.assessment)
        assert row.acceleration_ratio == run.acceleration.max() / bounds.acceleration
        assert row.track_shift_ratio == run.track_shift.max() / bounds.track_shift_force


SETTINGS = ("assessment.length=600", "friction=0.35")


def episode(policy: str, seed: int, **keywords: Any) -> float:
    """Sum of the rewards of an episode of the environment, run as its users do."""
    name, _, current = policy.partition(":")
    damper = "passive" if name == "passive" else "sayd"
    keywords.setdefault("settings", SETTINGS)
    env = gym.make("SAYD/Nominal-v1", damper=damper, speed_kmh=SPEED * 3.6, **keywords)
    agent = baselines.make(name, env, **({"current": float(current)} if current else {}))
    observation, _ = env.reset(seed=seed)
    state, total, ended, start = None, 0.0, False, True
    while not ended:
        action, state = agent.predict(observation, state, episode_start=np.array([start]))
        observation, reward, terminated, truncated, _ = env.step(action)
        total, ended, start = total + float(reward), terminated or truncated, False
    env.close()
    return total


@pytest.mark.parametrize("reward", ["mppt1", "mppt2", "low-force"])
def test_j_is_minus_the_mean_reward_of_the_environment_with_this_seed(reward: str):
    """To 1e-5, for the passive vehicle, a constant current and two controllers; an episode of 4 s.

    MPPT is none of them: in `evaluate` it has seen the run-in.
    """
    names = ("passive", "constant:0.3", "skyhook-onoff", "skyhook-continuous")
    result = evaluate(
        with_reward(load_scenario(overrides=SETTINGS), reward),
        [SPEED],
        [5],
        policies=[policy_spec(name) for name in names],
        environment=load_environment(overrides=["episode_s=4"]),
    )
    for name, row in zip(names, result.rows, strict=True):
        total = episode(name, 5, reward=reward, episode_s=4.0)
        assert pytest.approx(-total / 4.0, rel=1e-5) == row.J, name
        weight = {"mppt1": 0.0, "mppt2": 0.5, "low-force": 2.0}[reward]
        assert pytest.approx(row.J_acceleration + weight * row.J_force, rel=1e-12) == row.J
        others = {"J_mppt2": 0.5, "J_low_force": 2.0}
        expected = {
            column: pytest.approx(row.J_acceleration + k_F * row.J_force, rel=1e-12)
            for column, k_F in others.items()
            if k_F != weight
        }
        assert result.by_weights(row) == expected


def test_a_derailment_is_charged_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A limit of Y/Q exceeded in the run-in and on the way: J is the environment's, with its charge."""
    monkeypatch.chdir(tmp_path)
    policy, settings = "constant:0.3", (*SETTINGS, "damper=sayd-estimate")
    limit = "derailment: {quotient: 0.19, averaging: 0.1}"
    Path("touchy.yaml").write_text(f"study: estimates\nepisode_s: 4\n{limit}\n")
    result = evaluate(
        load_scenario("estimates", settings),
        [SPEED],
        [1, 4],
        policies=[policy_spec(policy)],
        environment=load_environment("touchy.yaml"),
    )
    assert [row.duration_s > 0.0 for row in result.rows] == [False, True]
    for row in result.rows:
        assert row.ending == "derailment risk: mean Y/Q beyond its limit"
        assert row.acceleration_ratio == row.J_offline == math.inf
        total = episode(policy, row.seed, environment="touchy.yaml", settings=settings)
        assert pytest.approx(-total / 4.0, rel=1e-5) == row.J
        assert row.J > 1.0
        total = episode(policy, row.seed, environment="touchy.yaml", settings=settings, reward="low-force")
        assert pytest.approx(-total / 4.0, rel=1e-5) == result.by_weights(row)["J_low_force"]
    console = Console(file=io.StringIO(), width=120)
    result.summary(console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert f"derailed: {policy} at 360 km/h, wear 1, friction 0.35: 2 of 2 runs" in text
    assert json.loads(json.dumps(result.as_dict(), allow_nan=True))["summary"][policy]["derailed"] == 2


def test_policies_run_on_the_same_tracks(short_scenario: Scenario):
    """What a policy gives does not depend on the company it is in, nor on the number of threads."""
    both = [policy_spec("passive"), policy_spec("constant:0.4")]
    context = RunContext(ExecutorChoice(workers=2))
    together = evaluate(short_scenario, [SPEED], range(6), policies=both, context=context)
    assert together.policies == ("passive", "constant:0.4")
    alone = evaluate(short_scenario, [SPEED], range(3, 6), policies=both[1:])
    assert together.runs("constant:0.4")[3:] == alone.rows


def test_without_policies_the_dampers_do_what_they_are_set_to():
    options = ("assessment.run_in=200", "assessment.length=600", "damper=sayd", "damper.current=0.25")
    (row,) = evaluate(load_scenario("estimates", options), [SPEED], [0]).rows
    assert (row.policy, row.valve_mean, row.valve_travel_per_km, row.switching_per_s) == (
        "constant:0.25",
        pytest.approx(0.25),
        0.0,
        0.0,
    )


def test_switchings_are_passages_between_the_outer_quarters():
    square = np.repeat(np.tile([0.0, 1.0], 10), 5)
    assert switchings(square[:, None].astype(np.float32)) == 19
    wave = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1001) / 100)  # ten periods, 0 to 0
    small = 0.5 + 0.4 * (wave - 0.5)  # from 0.3 to 0.7
    back = np.array([0.0, 0.6, 0.1, 0.8, 0.5, 0.9])  # from the lower quarter into the middle, then up
    assert switchings(np.stack([wave, small], axis=1).astype(np.float32)) == (20 + 0) / 2
    assert switchings(back[:, None].astype(np.float32)) == 1


def test_the_valve_travel_is_the_sum_of_the_changes_per_km():
    """An on-off controller travels once its range with each switching."""
    scenario = load_scenario("estimates", ("assessment.run_in=200", "assessment.length=600"))
    (row,) = evaluate(scenario, [SPEED], [0], policies=[policy_spec("skyhook-onoff")]).rows
    assert row.switching_per_s is not None
    assert row.valve_travel_per_km == pytest.approx(row.switching_per_s / (SPEED * 1e-3), rel=1e-9)
    assert row.switching_per_s > 1.0


def test_keys_of_json_are_those_that_scripts_rely_on(result: EvaluateResult):
    keys = result.as_dict()
    assert {
        "policy",
        "speed_kmh",
        "wear",
        "friction",
        "seed",
        "J",
        "J_acceleration",
        "J_force",
        "acceleration_ratio",
        "track_shift_ratio",
        "force_rms_n",
        "force_peak_n",
        "valve_mean",
        "valve_travel_per_km",
    } <= set(keys["rows"][0])
    assert list(keys["summary"]) == ["passive"]


def rows_of(policy: str, *values: float, ending: str | None = None) -> list[Row]:
    """Rows all of whose columns have a value, for seeds 0, 1, ..."""
    count = AVERAGED.index("valve_mean")
    return [Row(policy, 300.0, 1.0, 0.4, seed, *[v] * count, ending=ending) for seed, v in enumerate(values)]


def test_the_summary_is_the_mean_over_the_rows(short_scenario: Scenario):
    summary = EvaluateResult(short_scenario, rows_of("passive", 1.0, 2.0, 6.0)).as_dict()["summary"][
        "passive"
    ]
    assert {
        summary[name] for name in AVERAGED if not name.startswith(("valve", "switching", "fallback"))
    } == {3.0}
    assert summary["largest_ratio"] == 2.0  # the median over the seeds


def test_the_best_stands_out_and_what_exceeds_a_limit_too(short_scenario: Scenario):
    result = EvaluateResult(short_scenario, [*rows_of("passive", 1.5), *rows_of("mppt1", 0.5)])
    console = Console(file=io.StringIO(), width=120, force_terminal=True, color_system="standard")
    result.summary(console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "\x1b[1m0.5000\x1b[0m" in text
    assert re.search(r"\x1b\[31m *1\.50\x1b\[0m", text)


def test_a_policy_may_stand_there_once_only(short_scenario: Scenario):
    with pytest.raises(ConfigError, match="policy 'mppt1': duplicate"):
        evaluate(short_scenario, [SPEED], [0], policies=[policy_spec("mppt1")] * 2)


def test_the_command_runs_policies_wear_speeds_and_seeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    settings = ["--set", "assessment.run_in=200", "--set", "assessment.length=600", "--config", "estimates"]
    command = ["evaluate", "--speeds", "300,350", "--seed", "4", "--seeds", "2", "--wear", "0.5,1"]
    command += ["--policies", "passive,constant:0.3"]
    assert main([*command, *settings, "--json", "--out", str(tmp_path)]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [(row["policy"], row["wear"], row["speed_kmh"], row["seed"]) for row in rows] == [
        (policy, wear, speed, seed)
        for policy in ("passive", "constant:0.3")
        for wear in (0.5, 1.0)
        for speed in (300.0, 350.0)
        for seed in (4, 5)
    ]
    assert [row["valve_mean"] for row in rows] == [None] * 8 + [pytest.approx(0.3)] * 8
    names = {"result.json", "runs.csv", "medians.csv", "report.html", "runs"}
    pictures = {f"evaluate_wear_{wear}_friction_0.35.png" for wear in ("0.5", "1")}
    assert {path.name for path in tmp_path.iterdir()} == names | pictures
