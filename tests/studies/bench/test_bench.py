"""The bench: its keys, and that it measures what it says."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.damper import load_sayd
from sayd_env.config.scenario import load_scenario
from sayd_env.physics.parts import PARTS, SAYD_PARTS
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.report.files import document, json_text
from sayd_env.runs.executors import ExecutorChoice
from sayd_env.studies.bench import bench as module
from sayd_env.studies.bench import environment as bench_environment
from sayd_env.studies.bench import executors as bench_executors
from sayd_env.studies.bench import spread as bench_spread
from sayd_env.studies.bench import start as bench_start
from sayd_env.studies.bench.bench import BenchResult, bench
from sayd_env.studies.bench.environment import make_yardstick, step_times, whole_episodes
from sayd_env.studies.bench.executors import measure_executors, short_runs
from sayd_env.studies.bench.spread import Effort, Measurement, Spread
from sayd_env.studies.bench.training import TrainingRates
from sayd_env.studies.bench.vehicle import FirstOrder, PartTimer, match_accuracy, with_dampers

SPEED = 350.0 / 3.6
WITH_SAYDS = {"sayd_single", "sayd_single_processor_time", "sayd_batch", "valves", "hydraulics", "total_sayd"}
NO_RUNS = {"runs_per_second": {}, "executor_start_s": {}}


@pytest.fixture(scope="module")
def model() -> VehicleModel:
    return VehicleModel(load_scenario())


@pytest.fixture(scope="module")
def sayd_model() -> VehicleModel:
    return VehicleModel(load_scenario(None, ("damper=sayd",)))


@pytest.fixture(scope="module")
def result() -> BenchResult:
    """A quick bench of a small batch, whose starts are those of a program that only uses some memory.

    No yardstick, installed or not, no training, and no runs.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench_start, "_PROGRAM", "block = bytearray(50_000_000); status = 0")
        patch.setattr(bench_environment, "BATCH", 4)
        patch.setattr(bench_environment, "make_yardstick", lambda: None)
        patch.setattr(module, "measure_training", lambda effort, threads, did: did())
        patch.setattr(module, "measure_executors", lambda choices, effort, did: did() or NO_RUNS)
        patch.setattr(module, "QUICK", Effort(2, 1.0, 1000, 0.1, 1, 2, 1, 0.1, 50, 1, 10))
        reports: list[tuple[float, float, str]] = []
        result = bench(load_scenario(), quick=True, progress=lambda *report: reports.append(report))
    assert [done for done, _, _ in reports] == list(range(1, 10))
    assert {total for _, total, _ in reports} == {9}
    return result


def test_keys(result: BenchResult) -> None:
    content = json.loads(json_text(document(result, result.scenario, None)))
    assert set(content["realtime_factor"]) == {
        "passive_single",
        "sayd_single",
        "passive_batch",
        "sayd_batch",
        "scipy_reference",
        "passive_single_processor_time",
        "sayd_single_processor_time",
    }
    assert set(content["step_us"]) == {
        *PARTS,
        "integration",
        "total",
        "valves",
        "hydraulics",
        "total_sayd",
    }
    control = content["control_steps_per_second"]
    assert {"single", "batch", "overhead_us", "single_without_resets", "batch_without_resets"} <= set(control)
    assert control["ant_v5"] is None
    assert set(content["reset_s"]) == {"single", "batch"}
    assert content["batch"]["environments"] == 4
    assert set(content["startup_s"]) == {"first", "later"}
    assert min(content["realtime_factor"].values()) > 0.0
    assert min(value for value in control.values() if value is not None) > 0.0
    assert set(content["machine"]) == {"processor", "cores", "system", "date"}
    assert content["step_size_s"] == load_scenario().numerics.step


