"""Damper curves and valve maps in the units of test rigs: the same dampers as in SI, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.cli.options import VehicleOptions
from sayd_env.config import ConfigError, DataError
from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig, TableThrottle
from sayd_env.config.scaling import scaled
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.vehicle import MeasuredCurve
from sayd_env.measured.dampers import force_velocity, read_curve
from sayd_env.measured.notes import measured_notes
from sayd_env.measured.valves import ThrottleField, read_valve_map

POINTS = [[0.0, 0.0], [0.01, 4500.0], [0.05, 9200.0], [0.1, 11900.0]]
CURVE = "velocity [mm/s];force [kN]\n10;4,5\n50;9,2\n100;11,9\n"
LITRE_PER_MINUTE = 1e-3 / 60.0
MAP = """drop [bar] \\ current [A] -> flow [l/min];0,2;0,8;1,4
10;0,5;2;15
40;1;4;30
90;1,5;6;45
"""


def write(folder: Path, text: str, name: str = "rig.csv", encoding: str = "utf-8") -> str:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return str(path)


def curve(folder: Path, text: str, **keys: object) -> list[list[float]]:
    found = read_curve(MeasuredCurve.model_validate({"file": write(folder, text)} | keys))
    return [[round(v, 12), round(f, 9)] for v, f in found.tolist()]


def valve(folder: Path, text: str, **keys: object) -> ThrottleField:
    file = write(folder, text)
    return read_valve_map(TableThrottle.model_validate({"type": "table", "file": file} | keys))


@pytest.mark.parametrize(
    "text",
    [
        CURVE,
        "velocity_mm_s,force_n\n10,4500\n50,9200\n100,11900\n",
        "# rig 7\nF\tv\nkN\tm/s\n0\t0\n4.5\t0.01\n9.2\t0.05\n11.9\t0.1\n",
        "v (mm/s);F (daN)\n-100;-1190\n-50;-920\n-10;-450\n0;0\n10;450\n50;920\n100;1190\n",
    ],
)
def test_a_curve_is_the_same_in_all_units(tmp_path: Path, text: str) -> None:
    assert curve(tmp_path, text) == POINTS


def test_units_may_stand_in_the_configuration(tmp_path: Path) -> None:
    text = CURVE.replace(" [mm/s]", "").replace(" [kN]", "")
    assert curve(tmp_path, text, velocity_unit="mm/s", force_unit="kN") == POINTS


def test_directions_that_differ_are_chosen_by_the_user(tmp_path: Path) -> None:
    text = "velocity [m/s],force [kN]\n-0.1,-8\n-0.05,-6\n0.05,9\n0.1,12\n"
    with pytest.raises(DataError, match=r"at 0.1 m/s the forces of both directions are 1.2e\+04 and 8000 N"):
        curve(tmp_path, text)
    for direction, forces in (("positive", (9e3, 12e3)), ("negative", (6e3, 8e3)), ("mean", (7.5e3, 10e3))):
        found = curve(tmp_path, text, direction=direction)
        assert found == [[0.0, 0.0], [0.05, forces[0]], [0.1, forces[1]]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "velocity;force [kN]\n10;4\n50;9\n60;10\n",
            "line 1: column 'velocity': the unit of velocity is missing",
        ),
        (
            "velocity [m/s];force [kN]\n10;4\n50;9\n60;10\n",
            "velocity reaches 60000 mm/s; .*is its unit right",
        ),
        ("velocity [mm/s];force [N]\n10;4\n50;9\n60;10\n", "force reaches 0.01 kN; .*is its unit right"),
        (
            "velocity [mm/s];force [lb]\n10;4\n50;9\n60;10\n",
            "unknown unit 'lb'; allowed: mm/s, m/s, kN, N, daN",
        ),
        ("velocity [mm/s];force [bar]\n10;4\n50;9\n60;10\n", r"column 'force \[bar\]' is none of"),
        (
            "velocity [mm/s];force [kN];t [s]\n10;4;1\n50;9;2\n60;9;3\n",
            r"column 't \[s\]' is none of .* take it",
        ),
        ("velocity [mm/s];v [m/s]\n10;4\n50;9\n60;10\n", "expected one velocity"),
        ("velocity [mm/s];force [kN]\n10;4\n50;9\n60;8.5\n", "line 4: the force must rise with the velocity"),
        ("velocity [mm/s];force [kN]\n10;4\n50;9\n60;9\n", "line 4: .* give a saturated one a small slope"),
        (
            "velocity [mm/s];force [kN]\n10;-4\n50;-9\n60;-9.5\n",
            "line 2: .* force has the sign of its velocity",
        ),
        ("velocity [mm/s];force [kN]\n10;4\n50;9\n50;9.5\n", "line 4: velocity 0.05 m/s appears twice"),
        ("velocity [mm/s];force [kN]\n0;0.2\n50;9\n60;9.5\n", "line 2: the force at standstill is 200 N"),
        ("velocity [mm/s];force [kN]\n10;4\n50;x\n60;9.5\n", r"line 3: column 'force \[kN\]': found 'x'"),
        ("10;4\n50;9\n60;9.5\n", "found no header"),
        ("velocity [mm/s];stroke [mm]\n10;4\n50;9\n60;10\n", r"column 'stroke \[mm\]' is none of"),
    ],
)
def test_bad_curves_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        curve(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "rig.csv"))


def test_a_unit_that_contradicts_the_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="states kN, but force_unit is N"):
        curve(tmp_path, CURVE, force_unit="N")
    with pytest.raises(DataError, match="force_unit: found 'bar'; allowed: kN, N, daN"):
        curve(tmp_path, CURVE, force_unit="bar")
    with pytest.raises(DataError, match="direction: found 'mean', but velocities are all positive"):
        curve(tmp_path, CURVE, direction="mean")


LISTED = "current [mA],dp [kPa],Q [m3/h]\n" + "".join(
    f"{1e3 * i:g},{1e2 * dp:g},{0.06 * q:g}\n"
    for i, one in ((0.2, 0.5), (0.8, 2.0), (1.4, 15.0))
    for dp, q in ((10, one), (40, 2 * one), (90, 3 * one))
)
TURNED = "\n".join(";".join((row.split(";")[0], *row.split(";")[:0:-1])) for row in MAP.strip().splitlines())
"""Its currents from the highest to the lowest."""


@pytest.mark.parametrize(
    ("text", "limits"), [(MAP, (0.2, 1.4)), (TURNED, (0.2, 1.4)), (LISTED, (200.0, 1400.0))]
)
def test_a_valve_map_is_the_same_in_all_units(tmp_path: Path, text: str, limits: tuple[float, float]) -> None:
    """An orifice: linear over the root of the pressure drop, in litres a minute 0.5, 2 and 15 at 10 bar."""
    field = valve(tmp_path, text, current_range=limits)
    np.testing.assert_allclose(field.current, [0.0, 0.5, 1.0], atol=1e-12)
    flow = field.at([[0.0], [0.25], [1.0]], [2.5e5, 1e6, 1.6e7])
    expected = np.array([[0.5], [1.25], [15.0]]) * [0.5, 1.0, 4.0] * LITRE_PER_MINUTE
    np.testing.assert_allclose(flow, expected, rtol=1e-9)


def test_a_valve_that_current_closes(tmp_path: Path) -> None:
    text = "dp [bar] I [A] Q [l/min];0;0,5;1\n10;15;2;0,5\n40;30;4;1\n"
    field = valve(tmp_path, text, current_range=(1.0, 0.0))
    np.testing.assert_allclose(field.at([0.0, 0.5, 1.0], 1e6), np.array([0.5, 2.0, 15.0]) * LITRE_PER_MINUTE)


def test_currents_beyond_the_range_are_cut(tmp_path: Path) -> None:
    field = valve(tmp_path, MAP, current_range=(0.5, 1.1))
    np.testing.assert_allclose(field.current, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(field.flow[:, 1], np.array([1.25, 2.0, 8.5]) * LITRE_PER_MINUTE)


def test_a_share_of_the_command_needs_no_range(tmp_path: Path) -> None:
    text = "dp [bar] i [%] Q [l/min],0,50,100\n0,0,0,0\n10,1,2,3\n"
    assert valve(tmp_path, text).current.tolist() == [0.0, 0.5, 1.0]
    bare = "x,0,1\n0,0,0\n10,1,3\n"
    assert valve(tmp_path, bare, current_unit="-", drop_unit="bar", flow_unit="l/min").flow[1, 1] == 3.0 / 6e4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MAP, r"currents in A need current_range: .* for example \[0.2, 1.4\]"),
        ("x,0,1\n0,0,0\n1e5,1e-5,1e-4\n", "line 1: first cell 'x': the unit of current is missing"),
        ("dp [bar] i [-] q,0,1\n0,0,0\n10,1,2\n", "the unit of flow is missing: .* or give flow_unit"),
        ("dp [bar] i [-] q [l/min],0,50,100\n0,0,0,0\n9,1,2,3\n", "currents up to 100 .*expected shares, %"),
        ("dp [bar] i [-] q [l/min];0;0.2.;1\n0;0;0;0\n9;1;2;3\n", "found '0.2.'; expected a current"),
        ("dp [bar] i [-] q [furlong],0,1\n0,0,0\n10,1,2\n", "found 'furlong' as a unit; allowed: A, mA"),
        ("dp [Pa] i [-] q [l/min],0,1\n0,0,0\n10,1,2\n", "drop reaches 0.0001 bar; .*is its unit right"),
        ("dp [bar] i [-] q [m3/s],0,1\n0,0,0\n10,1,2\n", "flow reaches 120000 l/min; .*is its unit right"),
        (
            "dp [Pa] i [-] q [l/min],0,1\n0,0,0\n5e-324,1,2\n1e5,2,3\n",
            "line 3: pressure drops must rise, by 1",
        ),
    ],
)
def test_maps_in_units_unknown_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DataError, match=message) as caught:
        valve(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "rig.csv"))


@pytest.mark.parametrize("limits", [(0.0, 1.4), (0.2, 2.0), (0.5, 0.5)])
def test_a_range_that_the_map_does_not_cover_is_refused(tmp_path: Path, limits: tuple[float, float]) -> None:
    with pytest.raises(DataError, match=r"they must reach from|expected two currents"):
        valve(tmp_path, MAP, current_range=limits)


def chosen(damper: str, *assignments: str) -> Scenario:
    return VehicleOptions(damper=damper, assignments=list(assignments)).load("estimates")


def test_the_option_takes_files_of_all_kinds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    passive = chosen(write(tmp_path, CURVE, "curve.csv")).damper
    assert isinstance(passive, PassiveDamperConfig)
    np.testing.assert_allclose(force_velocity(passive), POINTS)
    assert passive.name == "curve"
    assert "curve.csv: force over velocity to 100 mm/s and 11.9 kN" in capsys.readouterr().err

    sayd = chosen(write(tmp_path, MAP, "map.txt"), "damper.throttle.current_range=[0.2, 1.4]").damper
    assert isinstance(sayd, SaydDamperConfig)
    assert isinstance(sayd.throttle, TableThrottle)
    assert read_valve_map(sayd.throttle).drop[-1] == 9e6
    assert "from 0.2 to 1.4 A (0.2 closed, 1.4 open)" in capsys.readouterr().err

    write(tmp_path, "base: passive-estimate\ncurve: {file: curve.csv, scale: 2.0}\n", "mine.yaml")
    double = chosen(str(tmp_path / "mine.yaml")).damper
    assert isinstance(double, PassiveDamperConfig)
    np.testing.assert_allclose(force_velocity(double)[:, 1], 2.0 * np.array(POINTS)[:, 1])

    with pytest.raises(DataError, match="found 'x_m', 'gauge_mm'; expected columns of a curve"):
        chosen(write(tmp_path, "x_m,gauge_mm\n0,1\n1,1\n2,1\n"))
    with pytest.raises(
        ConfigError, match=r"rig\.csv: is a table; .* of a damper, .*curve: .file: .*or --damper .*rig\.csv"
    ):
        load_scenario("estimates", [f"damper={tmp_path / 'rig.csv'}"])


def test_dampers_of_the_vehicle_have_measured_curves_too(tmp_path: Path) -> None:
    write(tmp_path, CURVE, "curve.csv")
    text = "base: estimates\nset: {vehicle.elements.lateral_damper.curve: {file: curve.csv}}\n"
    scenario = load_scenario(write(tmp_path, text, "study.yaml"))
    (damper,) = [each for each in scenario.vehicle.elements if each.name == "lateral_damper"]
    np.testing.assert_allclose(force_velocity(damper), POINTS)  # type: ignore[arg-type]
    assert measured_notes(dict(scenario)) == (
        f"{tmp_path / 'curve.csv'}: force over velocity to 100 mm/s and 11.9 kN",
    )
    double = scaled(scenario, {("vehicle", "elements", "lateral_damper", "curve"): 2.0})
    (damper,) = [each for each in double.vehicle.elements if each.name == "lateral_damper"]
    np.testing.assert_allclose(force_velocity(damper)[:, 1], 2.0 * np.array(POINTS)[:, 1])  # type: ignore[arg-type]


def test_the_examples_of_the_documentation_are_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "dampers.md").read_text(encoding="utf-8")
    points, field, listed = [part.split("```")[0] for part in text.split("```text\n")[1:]]
    assert curve(tmp_path, points) == POINTS
    for example in (field, listed):
        found = valve(tmp_path, example, current_range=(0.2, 1.4))
        np.testing.assert_allclose(found.at([0.0, 1.0], 4e6), np.array([1.0, 30.0]) * LITRE_PER_MINUTE)
