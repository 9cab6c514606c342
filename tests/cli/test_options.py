"""Command-line values: what is accepted, and one clear reason for everything else."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from sayd_env.cli.options import FRICTION, SEED, SHARE, one_of, policy_names
from sayd_env.cli.parsers import ListOf, Number, name, positive, speeds


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
def test_speeds_are_typed_in_km_h_and_read_in_m_s(text: str, expected: tuple[float, ...]):
    assert speeds(text) == tuple(value / 3.6 for value in expected)


def test_a_decimal_step_reaches_the_last_speed():
    found = speeds("100:101:0.1")
    assert len(found) == 11
    assert found[-1] == pytest.approx(101.0 / 3.6, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "an empty place"),
        ("300,,400", "an empty place"),
        ("300,", "an empty place"),
        ("fast", "fast: expected a finite number above 0 km/h"),
        ("0", "0: expected a finite number above 0"),
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
        ("9" * 5000, "expected a finite number above 0 km/h"),
    ],
)
def test_bad_speeds(text: str, problem: str):
    with pytest.raises(ValueError, match=r"use 300,350,400 or 320:445:25") as error:
        speeds(text)
    assert problem in str(error.value)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


NOT_NUMBERS = (
    "",
    " ",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "1_0",
    "0x1",
    "\u0661",
    "0,5",
    "new",
    "1\n2",
    "9" * 5000,
)


@pytest.mark.parametrize("text", [*NOT_NUMBERS, "-0.1", "1.1"])
def test_bad_shares(text: str):
    with pytest.raises(ValueError, match=r"expected a number from 0 to 1$"):
        SHARE(text)


@pytest.mark.parametrize("text", [*NOT_NUMBERS, "0", "-0.3", "1.5"])
def test_bad_friction(text: str):
    with pytest.raises(ValueError, match=r"expected a finite number above 0, at most 1$"):
        FRICTION(text)


@pytest.mark.parametrize("text", [*NOT_NUMBERS, "-1", "1.0", "1e3", "4294967296"])
def test_bad_seeds(text: str):
    with pytest.raises(ValueError, match=r"expected a whole number from 0 to 4294967295$"):
        SEED(text)


def test_bounds_are_included():
    assert (SHARE("0"), SHARE("1"), FRICTION("1"), SEED("4294967295")) == (0.0, 1.0, 1.0, 4294967295)
    assert isinstance(SEED("7"), int)


def test_a_message_shows_what_was_typed_without_control_characters():
    with pytest.raises(ValueError, match=r"expected") as error:
        positive("s")("1\x1b[2J")
    assert str(error.value).isprintable()


@pytest.mark.parametrize(
    ("parser", "text", "problem"),
    [
        (ListOf(SHARE), "0,2", "2: expected a number from 0 to 1"),
        (ListOf(SHARE), "0,", "an empty place: expected a number from 0 to 1"),
        (ListOf(SHARE, distinct=True), "0.5,0.50", "'0.5,0.50': duplicate number"),
        (ListOf(name), "P2,,M7", "found an empty place; expected names, separated by commas"),
        (ListOf(Number(1, 9, whole=True)), "1,10", "10: expected a whole number from 1 to 9"),
    ],
)
def test_bad_lists(parser: Callable[[str], object], text: str, problem: str):
    with pytest.raises(ValueError, match=r"expected|duplicate") as error:
        parser(text)
    assert str(error.value) == problem


def test_lists_keep_their_order():
    assert ListOf(SHARE, distinct=True)("1,0, 0.5") == (1.0, 0.0, 0.5)
    assert ListOf(name)("b, a=x+y") == ("b", "a=x+y")


def test_completion_knows_every_policy_and_goes_on_behind_a_comma():
    from sayd_env import baselines  # noqa: PLC0415 - numba
    from sayd_env.agents import pretrained  # noqa: PLC0415

    assert set(policy_names("")) == {*baselines.NAMES, *pretrained.names()}
    assert policy_names("passive,mppt2-t") == ["passive,mppt2-tuned"]
    assert one_of("new", kind="profile")("lm") == ["lma", "lmb10"]
