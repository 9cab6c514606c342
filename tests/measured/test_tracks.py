"""Measured irregularity files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.track import FileConfig
from sayd_env.physics.track import read_measured, realise

HEADER = "x_m,alignment_mm"
ROWS = [f"{x},{0.1 * x}" for x in range(6)]


def write(folder: Path, *lines: str) -> Path:
    path = folder / "track.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def wave_file(folder: Path, first: float = 0.0, last: float = 600.0) -> Path:
    """Sines of 20 m in two channels, 0.3 m apart: alignment 2 mm, cross-level 3 mm."""
    x = np.arange(first, last + 0.3, 0.3)
    wave = np.sin(2 * np.pi * x / 20)
    lines = [f"{a:.4f},{3 * b:.9f},{2 * b:.9f}" for a, b in zip(x, wave, strict=True)]
    return write(folder, "\ufeffx_m, cross_level_mm, alignment_mm", "", *lines)


def test_units_channels_and_resampling(tmp_path: Path) -> None:
    config = FileConfig(type="file", path=str(wave_file(tmp_path)), scale=0.5)
    x = np.linspace(60.0, 590.0, 3001)
    value, slope = realise(config, 595.0, 0).evaluate(x)
    k = 2 * np.pi / 20
    np.testing.assert_allclose(value[:, 0], 1e-3 * np.sin(k * x), atol=1e-7)
    np.testing.assert_allclose(slope[:, 0], 1e-3 * k * np.cos(k * x), atol=1e-7)
    np.testing.assert_allclose(value[:, 2], 1e-3 * np.sin(k * x), atol=1e-7)
    assert not value[:, [1, 3]].any()


def test_offset_and_ramps(tmp_path: Path) -> None:
    path = wave_file(tmp_path, 1000.0, 1060.0)
    config = FileConfig(type="file", path=str(path), offset=-900.0, ramp=10.0)
    value, _ = realise(config, 300.0, 0).evaluate([90.0, 98.0, 125.0, 145.0, 165.0, 250.0])
    np.testing.assert_allclose(value[[2, 3], 0], [2e-3, 2e-3], atol=1e-7)
    assert np.abs(value[[0, 1, 4, 5]]).max() < 1e-9


@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_a_file_shorter_than_the_run_is_refused(tmp_path: Path, offset: float) -> None:
    path = wave_file(tmp_path)
    config = FileConfig(type="file", path=str(path), offset=offset)
    length = 700.0 if offset == 0.0 else 500.0
    with pytest.raises(DataError, match=r"track.csv: covers (0|10) to .* of a run from 0 to"):
        realise(config, length, 0)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([""], "is empty"),
        ([HEADER], "found 0 rows"),
        ([HEADER, *ROWS[:3]], "found 3 rows of numbers; at least 4"),
        (["x_m", "0", "1", "2", "3"], "line 1: nothing to read beside 'x_m'; expected any of alignment_mm, "),
        (["alignment_mm", "0"], "line 1: column 'x_m' or 'x_km' is missing"),
        (["x_m,alignement_mm", *ROWS], "unknown column 'alignement_mm', did you mean 'alignment_mm'?"),
        (["x_m,alignment_mm,alignment_mm", *ROWS], "line 1: column 'alignment_mm' appears twice"),
        ([HEADER, *ROWS, "9,nan"], r"line 8: column 'alignment_mm': found 'nan'; expected a finite number"),
        ([HEADER, "inf,1", *ROWS], r"line 2: column 'x_m': found 'inf'"),
        ([HEADER, *ROWS, "6,abc"], r"line 8: column 'alignment_mm': found 'abc'; expected a number"),
        ([HEADER, *ROWS, "6,"], r"line 8: column 'alignment_mm': found ''"),
        ([HEADER, *ROWS, "6,1,2"], "line 8: found 3 cells; expected 2"),
        ([HEADER, *ROWS, "", "3.5,0"], "line 9: x_m 3.5 comes after x_m 5; positions must ascend"),
        ([HEADER, *ROWS, "5,0"], "line 8: x_m 5 appears twice"),
        ([HEADER, *ROWS, "50,0"], "line 8: a gap of 45 m before x_m 50"),
        ([HEADER, *ROWS, "6,1435"], r"line 8: column 'alignment_mm': found 1435 mm; .*is the unit mm"),
        ([HEADER, *ROWS, '6,"1'], "line 8: a quotation mark is not closed"),
    ],
)
def test_bad_files(tmp_path: Path, lines: list[str], message: str) -> None:
    path = write(tmp_path, *lines)
    with pytest.raises(DataError, match=message) as caught:
        read_measured(path)
    assert str(caught.value).startswith(str(path))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv: no such file"):
        read_measured(tmp_path / "none.csv")


def test_binary_file(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\x00\x81")
    with pytest.raises(ConfigError, match="is not a text file"):
        read_measured(path)
