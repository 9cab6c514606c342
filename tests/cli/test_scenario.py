"""Scenario flags say the same as keys of the configuration."""

from __future__ import annotations

import pytest

from sayd_env.cli.scenario import scenario_from
from sayd_env.config import ConfigError
from sayd_env.config.scenario import load_scenario


def test_without_flags_the_scenario_is_the_configured_one():
    assert scenario_from() == load_scenario()


def test_flags_equal_assignments():
    flags = scenario_from(profile="lma", wear=0.25, friction=0.5, track="china")
    assert flags == load_scenario(None, ["wheel=lma", "wear=0.25", "friction=0.5", "track=china"])


@pytest.mark.parametrize(("profile", "wear"), [("new", 0.0), ("worn", 1.0)])
def test_new_and_worn_are_the_scenarios_own_wheels(profile: str, wear: float):
    scenario = scenario_from(profile=profile)
    assert scenario.wear == wear
    assert scenario.wheel == load_scenario().wheel


def test_a_named_profile_is_unworn():
    assert scenario_from(profile="lmb10").wear == 0.0


def test_explicit_wear_is_stronger_than_new_and_worn_and_set_is_stronger_than_flags():
    assert scenario_from(profile="new", wear=0.5).wear == 0.5
    assert scenario_from(None, ["friction=0.2"], friction=0.4).friction == 0.2


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
        scenario_from(**flags)
