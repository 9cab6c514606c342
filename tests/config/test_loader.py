"""From text to raw data, and from raw data to one clear sentence on what is wrong with it."""

from __future__ import annotations

import math
import os
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import pytest
import yaml
from pydantic import Field

from sayd_env.config import (
    ConfigError,
    Model,
    apply_overrides,
    nearest,
    packaged_names,
    parse_yaml,
    quantity,
    read_config,
    read_text,
    validate,
)
from sayd_env.config.base import Number
from sayd_env.config.layers import Kind, read_layered
from sayd_env.config.loader import validated
from sayd_env.config.scenario import load_scenario


class Spring(Model):
    type: Literal["spring"]
    name: str
    stiffness: float = quantity("N/m", "Stiffness", gt=0.0)
    ends: tuple[Number, Number] = Field(description="Ends (m)")


class Damper(Model):
    type: Literal["damper"]
    name: str
    damping: float = quantity("N s/m", "Damping", ge=0.0, le=1e6)


class Machine(Model):
    name: str
    count: int = quantity("-", "Number of machines", default=1, ge=1)
    parts: tuple[Annotated[Spring | Damper, Field(discriminator="type")], ...] = Field(min_length=1)


GOOD = """
name: press
parts:
  - {type: spring, name: main, stiffness: 1e5, ends: [0, 1]}
  - {type: damper, name: brake, damping: 10.0}
"""


def check(text: str) -> Machine:
    return validate(Machine, parse_yaml(text, "machine.yaml"), "machine.yaml")


def message(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        check(text)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0500", 500),
        ("250_000", 250_000),
        ("0x1F", 31),
        ("0o17", 15),
        ("1e5", 1e5),
        ("-.5", -0.5),
        (".inf", math.inf),
        ("8:20", "8:20"),
        ("1:30.5", "1:30.5"),
    ],
)
def test_numbers_are_those_of_yaml_1_2(text: str, value: object) -> None:
    found = parse_yaml(text, "file.yaml")
    assert (found, type(found)) == (value, type(value))


def test_numbers_may_be_whole_and_may_have_an_exponent_without_a_point():
    spring = check(GOOD).parts[0]
    assert isinstance(spring, Spring)
    assert (spring.stiffness, spring.ends) == (1e5, (0.0, 1.0))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "stiffness: 1e5",
            "stiffness: 100 kN/m",
            "parts.main.stiffness: found '100 kN/m'; expected a number",
        ),
        ("stiffness: 1e5", "stiffness: '1e5'", "parts.main.stiffness: found '1e5'; expected a number"),
        ("stiffness: 1e5", "stiffness: true", "parts.main.stiffness: found True; expected a number"),
        ("stiffness: 1e5", "stiffness: .nan", "parts.main.stiffness: found nan; expected a finite number"),
        ("stiffness: 1e5", "stiffness: -.inf", "parts.main.stiffness: found -inf; expected a"),
        (
            "stiffness: 1e5",
            "stiffness: {a: {b: 1}}",
            "found {'a': {'b': 1}}; expected a number: Stiffness (N/m)",
        ),
        ("stiffness: 1e5", "stiffness: -1", "found -1; expected a number greater than 0: Stiffness (N/m)"),
        ("damping: 10.0", "damping: 2e6", "found 2000000.0; expected a number less than or equal to 1e+06"),
        ("stiffness: 1e5, ", "", "key 'parts.main.stiffness' is missing: Stiffness (N/m)"),
        ("[0, 1]", "[0]", "parts.main.ends: found [0]; entry 2 is missing: Ends (m)"),
        ("[0, 1]", "[0, 1, 2]", "parts.main.ends: found [0, 1, 2]; expected at most 2 entries, found 3"),
        ("[0, 1]", "[0, '1']", "parts.main.ends.1: found '1'; expected a number"),
        ("[0, 1]", "[0, true]", "parts.main.ends.1: found True; expected a number"),
        ("[0, 1]", "5", "parts.main.ends: found 5; expected a list"),
        ("name: press", "name: 5", "name: found 5; expected text (in quotes if it reads as a number)"),
        ("name: press", "name: press\ncount: 1.5", "count: found 1.5; expected a whole number"),
        (
            "type: spring",
            "type: spiring",
            "type: found 'spiring', did you mean 'spring'?; expected spring, damper",
        ),
        ("type: spring", "typ: spring", "unknown key 'parts.main.typ', did you mean 'type'?"),
        ("type: spring, ", "", "key 'parts.main.type' is missing"),
        (
            "stiffness",
            "stifness",
            "unknown key 'parts.main.stifness', did you mean 'stiffness'?; allowed here:",
        ),
    ],
)
def test_one_line_names_file_key_finding_and_what_is_allowed(old: str, new: str, expected: str):
    found = message(GOOD.replace(old, new, 1))
    assert found.startswith("machine.yaml: ")
    assert expected in found
    assert "\n" not in found