def test_parts_make_a_step(result: BenchResult) -> None:
    costs = result.as_dict()["step_us"]
    assert min(costs[part] for part in PARTS) > 0.0
    spread = result.measured["step_us"]["total"].spread
    assert spread.minimum <= spread.median <= spread.maximum
    # The total is the single vehicle's time: h / (cost of a step) is its real-time factor.
    for total, kind in (("total", "passive"), ("total_sayd", "sayd")):
        realtime = result.measured["realtime_factor"]
        factor = realtime[f"{kind}_single_processor_time"].spread
        least = result.measured["step_us"][total].spread.minimum
        assert 1e6 * result.step / least == pytest.approx(factor.maximum)
    assert min(costs[part] for part in ("valves", "hydraulics", "total_sayd")) > 0.0


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system does not tell")
def test_memory_is_that_of_the_started_program(result: BenchResult) -> None:
    assert result.memory is not None
    assert 50.0 < result.memory["later"] < 120.0  # the block and the interpreter


def test_summary_table_and_picture(result: BenchResult) -> None:
    console = Console(width=150, record=True)
    result.summary(console)
    text = console.export_text()
    assert "passive, one vehicle, one core" in text
    assert "8 SAYDs, batch, all cores" in text
    assert "step minus compiled call" in text
    assert "no Ant-v5 beside them: mujoco is not installed" in text
    assert "later start" in text
    header, rows = result.tables()["bench"]
    assert all(len(row) == len(header) for row in rows)
    for draw in result.plots().values():
        figure = Figure()
        draw(figure)
        figure.draw_without_rendering()


def test_training_stands_beside_the_rest(result: BenchResult) -> None:
    """Where it can be measured; where it cannot, a line says why."""
    assert result.as_dict()["training"] is None
    rates = {
        name: Measurement(f"training: {name}", "steps/s", Spread.of([rate]))
        for name, rate in (("environment", 900.0), ("ppo", 300.0), ("sac", 100.0))
    }
    shares = {"ppo": 0.25, "sac": 0.5}
    vehicles, threads = (
        {"environment": 32, "ppo": 32, "sac": 8},
        {"simulator": 2, "torch": 1, "torch_uncapped": 2},
    )
    trained = replace(result, training=TrainingRates(rates, shares, vehicles, threads))
    content = json.loads(json_text(document(trained, result.scenario, None)))["training"]
    assert [content[name] for name in ("environment", "ppo", "sac")] == [900.0, 300.0, 100.0]
    assert content["environment_share"] == {"ppo": 0.25, "sac": 0.5}
    assert content["threads"] == threads
    console = Console(width=150, record=True)
    result.summary(console)
    trained.summary(console)
    text = console.export_text()
    assert text.count("torch and Stable-Baselines3 are not installed") == 1
    assert "training: sac" in text
    assert "share of the time: PPO 25%, SAC 50%" in text
    figure = Figure()
    trained.plots()["bench"](figure)
    figure.draw_without_rendering()


def test_a_vehicle_without_yaw_dampers(result: BenchResult) -> None:
    """It has no figures with semi-active ones: null in the output, no rows, no share."""
    passive = replace(
        result,
        measured=result.measured
        | {
            group: {name: q for name, q in result.measured[group].items() if name not in WITH_SAYDS}
            for group in ("realtime_factor", "step_us")
        },
    )
    assert passive.as_dict()["realtime_factor"]["sayd_single"] is None
    console = Console(width=150, record=True)
    passive.summary(console)
    assert "SAYDs" not in console.export_text()


def test_spread() -> None:
    assert Spread.of([3.0, 1.0, 2.0]) == Spread(2.0, 1.0, 3.0, 3)


def test_scipy_solves_the_same_model(model: VehicleModel) -> None:
    """A tight integration and the time step agree; the reported errors are those of the definition."""
    reference = match_accuracy(model, SPEED, 0.3)
    assert reference.error <= reference.step_error < 5e-3
    exact, _ = FirstOrder(model, SPEED, 0.3).solve("DOP853", 1e-8)
    system = FirstOrder(model, SPEED, 0.3)
    ours, _ = system.solve(reference.method, reference.tolerance)
    error = np.linalg.norm(ours - exact) / np.linalg.norm(exact)
    assert error == pytest.approx(reference.error, rel=0.2)
    assert system.evaluations == reference.evaluations


