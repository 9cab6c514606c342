"""Conditions of the map: what they are, that none is held out, and how they reach a scenario."""

from __future__ import annotations

import pytest

from sayd_env.config import ConfigError
from sayd_env.config.comparison import load_comparison
from sayd_env.config.environment import load_environment
from sayd_env.config.map import MapCondition, load_map
from sayd_env.config.profile import load_wheel
from sayd_env.config.scenario import load_scenario
from sayd_env.config.tuning import load_tuning

MAP = load_map()


def test_no_condition_is_held_out():
    """None has a speed, wear, friction, track or seed of the comparison's."""
    held_out, randomisation = load_comparison(), load_environment("training").randomisation
    assert not set(MAP.speeds_kmh) & set(held_out.speeds_kmh)
    assert not {(wheel.profile, wheel.wear) for wheel in MAP.wheels if wheel.wear > 0.0} & {
        (wheel.profile, wheel.wear) for wheel in held_out.wheels
    }
    assert not set(MAP.gauges) & {wheel.gauge for wheel in held_out.wheels}
    assert not set(MAP.friction) & set(held_out.friction)
    assert not set(MAP.seeds) & {*held_out.seeds, *held_out.critical_speed.seeds}
    study = load_scenario().track.irregularity
    for track in held_out.tracks:  # another spectrum than the study's, whatever its level
        assert track.irregularity.model_copy(update={"scale": 1.0}) != study.model_copy(update={"scale": 1.0})
    assert {track.name for track in randomisation.tracks} == {"german_low"}
    assert not set(MAP.seeds) & {case.seed for case in load_tuning().scenarios}


def test_speeds_wheels_and_gauges_are_combined_and_the_rest_varied_one_at_a_time():
    conditions = MAP.conditions()
    assert len(conditions) == len(set(conditions)) == 6 * 5 * (2 + 2 + 2)
    first = MAP.gauges[0], MAP.friction[0], MAP.levels[0]
    for each in conditions:
        changed = [a != b for a, b in zip((each.gauge, each.friction, each.level), first, strict=True)]
        assert sum(changed) <= 1


def test_a_condition_reaches_the_scenario():
    study = load_scenario()
    lma = MAP.scenario(study, MapCondition(200.0, "LMA", 1.440, 0.2, 0.8))
    assert (lma.wheel, lma.wear, lma.track.gauge, lma.friction) == (load_wheel("lma"), 0.0, 1.440, 0.2)
    assert lma.track.irregularity == study.track.irregularity.model_copy(update={"scale": 0.8})
    shifted = MAP.scenario(study, MapCondition(200.0, "1 mm shift", 1.435, study.friction, None))
    assert shifted.wheel == study.wheel.model_copy(update={"shift": 1e-3})
    assert shifted.track == study.track
    worn = MAP.scenario(study, MapCondition(200.0, "worn", 1.435, study.friction, None))
    assert worn == study.model_copy(update={"wear": 1.0})


def test_a_look_has_fewer_conditions():
    short = MAP.shortened()
    assert len(short.conditions()) == len(MAP.quick.speeds_kmh) * len(MAP.quick.wheels)
    assert set(short.conditions()) <= set(MAP.conditions())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("wheels.0.wear=0.5", "profile 'lma' does not say how it wears"),
        ("wheels.0.profile=lmaa", "unknown profile 'lmaa', did you mean 'lma'"),
        ("gauges=[1435]", "gauge: found 1435; allowed are 0.9 to 1.7 m"),
        ("levels=[null, null]", "found a duplicate in None, None"),
        ("quick.wheels=[warn]", "quick: unknown wheel 'warn', did you mean 'worn'"),
        ("openings=[1.5]", "openings.0: found 1.5"),
    ],
)
def test_bad_conditions_are_refused(change: str, message: str):
    with pytest.raises(ConfigError, match=message):
        load_map(overrides=[change])


def test_an_even_track_has_no_level():
    even = load_scenario(overrides=["track=smooth"])
    with pytest.raises(ConfigError, match="levels: track 'of the study' is even"):
        MAP.scenario(even, MapCondition(200.0, "new", 1.435, 0.35, 0.8))
