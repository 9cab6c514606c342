"""Naming a part changes nothing: its name, a copy of its file or a file that stands on it; refusals."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sayd_env.cli.options import VehicleOptions
from sayd_env.config import ConfigError, packaged_names, read_config
from sayd_env.config.assessment import ASSESSMENT
from sayd_env.config.control import CONTROLLERS, load_controller
from sayd_env.config.damper import DAMPER, SaydDamperConfig, load_sayd
from sayd_env.config.environment import ENVIRONMENT, load_environment
from sayd_env.config.layers import Kind, layered
from sayd_env.config.line import LINE
from sayd_env.config.lines import LINES
from sayd_env.config.profile import load_wheel
from sayd_env.config.scenario import STUDY, load_scenario
from sayd_env.config.sensors import SENSORS
from sayd_env.config.track import TRACK, read_track
from sayd_env.config.vehicle import VEHICLE
from sayd_env.envs.episode_batch import environment_scenario

CONFIGS = Path(__file__).parents[2] / "configs"
NOMINAL = {
    "vehicle": ("vehicle", "emu"),
    "damper": ("damper", "passive"),
    "wheel": ("profile", "s1002cn"),
    "rail": ("profile", "cn60"),
    "track": ("track", "german_low"),
    "track.section": ("section", "slab"),
    "assessment": ("study", "en14363"),
}
"""Parts of the nominal scenario."""
KINDS = [
    VEHICLE,
    DAMPER,
    Kind("profile"),
    TRACK,
    TRACK.parts["section"],
    SENSORS,
    ENVIRONMENT,
    Kind("control"),
    LINE,
    LINES,
]
EVERY = [
    *((kind, name) for kind in KINDS for name in packaged_names(kind.folder)),
    *((STUDY, name) for name in ("estimates", "nominal", "manchester")),
    (ASSESSMENT, "en14363"),
]
"""All packaged files that have layers."""
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(text: str, name: str = "mine.yaml") -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


def refused(read: Callable[..., object], *arguments: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        read(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("key", NOMINAL)
def test_naming_a_part_of_the_nominal_scenario_changes_nothing(key: str, tmp_path: Path):
    folder, name = NOMINAL[key]
    copy = tmp_path / "copy.yaml"
    shutil.copy(CONFIGS / folder / f"{name}.yaml", copy)
    for given in (name, copy):
        assert load_scenario(None, [f"{key}={given}"]) == load_scenario()


@pytest.mark.parametrize(
    "flags",
    [
        {"damper": "passive"},
        {"track": "german_low"},
        {"profile": "s1002cn", "wear": 1.0},
        {"config": "nominal"},
        {"config": "nominal", "damper": "passive", "track": "german_low"},
        {"rail": "cn60"},
    ],
)
def test_options_that_name_the_defaults_change_nothing(flags: dict[str, Any]):
    assert VehicleOptions(**flags).load() == VehicleOptions().load() == load_scenario()


@pytest.mark.parametrize(("kind", "name"), EVERY, ids=[f"{kind.folder}-{name}" for kind, name in EVERY])
def test_a_copy_of_a_file_and_one_that_stands_on_it_are_the_same(kind: Kind, name: str, write: Write):
    copy = write((CONFIGS / kind.folder / f"{name}.yaml").read_text(encoding="utf-8"), "copy.yaml")
    for path in (copy, write(f"base: '{name}'\n"), write("base: ./copy.yaml\n", "second.yaml")):
        assert layered(kind, str(path)).data == layered(kind, name).data


@pytest.mark.parametrize("name", [name for name in packaged_names("control") if name in CONTROLLERS])
def test_a_copied_controller_is_the_controller(name: str, write: Write):
    packaged = load_controller(name)
    copy = write((CONFIGS / "control" / f"{name}.yaml").read_text(encoding="utf-8"), f"{name}.yaml")
    assert load_controller(str(copy)) == packaged
    assert load_controller(str(write(f"base: {name}\n", f"{name}.yaml"))) == packaged


@pytest.mark.parametrize("name", packaged_names("env"))
def test_naming_the_parts_of_an_environment_changes_nothing(name: str):
    config = load_environment(name)
    assert (
        load_environment(name, [f"sensors={config.sensors.name}", "study=nominal", "damper=sayd"]) == config
    )
    scenario = environment_scenario(config)
    assert scenario == load_scenario("nominal", ["damper=sayd"])
    assert scenario.damper == load_sayd("sayd")
    for key, (_, part) in (NOMINAL | {"damper": ("damper", "sayd")}).items():
        assert environment_scenario(config, [f"{key}={part}"]) == scenario


def test_the_nominal_scenario_is_the_estimates_with_calibrated_parts():
    nominal = load_scenario()
    parts = [f"{key}={NOMINAL[key][1]}" for key in ("vehicle", "damper", "wheel", "track")]
    said = {"description", "provenance"}
    scenario = load_scenario("estimates", [*parts, f"friction={nominal.friction}"])
    assert scenario.model_dump(exclude=said) == nominal.model_dump(exclude=said)


@pytest.mark.parametrize(
    "name", [name for name in packaged_names("track") if name not in ("german_low", "german_low-estimate")]
)
def test_another_track_changes_the_irregularities_alone(name: str):
    track, nominal = read_track(name), load_scenario().track
    assert (track.section, track.gauge) == (nominal.section, nominal.gauge)
    assert track.irregularity != nominal.irregularity


ESTIMATED = [(kind, name) for kind, name in EVERY if name.endswith("-estimate")]


@pytest.mark.parametrize(("kind", "name"), ESTIMATED, ids=[name for _, name in ESTIMATED])
def test_a_calibrated_part_is_its_estimate_with_numbers_of_known_provenance(kind: Kind, name: str):
    own, _ = read_config(kind.folder, name.removesuffix("-estimate"))
    assert own["base"] == name
    assert set(own) <= {"base", "name", "section", "provenance", "set"}
    assert ("set" in own) == ("provenance" in own)
    assert "provenance" not in layered(kind, name).data


def test_estimates_are_reachable_by_their_names():
    assert load_scenario(None, ["damper=passive-estimate"]).damper == load_scenario("estimates").damper
    assert VehicleOptions(damper="passive-estimate").load().damper == load_scenario("estimates").damper


def test_a_part_may_stand_on_another_file_and_set_single_numbers(
    write: Write, monkeypatch: pytest.MonkeyPatch
):
    write("base: passive\nset: {curve.1.0: 0.002, series_stiffness: 4.0e+6}\n", "below/soft.yaml")
    path = write("base: below/soft.yaml\nname: mine\nset: {curve.2.1: 12.0e+3}\n")
    monkeypatch.chdir("/")
    packaged, mine = (load_scenario(None, [f"damper={given}"]).damper for given in ("passive", path))
    (_, first, second), expected = packaged.curve, packaged.model_dump()
    assert mine.model_dump() == expected | {
        "name": "mine",
        "curve": ((0.0, 0.0), (0.002, first[1]), (second[0], 12e3)),
        "series_stiffness": 4e6,
    }


def test_a_data_file_lies_beside_the_layer_that_names_it(write: Write, tmp_path: Path):
    table = {"type": "table", "file": str(tmp_path / "a" / "throttle.csv")}
    write("base: sayd\nthrottle: {type: table, file: throttle.csv}\n", "a/table.yaml")
    for text in (
        "base: a/table.yaml\n",
        "base: sayd\nset: {throttle: {type: table, file: a/throttle.csv}}\n",
    ):
        damper = load_sayd(str(write(text)))
        assert damper.throttle.model_dump(exclude_none=True) == table
    write("irregularity: {type: file, path: line.csv}\nbase: smooth\n", "a/line.yaml")
    study = write("set: {track: a/line.yaml}\n", "study.yaml")
    track = load_scenario(str(study)).track
    assert track == read_track(str(tmp_path / "a" / "line.yaml"))
    assert track.irregularity.model_dump()["path"] == str(tmp_path / "a" / "line.csv")


def test_a_named_part_of_a_study_replaces_that_of_its_base_as_a_whole(write: Write):
    """As the option does: what the named file leaves out is not taken from the study below."""
    write("base: smooth\nirregularity: {type: spectrum, wavelength_min: 3.0}\n", "track.yaml")
    study = write("track: track.yaml\n", "study.yaml")
    assert "keys are missing in 'irregularity'" in refused(load_scenario, str(study))
    replaced = load_scenario(str(write("track: smooth\n", "study.yaml")))
    assert replaced == load_scenario(None, ["track=smooth"])


def test_the_file_that_sets_a_number_is_blamed_for_it(write: Write):
    below = write("base: passive\nseries_stiffness: 5 MN/m\n", "below.yaml")
    path = write("base: below.yaml\nset: {curve.1.0: fast}\n", "a.yaml")
    with pytest.raises(ConfigError) as caught:
        load_scenario(None, [f"damper={path}"])
    assert str(caught.value).splitlines() == [
        f"{path}: set: curve.1.0: found 'fast'; expected a number: Points (velocity (m/s), force (N)) "
        "for v >= 0; the last slope goes on",
        f"{below}: series_stiffness: found '5 MN/m'; expected a number: Series stiffness (N/m)",
    ]


def test_a_file_cannot_stand_on_itself(write: Write):
    write("base: ../a/two.yaml\n", "a/one.yaml")
    write("base: ./one.yaml\n", "a/two.yaml")
    own = write("base: mine.yaml\n")
    for path in (own, own.parent / "a" / "one.yaml"):
        for read in (read_track, load_sayd, load_wheel, load_environment, load_scenario):
            assert "refers back to this file" in refused(read, str(path))


@pytest.mark.parametrize(
    ("read", "text", "expected"),
    [
        (load_sayd, "base: sayed", "base: unknown damper 'sayed', did you mean 'sayd'?; available: "),
        (load_sayd, "base: ./sayd.yaml", "sayd.yaml: no such file"),
        (load_sayd, "base: 5", "mine.yaml: base: found 5; expected a name, a path or null"),
        (
            load_sayd,
            "base: passive",
            "passive-estimate.yaml: is a passive damper; as sayd are available: sayd",
        ),
        (load_sayd, "base: sayd\nset: [1]", "mine.yaml: set: expected keys and values"),
        (load_sayd, "base: sayd\nset: {oils.x: 1}", "mine.yaml: set: oils.x=1: no key 'oils', did you mean"),
        (load_wheel, "base: cn60", "cn60.yaml: is a rail profile; as wheel are available: "),
        (read_track, "base: smooth\nsection: slob", "unknown section 'slob', did you mean 'slab'?"),
        (
            read_track,
            "base: smooth\nsection: 3",
            "section: found 3; expected a name (slab, slab-estimate), a",
        ),
    ],
)
def test_a_bad_layer_is_refused_by_name(read: Callable[..., object], text: str, expected: str, write: Write):
    assert expected in refused(read, str(write(text)))


def test_a_damper_cannot_stand_on_one_of_another_type(write: Write):
    path = write("base: sayd\ntype: passive\n")
    expected = f"{path}: type: found 'passive'; its base 'sayd' is a sayd one"
    assert expected in refused(load_scenario, None, [f"damper={path}"])
    assert isinstance(load_scenario(None, ["damper=sayd"]).damper, SaydDamperConfig)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "bodies: []\nelements: []\n",
            "seems to be a vehicle, by its keys bodies, elements; expected a damper",
        ),
        ("sections: []\n", "seems to be a line, by its keys sections; expected a damper"),
        ("irregularity: {}\n", "seems to be a track, by its keys irregularity; expected a damper"),
        ("base: emu\n", "base: unknown damper 'emu', which is a vehicle; available: passive"),
        ("name: mine\n", "key 'type' is missing: it says of which kind the entry is; expected passive, sayd"),
    ],
)
def test_a_file_of_another_kind_is_named(write: Write, text: str, message: str) -> None:
    path = write(text, "mine.yaml")
    with pytest.raises(ConfigError) as caught:
        load_scenario(None, [f"damper={path}"])
    assert str(caught.value).startswith(f"{path}: {message}")


@pytest.mark.parametrize(
    ("base", "assignment"),
    [
        ("passive", "series_stiffness=6.0"),
        ("passive", "series_stiffness=6000.0"),
        ("passive", "curve=[[0, 0], [4.0, 9.8], [250.0, 12.0]]"),
        ("passive", "curve=[[0, 0], [0.004, 9.8], [0.25, 12.0]]"),
        ("passive", "curve=[[0, 0], [4.0, 9800], [250.0, 12000]]"),
        ("sayd", "bogie_mount.stiffness=30.0"),
        ("sayd", "cylinder.area=1860.0"),
        ("sayd", "cylinder.area=18.6"),
        ("sayd", "cylinder.bore=63.0"),
        ("sayd", "cylinder.stroke=200.0"),
        ("sayd", "oil.tank_pressure=1.0"),
        ("sayd", "throttle.density=0.86"),
        ("sayd", "throttle.closed_area=0.167"),
        ("sayd", "relief.opening=66.0"),
        ("sayd", "rectifier.nominal_flow=40.0"),
        ("sayd", "housing_mass=0.017"),
    ],
)
def test_a_dampers_number_in_another_unit_is_refused(base: str, assignment: str) -> None:
    key = assignment.partition("=")[0]
    with pytest.raises(ConfigError, match=rf"damper\.{key}: "):
        load_scenario(None, [f"damper={base}", f"damper.{assignment}"])
