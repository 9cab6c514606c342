"""Faults: every kind is read, everything else is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sayd_env.config import ConfigError
from sayd_env.config.fault import (
    DamperLost,
    PowerLost,
    SensorBiased,
    SensorDead,
    SensorFrozen,
    SensorNoisy,
    ValveStuck,
    parse_faults,
)

VALVE = {"kind": "valve_stuck", "damper": "front.left.upper", "current": 0.3, "start_s": 5.0}


def test_every_kind_is_read():
    faults = parse_faults(
        [
            VALVE,
            {"kind": "power_lost", "damper": "rear.right.lower"},
            {"kind": "damper_lost", "damper": "rear.left.upper", "start_s": 1},
            {"kind": "sensor_dead", "signal": "speed"},
            {"kind": "sensor_frozen", "signal": "current.rear.left.upper", "start_s": 0.5},
            {"kind": "sensor_biased", "signal": "stroke.front.left.upper", "bias": -0.002},
            {"kind": "sensor_noisy", "signal": "lateral_acceleration.rear.trailing", "noise": 1.5},
        ],
        "options",
    )
    kinds = [ValveStuck, PowerLost, DamperLost, SensorDead, SensorFrozen, SensorBiased, SensorNoisy]
    assert [type(fault) for fault in faults] == kinds
    assert faults[0] == ValveStuck(kind="valve_stuck", damper="front.left.upper", current=0.3, start_s=5.0)
    assert [fault.start_s for fault in faults[1:4]] == [0.0, 1.0, 0.0]
    assert isinstance(faults[5], SensorBiased)
    assert faults[5].bias == -0.002


def test_no_faults_and_numpy_numbers_are_welcome():
    assert parse_faults([], "options") == ()
    (fault,) = parse_faults(({**VALVE, "current": np.float32(0.5), "start_s": np.int64(3)},), "options")
    assert isinstance(fault, ValveStuck)
    assert (fault.current, fault.start_s) == (0.5, 3.0)


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        ("valve_stuck", "options: faults: found 'valve_stuck'; expected a list of faults"),
        (3, "options: faults: found 3; expected a list of faults"),
        ([3], "faults.0: found 3; expected keys and values"),
        ([{"damper": "front.left.upper"}], "key 'faults.0.kind' is missing: it says of which kind"),
        ([VALVE | {"kind": "valve_stuk"}], "faults.0.kind: found 'valve_stuk', did you mean 'valve_stuck'?"),
        (
            [VALVE | {"current": 1.5}],
            "faults.0.current: found 1.5; expected a number less than or equal to 1",
        ),
        ([VALVE | {"current": float("nan")}], "faults.0.current: found nan; expected a finite number"),
        ([VALVE | {"start_s": -1.0}], "faults.0.start_s: found -1.0; expected a number greater than or"),
        ([VALVE, VALVE | {"curent": 1.0}], "unknown key 'faults.1.curent', did you mean 'current'?"),
        (
            [VALVE | {"damper": "front.left"}],
            "faults.0.damper: found 'front.left'; expected the name of a damper, did you mean",
        ),
        (
            [{"kind": "sensor_dead", "signal": "stroke.front"}],
            "faults.0.signal: found 'stroke.front'; expected the name of a signal",
        ),
        ([{"kind": "sensor_biased", "signal": "speed"}], "key 'faults.0.bias' is missing: Error"),
        (
            [{"kind": "sensor_noisy", "signal": "speed", "noise": -1.0}],
            "faults.0.noise: found -1.0; expected",
        ),
        (
            [{"kind": "damper_lost", "damper": "front.left.upper", "current": 0.5}],
            "unknown key 'faults.0.cur",
        ),
    ],
)
def test_a_bad_fault_is_one_clear_line(raw: Any, expected: str):
    with pytest.raises(ConfigError) as caught:
        parse_faults(raw, "options")
    assert str(caught.value).startswith("options: ")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)
