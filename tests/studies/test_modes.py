"""The study of modes and its command."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config.scenario import load_scenario
from sayd_env.physics.linear import modes as modes_at
from sayd_env.physics.simulator import VehicleModel

# A vehicle that hunts on worn wheels, frozen for this test: its arm joints and yaw dampers are soft.
HUNTS = (
    "vehicle.elements.arm_joint.stiffness.0=50e6",
    "vehicle.elements.arm_joint.stiffness.1=6e6",
    "damper.curve=[[0.0, 0.0], [0.12, 12.0e3], [1.0, 15.0e3]]",
    "damper.series_stiffness=5.0e6",
)


def test_command_gives_the_modes_at_each_speed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["modes", "--config", "estimates", "--json", "--speeds", "200,240", "--out", str(tmp_path)]) == 0
    )
    result = json.loads(capsys.readouterr().out)
    assert result["amplitude_mm"] == 3.0
    vehicle = VehicleModel(load_scenario("estimates"))
    for speed in (200.0, 240.0):
        rows = [row for row in result["modes"] if row["speed_kmh"] == pytest.approx(speed)]
        expected = modes_at(vehicle, speed / 3.6, 3e-3)
        assert [row["frequency_hz"] for row in rows] == pytest.approx(
            [mode.frequency_hz for mode in expected]
        )
        assert [row["damping_ratio"] for row in rows] == pytest.approx(
            [mode.damping_ratio for mode in expected]
        )
        assert len({row["name"] for row in rows}) == len(rows)
    assert {p.name for p in tmp_path.iterdir()} == {"result.json", "modes.csv", "root_locus.png"}
    with (tmp_path / "modes.csv").open() as file:
        assert len(list(csv.reader(file))) == 1 + len(result["modes"])


def test_damping_changes_sign_at_the_linear_critical_speed(capsys: pytest.CaptureFixture[str]) -> None:
    changes = [argument for change in HUNTS for argument in ("--set", change)]
    arguments = ["--config", "estimates", *changes, "--json", "--speeds", "250", "--amplitude", "4"]
    assert main(["modes", *arguments]) == 0
    critical = json.loads(capsys.readouterr().out)["linear_critical_speed_kmh"]
    assert critical is not None
    vehicle = VehicleModel(load_scenario("estimates", HUNTS))
    least = [
        min(
            m.damping_ratio
            for m in modes_at(vehicle, critical * factor / 3.6, 4e-3)
            if 0.5 < m.frequency_hz < 15.0
        )
        for factor in (0.98, 1.02)
    ]
    assert least[0] > 0.0 > least[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--amplitude", "0"], "--amplitude 0: expected a finite number above 0 mm"),
        (["--amplitude", "40"], "linearisation amplitude: found 40 mm"),
        (["--speeds", "900"], "outside the range of vehicle 'emu'"),
    ],
)
def test_bad_input_is_refused(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["modes", *arguments]) == 2
    assert message in capsys.readouterr().err


def test_an_unstable_vehicle_has_no_critical_speed_in_the_range(capsys: pytest.CaptureFixture[str]) -> None:
    """The end of the search is none: without yaw dampers, on soft springs, it lies below."""
    soft = "vehicle.elements.primary_spring.stiffness=[1e5, 1e5, 1e6]"
    weak = ["--set", soft, "--set", "vehicle.elements.arm_joint.stiffness=[1e4, 1e4, 1e4]"]
    assert main(["modes", "--speeds", "300", "--json", *weak]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["linear_critical_speed_kmh"], found["status"]) == (None, "below_grid")


def test_default_speeds_end_where_the_vehicle_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["modes", "--json", "--set", "vehicle=manchester", "--set", "wear=0.0"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert max(row["speed_kmh"] for row in result["modes"]) == pytest.approx(400.0)
    assert np.allclose(result["critical_speed_range_kmh"], [100.0, 112.0 * 3.6])
