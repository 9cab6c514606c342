"""Command-line values: what is accepted, and one clear message for everything else."""

from __future__ import annotations

import pytest

from sayd_env.cli.options import parse_friction, parse_speeds, parse_wear
from sayd_env.config import ConfigError


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("300", (300.0,)),
        ("300,350, 400", (300.0, 350.0, 400.0)),
        ("320:445:25", (320.0, 345.0, 370.0, 395.0, 420.0, 445.0)),
        ("300:390:40", (300.0, 340.0, 380.0)),
        ("300:300:10", (300.0,)),
        ("2e2,250.5", (200.0, 250.5)),
    ],
)
def test_speeds(text: str, expected: tuple[float, ...]):
    assert parse_speeds(text) == expected


def test_a_decimal_step_reaches_the_last_speed():
    speeds = parse_speeds("100:101:0.1")
    assert len(speeds) == 11
    assert speeds[-1] == pytest.approx(101.0, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "an empty place"),
        ("300,,400", "an empty place"),
        ("300,", "an empty place"),
        ("fast", "found 'fast'"),
        ("0", "found 0; expected a finite number above 0"),
        ("-300", "above 0"),
        ("nan", "above 0"),
        ("inf", "above 0"),
        ("400,300", "300 follows 400; speeds must rise"),
        ("300,300", "speeds must rise"),
        ("445:320:25", "the last speed 320 is below the first 445"),
        ("300:400", "expected first:last:step"),
        ("300:400:0", "above 0"),
        ("300:400:-10", "above 0"),
        ("300:nan:10", "above 0"),
        ("1:500:0.001", "at most 1000"),
        ("1:1e300:1e-300", "at most 1000"),
    ],
)
def test_bad_speeds(text: str, problem: str):
    with pytest.raises(ConfigError) as error:
        parse_speeds(text)
    assert problem in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["-0.1", "1.1", "nan", "inf", "new", ""])
def test_bad_wear(text: str):
    with pytest.raises(ConfigError, match=f"--wear {text}: expected a number from 0 to 1"):
        parse_wear(text)


@pytest.mark.parametrize("text", ["0", "-0.3", "1.5", "nan"])
def test_bad_friction(text: str):
    with pytest.raises(ConfigError, match=f"--friction {text}: expected"):
        parse_friction(text)


def test_bounds_of_wear_and_friction_are_included():
    assert (parse_wear("0"), parse_wear("1"), parse_friction("1")) == (0.0, 1.0, 1.0)
