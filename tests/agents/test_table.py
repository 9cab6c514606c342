"""Tables of a training: whole rows, or one message that says which line is damaged."""

from __future__ import annotations

from pathlib import Path

import pytest

from sayd_env.agents.table import Table
from sayd_env.config import DataError


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"\0\0\0", r"line 1: is damaged (found columns \x00\x00\x00; expected steps, J)"),
        (b"steps\n1\n", "line 1: is damaged (found columns steps; expected steps, J)"),
        (b"steps,steps,J\n1,1,1\n", "line 1: is damaged (found columns steps, steps, J; expected steps, J)"),
        (b"steps,J\n1,0.5\n2\n", "line 3: is damaged (found 1 cells; the header has 2)"),
        (b"steps,J\n1,0.5,2\n", "line 2: is damaged (found 3 cells; the header has 2)"),
        (b"steps,J\n1,x\n", "line 2: is damaged (column 'J': found 'x'; expected a finite number)"),
        (b"steps,J\n1,1e999\n", "line 2: is damaged (column 'J': found inf; expected a finite number)"),
        (b"steps,J\n,1\n", "line 2: is damaged (column 'steps': found None; expected a finite number)"),
        (b'steps,J\n"1,0.5\n', "line 2: is damaged (unexpected end of data)"),
    ],
)
def test_a_damaged_table_is_one_message(content: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "evaluations.csv"
    file.write_bytes(content)
    with pytest.raises(DataError) as caught:
        Table(file, numbers=("steps", "J"), until=10)
    assert str(caught.value) == f"{file}: {message}; move it away to go on without its rows"


def test_a_table_comes_back_as_far_as_it_counts(tmp_path: Path) -> None:
    file = tmp_path / "evaluations.csv"
    written = Table(file, numbers=("steps", "J"))
    for steps in (0, 50, 100):
        written.add({"steps": steps, "J": 0.1 + steps} | ({"seconds": 2.5} if steps else {}))
    written.save()
    kept = Table(file, numbers=("steps", "J"), until=50)
    assert kept.rows == written.rows[:2]
    Table(file).save()
    Table(tmp_path / "empty.csv").save()
    assert Table(tmp_path / "empty.csv", numbers=("steps", "J")).rows == []
