"""Scenario flags say the same as keys of the configuration."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from sayd_env.cli.options import VehicleOptions
from sayd_env.config import ConfigError
from sayd_env.config.damper import load_sayd
from sayd_env.config.scenario import load_scenario


def test_without_flags_the_scenario_is_the_configured_one():
    assert VehicleOptions().load() == load_scenario()


def test_flags_equal_assignments():
    flags = VehicleOptions(profile="lma", track="china", wear=0.25, friction=0.5).load()
    assert flags == load_scenario(None, ["wheel=lma", "wear=0.25", "friction=0.5", "track=china"])


@pytest.mark.parametrize(("profile", "wear"), [("new", 0.0), ("worn", 1.0)])
def test_new_and_worn_are_the_scenarios_own_wheels(profile: str, wear: float):
    scenario = VehicleOptions(profile=profile).load()
    assert scenario.wear == wear
    assert scenario.wheel == load_scenario().wheel


def test_a_named_profile_is_unworn():
    assert VehicleOptions(profile="lmb10").load().wear == 0.0


def test_explicit_wear_is_stronger_than_new_and_worn_and_set_is_stronger_than_flags():
    assert VehicleOptions(profile="new", wear=0.5).load().wear == 0.5
    assert VehicleOptions(assignments=["friction=0.2"], friction=0.4).load().friction == 0.2


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