def test_several_missing_keys_share_a_line_and_other_problems_have_their_own():
    lines = message("count: 0\n").splitlines()
    assert lines == [
        "machine.yaml: keys are missing: name, parts",
        "machine.yaml: count: found 0; expected a number greater than or equal to 1: Number of machines (-)",
    ]


def test_a_file_of_another_kind_is_not_a_page_of_messages():
    lines = message("wheels: 4\nsprings: 2\nnam: cart\nparts: []\n").splitlines()
    assert lines == [
        "machine.yaml: parts: found []; expected at least 1 entries, found 0",
        "machine.yaml: unknown keys: wheels, springs; allowed here: count, name, parts",
        "machine.yaml: unknown key 'nam', did you mean 'name'?; allowed here: count, name, parts",
    ]


def test_a_list_that_lost_its_bad_entries_is_not_called_too_short():
    assert message("name: a\nparts: [{type: spring, name: b, stiffness: 0, ends: [0, 1]}]").count("\n") == 0
    assert "expected at least 1 entries, found 0" in message("name: a\nparts: []")


LAUGHS = ("[*{0}, *{0}]", "{{<<: [*{0}, *{0}]}}", "{{<<: *{0}, <<: *{0}}}", "{{a: *{0}, b: *{0}}}")


def laughs(twice: str) -> str:
    """An anchor that stands for 2^40 values, doubled line by line."""
    lines = (f"b{i + 1}: &b{i + 1} " + twice.format(f"b{i}") for i in range(40))
    return "\n".join(("b0: &b0 {x: 1}", *lines))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty; expected keys and values"),
        ("- 1\n- 2\n", "found [1, 2]; expected keys and values"),
        ("hello", "found 'hello'; expected keys and values"),
        ("name: a\nname: b\n", "line 2: key 'name' appears twice"),
        ("a: [1, 2\nb: }", "line 2: "),
        ("a:\n\tb: 1\n", "line 2: found character '\\t'"),
        ("a: *nowhere\n", "line 1: found undefined alias 'nowhere'"),
        ("a: 1\n---\nb: 2\n", "line 2: but found another document"),
        ("a: &a {b: *a}\n", "recursive"),
        ("? [1, 2]\n: 3\n", "line 1: found [1, 2]; expected a name as key"),
        ("a: 2020-13-45\n", "month must be in 1..12"),
        ("a: !!python/object:os.system x\n", "line 1: could not determine a constructor"),
        ("a: \x07\n", "is not a text file"),
        ("[" * 5000, "is nested too deeply"),
        ("a: " + "[" * 60 + "]" * 60, "is nested too deeply, beyond 50 levels"),
        ("a: '" + "x" * 300_000 + "'", "is longer than 262144 characters"),
        (f"a: {'9' * 5000}", "has a number too long to read"),
        ('a: "\\e[2J"', "a: found '\\x1b[2J'; expected text without control characters"),
        ('a: "\\uD800"', "found '\\ud800'; expected text without control characters"),
        *((laughs(begin), "holds more than 50000 values, counted wherever an alias") for begin in LAUGHS),
    ],
)
def test_text_that_is_no_configuration(text: str, expected: str):
    found = message(text)
    assert found.startswith("machine.yaml: ")
    assert expected in found
    assert "\n" not in found


def test_what_was_read_before_is_not_shared():
    """A text is parsed once; who changes what came of it changes nobody else's."""
    first = parse_yaml(GOOD, "machine.yaml")
    first["parts"][0]["ends"].append(2)
    assert parse_yaml(GOOD, "machine.yaml")["parts"][0]["ends"] == [0, 1]


def test_an_anchor_may_be_merged_and_overridden():
    assert parse_yaml("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}", "x")["b"] == {"x": 1, "y": 3}


def test_files_that_cannot_be_read(tmp_path: Path):
    (tmp_path / "binary.yaml").write_bytes(bytes(range(256)))
    (tmp_path / "western.yaml").write_bytes("a: 1\n# Dämpfer\n".encode("cp1252"))
    (tmp_path / "utf16.yaml").write_text("# Dämpfer", encoding="utf-16")
    assert read_text(tmp_path / "utf16.yaml") == "# Dämpfer"
    os.mkfifo(tmp_path / "pipe.yaml")
    for path, expected in (
        (tmp_path / "nowhere.yaml", "no such file"),
        (tmp_path, "is a directory, expected a file"),
        (tmp_path / "binary.yaml", "is not a text file"),
        (tmp_path / "western.yaml", "line 2: is not in UTF-8; save the file as such"),
        (tmp_path / "pipe.yaml", "is a device or a pipe, expected a file"),
        (Path("/dev/zero"), "is a device or a pipe, expected a file"),
        (tmp_path / "binary.yaml" / "below.yaml", "cannot be read (Not a directory)"),
    ):
        with pytest.raises(ConfigError) as caught:
            read_text(path)
        assert str(caught.value) == f"{path}: {expected}"


