"""Histories of runs: against the laws of motion, against evaluate and assess, and from sample to sample."""

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
from sayd_env.config.line import LineConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.sensors import DAMPERS, POINTS
from sayd_env.config.units import GRAVITY
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.along import Trip, resolved
from sayd_env.runs.controlled import assessed_controlled
from sayd_env.runs.histories import MOTION, QUANTITIES, WHEELS, History, chosen, history, signals_of
from sayd_env.runs.policies import policy_spec
from sayd_env.stability import assess, read_recording
from sayd_env.studies.simulate import Target, chosen_target, run_of, simulate

SPEED = 80.0
SHORT = ["--config", "estimates", "--set", "assessment.run_in=200", "--set", "assessment.length=600"]


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open() as stream:
        names = stream.readline().rstrip("\n").split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


@pytest.fixture(scope="module")
def written(short_scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """All signals of a run with semi-active dampers, read back from its file."""
    target = Target(tmp_path_factory.mktemp("run") / "run.csv", "csv")
    policy = policy_spec("constant:0.3")
    simulate(short_scenario, target, policy=policy, speed=SPEED, seed=3, seconds=1.0, signals=["all"])
    return columns(target.file)


def test_forces_and_motion_of_the_file_obey_newton(
    written: dict[str, np.ndarray], short_scenario: Scenario
) -> None:
    """Inner forces cancel: lateral forces of the rails move all bodies, vertical ones carry them.

    To 0.1 %: dampers take their own diagonal of the damping matrix at the end of a step, the rest before it.
    """
    model = VehicleModel(short_scenario).multibody
    masses = {
        f"{axis}": {
            name: model.mass[k]
            for k, name in enumerate(model.dof_names)
            if name.endswith(f".{axis}") and not name.startswith("track.")
        }
        for axis in "yz"
    }
    rate = {
        axis: sum(mass * written[f"body_acceleration.{name}_m_s2"] for name, mass in each.items())
        for axis, each in masses.items()
    }
    lateral = sum(written[f"Y.{wheel}_n"] for wheel in WHEELS)
    vertical = sum(written[f"Q.{wheel}_n"] for wheel in WHEELS)
    assert np.std(lateral) > 100.0
    np.testing.assert_allclose(rate["y"], -lateral, rtol=0.0, atol=1e-3 * np.abs(lateral).max())
    weight = model.total_mass * GRAVITY
    np.testing.assert_allclose(rate["z"] + weight, vertical, rtol=0.0, atol=1e-3 * weight)
    for point in POINTS:
        both = written[f"Y.{point}.left_n"] + written[f"Y.{point}.right_n"]
        np.testing.assert_allclose(written[f"track_shift.{point}_n"], both, atol=1e-6)


def test_motion_is_its_own_derivative(written: dict[str, np.ndarray], short_scenario: Scenario) -> None:
    """Central differences over 2 ms of what moves slowly enough for them."""
    for name in ("carbody.y", "frame.front.yaw", "wheelset.rear.leading.y", "carbody.roll"):
        unit = "rad" if name.endswith(("yaw", "roll")) else "m"
        x, v = written[f"displacement.{name}_{unit}"], written[f"velocity.{name}_{unit}_s"]
        slope = (x[2:] - x[:-2]) / 2e-3
        assert np.abs(slope - v[1:-1]).max() < 0.01 * np.abs(v).max()
    way, speed = written["distance_m"], written["speed_m_s"]
    np.testing.assert_allclose(np.diff(way), 1e-3 * speed[1:], rtol=1e-6)
    step_zero = np.argmin(np.abs(written["time_s"]))
    assert way[step_zero] == pytest.approx(0.0, abs=1e-9)


def test_time_runs_from_the_run_in_to_the_seconds_that_were_asked_for(
    written: dict[str, np.ndarray], short_scenario: Scenario
) -> None:
    time = written["time_s"]
    assert time[-1] == 1.0
    np.testing.assert_allclose(np.diff(time), 1e-3, rtol=1e-9)
    assert -time[0] + 1e-3 == pytest.approx(200.0 / SPEED, abs=0.01)  # whole control periods
    before, after = written["command.front"][time <= 0.0], written["command.front"][time > 0.0]
    assert set(before) == {0.0}
    np.testing.assert_allclose(after, 0.3, rtol=1e-7)
    valve = written["valve.front.left.upper"]
    assert valve[time <= 0.0].max() == 0.0
    assert valve[-1] == pytest.approx(0.3, abs=1e-3)  # the spool has followed within a second
    force, hydraulic = (written[f"{q}.rear.left.upper_n"] for q in ("damper_force", "hydraulic_force"))
    area = short_scenario_area()
    pressures = [written[f"pressure_{c}.rear.left.upper_pa"] for c in "ab"]
    np.testing.assert_allclose(hydraulic, area * (pressures[0] - pressures[1]), atol=1e-6)
    assert np.corrcoef(force, hydraulic)[0, 1] < -0.9
    rate = written["stroke_rate.rear.left.upper_m_s"]
    assert np.mean(force * rate) > 0.0  # tension resists extension: the damper takes energy away


def short_scenario_area() -> float:
    from sayd_env.config.damper import load_sayd  # noqa: PLC0415

    return load_sayd("sayd").cylinder.area


@pytest.mark.parametrize("policy", ["passive", "constant:0.3"])
def test_the_file_assessed_is_the_evaluation_of_the_same_run(
    policy: str, short_scenario: Scenario, tmp_path: Path
) -> None:
    """The reader of recordings and EN 14363 on the file, against the run that evaluate makes and judges."""
    spec, target = policy_spec(policy), Target(tmp_path / "run.csv", "csv")
    wanted = ["speed", "lateral_acceleration", "track_shift"]
    simulate(short_scenario, target, policy=spec, speed=SPEED, seed=3, signals=wanted)
    recording = read_recording(target.file, short_scenario.assessment)
    found = assess(recording.signals, recording.sample_rate, recording.speed, short_scenario.assessment)
    (run,) = assessed_controlled([run_of(short_scenario, policy=spec, speed=SPEED, seed=3)])
    assert [channel.name for channel in recording.channels] == [
        f"{quantity}.{point}" for quantity in wanted[1:] for point in POINTS
    ]
    np.testing.assert_allclose(found.maximum, [*run.acceleration, *run.track_shift], rtol=1e-8)
    np.testing.assert_allclose(found.dominant_frequency, [*run.frequency, *run.frequency_force], rtol=1e-8)


def test_a_run_along_a_line_is_where_the_line_says(short_scenario: Scenario, tmp_path: Path) -> None:
    line = LineConfig.model_validate(
        {
            "sections": [
                {"name": "slow", "length": 150.0, "speed_kmh": 280.0},
                {"name": "fast", "length": 150.0, "speed_kmh": 282.0},
            ]
        }
    )
    target = Target(tmp_path / "run.csv", "csv")
    result = simulate(
        short_scenario, target, line=line, speed=280.0 / 3.6, signals=["speed", "distance"], run_in=False
    )
    trip = Trip(resolved(line, short_scenario, None), 280.0 / 3.6)
    found = columns(target.file)
    time = found["time_s"]
    assert (time[0], time[-1]) == (0.001, trip.seconds)
    np.testing.assert_allclose(found["distance_m"], trip.distance(time), atol=0.01)
    np.testing.assert_allclose(found["speed_m_s"], trip.speed_at(found["distance_m"]), rtol=1e-3)
    assert result.as_dict()["line"] == "line"


def test_a_run_that_ends_early_has_no_sample_beyond_its_end(short_scenario: Scenario) -> None:
    """It ends within a control period of 10 ms where the same run with periods of 1 ms does."""
    irregularity = short_scenario.track.irregularity.model_copy(update={"scale": 6.0})
    track = short_scenario.track.model_copy(update={"irregularity": irregularity})
    bad = short_scenario.model_copy(update={"track": track, "friction": 0.6})
    setup = load_environment()
    found: dict[float, History] = {}
    for period in (0.01, 0.001):
        environment = setup.model_copy(update={"control_period": period})
        run = run_of(bad, policy=policy_spec("constant:0.5"), speed=100.0, seed=1, environment=environment)
        found[period] = history(run, chosen(signals_of(run), ["Y", "Q", "lateral_acceleration"]))
    coarse, fine = found[0.01], found[0.001]
    assert coarse.ending == fine.ending is not None
    assert len(coarse.time) == len(fine.time)
    for one, other in zip(coarse.values, fine.values, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_there_is_depends_on_the_dampers(short_scenario: Scenario) -> None:
    passive, sayd = (
        signals_of(run_of(short_scenario, policy=policy_spec(name), speed=SPEED))
        for name in ("passive", "constant:0.3")
    )
    assert {signal.quantity for signal in sayd} == set(QUANTITIES)
    assert set(QUANTITIES) - {signal.quantity for signal in passive} == {
        *("hydraulic_force", "pressure_a", "pressure_b", "command", "current", "valve")
    }
    names = [signal.full_name for signal in sayd]
    assert len(set(names)) == len(names)
    assert max(map(len, names)) <= 63  # the longest name of a variable in MATLAB
    usual = chosen(sayd)
    assert not {signal.quantity for signal in usual} & set(MOTION)
    assert [s.name for s in chosen(sayd, ["Y.*.left", "damper_force.rear.*"])] == [
        *(f"Y.{point}.left" for point in POINTS),
        *(f"damper_force.{place}" for place in DAMPERS[4:]),
    ]
    assert len(chosen(sayd, ["all"])) == len(sayd)


@pytest.mark.parametrize(
    ("patterns", "problem"),
    [
        (["Yfront"], "no such signal"),
        (["track_shif"], "no such signal, did you mean 'track_shift'?"),
        (["pressure_a"], "passive yaw dampers have none"),
        (["*.nowhere"], "no such signal"),
    ],
)
def test_signals_that_there_are_not(patterns: list[str], problem: str, short_scenario: Scenario) -> None:
    run = run_of(short_scenario, speed=SPEED)
    with pytest.raises(ConfigError, match="--signals") as error:
        chosen(signals_of(run), patterns)
    assert problem in str(error.value)
    assert len(str(error.value)) < 600


def test_more_than_the_memory_holds_is_refused_before_the_run(
    short_scenario: Scenario, tmp_path: Path
) -> None:
    target = Target(tmp_path / "run.csv", "csv")
    with pytest.raises(ConfigError, match=r"at most 200,000,000 are allowed: choose fewer with --signals"):
        simulate(short_scenario, target, speed=SPEED, seconds=5e4, signals=["all"])
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("file", "kind", "expected"),
    [
        (None, None, ("out/simulate.csv", "csv")),
        (None, "mat", ("out/simulate.mat", "mat")),
        ("a.MAT", None, ("a.MAT", "mat")),
        ("a.csv", "csv", ("a.csv", "csv")),
        ("a.txt", None, "expected a file that ends in .csv, .parquet, .mat, .mf4"),
        ("a.csv", "mat", "--format mat: the file 'a.csv' is csv"),
        (None, "xlsx", "--format xlsx: unknown format"),
    ],
)
def test_file_and_format(file: str | None, kind: str | None, expected: Any) -> None:
    path = None if file is None else Path(file)
    if isinstance(expected, str):
        with pytest.raises(ConfigError, match=expected):
            chosen_target(path, kind, Path("out"))
        return
    target = chosen_target(path, kind, Path("out"))
    assert (target.file.as_posix(), target.kind) == expected


def test_the_command_writes_a_file_and_a_page_for_each_value(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    read_page: Callable[..., Any],
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["simulate", *SHORT, "--speed", "288", "--seconds", "0.5", "--signals", "track_shift,Y"]
    assert main([*command, "--set", "wear=0.5"]) == 0
    folder = tmp_path / "results" / "simulate"
    one = json.loads((folder / "result.json").read_text())
    assert one["file"] == "results/simulate/simulate.csv"
    page = read_page((folder / "report.html").read_text())
    assert len(page.pictures) == 2
    assert page.links == []
    assert "track_shift.front.leading" in page.text
    capsys.readouterr()
    assert main([*command, "--set", "wear=0.5,0.75", "--out", "two"]) == 0
    shown = capsys.readouterr().out
    assert "simulate_2.csv" in shown
    two = json.loads(Path("two/result.json").read_text())
    assert [each["set"]["wear"] for each in two["results"]] == [0.5, 0.75]
    assert two["results"][0]["signals"] == one["signals"]
    assert Path("two/signals.csv").read_text().startswith("wear,name,unit,")
    first = columns(Path("two/simulate_1.csv"))
    for name, values in columns(folder / "simulate.csv").items():
        np.testing.assert_array_equal(values, first[name])
    assert np.any(
        columns(Path("two/simulate_2.csv"))["Y.front.leading.left_n"] != first["Y.front.leading.left_n"]
    )


def test_the_page_lists_all_signals() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulate.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in page.splitlines()
        if line.startswith("| `")
    ]
    listed = {row[0].split("`")[1]: row for row in rows if len(row) == 4}
    assert list(listed) == list(QUANTITIES)
    for name, about in QUANTITIES.items():
        assert listed[name][2:] == [about.unit, about.meaning]
        assert listed[name][0].endswith("\u2022") == about.usual
