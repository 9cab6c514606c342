"""The vehicle as a unit: valid, and the same numbers as our simulator."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.sensors import DAMPERS
from sayd_env.fmu.unit import vehicle_unit
from sayd_env.fmu.vehicle import VehicleUnit, vehicle_variables
from sayd_env.physics.simulator import Simulator, VehicleModel
from sayd_env.studies.fmu import export

SPEED, SEED = 300 / 3.6, 3


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(
        "estimates", ['damper="sayd-estimate"', "assessment.run_in=200", "assessment.length=600"]
    )


@pytest.fixture(scope="module")
def units(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return export(vehicle_unit(scenario, SPEED, SEED), tmp_path_factory.mktemp("fmu")).files


@pytest.fixture
def folder(units: list[Path]) -> Iterator[str]:
    found = fmpy.extract(str(units[1]))
    yield found
    shutil.rmtree(found)


def started(folder: str, **start: float) -> tuple[Any, dict[str, int]]:
    about = fmpy.read_model_description(folder)
    place = {v.name: v.valueReference for v in about.modelVariables}
    unit = fmpy.instantiate_fmu(folder, about)
    for name, value in start.items():
        if name == "speed":
            unit.setFloat64([place[name]], [value])
        else:
            unit.setInt32([place[name]], [int(value)])
    unit.enterInitializationMode(startTime=0.0)
    unit.exitInitializationMode()
    return unit, place


def test_units_are_valid(units: list[Path]) -> None:
    assert [validate_fmu(str(unit)) for unit in units] == [[], []]


def test_it_runs_as_our_simulator_does(folder: str, scenario: Scenario) -> None:
    """Commands of half the run at 0.05, then 0.6; steps of 2 ms, the simulator's samples are 1 ms."""
    unit, place = started(folder)
    found = []
    for n in range(100):
        command = 0.05 if n < 50 else 0.6
        unit.setFloat64([place[f"current.{d}"] for d in DAMPERS], [command] * len(DAMPERS))
        unit.doStep(currentCommunicationPoint=2e-3 * n, communicationStepSize=2e-3)
        names = [f"force.{d}" for d in DAMPERS] + [
            "lateral_acceleration.rear.trailing",
            "stroke.front.left.upper",
        ]
        found.append(unit.getFloat64([place[name] for name in names]))
    unit.terminate()
    unit.freeInstance()
    simulator = Simulator(VehicleModel(scenario), SPEED, SEED)
    parts = []
    for command in (0.05, 0.6):
        simulator.command(command)
        parts.append(simulator.advance(100, sayds=True))
    force = np.vstack([part.damper_force for part in parts])[1::2]
    acceleration = np.concatenate([part.acceleration[:, 3] for part in parts])[1::2]
    stroke = np.concatenate([part.sayds[:, 0, 0] for part in parts])[1::2]
    own = np.column_stack([force, acceleration, stroke])
    assert np.max(np.abs(np.array(found) - own) / np.max(np.abs(own), axis=0)) < 1e-6


def test_what_is_wrong_is_said_and_the_tool_lives_on(folder: str, capfd: pytest.CaptureFixture[str]) -> None:
    unit, _ = started(folder)
    with pytest.raises(Exception, match="oStep"):
        unit.doStep(currentCommunicationPoint=0.0, communicationStepSize=3.3e-4)
    unit.reset()
    unit.freeInstance()
    assert "expected a multiple of 0.0005 s" in capfd.readouterr().out


def test_without_python_it_says_what_it_needs(
    folder: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SAYD_PYTHON", "/nowhere/python")
    with pytest.raises(Exception, match="nitializationMode"):
        started(folder)
    assert "needs Python with sayd-env" in capfd.readouterr().out


def test_outside_forces_act_on_bogie_and_carbody(scenario: Scenario) -> None:
    """Newton: a carbody's change of momentum is the impulse of the forces, for a constant -F_2 along x.

    The scheme's first step still has half of the force from before.
    """
    unit = VehicleUnit(scenario)
    first = {v.name: i for i, v in enumerate(unit.variables)}
    values = []
    for force in (0.0, 1e3):
        value = np.array([v.start for v in unit.variables])
        value[first["speed"]], value[first["outside_dampers"]] = SPEED, 1.0
        unit.begin(value)
        begin = first[f"F_2.{DAMPERS[0]}"]
        value[begin : begin + len(DAMPERS)] = -force
        for _ in range(2):
            unit.step(1e-3, value)
        ends = first[f"v_2.{DAMPERS[0]}"]
        values.append(value[ends : ends + len(DAMPERS)].mean())
    body = unit.model.multibody
    rows = np.mean([car for *_, car in body.yaw_dampers], axis=0)
    expected = (2e-3 - 0.5 * unit.model.step(SPEED)[0]) * rows @ (8e3 * rows / body.mass)
    assert values[1] - values[0] == pytest.approx(expected, rel=0.01)  # 1 %: what holds the body meanwhile


def test_passive_dampers_are_refused() -> None:
    with pytest.raises(ConfigError, match="--damper sayd"):
        vehicle_variables(load_scenario("estimates"), SPEED, 0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--speed", "5000"], r"--speed: found 5000 km/h; vehicle 'emu' runs at 28.8 to 504"),
        (["--seed", "3000000000"], r"--seed: found 3000000000; a unit's whole numbers end at 2147483647"),
        (["--config", "manchester", "--damper", "sayd"], "0 yaw dampers; the unit needs 4 and 8"),
    ],
)
def test_what_no_unit_can_hold_is_refused(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "--fmu", "vehicle", "--out", str(tmp_path / "unit"), *options]) == 2
    assert message in capsys.readouterr().err


def test_a_configuration_s_passive_dampers_are_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "passive.yaml"
    path.write_text("damper: passive\n")
    for kind in ("vehicle", "damper"):
        out = ["--out", str(tmp_path / "unit")]
        assert main(["export", "--fmu", kind, "--config", str(path), *out]) == 2
        assert "--damper sayd" in capsys.readouterr().err
