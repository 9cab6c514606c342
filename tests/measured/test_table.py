"""Text tables as people have them: what is read, and what is refused by its place."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.measured.table import read_text_table
from sayd_env.measured.units import name_and_unit, unit_of

VALUES = [[0.0, 270.0, 0.4], [0.004, 270.5, -1.25], [0.008, 271.0, 12.5]]
NAMES = ("t [s]", "v [km/h]", "a [m/s²]")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "table.csv"


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("separator", [";", "\t", "|", ",", "  ", "; "])
@pytest.mark.parametrize("end", ["", "trailing"])
def test_separators_and_decimal_marks(file: Path, separator: str, decimal: str, end: str) -> None:
    quote = '"' if separator == decimal else ""
    tail = separator if end and separator.strip() else ""
    rows = [[f"{quote}{x}{quote}".replace(".", decimal) for x in row] for row in VALUES]
    lines = [separator.join(NAMES), *(separator.join(row) + tail for row in rows)]
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    table = read_text_table(file)
    assert table.names == NAMES
    np.testing.assert_array_equal(table.numbers(range(3)), VALUES)
    assert table.lines.tolist() == [2, 3, 4]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-32", "cp1252"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_encodings_and_ends_of_lines(file: Path, encoding: str, end: str) -> None:
    file.write_bytes(end.join(["t [s];a [m/s²]", "0;1,5", "1;2,5", ""]).encode(encoding))
    table = read_text_table(file)
    assert table.names == ("t [s]", "a [m/s²]")
    assert table.numbers([1]).tolist() == [[1.5], [2.5]]


@pytest.mark.parametrize(
    ("text", "names", "units", "first"),
    [
        ("Speed;300;\nOperator;X;\n\nt;a;\ns;N;\n0;1;\n1;2;\n", ("t", "a"), ("s", "N"), 6),
        ("# a file\n% more\nt,a\n! between\n0,1\n// here\n1,2\n", ("t", "a"), (), 5),
        ('"Date","22/11/2022 7:44"\n"No","t","a, left"\n0,1,2\n1,2,3\n', ("No", "t", "a, left"), (), 3),
        ("# t,a\n# s,N\n0,1\n1,2\n", ("t", "a"), ("s", "N"), 3),
        ("sep=;\nt;a\n0;1\n1;2\n", ("t", "a"), (), 3),
        ('t;"a\nleft"\n0;1\n1;2\n', ("t", "a left"), (), 3),
        ("t  a left [N]\n0  1\n1  2\n", ("t", "a left [N]"), (), 2),
        ("a_n\n0,5\n1,5\n", ("a_n",), (), 2),
        ("a;g\n0;1\n1;2\n", ("a", "g"), (), 2),
        ("-30,000;28,125\n0,125;0,000\n", (), (), 1),
        ("A wheel, worn\n-30 28.1\n-29 28.2\n", (), (), 2),
    ],
)
def test_what_stands_above_the_rows(
    file: Path, text: str, names: tuple[str, ...], units: tuple[str, ...], first: int
) -> None:
    file.write_text(text, encoding="utf-8")
    table = read_text_table(file)
    assert (table.names, table.head.units, table.lines[0], len(table)) == (names, units, first, 2)


def test_numbers_of_some_columns_and_cells_without_a_value(file: Path) -> None:
    file.write_text("t;place;a\n0;Ulm, 3 4 5;1D+01\n1;;NaN\n2;x;\n\n3;y;\n4;z;n/a\n5;x;-0,5\n")
    table = read_text_table(file)
    np.testing.assert_array_equal(
        table.numbers([0, 2], gaps=True),
        [[0, 10], [1, np.nan], [2, np.nan], [3, np.nan], [4, np.nan], [5, -0.5]],
    )
    assert table.cells([1]).ravel().tolist() == ["Ulm, 3 4 5", "", "x", "y", "z", "x"]
    assert table.where(3, 2) == f"{file}: line 6: column 'a'"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("# nothing\n;;\n", "is empty"),
        ("t;a\n1,234;2,345\n3,456;4,567\n", "line 2: column 't': found '1,234', which may be 1.234 or 1234"),
        ("t;a\n0;2.5\n1,25;2\n", "line 3: column 't': found '1,25', and elsewhere '2.5'"),
        ("t;a\n1.234,5;2\n3.456,5;4\n", r"line 2: column 't': found '1\.234,5'; expected a number"),
        ("t,a\n0,5,1\n1,5,1\n1,5,2,5\n2,5,1\n3,5,1\n", "line 4: found 4 cells; expected 3 .*decimal comma"),
        ("t;a\n0;True\n1;True\n", "line 2: column 'a': found 'True'"),
        ("t;a\n0;1\n1;inf\n", "line 3: column 'a': found 'inf'; expected a finite number"),
        ("t;a\n0;1\n1;\n", "line 3: column 'a': found ''; expected a number"),
        ("t;a\n0;1\n1;0x10\n", "line 3: column 'a': found '0x10'"),
        ("t;a\n0;1\n1;1_0\n", "line 3: column 'a': found '1_0'"),
        ("t;a\n0;1\n1;2\nEnd\n", "line 4: found 1 cell, 'End'; expected 2"),
        ("t;a\n0;1\n1;2\nEnd;\n", "line 4: column 't': found 'End'"),
        ("t;a;b\n0;1;2\n1;2\n2;3;4\n", "line 3: found 2 cells, '1;2'; expected 3"),
        ("t a b\n0 1 2\n1 2\n2 3 4\n", "line 3: found 2 cells, '1 2'; expected 3"),
        ('t;a;b\n0;1;2\n1;"2"\n2;3;4\n', "line 3: found 2 cells"),
        ("t;a\n0;1\n;\n2;3\n", "line 3: found separators alone"),
        ('t;a\n0;1\n1;"2\n', "line 3: a quotation mark is not closed"),
    ],
)
def test_what_is_refused_by_its_place(file: Path, text: str, message: str) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=message) as caught:
        (table := read_text_table(file)).numbers(range(len(table.names)))
    assert str(caught.value).startswith(str(file))


@pytest.mark.parametrize("header", ["t [s];Bogie 1 front [m/s²]", "t [s],a [N]", "t [s]\ta [N]", "t|a 1"])
def test_a_header_alone_is_one(file: Path, header: str) -> None:
    file.write_text(f"{header}\n", encoding="utf-8")
    table = read_text_table(file)
    assert (len(table), len(table.names)) == (0, 2)


@pytest.mark.parametrize(
    ("last", "why"),
    [
        ("2;3", "has 2 of 3 cells"),
        ("2;3\n", "has 2 of 3 cells"),
        ("2;3;-0.", r"ends within a number \('2;3;-0\.'\)"),
        ("2;3;-", "ends within a number"),
        ("2;3;1.5e", "ends within a number"),
    ],
)
def test_a_last_line_that_was_cut_off_may_be_left_out(file: Path, last: str, why: str) -> None:
    file.write_text(f"t;a;b\n0;1;2.5\n1;2;3.5\n{last}", encoding="utf-8")
    table = read_text_table(file, may_end_short=True)
    assert table.numbers(range(3)).tolist() == [[0, 1, 2.5], [1, 2, 3.5]]
    (note,) = table.notes
    assert re.fullmatch(rf"Line 4, the last one, is left out: it {why}.*\.", note)


@pytest.mark.parametrize("last", ["2;3;4", "2;3;\n", "2;3;-\n"])
def test_a_last_line_that_is_whole_stays(file: Path, last: str) -> None:
    file.write_text(f"t;a;b\n0;1;2.\n1;2;3.5\n{last}", encoding="utf-8")
    table = read_text_table(file, may_end_short=True)
    assert (len(table), table.notes) == (3, ())


def test_no_wait_and_no_memory_for_what_is_no_file(file: Path) -> None:
    os.mkfifo(file)
    with pytest.raises(ConfigError, match="is a device or a pipe, expected a table"):
        read_text_table(file)
    with pytest.raises(ConfigError, match="is a device or a pipe"):
        read_text_table("/dev/zero")
    with pytest.raises(ConfigError, match="is a directory"):
        read_text_table(file.parent)
    long = file.with_name("long.csv")
    long.write_bytes(b"t;a\n" + b"0;1\n" * 2**19)
    with pytest.raises(ConfigError, match=r"long\.csv: is larger than 1 MiB"):
        read_text_table(long, largest=2**20)
    for content in (b"\x89PNG\r\n\x1a\n\x00\x00", b"t;a\x01\n0;1\n", b"t;a\n0;\x81\n"):
        long.write_bytes(content)
        with pytest.raises(ConfigError, match="is not a text file"):
            read_text_table(long)


@pytest.mark.parametrize(
    ("header", "name", "quantity", "factor"),
    [
        ("acc, bogie 1, lateral [m/s^2]", "acc, bogie 1, lateral", "acceleration", 1.0),
        ("a (m/s²)", "a", "acceleration", 1.0),
        ("a in m/s**2", "a", "acceleration", 1.0),
        ("bogie1_front_m_s2", "bogie1_front", "acceleration", 1.0),
        ("a_g", "a", "acceleration", 9.80665),
        ("a <m s-2>", "a", "acceleration", 1.0),
        ("v / (km/h)", "v", "speed", 1 / 3.6),
        ("Speed km/h", "Speed", "speed", 1 / 3.6),
        ("speed_kmh", "speed", "speed", 1 / 3.6),
        ("Y, kN", "Y", "force", 1e3),
        ("p [bar]", "p", "pressure", 1e5),
        ("Q_l_min", "Q", "flow", 1e-3 / 60),
        ("kappa_1_km", "kappa", "curvature", 1e-3),
    ],
)
def test_units_as_people_spell_them(header: str, name: str, quantity: str, factor: float) -> None:
    found, text = name_and_unit(header)
    unit = unit_of(text)
    assert unit is not None
    assert (found, unit.quantity, unit.factor) == (name, quantity, pytest.approx(factor))


@pytest.mark.parametrize("text", ["mN", "[mPa]", "MV", "MA", "Mbar", "Ms", "Mm"])
def test_milli_is_not_mega(text: str) -> None:
    """Prefixes of SI that case alone tells apart: a factor of 1e9."""
    assert unit_of(text) is None
