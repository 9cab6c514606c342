"""Scenario flags say the same as keys of the configuration."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sayd_env.cli.options import VehicleOptions, gauge_text, say_same_tracks
from sayd_env.config import ConfigError
from sayd_env.config.damper import load_sayd
from sayd_env.config.profile import load_wheel
from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import read_track
from sayd_env.physics.profiles import wheel_profile
from sayd_env.runs.policies import policy_spec


def test_without_flags_the_scenario_is_the_configured_one():
    assert VehicleOptions().load() == load_scenario()


def test_flags_equal_assignments():
    flags = VehicleOptions(profile="lma", track="china", wear=0.25, friction=0.5).load()
    assert flags == load_scenario(None, ["wheel=lma", "wear=0.25", "friction=0.5", "track=china"])


def test_rail_and_gauge_equal_assignments():
    found = VehicleOptions(profile="s1002", rail="60e1", gauge="1437.5").load()
    assert found == load_scenario(None, ["wheel=s1002", "wear=0", 'rail="60e1"', "track.gauge=1.4375"])
    assert VehicleOptions(gauge="german_low").load().track.gauge == read_track("german_low").gauge


def test_a_gauge_is_no_data_file(tmp_path: Path):
    path = tmp_path / "track.csv"
    path.write_text("garbage", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"--gauge .*track\.csv: expected mm, .* belongs to --track"):
        VehicleOptions(gauge=str(path)).load()


@pytest.mark.parametrize("text", ["nan", "inf", "-Infinity", "1e9"])
def test_a_typed_gauge_is_a_finite_number(text: str):
    with pytest.raises(ValueError, match="expected a number from 900 to 1700 mm"):
        gauge_text(text)


def test_a_profile_file_is_a_part_and_what_was_done_to_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    points = wheel_profile(load_wheel("s1002"))
    for name, factor in (("left.csv", 1e3), ("right.csv", 1e3 / 25.4)):
        columns = np.column_stack([points.y, points.z])[::20] * factor
        np.savetxt(tmp_path / name, columns, delimiter=";", fmt="%.6f")
    right = f"wheel.right={tmp_path / 'right.csv'}"
    found = VehicleOptions(profile=str(tmp_path / "left.csv"), assignments=[right]).load()
    assert (found.wheel.name, found.wheel.back_to_back) == ("left", 1.36)
    assert found.wheel.right is not None
    assert found.wheel.right.shape.file == str(tmp_path / "right.csv")
    said = capsys.readouterr().err
    assert f"{tmp_path / 'left.csv'}: unit: mm, in which points" in said
    assert f"{tmp_path / 'right.csv'}: unit: in, in which points" in said
    assert "left: backs 1360 mm apart, tape circle 70 mm from the back" in said
    with pytest.raises(ConfigError, match="no such profile file"):
        VehicleOptions(rail="nowhere.prr").load()


@pytest.mark.parametrize(("profile", "wear"), [("new", 0.0), ("worn", 1.0)])
def test_new_and_worn_are_the_scenarios_own_wheels(profile: str, wear: float):
    scenario = VehicleOptions(profile=profile).load()
    assert scenario.wear == wear
    assert scenario.wheel == load_scenario().wheel


def test_a_named_profile_is_unworn():
    assert VehicleOptions(profile="lmb10").load().wear == 0.0


def test_explicit_wear_is_stronger_than_new_and_worn():
    assert VehicleOptions(profile="new", wear=0.5).load().wear == 0.5


@pytest.mark.parametrize(
    ("flags", "assignment"),
    [
        ({"friction": 0.4}, "friction=0.2"),
        ({"wear": 0.0}, "wear=0.2"),
        ({"profile": "worn"}, "wear=0.2"),
        ({"profile": "lma"}, "wheel=s1002"),
        ({"gauge": "1435"}, "track.gauge=1.436"),
        ({"track": "china"}, "track=german_low"),
        ({"damper": "sayd"}, "damper=passive"),
        ({"gauge": "1435"}, "track=china"),
    ],
)
def test_what_an_option_and_an_assignment_give_is_refused(flags: dict[str, Any], assignment: str):
    option, key = next(iter(flags)), assignment.partition("=")[0]
    with pytest.raises(ConfigError, match=f"--{option}: sets what --set {key} does; give one"):
        VehicleOptions(**flags, assignments=[assignment]).load()


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ({"profile": "s1002cm"}, "did you mean 's1002cn'"),
        ({"track": "chinna"}, "did you mean 'china'"),
        ({"track": "1e3"}, "unknown track '1e3'"),
        ({"track": "nowhere/track.yaml"}, "no such"),
    ],
)
def test_unknown_names_are_one_message_with_the_nearest_name(flags: dict[str, str], message: str):
    with pytest.raises(ConfigError, match=message):
        VehicleOptions(**flags).load()


OWN = """
damper: {damper}
set: {{damper.{key}: {value}}}
"""


@pytest.mark.parametrize(
    ("kind", "key", "value"), [("sayd", "current", 0.25), ("passive", "series_stiffness", 4.0e6)]
)
def test_a_kind_of_damper_that_the_configuration_has_keeps_its_numbers(
    kind: str, key: str, value: float, tmp_path: Path
):
    study = tmp_path / "study.yaml"
    study.write_text(OWN.format(damper=kind, key=key, value=value))
    scenario = VehicleOptions(damper=kind, config=str(study)).load()
    assert scenario == load_scenario(str(study))
    assert getattr(scenario.damper, key) == value


def test_another_kind_of_damper_replaces_that_of_the_configuration(tmp_path: Path):
    study = tmp_path / "study.yaml"
    study.write_text(OWN.format(damper="passive", key="series_stiffness", value=4.0e6))
    scenario = VehicleOptions(damper="sayd", config=str(study), assignments=["damper.current=0.5"]).load()
    assert scenario.damper == load_sayd("sayd").model_copy(update={"current": 0.5})


def test_a_damper_may_be_a_file(tmp_path: Path):
    packaged = resources.files("sayd_env.configs").joinpath("damper", "sayd.yaml").read_text(encoding="utf-8")
    own = tmp_path / "mine.yaml"
    own.write_text(packaged.replace("name: ", "name: my-", 1))
    damper = VehicleOptions(damper=str(own)).load().damper
    assert damper.name.startswith("my-")
    assert damper.type == "sayd"


@pytest.mark.parametrize(
    ("settings", "seeds", "line", "said"),
    [
        (["track=smooth"], 2, None, True),
        (["track=smooth"], 1, None, False),
        ([], 2, None, False),
        (["track=smooth"], 2, "straight", True),  # which leaves the track to the episode
        (["track=smooth"], 2, "conditions", False),  # which has spectra of its own
    ],
)
def test_several_seeds_on_one_track_are_said(settings: list[str], seeds: int, line: str | None, said: bool):
    """But for the sensors' errors each of them is the same run, shown as a median."""
    words: list[str] = []
    say_same_tracks(words.append, [load_scenario(None, settings)], seeds, line)
    assert words == ["the track is the same for every seed: nothing of it is drawn"] * said


def test_wear_of_a_named_profile_may_be_assigned():
    """Its wear is 0 by default, which nobody has typed."""
    assert VehicleOptions(profile="s1002cn", assignments=["wear=0.5"]).load().wear == 0.5


def test_dampers_that_no_run_has_are_refused():
    """Passive ones where valves are commanded, and any on a vehicle that has none."""
    own = VehicleOptions(assignments=["damper.series_stiffness=5e6"])
    scenario, mppt2, passive = own.load(), policy_spec("mppt2"), policy_spec("passive")
    with pytest.raises(
        ConfigError, match=r"--set damper.series_stiffness: has no effect: every policy commands valves"
    ):
        own.refuse_idle_dampers([scenario], [mppt2])
    own.refuse_idle_dampers([scenario], [mppt2, passive])
    own.refuse_idle_dampers([scenario])
    usual = VehicleOptions(damper="passive")
    usual.refuse_idle_dampers([usual.load()], [mppt2])  # naming a default changes nothing
    without = VehicleOptions(config="manchester", damper="sayd")
    with pytest.raises(ConfigError, match=r"--damper sayd: .* vehicle 'manchester' has no yaw dampers"):
        without.refuse_idle_dampers([without.load()])
