"""Result files: plain JSON, complete or absent, with everything needed to repeat the result."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from sayd_env.config import ConfigError, Model, StudyError
from sayd_env.config.software import git_state
from sayd_env.report.files import (
    ResultDirectory,
    csv_bytes,
    document,
)
from sayd_env.report.html import Page, Picture, Section, Verdict


class Settings(Model):
    speed: float = 80.0


@dataclass(frozen=True)
class Sine:
    """A small study result."""

    values: np.ndarray

    def as_dict(self) -> dict[str, Any]:
        return {"values": self.values, "peak": self.values.max()}

    def tables(self) -> Mapping[str, Any]:
        return {"sine": (("index", "value"), enumerate(self.values))}

    def plots(self) -> Mapping[str, Callable[[Figure], None]]:
        def draw(figure: Figure) -> None:
            figure.subplots().plot(self.values)

        return {"sine": draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        console.print("a sine")


RESULT = Sine(np.sin(np.linspace(0.0, math.pi, 5)))


def test_csv_reads_back_bit_for_bit_and_has_empty_cells_for_missing_numbers():
    rows = [(np.float64(0.1) * 3, math.nan), (np.float32(1.0), "a,b")]
    read = list(csv.reader(io.StringIO(csv_bytes(("x_m", "y"), rows).decode())))
    assert read[0] == ["x_m", "y"]
    assert float(read[1][0]) == 0.1 * 3
    assert read[1][1] == ""
    assert read[2] == ["1.0", "a,b"]


def test_csv_refuses_a_row_of_another_length():
    with pytest.raises(ValueError, match="1 cells under a header of 2"):
        csv_bytes(("a", "b"), [(1,)])


def test_a_result_is_saved_with_tables_plots_and_provenance(tmp_path: Path):
    content = document(RESULT, Settings(), 7, "sayd sine --seed 7")
    files = ResultDirectory(tmp_path / "deep" / "er").save(RESULT, content)
    assert [path.name for path in files] == ["sine.csv", "sine.png", "result.json"]
    assert sorted(path.name for path in files[0].parent.iterdir()) == ["result.json", "sine.csv", "sine.png"]
    stored = json.loads(files[-1].read_text())
    assert stored["config"] == {"speed": 80.0}
    assert stored["seed"] == 7
    assert stored["command"] == "sayd sine --seed 7"
    assert stored["peak"] == 1.0
    assert stored["versions"]["numpy"] == np.__version__
    assert {"python", "sayd_env", "scipy", "numba"} <= set(stored["versions"])
    assert stored["git_commit"] is None or re.fullmatch("[0-9a-f]{40}", stored["git_commit"])
    assert files[1].read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_files_of_the_former_result_do_not_stay_beside_a_new_one(tmp_path: Path):
    """Those that somebody else has put there do."""

    class Bare(Sine):
        def plots(self) -> Mapping[str, Callable[[Figure], None]]:
            return {}

    directory = ResultDirectory(tmp_path)
    directory.save(RESULT, document(RESULT, None, 7))
    assert json.loads((tmp_path / "result.json").read_text())["written"] == [
        "sine.csv",
        "sine.png",
        "result.json",
    ]
    (tmp_path / "mine.png").touch()
    directory.save(Bare(RESULT.values), document(RESULT, None, 7))
    assert {path.name for path in tmp_path.iterdir()} == {"sine.csv", "result.json", "mine.png"}


def test_a_page_gets_the_stored_pictures_and_the_record(tmp_path: Path, read_page: Callable[[str], Any]):
    class Paged(Sine):
        def page(self) -> Page:
            return Page("A sine", Verdict(["It swings."]), [Section("Values", [Picture("sine", "a sine")])])

    paged = Paged(RESULT.values)
    files = ResultDirectory(tmp_path).save(paged, document(paged, None, seed=7))
    assert [path.name for path in files] == ["sine.csv", "sine.png", "report.html", "result.json"]
    read = read_page((tmp_path / "report.html").read_text())
    assert read.pictures == [(tmp_path / "sine.png").read_bytes()]
    assert "seed 7" in read.text


def test_keys_of_the_record_cannot_be_overwritten_by_a_result():
    class Clash(Sine):
        def as_dict(self) -> dict[str, Any]:
            return {"seed": 1, "written": 2}

    with pytest.raises(ValueError, match="'seed', 'written'"):
        document(Clash(np.zeros(1)), None, None)


def test_outside_a_checkout_there_is_no_commit(tmp_path: Path):
    assert git_state(tmp_path) == (None, None)


@pytest.mark.parametrize("failing", ["write", "replace"])
def test_an_interrupted_write_leaves_the_former_files_untouched(
    failing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    directory = ResultDirectory(tmp_path)
    directory.write({"table.csv": b"old", "result.json": b"old"})

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync" if failing == "write" else "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        directory.write({"table.csv": b"new", "result.json": b"new"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {
        "table.csv": b"old",
        "result.json": b"old",
    }


def test_a_plot_that_fails_leaves_no_file(tmp_path: Path):
    class Broken(Sine):
        def plots(self) -> Mapping[str, Callable[[Figure], None]]:
            def draw(figure: Figure) -> None:
                raise RuntimeError("no picture")

            return {"broken": draw}

    with pytest.raises(RuntimeError, match="no picture"):
        ResultDirectory(tmp_path).save(Broken(np.zeros(1)), {})
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_clear_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    directory = ResultDirectory(tmp_path)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StudyError, match=r"cannot be written \(No space left on device\)"):
        directory.write({"result.json": b"{}"})
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_way_is_found_before_the_study_starts(tmp_path: Path):
    (tmp_path / "file").write_text("x")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ConfigError, match="a file is in the way"):
            ResultDirectory(path)


@pytest.mark.parametrize("name", ["result.json", "sine.csv"])
def test_a_folder_in_the_way_of_a_file_leaves_no_other_file(name: str, tmp_path: Path):
    (tmp_path / name).mkdir()
    with pytest.raises(ConfigError, match=f"a folder named {name} is in the way"):
        ResultDirectory(tmp_path).save(RESULT, {})
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_directory_is_made_when_there_is_something_to_write(tmp_path: Path):
    (tmp_path / "lost").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match=r"--out .*lost: cannot be written"):
        ResultDirectory(tmp_path / "lost")
    directory = ResultDirectory(tmp_path / "deep" / "er")
    assert [path.name for path in tmp_path.iterdir()] == ["lost"]
    directory.write({"result.json": b"{}"})
    assert (tmp_path / "deep" / "er" / "result.json").read_bytes() == b"{}"


def test_a_directory_that_cannot_be_written_is_found_before_the_study_starts():
    # Not even root may create a file there.
    with pytest.raises(ConfigError, match="--out /proc/sayd: cannot be written"):
        ResultDirectory(Path("/proc/sayd"))
