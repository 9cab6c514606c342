"""Sensors: packaged sets, the list of signals, refusals."""

from __future__ import annotations

from collections import Counter

import pytest

from sayd_env.config import ConfigError, packaged_names
from sayd_env.config.damper import load_sayd
from sayd_env.config.scenario import load_scenario
from sayd_env.config.sensors import DAMPERS, KINDS, SIGNALS, UNITS, load_sensors
from sayd_env.physics.multibody import assemble


def test_there_are_41_signals_in_groups():
    names = list(SIGNALS)
    assert len(names) == 41
    assert names[:2] == ["lateral_acceleration.front.leading", "lateral_acceleration.front.trailing"]
    assert names[4:6] == ["longitudinal_acceleration.front.left", "longitudinal_acceleration.front.right"]
    assert names[8] == "pressure_a.front.left.upper"
    assert names[16] == "pressure_b.front.left.upper"
    assert names[24] == "stroke.front.left.upper"
    assert names[32] == "current.front.left.upper"
    assert names[40] == "speed"
    assert Counter(SIGNALS.values()) == {
        "lateral_acceleration": 4,
        "longitudinal_acceleration": 4,
        "pressure": 16,
        "stroke": 8,
        "current": 8,
        "speed": 1,
    }
    assert set(UNITS) == set(KINDS)


def test_dampers_are_named_in_the_order_of_the_vehicle():
    scenario = load_scenario()
    places = [name for name, *_ in assemble(scenario.vehicle, scenario.track.section).yaw_dampers]
    assert [place.removeprefix("yaw_damper.") for place in places] == list(DAMPERS)


def test_the_ideal_set_has_no_errors_and_the_ranges_of_the_realistic_one():
    ideal, realistic = load_sensors("ideal"), load_sensors("realistic")
    assert {"ideal", "realistic"} <= set(packaged_names("sensors"))
    for signal in SIGNALS:
        sensor, other = ideal.of(signal), realistic.of(signal)
        assert (sensor.noise, sensor.bias, sensor.bias_spread, sensor.resolution) == (0.0, 0.0, 0.0, 0.0)
        assert (sensor.bandwidth, sensor.sampling) == (None, 0.001)
        assert (sensor.low, sensor.high) == (other.low, other.high)
        assert other.noise > 0.0
        assert other.resolution < 0.01 * (other.high - other.low)


def test_ranges_hold_what_the_hardware_can_do():
    sensors, damper = load_sensors("realistic"), load_sayd("sayd")
    assert sensors.pressure.high > damper.relief.full + damper.oil.tank_pressure
    assert sensors.stroke.high - sensors.stroke.low == pytest.approx(damper.cylinder.stroke)
    assert sensors.speed.high >= load_scenario().vehicle.speed_range[1]


def test_noise_of_the_accelerometer_is_that_of_its_data_sheet():
    # ADXL356: 75 ug/sqrt(Hz), white up to half of the sampling rate of 1 kHz.
    computed = 75e-6 * 9.81 * (500.0**0.5)
    assert computed == pytest.approx(0.0165, rel=0.01)
    assert computed <= load_sensors("realistic").lateral_acceleration.noise <= 1.5 * computed


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("pressure.noise=-1", "pressure.noise: found -1; expected a number greater than or equal to 0"),
        ("stroke.sampling=0.0015", "stroke.sampling: found 0.0015; expected a multiple of 0.001 s"),
        ("stroke.sampling=0.0001", "expected a multiple of 0.001 s"),
        ("stroke.bandwidth=0", "stroke.bandwidth: found 0; expected a number greater than 0"),
        ("speed.low=200", "speed: low (200) must be below high (140)"),
        ("speed.resolution=1000", "speed: resolution (1000) must not exceed the range"),
        ("current.nois=0", "unknown key 'current.nois', did you mean 'noise'?"),
        ("gyro={low: 0}", "unknown key 'gyro'; allowed here: current"),
    ],
)
def test_a_bad_sensor_is_one_clear_line(override: str, expected: str):
    with pytest.raises(ConfigError) as caught:
        load_sensors("realistic", [override])
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)
