"""Runs of a controlled vehicle, on sines whose RMS, power and frequency are known in closed form."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError, StudyError
from sayd_env.config.assessment import AssessmentConfig, load_assessment
from sayd_env.envs.loop import LOG
from sayd_env.envs.rollout import Rollout
from sayd_env.runs.controlled import (
    ControlledRun,
    ControlledRuns,
    _derailed,
    controlled_run_of,
    high_frequency_power,
)

SPEED = 100.0  # m/s: the assessed 5 km begin at 5 s and end at 55 s
RATE = 1000
TIME = np.arange(56_500) / RATE
ASSESSED = slice(5 * RATE, 55 * RATE)


@pytest.fixture(scope="module")
def settings() -> AssessmentConfig:
    return load_assessment()


def tone(frequency: float, amplitude: float, channels: int) -> np.ndarray:
    return np.repeat((amplitude * np.cos(2 * np.pi * frequency * TIME))[:, None], channels, axis=1)


@pytest.fixture(scope="module")
def signals() -> dict[str, Any]:
    """5 Hz acceleration, 4 Hz track shift force, dampers at 3 and 20 Hz; wilder before and behind."""
    force = tone(3.0, 6e3, 8) + tone(20.0, 1e3, 8)
    force[:4900] = force[55_100:] = 40e3
    force[ASSESSED, 4] *= 0.5  # the first damper of the rear bogie
    command = np.full((5150, 2), 0.25)
    command[:, 1] = np.linspace(0.0, 1.0, 5150)
    command[5000:] = 1.0
    return {
        "acceleration": tone(5.0, 2.0, 4) * np.array([1.0, 0.5, 0.25, 2.0]),
        "track_shift": tone(4.0, 10e3, 4),
        "damper_force": force,
        "command": command,
        "control_period": 0.01,
    }


def rollout_of(signals: dict[str, Any], rate: float = RATE) -> Rollout:
    """Signals as a policy's run; its run-in is rounded up to a whole control period."""
    true = np.zeros((len(signals["acceleration"]), LOG))
    true[:, :4], true[:, 4:8], true[:, 8:16] = (
        signals[key] for key in ("acceleration", "track_shift", "damper_force")
    )
    episode: Any = SimpleNamespace(speed=SPEED, seed=7, initial_current=0.25)
    actions, run_in = signals["command"].astype(np.float32), round(5.01 * rate)
    return Rollout(
        episode,
        0.01,
        rate,
        run_in,
        true,
        true[:, :0],
        actions,
        np.zeros(5150),
        np.zeros((5150, 4)),
        None,
        len(true),
    )


@pytest.fixture(scope="module")
def rollout(signals: dict[str, Any]) -> Rollout:
    return rollout_of(signals)


@pytest.fixture(scope="module")
def run(rollout: Rollout, settings: AssessmentConfig) -> ControlledRun:
    return controlled_run_of("mppt1", rollout, settings)


def test_a_sine_is_assessed_as_amplitude_over_root_2(run: ControlledRun):
    assert run.acceleration == pytest.approx(np.array([2.0, 1.0, 0.5, 4.0]) / math.sqrt(2), rel=2e-3)
    assert run.track_shift == pytest.approx(np.full(4, 10e3 / math.sqrt(2)), rel=2e-3)
    assert run.frequency == pytest.approx(5.0, abs=0.01)
    assert run.frequency_force == pytest.approx(4.0, abs=0.01)
    assert (run.policy, run.speed, run.seed, run.initial_current) == ("mppt1", SPEED, 7, 0.25)


def test_the_force_is_that_of_the_assessed_length(run: ControlledRun):
    """Two tones have the mean square (a^2 + b^2) / 2; both peak together at whole seconds."""
    one = (6e3**2 + 1e3**2) / 2
    assert run.force_rms == pytest.approx(math.sqrt(one * (7 + 0.25) / 8), rel=1e-6)
    assert run.force_peak == pytest.approx(7e3, rel=1e-9)
    assert run.force_power_high == pytest.approx(1e3**2 / 2 * (7 + 0.25) / 8, rel=1e-3)


@pytest.mark.parametrize(("frequency", "share"), [(3.0, 0.0), (8.0, 0.0), (12.0, 1.0), (100.0, 1.0)])
def test_power_above_10_hz_is_that_of_the_fast_tones(frequency: float, share: float):
    power = high_frequency_power(tone(frequency, 2e3, 2)[:20_000], RATE)
    assert power == pytest.approx(share * 2e3**2 / 2, abs=1e-3 * 2e3**2 / 2)


def test_commands_end_with_the_assessed_length(run: ControlledRun, signals: dict[str, Any]):
    assert run.command.shape == (5000, 2)
    assert run.command.dtype == np.float32
    assert run.command == pytest.approx(signals["command"][:5000], abs=1e-7)


