"""Histories as files: read back by other libraries, each format holds the same numbers, names and units."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.io import loadmat

from sayd_env.config import ConfigError, StudyError
from sayd_env.report.histories import FORMATS, checked_format, write_history
from sayd_env.runs.histories import HistorySignal

RANDOM = np.random.default_rng(5)
TIME = (np.arange(400) + 1 - 150) / 1000
COLUMNS = [
    (HistorySignal("Y.front.leading.left", "N", "traced", 0), 1e5 * RANDOM.normal(size=400)),
    (HistorySignal("carbody_acceleration.front.y", "m/s2", "true", 1), RANDOM.normal(size=400)),
    (HistorySignal("valve.front.left.upper", "-", "true", 2), RANDOM.random(400)),
    (HistorySignal("pressure_a.rear.right.lower", "Pa", "traced", 3), 10.0 ** RANDOM.uniform(-300, 300, 400)),
]
UNITS = ("_n", "_m_s2", "", "_pa")
"""As names of columns end."""

Values = Mapping[str, np.ndarray]


def of_csv(path: Path) -> Values:
    with path.open() as stream:
        names = stream.readline().rstrip("\n").split(",")
    return dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))


def of_parquet(path: Path) -> Values:
    table = pd.read_parquet(path)
    return {str(name): table[name].to_numpy() for name in table}


def of_mat(path: Path) -> Values:
    return {name: values[:, 0] for name, values in loadmat(path).items() if not name.startswith("__")}


def of_mf4(path: Path) -> Values:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(path) as file:
        found = {name: file.get(name) for name in file.channels_db if name != "time"}
        (times,) = {tuple(signal.timestamps) for signal in found.values()}
        return {"time": np.array(times)} | {name: signal.samples for name, signal in found.items()}


READERS: Mapping[str, Callable[[Path], Values]] = {
    "csv": of_csv,
    "parquet": of_parquet,
    "mat": of_mat,
    "mf4": of_mf4,
}


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_read_back_holds_the_same_numbers(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"a run{FORMATS[kind]}"
    write_history(path, kind, TIME, COLUMNS, {"command": "sayd simulate"})
    found = READERS[kind](path)
    names = ["time", *(signal.name for signal, _ in COLUMNS)]
    if kind != "mf4":
        names = [name + unit for name, unit in zip(names, ("_s", *UNITS), strict=True)]
    if kind == "mat":
        names = [name.replace(".", "_") for name in names]
    assert list(found) == names
    for name, values in zip(names, [TIME, *(values for _, values in COLUMNS)], strict=True):
        np.testing.assert_array_equal(found[name], values)
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]  # nothing else is left there


def test_units_are_stored_where_the_format_has_a_place(tmp_path: Path) -> None:
    parquet, asammdf = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("asammdf")
    for kind in ("parquet", "mf4"):
        write_history(tmp_path / f"run{FORMATS[kind]}", kind, TIME, COLUMNS, {"command": "sayd simulate"})
    schema = parquet.read_schema(tmp_path / "run.parquet")
    assert [field.metadata[b"unit"].decode() for field in schema] == [
        "s",
        *(signal.unit for signal, _ in COLUMNS),
    ]
    assert schema.metadata[b"command"] == b"sayd simulate"
    with asammdf.MDF(tmp_path / "run.mf4") as file:
        assert [file.get(signal.name).unit for signal, _ in COLUMNS] == ["N", "m/s2", "", "Pa"]
        assert "sayd simulate" in file.header.comment


def test_a_file_that_fails_leaves_the_former_one(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("former")
    uneven = [(COLUMNS[0][0], np.zeros(3))]
    with pytest.raises(ValueError, match="same length"):
        write_history(path, "csv", TIME, uneven, {})
    assert path.read_text() == "former"
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(StudyError, match="cannot be written"):
        write_history(path / "in a file" / "run.csv", "csv", TIME, COLUMNS, {})


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind, library in (("parquet", "pyarrow"), ("mf4", "asammdf")):
        monkeypatch.setitem(sys.modules, library, None)
        with pytest.raises(
            ConfigError, match=rf"{library}: install it with pip install 'sayd-env\[measured\]'"
        ):
            checked_format(kind)
    with pytest.raises(ConfigError, match="--format xls: unknown format; expected csv, parquet, mat, mf4"):
        checked_format("xls")
