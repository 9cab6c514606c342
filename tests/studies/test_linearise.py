"""The study of the linear vehicle and its command."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from sayd_env.cli import main
from sayd_env.config.scenario import load_scenario
from sayd_env.physics.linear import OperatingPoint, equivalent, modes_of
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.state_space import state_space

VEHICLE = ["--config", "estimates", "--wear", "0"]
POINT = [*VEHICLE, "--speed", "250", "--shift", "3", "--stroke-speed", "8"]


def test_command_writes_the_system_that_python_gives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["linearise", *POINT, "--json", "--out", str(tmp_path)]) == 0
    result = json.loads(capsys.readouterr().out)
    vehicle = VehicleModel(load_scenario("estimates", ["wear=0.0"]))
    point = OperatingPoint(speed=250.0 / 3.6, shift=3e-3, stroke_speed=8e-3)
    steady, system = equivalent(vehicle, point), state_space(vehicle, point)
    assert result["speed_kmh"] == pytest.approx(250.0)
    assert result["stroke_speed_rms_mm_s"] == pytest.approx(8.0)
    assert result["creep_factor"] == pytest.approx(steady.creep)
    assert [row["frequency_hz"] for row in result["modes"]] == pytest.approx(
        [mode.frequency_hz for mode in modes_of(vehicle, steady)]
    )
    assert list(result["inputs"]) == list(system.inputs)
    assert result["outputs"]["stroke.rear.right.lower"] == "m"
    stored = np.load(tmp_path / "state_space.npz")
    np.testing.assert_allclose(stored["A"], system.a, rtol=1e-9)
    assert {path.name for path in tmp_path.iterdir()} == {
        "bode.png",
        "modes.csv",
        "names.csv",
        "responses.csv",
        "result.json",
        "state_space.mat",
        "state_space.npz",
    }
    with (tmp_path / "names.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows if row["kind"] == "output"] == list(system.outputs)


def test_semi_active_dampers_at_rest_and_one_track(capsys: pytest.CaptureFixture[str]) -> None:
    rest = ["--damper", "sayd-estimate", "--shift", "0", "--stroke-speed", "0", "--delay-order", "4"]
    assert main(["linearise", *VEHICLE, "--speed", "250", *rest, "--json"]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert result["damper"]["force_per_command_n"] == 0.0
    assert result["creep_factor"] == 1.0
    assert {"alignment", "vertical", "cross_level", "gauge"} <= set(result["inputs"])
    assert "held by friction: a command moves nothing" in " ".join(captured.err.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--current", "0.3"], "damper 'passive-estimate' has no valve"),
        (["--damper", "sayd-estimate", "--stroke-speed", "1500"], "stroke speed of 1500 mm/s (RMS)"),
        (["--shift", "40"], "linearisation amplitude: found 56.5685 mm"),
        (["--speed", "900"], "outside the range of vehicle 'emu-estimate'"),
        (["--delay-order", "26"], "--delay-order 26: expected a whole number from 1 to 25"),
    ],
)
def test_bad_input_is_refused(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["linearise", *VEHICLE, *arguments]) == 2
    assert message in capsys.readouterr().err.replace("\n", " ")


def test_a_curve_from_a_file_is_the_same_points(tmp_path: Path) -> None:
    points = [[0.0, 0.0], [0.01, 6000.0], [0.1, 9000.0]]
    rows = [f"{1e3 * v:g},{1e-3 * f:g}" for v, f in points]
    (tmp_path / "curve.csv").write_text("\n".join(["velocity_mm_s,force_kN", *rows]), encoding="utf-8")
    for name, curve in (("file", f"{{file: {tmp_path / 'curve.csv'}}}"), ("points", str(points))):
        out = ["--set", f"damper.curve={curve}", "--out", str(tmp_path / name), "--json"]
        assert main(["linearise", *POINT, *out]) == 0
    one, other = (np.load(tmp_path / name / "state_space.npz")["A"] for name in ("file", "points"))
    np.testing.assert_allclose(one, other, rtol=1e-9)