def test_the_trace_shows_the_rear_dampers_first_40_s(run: ControlledRun, signals: dict[str, Any]):
    assert (run.force_trace.shape, run.trace_period) == ((8000,), 0.005)
    every_fifth = signals["damper_force"][ASSESSED, 4][: 40 * RATE : 5]
    inner = slice(200, -200)
    assert run.force_trace[inner] == pytest.approx(every_fifth[inner], abs=1e-3 * 3.5e3)


def test_a_slow_recording_is_not_thinned(signals: dict[str, Any]):
    settings = load_assessment(overrides=["sample_rate=200"])
    thin = {key: signals[key][::5] for key in ("acceleration", "track_shift", "damper_force")}
    run = controlled_run_of("x", rollout_of(signals | thin, 200.0), settings)
    assert run.trace_period == 0.005
    assert run.force_trace == pytest.approx(thin["damper_force"][1000:9000, 4], rel=1e-6)


def test_a_signal_that_is_not_finite_is_refused(signals: dict[str, Any], settings: AssessmentConfig):
    broken = signals | {"acceleration": np.full((len(TIME), 4), np.inf)}
    with pytest.raises(DataError, match="found inf"):
        controlled_run_of("x", rollout_of(broken), settings)


def test_a_rollout_that_cannot_be_assessed_is_refused(rollout: Rollout, settings: AssessmentConfig):
    with pytest.raises(StudyError, match=r"'mppt1' at 360 km/h, seed 7, ended: a wheel climbed"):
        controlled_run_of("mppt1", dataclasses.replace(rollout, ending="a wheel climbed"), settings)
    with pytest.raises(StudyError, match="the run of seed 7 at 360 km/h diverged"):
        _derailed("mppt1", dataclasses.replace(rollout, ending="non-finite state"))
    with pytest.raises(ConfigError, match="found 500 m, while the environment runs in for 200 m"):
        controlled_run_of("mppt1", dataclasses.replace(rollout, run_in=2000), settings)


@pytest.mark.parametrize("steps", [0, 700])
def test_a_derailed_vehicle_exceeds_every_limit(steps: int, rollout: Rollout):
    short = dataclasses.replace(rollout, ending="a wheel climbed", actions=rollout.actions[:steps])
    run = _derailed("mppt1", short)
    assert np.isinf([*run.acceleration, *run.track_shift, run.force_rms, run.force_peak]).all()
    assert run.command.shape == (max(steps, 1), 2)


def test_one_policy_stands_for_others(controlled_run: Callable[..., ControlledRun]):
    """From closed valves; what ran from open ones stays, and so do all others."""
    starts = [("a", 0.0), ("a", 1.0), ("b", 0.0), ("c", 0.0)]
    runs = ControlledRuns(
        controlled_run(name, 300.0, seed, initial_current=current, force_rms=float(ord(name)))
        for name, current in starts
        for seed in range(2)
    )
    changed = runs.in_place_of(("a", "b"), "c")
    assert {(r.policy, r.initial_current, chr(int(r.force_rms))) for r in changed.runs} == {
        ("a", 0.0, "c"),
        ("a", 1.0, "a"),
        ("b", 0.0, "c"),
        ("c", 0.0, "c"),
    }
    assert len(changed.runs) == len(runs.runs)


def test_runs_are_found_in_any_order(controlled_run: Callable[..., ControlledRun]):
    runs = [
        controlled_run("mppt1", kmh, seed, acceleration=np.full(4, kmh + seed))
        for seed in (2, 1)
        for kmh in (400, 300)
    ]
    runs.append(controlled_run("mppt1", 400, 1, initial_current=1.0))
    runs.append(controlled_run("mppt1", 400, 2, initial_current=1.0))
    container = ControlledRuns(runs)
    assert container.seeds == (1, 2)
    assert container.variants == (("mppt1", 0.0), ("mppt1", 1.0))
    assert [run.seed for run in container.at("mppt1", 300)] == [1, 2]
    grid = container.sweep("mppt1")
    assert grid.speeds * 3.6 == pytest.approx([300, 400])
    assert grid.acceleration[:, :, 0].tolist() == [[301, 302], [401, 402]]
    tables = container.tables(("a", "b", "c", "d"))
    assert {name: len(rows) for name, (_, rows) in tables.items()} == {
        "runs_controlled": 6 * 4,
        "dampers_controlled": 6,
    }
    for header, rows in tables.values():
        assert {len(row) for row in rows} == {len(header)}


def test_a_run_that_is_missing_or_there_twice_is_named(controlled_run: Callable[..., ControlledRun]):
    container = ControlledRuns([controlled_run("mppt1", 400, 0), controlled_run("mppt1", 300, 1)])
    with pytest.raises(ValueError, match=r"no run of 'mppt1' at 300 km/h, V\(0\) = 0, seed 0"):
        container.sweep("mppt1")
    with pytest.raises(ValueError, match="twice"):
        ControlledRuns([controlled_run(), controlled_run()])
    with pytest.raises(ValueError, match="no runs"):
        ControlledRuns([])
