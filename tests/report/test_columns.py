"""Tables: one set of columns for console, CSV and JSON, in 80 columns, with numbers that are never cut."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from sayd_env.report.columns import Column, Listing, csv_table, json_rows


@dataclass(frozen=True)
class Row:
    policy: str
    speed: float
    ratio: float
    holds: bool = True


COLUMNS = (
    Column("policy", "policy"),
    Column("speed", "speed", "km/h", 3.6, 0),
    Column("ratio", "ratio", digits=2, limit=1.0, best=True, infinite="derailed"),
    Column("holds", "holds", bad=lambda holds: not holds, wide=True),
)
ROWS = [Row("passive", 100.0, 1.25), Row("a[b]_c", 100.0, 0.5, False), Row("lost", 50.0, math.inf)]


def printed(columns: Any, rows: Any, width: int = 80, wide: bool = False) -> str:
    console = Console(file=io.StringIO(), width=width)
    Listing("a title", columns, rows).print(console, wide)
    return console.file.getvalue()  # type: ignore[attr-defined]


def styled(columns: Any, rows: Any, section: str | None = None, wide: bool = False) -> str:
    console = Console(file=io.StringIO(), width=80, force_terminal=True, color_system="standard")
    Listing("a title", columns, rows, section).print(console, wide)
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_stored_values_are_those_of_the_rows():
    header, rows = csv_table(COLUMNS, ROWS)
    assert header == ["policy", "speed", "ratio", "holds"]
    assert list(rows)[1] == ["a[b]_c", 100.0, 0.5, False]
    assert json_rows(COLUMNS, ROWS)[0] == {"policy": "passive", "speed": 100.0, "ratio": 1.25, "holds": True}
    assert csv_table(COLUMNS, json_rows(COLUMNS, ROWS)) == (header, rows)  # mappings are rows, too


def test_printed_values_have_unit_scale_and_digits():
    lines = printed(COLUMNS, ROWS).splitlines()
    assert lines[0] == "a title"
    assert lines[1].split() == ["policy", "speed", "(km/h)", "ratio"]
    assert [line.split() for line in lines[3:6]] == [
        ["passive", "360", "1.25"],
        ["a[b]_c", "360", "0.50"],
        ["lost", "180", "derailed"],
    ]
    assert lines[6] == "1 more column with --wide"
    assert "holds" in printed(COLUMNS, ROWS, wide=True)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "-"),
        (math.nan, "-"),
        (np.bool_(True), "yes"),
        (False, "no"),
        (0.43886, "0.4389"),
        (9638.4, "9638"),
        (12808.2, "12,808"),
        (np.int64(2_000_000), "2,000,000"),
        (1000, "1000"),
        (-math.inf, "-inf"),
        ("bell \x07 and [bold]", "bell \ufffd and [bold]"),
    ],
)
def test_words_of_a_value_without_digits(value: Any, words: str):
    assert Column("x", "x").words(value) == words


def test_the_best_is_bold_and_what_passes_its_limit_is_red_in_each_section():
    text = styled(COLUMNS, ROWS, section="speed", wide=True)
    for words in (
        "\x1b[1m0.50\x1b[0m",
        "\x1b[31m1.25\x1b[0m",
        "\x1b[1;31mderailed\x1b[0m",
        "\x1b[31mno\x1b[0m",
    ):
        assert words in text


def test_a_table_gets_narrow_by_its_texts_before_a_number_is_cut():
    rows = [{"name": "many words that can be wrapped in lines", "value": 123456.789, "other": 0.25}] * 2
    columns = (
        Column("name", "name"),
        Column("value", "a long heading of a number", digits=3),
        Column("other", "another", digits=2),
    )
    for width in (80, 40, 30):
        text = printed(columns, rows, width)
        assert text.count("123456.789") == 2
        assert max(map(len, text.splitlines())) <= width
    assert "skyhook-continuous" in printed(
        [Column("p", "p"), Column("q", "q")], [{"p": "skyhook-continuous", "q": "x " * 40}], 40
    )


def test_columns_for_which_there_is_no_room_are_left_to_wide():
    """As where two keys are swept: twelve columns of 7 characters and 11 gaps of 2 are 106."""
    columns = [Column(f"c{i}", f"col {i:02d}") for i in range(12)]
    rows = [{f"c{i}": 100_000 + i for i in range(12)}]
    lines = printed(columns, rows).splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[3].split() == [f"100,{i:03d}" for i in range(9)]
    assert "3 more columns with --wide" in lines
    assert len(printed(columns, rows, wide=True).splitlines()[3].split()) == 12


def test_a_wide_table_takes_the_room_that_it_needs():
    columns = [Column(f"c{i}", f"column {i}", wide=i > 2) for i in range(20)]
    rows = [{f"c{i}": 1000 + i for i in range(20)}]
    assert max(map(len, printed(columns, rows).splitlines())) <= 80
    wide = printed(columns, rows, wide=True)
    assert [line.split() for line in wide.splitlines()][3] == [str(1000 + i) for i in range(20)]


def test_a_table_without_rows_has_its_headings():
    assert "policy" in printed(COLUMNS, [])
