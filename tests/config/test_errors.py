"""Messages are safe for a terminal and fit on a screen, whatever they quote."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sayd_env.config import ConfigError, parse_yaml
from sayd_env.config.errors import SaydError
from sayd_env.config.explain import shown

MESSAGES = st.text(st.characters(codec=None), max_size=80)


@given(st.lists(MESSAGES, max_size=60).map("\n".join), st.sampled_from((1, 100, 1000)))
@example("\x1b[2J\0\ud800\u202e", 1)
@settings(max_examples=30, deadline=None)
def test_a_message_fits_on_a_screen_and_moves_no_cursor(text: str, times: int) -> None:
    said = str(SaydError(text * times))
    assert len(said) <= 2000
    assert len(said.splitlines()) <= 24
    assert said.replace("\n", "").isprintable()
    assert str(SaydError(said)) == said  # who passes it on cuts nothing more
    said.encode()


def test_of_a_long_line_both_ends_are_left_and_of_many_lines_the_first() -> None:
    said = str(SaydError("begin " + "x" * 10**6 + " end"))
    assert said.startswith("begin ")
    assert said.endswith(" end")
    lines = str(SaydError("\n".join(map(str, range(100))))).splitlines()
    assert lines == [*map(str, range(21)), "... and 79 lines more"]


class Silent:
    """An object that cannot say what it is."""

    def __repr__(self) -> str:
        raise RuntimeError


def nested() -> list[Any]:
    value: list[Any] = []
    for _ in range(10**5):
        value = [value]
    return value


@pytest.mark.parametrize("value", [10**5000, Silent(), nested()], ids=lambda value: type(value).__name__)
def test_a_value_that_cannot_be_written_is_named_by_its_type(value: Any) -> None:
    assert shown(value) == f"a {type(value).__name__} too long to write"


@given(st.text(max_size=60))
@example("1" + ":10" * 400 + ".5")  # a number to base 60, beyond all floats
@example("x: " + "1" * 5000)
@example('{a: "\\0", b: "\\uD800"}')
@example("&a [*a]")
@example("&a {<<: *a}")
@example("[" * 3000 + "]" * 3000)
@settings(max_examples=150, deadline=None)
def test_any_text_is_read_or_refused_as_yaml(text: str) -> None:
    with suppress(ConfigError):
        parse_yaml(text, "file.yaml")
