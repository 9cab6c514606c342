"""Scenarios: studies on top of studies, sections by name, by path and by content, and who is to blame."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from sayd_env.config import ConfigError, packaged_names, read_config
from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import FileConfig, SpectrumConfig

Write = Callable[..., Path]
VEHICLE = read_config("vehicle", "emu-estimate")[0]


def refused(config: object = None, *overrides: str) -> str:
    with pytest.raises(ConfigError) as caught:
        load_scenario(None if config is None else str(config), overrides)
    return str(caught.value)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(text: str, name: str = "study.yaml") -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


def test_every_packaged_study_of_a_scenario_loads():
    for name in packaged_names("study"):
        if {"vehicle", "base"} & set(read_config("study", name)[0]) and name != "calibration":
            assert load_scenario(name).vehicle.wheel_radius > 0


def test_a_study_differs_from_its_base_only_where_it_says_so(write: Write):
    base = load_scenario("estimates")
    path = write("base: estimates\nfriction: 0.3\ndamper: {series_stiffness: 4.0e+6}\n")
    scenario = load_scenario(str(path))
    assert scenario.friction == 0.3
    assert scenario.damper.series_stiffness == 4e6
    assert scenario.damper.curve == base.damper.curve
    assert scenario.vehicle == base.vehicle


def test_single_numbers_stand_under_set(write: Write):
    path = write("set: {vehicle.bodies.carbody.mass: 40000.0, 'damper.curve.1.0': 0.002}\n")
    scenario = load_scenario(str(path))
    assert scenario.vehicle.bodies[0].mass == 40e3
    assert scenario.damper.curve[1][0] == 0.002


def test_a_section_with_a_name_or_another_type_replaces_the_whole(write: Write):
    path = write(
        "base: estimates\n"
        "track: {irregularity: {type: sine, channel: gauge, amplitude: 0.001, wavelength: 9}}\n"
    )
    scenario = load_scenario(str(path))
    assert scenario.track.irregularity.type == "sine"
    assert scenario.track.section == load_scenario("estimates").track.section


def test_assignments_come_last_and_in_their_order():
    scenario = load_scenario(
        "estimates", ["track=china", "track.irregularity.scale=0.5", "vehicle=manchester"]
    )
    assert isinstance(scenario.track.irregularity, SpectrumConfig)
    assert scenario.track.irregularity.scale == 0.5
    assert scenario.vehicle.name == "manchester"


def test_a_name_that_reads_as_a_number_works_on_the_command_line_and_is_explained_in_a_file(write: Write):
    assert load_scenario(None, ["rail=60e1"]).rail.name == load_scenario(None, ["rail='60e1'"]).rail.name
    found = refused(write("rail: 60e1\n"))
    assert "rail: found 600.0; expected a name (60e1, " in found
    assert "did you mean '60e1', in quotes?" in found


def test_paths_in_a_file_start_at_that_file(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write("x_m,alignment_mm\n" + "".join(f"{x},1.0\n" for x in range(100)), "deep/data/measured.csv")
    write(
        "section: {mass: 500.0, roll_inertia: 100.0, lateral_stiffness: 2.0e+7, lateral_damping: 5.0e+4,\n"
        "  vertical_stiffness: 2.5e+8, vertical_damping: 5.0e+4, seat_half_spacing: 0.75}\n"
        "gauge: 1.435\nirregularity: {type: file, path: data/measured.csv, ramp: 10.0}\n",
        "deep/track.yaml",
    )
    write("friction: 0.33\n", "deep/base.yaml")
    write(yaml.safe_dump(VEHICLE | {"name": "mine"}), "vehicle.yaml")
    study = write("base: ./base.yaml\ntrack: track.yaml\nvehicle: ../vehicle.yaml\n", "deep/study.yaml")
    monkeypatch.chdir("/")
    scenario = load_scenario(str(study))
    assert (scenario.friction, scenario.vehicle.name) == (0.33, "mine")
    assert isinstance(scenario.track.irregularity, FileConfig)
    assert Path(scenario.track.irregularity.path).samefile(tmp_path / "deep/data/measured.csv")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty; expected keys and values"),
        ("[1, 2]", "found [1, 2]; expected keys and values"),
        ("weer: 1", "unknown key 'weer', did you mean 'wear'?; allowed here: assessment, "),
        ("wear: 2", "wear: found 2; expected a number less than or equal to 1"),
        ("friction: 0", "friction: found 0; expected a number greater than 0: Coefficient of friction"),
        ("friction: .nan", "friction: found nan; expected a finite number"),
        (
            "damper: {series_stiffness: 100 kN/m}",
            "damper.series_stiffness: found '100 kN/m'; expected a number",
        ),
        (
            "damper: {series_stifness: 1}",
            "unknown key 'damper.series_stifness', did you mean 'series_stiffness'?",
        ),
        ("vehicle: 5", "vehicle: found 5; expected a name (emu, emu-estimate, manchester"),
        ("vehicle: null", "vehicle: found None; expected a name (emu, "),
        ("vehicle: {name: mine}", "keys are missing in 'vehicle': bodies, elements, wheel_radius"),
        ("track: {irregularity: {type: file}}", "key 'track.irregularity.path' is missing: CSV file"),
        (
            "numerics: {step: 0.01}",
            "numerics.step: found 0.01; expected a number less than or equal to 0.001",
        ),
        ("numerics: {step: 1e-12}", "expected a number greater than or equal to 1e-06"),
        ("base: 5", "base: found 5; expected a name, a path or null"),
        ("set: [1]", "set: expected keys and values"),
        ("set: {weer: 1}", "set: unknown key 'weer', did you mean 'wear'?"),
        ("set: {vehicle.bodies.carbdy.mass: 1}", "no entry 'vehicle.bodies.carbdy', did you mean 'carbody'?"),
        ("1: 2", "1: found 1; expected text as key"),
        ("contact: {table_step: 3.1e-4}", "contact: table_half_width must be a whole number of table_step"),
    ],
)
def test_a_bad_study_is_one_line_that_begins_with_its_file(text: str, expected: str, write: Write):
    path = write(text)
    found = refused(path)
    assert found.startswith(f"{path}: ")
    assert expected in found
    assert "\n" not in found


def test_a_study_cannot_stand_on_itself(write: Write):
    write("base: ../a/two.yaml\n", "a/one.yaml")
    write("base: ./one.yaml\n", "a/two.yaml")
    own = write("base: study.yaml\n")
    assert "refers back to this file" in refused(own)
    assert "refers back to this file" in refused(own.parent / "a" / "one.yaml")


def test_the_file_of_a_section_is_blamed_for_what_stands_in_it(write: Write):
    vehicle = write(yaml.safe_dump(VEHICLE | {"wheel_radius": 460}), "vehicle.yaml")
    study = write("vehicle: vehicle.yaml\nfriction: 0.3\n")
    for found in (refused(study), refused(None, f"vehicle={vehicle}")):
        assert found.startswith(f"{vehicle}: wheel_radius: found 460; expected a number less than 1: ")


@pytest.mark.parametrize(
    ("item", "expected"),
    [
        ("vehicle=manchestr", "unknown vehicle 'manchestr', did you mean 'manchester'?; available: emu, "),
        ("track=", "--set: track: found None; expected a name (china, "),
        (
            "rail=s1002",
            "configs/profile/s1002.yaml: is a wheel profile; as rail are available: 60e1, 60e1_30",
        ),
        ("wheel=cn60", "configs/profile/cn60.yaml: is a rail profile; as wheel are available: "),
        ("vehicle.bodies.carbody.mass=-1", "--set: vehicle.bodies.carbody.mass: found -1; expected a number"),
        ("damper.curve=[[0, 0], [0.2, 9], [0.1, 8]]", "velocity (m/s) must increase: 0.1 follows 0.2"),
        ("wheel.shape.file=x.csv", "wheel.shape: give exactly one of zones, points, file; found zones, file"),
        ("assessment.length=10", "--set: assessment: length must hold at least one segment and one window"),
        ("contact.regularisation=1e-9", "expected a number greater than or equal to 0.01"),
    ],
)
def test_a_bad_assignment_is_one_line(item: str, expected: str):
    found = refused(None, item)
    assert expected in found
    assert "\n" not in found


def test_creep_laws():
    """FASTSIM's table by default; the others by name; anything else is refused with what is expected."""
    assert load_scenario().contact.creep_law == "table"
    for law in ("table", "polach", "fastsim"):
        assert load_scenario(None, [f"contact.creep_law={law}"]).contact.creep_law == law
    with pytest.raises(ConfigError, match=r"contact\.creep_law.*'kalker'"):
        load_scenario(None, ["contact.creep_law=kalker"])


def test_the_content_of_a_scenario_finds_its_files_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a track and of a damper's curve, both named relative to where the program runs."""
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path)
    rows = (f"{x},{0.1 * (x % 7)}\n" for x in range(900))
    Path("geometry.csv").write_text("x_m,alignment_mm\n" + "".join(rows))
    Path("curve.csv").write_text("v [mm/s],F [kN]\n0,0\n5,4\n100,12\n")
    scenario = load_scenario("nominal", ["track=geometry.csv", "damper.curve={file: curve.csv}"])
    content = scenario.content()
    (tmp_path / "there" / "all.yaml").write_text(json.dumps(content))
    monkeypatch.chdir(tmp_path / "there")
    again = load_scenario("all.yaml")
    assert again.content() == content
    assert str(tmp_path / "geometry.csv") in json.dumps(again.content())
    assert str(tmp_path / "curve.csv") in json.dumps(again.content())
