"""Evaluation of one configuration: its cost against a computation with SciPy alone, and its keys."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import butter, get_window, sosfiltfilt

from sayd_env.cli import main
from sayd_env.config.scenario import Scenario
from sayd_env.physics.simulator import VehicleModel
from sayd_env.studies.critical_speed import model_limits
from sayd_env.studies.evaluate import EvaluateResult, Row, evaluate
from sayd_env.studies.sweep import assessed_run, simulate

Array = npt.NDArray[np.float64]
SPEED = 360 / 3.6
RUN_IN, LENGTH, RATE = 200.0, 600.0, 1000.0


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
    return evaluate(short_scenario, [SPEED], range(2), workers=1)


def test_the_cost_is_that_of_eq_27_from_the_telemetry(result: EvaluateResult, short_model: VehicleModel):
    scenario = short_model.scenario
    for row in result.rows:
        signals = simulate(short_model, SPEED, row.seed)
        expected = acceleration_cost(signals.acceleration, model_limits(short_model).acceleration)
        assert row.J_acceleration == pytest.approx(expected, rel=1e-9)
        distance = np.arange(len(signals.time)) * SPEED / RATE
        force = signals.damper_force[(distance >= RUN_IN) & (distance < RUN_IN + LENGTH)]
        assert force.shape[1] == 8
        assert row.force_rms_n == pytest.approx(np.sqrt(np.mean(force**2)), rel=1e-12)
        assert row.force_peak_n == np.abs(force).max()
        assert row.J_force == pytest.approx(np.mean(force**2) / scenario.cost.force_reference**2, rel=1e-12)
        cost = scenario.cost
        total = cost.acceleration_weight * row.J_acceleration + cost.force_weight * row.J_force
        np.testing.assert_allclose(row.J, total, rtol=1e-12)


def test_the_ratios_are_those_of_the_assessment(result: EvaluateResult, short_model: VehicleModel):
    bounds = model_limits(short_model)
    for row in result.rows:
        run = assessed_run(short_model, SPEED, row.seed)
        assert row.acceleration_ratio == run.acceleration.max() / bounds.acceleration
        assert row.track_shift_ratio == run.track_shift.max() / bounds.track_shift_force


def test_workers_do_not_change_the_result(result: EvaluateResult, short_scenario: Scenario):
    assert evaluate(short_scenario, [SPEED], range(2), workers=2).rows == result.rows


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


def test_the_summary_is_the_mean_over_the_rows(short_scenario: Scenario):
    rows = [Row("passive", 300.0, 1.0, 0.4, seed, *[float(seed)] * 7) for seed in (1, 2, 6)]
    summary = EvaluateResult(short_scenario, rows).as_dict()["summary"]["passive"]
    assert set(summary.values()) == {3.0}


def test_the_command_runs_speeds_times_seeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    settings = ["--set", "assessment.run_in=200", "--set", "assessment.length=600", "--config", "estimates"]
    command = ["evaluate", "--speeds", "300,350", "--seed", "4", "--seeds", "2", "--wear", "0.5"]
    assert main([*command, *settings, "--json", "--out", str(tmp_path)]) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert [(row["speed_kmh"], row["seed"]) for row in rows] == [
        (pytest.approx(speed), seed) for speed in (300, 350) for seed in (4, 5)
    ]
    assert {row["wear"] for row in rows} == {0.5}
    assert {row["valve_mean"] for row in rows} == {None}
    assert {path.name for path in tmp_path.iterdir()} == {"result.json", "runs.csv", "evaluate.png"}