def test_a_file_beyond_the_limit_is_refused_before_it_is_read(tmp_path: Path):
    file = tmp_path / "endless.yaml"
    with file.open("wb") as stream:
        stream.truncate(2**40)
    with pytest.raises(ConfigError, match="is larger than 1 MiB, the most that is read of a file"):
        read_config("vehicle", str(file))


def test_absurd_numbers_are_named_before_anybody_computes_with_them():
    for key, value in (
        ("track.section.mass", "5e-324"),
        ("track.section.lateral_stiffness", "1.7e+308"),
        ("track.section.roll_inertia", "1e+300"),
        ("track.irregularity.density.omega_s", "1e+41"),
    ):
        with pytest.raises(ConfigError) as caught:
            load_scenario("estimates", [f"{key}={value}"])
        expected = f"--set: {key}: found {value}; expected 0 or a number of a magnitude from 1e-40 to 1e+40"
        assert str(caught.value) == expected


def test_plain_yaml_reads_the_same_numbers_in_packaged_files():
    """A point and a sign in the exponent: YAML 1.1, as PyYAML reads it, takes 30.0e6 for text."""
    for file in resources.files("sayd_env.configs").iterdir():
        for path in file.iterdir() if file.is_dir() else ():
            if path.name.endswith(".yaml"):
                text = path.read_text(encoding="utf-8")
                assert yaml.safe_load(text) == parse_yaml(text, path.name), path.name


def test_packaged_names_are_offered():
    with pytest.raises(ConfigError, match=r"unknown vehicle 'emo', did you mean 'emu'\?; available: emu, "):
        read_config("vehicle", "emo")
    for kind in ("vehicle", "damper", "profile", "track", "study"):
        for name in packaged_names(kind):
            assert isinstance(read_config(kind, name)[0], dict)


def test_nearest_offers_only_what_is_close():
    assert nearest("stifness", ["stiffness", "damping"]) == ", did you mean 'stiffness'?"
    assert nearest("colour", ["stiffness", "damping"]) == ""


DATA = parse_yaml(GOOD, "machine.yaml")


def test_assignments_reach_entries_by_name_and_by_number():
    changed = apply_overrides(DATA, ["parts.main.stiffness=2e5", "parts.1.damping=3", "count=4"])
    assert changed["parts"][0]["stiffness"] == 2e5
    assert changed["parts"][1]["damping"] == 3
    assert changed["count"] == 4
    assert DATA["parts"][0]["stiffness"] == 1e5  # the original stays


@pytest.mark.parametrize(
    ("item", "expected"),
    [
        ("count", "--set count: expected key=value"),
        ("", "--set : expected key=value"),
        ("=3", "--set =3: expected key=value"),
        ("pats.main.stiffness=1", "--set pats.main.stiffness=1: no key 'pats', did you mean 'parts'?"),
        (
            "parts.mian.stiffness=1",
            "no entry 'parts.mian', did you mean 'main'?; use a number below 2 or a name",
        ),
        ("parts.7.stiffness=1", "no entry 'parts.7'; use a number below 2"),
        ("name.first=x", "'name' is a value, not a section"),
        ("count=[1", "--set count: line 1: "),
        (
            "parts.main.stiffness=-1",
            "--set: parts.main.stiffness: found -1; expected a number greater than 0",
        ),
        (
            "parts.main.colour=red",
            "--set: unknown key 'parts.main.colour'; allowed here: ends, name, stiffness",
        ),
        ("cuont=1", "--set: unknown key 'cuont', did you mean 'count'?"),
    ],
)
def test_a_bad_assignment_is_blamed_and_not_the_file(item: str, expected: str):
    with pytest.raises(ConfigError) as caught:
        validated(Machine, DATA, "machine.yaml", [item])
    assert str(caught.value).startswith("--set")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_file_is_blamed_for_its_own_mistakes_despite_assignments(tmp_path: Path):
    path = tmp_path / "machine.yaml"
    path.write_text(GOOD.replace("1e5", "-1"))
    with pytest.raises(ConfigError) as caught:
        read_layered(Machine, Kind("study"), str(path), ["count=2", "parts.brake.damping=1"])
    assert str(caught.value).startswith(f"{path}: parts.main.stiffness: found -1; ")
