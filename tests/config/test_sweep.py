"""Sweeps: how several values of a key are written, and what is refused."""

from __future__ import annotations

import pytest

from sayd_env.config import ConfigError, parse_yaml
from sayd_env.config.sweep import split_values, variants


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("0.5", ["0.5"]),
        ("0,0.5, 1", ["0", "0.5", "1"]),
        ("[1, 2]", ["[1, 2]"]),
        ("[1, 2],[3, 4]", ["[1, 2]", "[3, 4]"]),
        ("{a: 1, b: [2, 3]}", ["{a: 1, b: [2, 3]}"]),
        ("'a, b'", ["'a, b'"]),
        ("'a, b',c", ["'a, b'", "c"]),
        ('["x, y", "]"],2', ['["x, y", "]"]', "2"]),
        ("it's,one", ["it's", "one"]),
        ("", [""]),
        ("1,", ["1", ""]),
    ],
)
def test_commas_part_values_outside_brackets_and_quotes(text: str, parts: list[str]) -> None:
    assert split_values(text) == parts


@pytest.mark.parametrize("text", ["[1, 2]", "{a: 1, b: 2}", "'a, b'", '["x, y", 1]'])
def test_what_yaml_reads_as_one_value_is_one(text: str) -> None:
    """A flow sequence, a flow mapping or a quoted text of YAML is never cut."""
    (part,) = split_values(text)
    assert parse_yaml(part, "") == parse_yaml(text, "")


def test_several_keys_make_their_product() -> None:
    found = variants(["wear=0,1", "track=china", "friction=0.2,0.3,0.4"])
    assert [tuple(each.swept.values()) for each in found] == [
        (wear, friction) for wear in (0, 1) for friction in (0.2, 0.3, 0.4)
    ]
    assert found[4].assignments == ("wear=1", "track=china", "friction=0.3")
    assert found[4].title == "wear=1, friction=0.3"


def test_without_several_values_there_is_one_configuration_as_it_was() -> None:
    (only,) = variants(["wear=0.5", "vehicle.bodies.frame.inertia=[1, 2, 3]"])
    assert only.assignments == ("wear=0.5", "vehicle.bodies.frame.inertia=[1, 2, 3]")
    assert only.swept == {}
    assert len(variants(None)) == 1


def test_names_stay_names_and_lists_are_shown_as_typed() -> None:
    rails, curves = variants(["rail=60e1,cn60"]), variants(["x=[1, 2],[3, 4]"])
    assert [each.swept["rail"] for each in rails] == ["60e1", "cn60"]
    assert [each.swept["x"] for each in curves] == ["[1, 2]", "[3, 4]"]


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        (["wear=0,,1"], "an empty place"),
        (["wear=0,"], "an empty place"),
        (["wear=0.5,0.50"], r"--set wear: found 0\.50 twice"),
        (["wear=0,1", "wear=0.5"], "--set wear: has several values here and is set once more"),
        (["a=[1,2", "b=1,]"], "twice|an empty place|--set"),
    ],
)
def test_bad_sweeps(given: list[str], problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        variants(given)


def test_too_many_runs_are_refused_before_they_are_listed() -> None:
    """A product of 10^18 configurations takes no time and no memory."""
    thousand = ",".join(map(str, range(1000)))
    with pytest.raises(ConfigError, match=r"10,000 are allowed") as error:
        variants([f"k{i}={thousand}" for i in range(6)], runs=10)
    assert "1000 values of k0 x " in str(error.value)
    assert len(variants([f"a={thousand}"], runs=10)) == 1000
    with pytest.raises(ConfigError, match="make 11,000 runs"):
        variants([f"a={thousand}"], runs=11)