def test_parts_of_a_moving_vehicle(model: VehicleModel) -> None:
    """Nothing becomes denormal, which would cost many times as much, or infinite."""
    timer = PartTimer(Simulator(model, SPEED), 20_000)
    for part in range(len(PARTS)):
        assert timer.microseconds(part) > 0.0
        for values in (timer.simulator.work.f, timer.simulator.state.force):
            moved = np.abs(values[values != 0.0])
            assert np.all(np.isfinite(moved))
            assert np.all(moved > np.finfo(float).tiny)


def test_semi_active_dampers_of_a_moving_vehicle(sayd_model: VehicleModel) -> None:
    """The repeated dampers move on: their pressures stay finite, change, and never become denormal."""
    timer = PartTimer(Simulator(sayd_model, SPEED), 20_000, sayds=True)
    for part in range(len(SAYD_PARTS)):
        before = timer.simulator.state.sayd.copy()
        assert timer.microseconds(part) > 0.0
        after = timer.simulator.state.sayd
        assert np.all(np.isfinite(after))
        moved = np.abs(after[after != 0.0])
        assert np.all(moved > np.finfo(float).tiny)
        assert part == 0 or not np.array_equal(before, after)


def test_both_kinds_of_dampers() -> None:
    """Each scenario is measured with both: its own kind as it is, the other one from the package."""
    own = load_scenario(None, ("damper.series_stiffness=4e6",))
    passive, semi = with_dampers(own)
    assert passive == own
    assert semi.damper == load_sayd("sayd")
    assert semi.model_copy(update={"damper": own.damper}) == own
    own = load_scenario(None, ("damper=sayd", "damper.current=0.3"))
    passive, semi = with_dampers(own)
    assert semi == own
    assert passive.damper == load_scenario().damper


def test_rate_over_whole_episodes() -> None:
    """2000 steps at 10 000 steps/s and a reset of 0.05 s take 0.25 s."""
    assert whole_episodes(10_000.0, 2000, 0.05) == pytest.approx(8000.0)


def test_overhead_is_what_is_outside_the_compiled_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """An environment that spends 2 ms in its compiled loop and 1 ms around it, by a clock that it moves."""
    now = 0.0

    def busy(seconds: float) -> None:
        nonlocal now
        now += seconds

    monkeypatch.setattr(bench_spread, "time", SimpleNamespace(perf_counter=lambda: now))

    class Known:
        def __init__(self) -> None:
            self.vehicles = SimpleNamespace(_compiled=lambda: busy(2e-3))
            self.batch = SimpleNamespace(steps=1000, vehicles=self.vehicles)
            self.action_space = SimpleNamespace(sample=lambda: busy(3e-3))
            self.unwrapped = self

        def reset(self) -> None:
            busy(5e-3)

        def step(self, _: Any) -> None:
            busy(0.5e-3)
            self.vehicles._compiled()
            busy(0.5e-3)

    env = Known()
    loop = env.vehicles._compiled
    assert step_times(env, 15) == pytest.approx({"overhead_us": 1000.0, "compiled_us": 2000.0})
    assert env.vehicles._compiled is loop


def test_yardstick_that_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: str) -> None:
        raise gym.error.DependencyNotInstalled("no mujoco")

    monkeypatch.setattr(gym, "make", refuse)
    assert make_yardstick() is None


def test_a_start_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_start, "_PROGRAM", "import sys; sys.exit('out of order')")
    with pytest.raises(StudyError, match="a start of sayd failed: out of order"):
        bench_start.timed_start([], tmp_path)


def test_a_speed_out_of_range() -> None:
    with pytest.raises(ConfigError, match="outside the range"):
        bench(load_scenario(), 1000.0)


def test_runs_by_executor(monkeypatch: pytest.MonkeyPatch) -> None:
    """Short runs of two policies on some seeds, and of each executor a rate and the time of its start."""
    assert len(short_runs()) == 32
    monkeypatch.setattr(bench_executors, "SEEDS", 1)
    assert [run.policy.title for run in short_runs()] == ["passive", "mppt2"]
    found = measure_executors([ExecutorChoice("threads", workers=1)], replace(Effort(), rounds=1))
    assert set(found) == {"runs_per_second", "executor_start_s"}
    assert found["runs_per_second"]["threads"].spread.median > 0.0
