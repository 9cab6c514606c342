"""The bench: its keys, and that it measures what it says."""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.scenario import load_scenario
from sayd_env.physics.parts import PARTS
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.studies import bench as module
from sayd_env.studies.bench import BenchResult, Effort, FirstOrder, PartTimer, Spread, bench, match_accuracy
from sayd_env.studies.output import document, json_text

SPEED = 350.0 / 3.6


@pytest.fixture(scope="module")
def model() -> VehicleModel:
    return VehicleModel(load_scenario())


@pytest.fixture(scope="module")
def result() -> BenchResult:
    """A quick bench whose starts are those of a program that only uses some memory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_PROGRAM", "block = bytearray(50_000_000); status = 0")
        patch.setattr(module, "QUICK", Effort(2, 1.0, 1000, 0.1, 1, 2))
        heard: list[tuple[float, float, str]] = []
        result = bench(load_scenario(), quick=True, progress=lambda *report: heard.append(report))
    assert [done for done, _, _ in heard] == [1, 2, 3, 4, 5, 6]
    assert {total for _, total, _ in heard} == {6}
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
    }
    assert set(content["step_us"]) == {*PARTS, "integration", "total"}
    assert set(content["control_steps_per_second"]) == {"single", "batch", "overhead_us"}
    assert set(content["startup_s"]) == {"first", "later"}
    for factor in ("passive_single", "passive_batch", "scipy_reference"):
        assert content["realtime_factor"][factor] > 0.0
    assert set(content["machine"]) == {"processor", "cores", "system", "date"}
    assert content["step_size_s"] == load_scenario().numerics.step


def test_parts_make_a_step(result: BenchResult) -> None:
    costs = result.as_dict()["step_us"]
    assert min(costs[part] for part in PARTS) > 0.0
    spread = result.step_us["total"]
    assert spread.minimum <= spread.median <= spread.maximum
    # The total is the single vehicle's time: h / (cost of a step) is its real-time factor.
    factor = result.realtime["passive_single_processor_time"]
    assert 1e6 * result.step / spread.minimum == pytest.approx(factor.maximum)
    assert factor.maximum > 0.9 * result.realtime["passive_single"].maximum


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="this system does not tell")
def test_memory_is_that_of_the_started_program(result: BenchResult) -> None:
    assert result.memory is not None
    assert 50.0 < result.memory["later"] < 120.0  # the block and the interpreter


def test_summary_table_and_picture(result: BenchResult) -> None:
    console = Console(width=150, record=True)
    result.summary(console)
    text = console.export_text()
    assert "one vehicle, one core" in text
    assert "later start" in text
    header, rows = result.tables()["bench"]
    assert all(len(row) == len(header) for row in rows)
    for draw in result.plots().values():
        figure = Figure()
        draw(figure)
        figure.draw_without_rendering()


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


def test_a_start_that_fails(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="a start of sayd failed: out of order"):
        module._timed([sys.executable, "-c", "import sys; sys.exit('out of order')"], tmp_path)


def test_a_speed_out_of_range() -> None:
    with pytest.raises(ConfigError, match="outside the range"):
        bench(load_scenario(), 1000.0)


@pytest.mark.timing
def test_at_least_150_times_real_time(model: VehicleModel) -> None:
    """The required speed of one vehicle on one core; the best run counts, as others may use the machine."""
    simulator = Simulator(model, SPEED)
    simulator.advance(1000)
    best = math.inf
    for _ in range(5):
        begin = time.perf_counter()
        simulator.advance(4000)
        best = min(best, time.perf_counter() - begin)
    assert 4.0 / best > 150.0


@pytest.mark.timing
def test_starts_of_the_program() -> None:
    """The first start, which compiles, takes at most 60 s, later ones at most 3 s (best of three)."""
    steps = module._Steps(lambda *_: None, module.QUICK)
    effort = Effort(0, 0.0, 0, 0.0, 1, 3)
    startup, memory = module._starts(load_scenario(), SPEED, effort, steps)
    assert startup["first"].minimum < 60.0
    assert startup["later"].minimum < 3.0
    assert startup["later"].maximum < startup["first"].minimum
    assert memory is None or memory["later"] < 1000.0
