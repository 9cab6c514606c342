"""Measured irregularity files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.scenario import load_scenario
from sayd_env.config.track import FileConfig, read_track
from sayd_env.measured.notes import measured_notes
from sayd_env.measured.tracks import MeasuredTrack, check_gauge
from sayd_env.physics.simulator import VehicleModel
from sayd_env.physics.track import read_measured, realise

HEADER = "x_m,alignment_mm"
ROWS = [f"{x},{0.1 * x}" for x in range(6)]


def write(folder: Path, *lines: str) -> Path:
    path = folder / "track.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def read(path: Path, **keys: object) -> MeasuredTrack:
    return read_measured(FileConfig.model_validate({"type": "file", "path": str(path)} | keys))


X = np.arange(0.0, 1000.0, 0.25)
MIDDLE = slice(1200, 2800)


def wave(length: float, amplitude: float = 2.0) -> np.ndarray:
    return amplitude * np.sin(2.0 * np.pi * X / length)


def columns(folder: Path, header: str, *values: np.ndarray, separator: str = ",", above: str = "") -> Path:
    rows = (separator.join(f"{v:.9f}" for v in row) for row in zip(*values, strict=True))
    return write(folder, *([above] if above else []), header, *rows)


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


def test_waves_of_a_dense_file_are_not_folded_into_longer_ones(tmp_path: Path) -> None:
    """Rows every 20 mm with a wave of 260 mm, which samples every 250 mm would show as one of 6.5 m."""
    x = np.arange(0.0, 300.0, 0.02)
    values = 2.0 * np.sin(2 * np.pi * x / 20) + 0.3 * np.sin(2 * np.pi * x / 0.26)
    config = FileConfig(type="file", path=str(columns(tmp_path, "x_m,alignment_mm", x, values)))
    inside = np.linspace(60.0, 280.0, 1501)  # a run begins evenly
    found = 1e3 * realise(config, 299.0, 0).evaluate(inside)[0][:, 0]
    np.testing.assert_allclose(found, 2.0 * np.sin(2 * np.pi * inside / 20), atol=1e-3)


def test_rows_of_centimetres_are_read(tmp_path: Path) -> None:
    x = 0.01 * np.arange(3000)
    assert read(columns(tmp_path, "x_m,alignment_mm", x, np.sin(x))).x[-1] == pytest.approx(29.99)


def test_a_distance_named_by_its_unit_may_have_a_row_of_units(tmp_path: Path) -> None:
    rows = (f"{1e-3 * a:.5f};{b:.6f}" for a, b in zip(X, wave(20), strict=True))
    track = read(write(tmp_path, "km;alignment", "[km];[mm]", *rows))
    np.testing.assert_allclose(track.x, X, atol=1e-9)


def test_the_third_domain_of_the_longitudinal_level_ends_at_150_m(tmp_path: Path) -> None:
    path = columns(tmp_path, "x_m,vertical_d3_mm", X, wave(90))
    assert read(path, domains=("D3",)).notes == ("vertical_d3_mm: waves of 70 to 150 m, without all others",)


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
    ("judged", "refused"),
    [
        ((110.0, 150.0), False),
        ((110.0, 150.5), True),
        ((109.5, 150.0), True),
        ((500.0, 5500.0), True),
        ((0.0, 150.0), True),
    ],
)
def test_what_is_judged_lies_on_the_file_and_not_on_its_ramps(
    tmp_path: Path, judged: tuple[float, float], refused: bool
) -> None:
    """The file covers 100 to 160 m, with ramps of 10 m."""
    config = FileConfig(type="file", path=str(wave_file(tmp_path, 0.0, 60.0)), offset=100.0, ramp=10.0)
    if not refused:
        realise(config, 6000.0, 0, judged=[judged])
        return
    start = max(judged[0], 50.0)  # where the run itself has faded in
    message = f"covers 100 to 160 m, .* 10 m are its ramp, .* judged from {start:g} to {judged[1]:g} m; give"
    with pytest.raises(DataError, match=message):
        realise(config, 6000.0, 0, judged=[judged])


def test_a_file_may_begin_with_the_run(tmp_path: Path) -> None:
    config = FileConfig(type="file", path=str(wave_file(tmp_path)), ramp=25.0)
    realise(config, 700.0, 0, judged=[(0.0, 575.0)])


def test_an_assessed_run_lies_on_the_file(tmp_path: Path) -> None:
    """Assessed are 500 to 1100 m: the file with its ramps goes from 480 to 1120 m."""
    settings = ["irregularity.ramp=20.0", "irregularity.offset=480.0"]

    def model(length: float) -> VehicleModel:
        track = read_track(str(wave_file(tmp_path, 0.0, length)), settings)
        scenario = load_scenario("estimates", ["assessment.length=600.0"])
        return VehicleModel(scenario.model_copy(update={"track": track}))

    model(640.2).realisation(0)
    with pytest.raises(DataError, match=r"covers 480 to 1080 m, .* judged from 500 to 1100 m; give a longer"):
        model(600.0).realisation(0)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([""], "is empty"),
        ([HEADER], "found 0 rows"),
        ([HEADER, *ROWS[:3]], "found 3 rows of numbers; at least 4"),
        (["x_m", "0", "1", "2", "3"], "line 1: nothing to read beside 'x_m'; expected any of alignment_mm, "),
        (["alignment_mm", "0"], "line 1: column 'x_m' or 'x_km' is missing"),
        (["x_m,alignement_mm", *ROWS], "unknown column 'alignement_mm', did you mean 'alignment_mm'?"),
        (
            ["x_m,alignment_mm,alignment_mm", *(f"{row},0" for row in ROWS)],
            "line 1: column 'alignment_mm' appears twice",
        ),
        ([HEADER, *ROWS, "9,nan"], r"line 8: column 'alignment_mm': found 'nan'; expected a finite number"),
        ([HEADER, "inf,1", *ROWS], r"line 2: column 'x_m': found 'inf'"),
        ([HEADER, *ROWS, "6,abc"], r"line 8: column 'alignment_mm': found 'abc'; expected a number"),
        ([HEADER, *ROWS, "6,"], r"line 8: column 'alignment_mm': found ''"),
        ([HEADER, *ROWS, "6,1,2"], "line 8: found 3 cells; expected 2"),
        ([HEADER, *ROWS, "", "3.5,0"], "line 9: x_m 3.5 comes after x_m 5; positions must ascend"),
        ([HEADER, *ROWS, "5,0"], "line 8: x_m 5 appears twice"),
        ([HEADER, *ROWS, "50,0"], "line 8: a gap of 45 m before x_m 50"),
        ([HEADER, *ROWS, "6,1435"], r"line 8: column 'alignment_mm': found 1435 mm; .*is the unit mm"),
        ([HEADER, *ROWS, "6", "7,1"], "line 8: found 1 cell, '6'; expected 2"),
        ([HEADER, *ROWS, "6"], "line 8: found 1 cell, '6'; expected 2"),
        ([HEADER, *ROWS, ",", "7,1"], "line 8: found separators alone; expected a row of numbers"),
        (
            ["x_m,alignment_mm", "0,0,0,5", "0,5,0,7"],
            "line 2: found no header .*; commas stand between columns",
        ),
        ([HEADER, *ROWS, '6,"1'], "line 8: a quotation mark is not closed"),
    ],
)
def test_bad_files(tmp_path: Path, lines: list[str], message: str) -> None:
    path = write(tmp_path, *lines)
    with pytest.raises(DataError, match=message) as caught:
        read(path)
    assert str(caught.value).startswith(str(path))


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv: no such table"):
        read(tmp_path / "none.csv")


def test_binary_file(tmp_path: Path) -> None:
    path = tmp_path / "track.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\x01\x02\x81")
    with pytest.raises(ConfigError, match="is not a text file"):
        read(path)


def test_other_separators_marks_names_and_units_are_the_same_track(tmp_path: Path) -> None:
    expected = read(columns(tmp_path, "x_m,alignment_mm,vertical_mm", X, wave(20), wave(12))).values
    written = (
        ("x [m];Alignment [mm];Longitudinal level [mm]", (X, wave(20), wave(12)), ";", "# line 12, track 1"),
        ("Chainage (km)\talignment (m)\tvertical (cm)", (X / 1e3, wave(20) / 1e3, wave(12) / 10), "\t", ""),
        ("km;alignment [mm];vertical [mm]", (12.0 + X / 1e3, wave(20), wave(12)), ";", "Recorded;2022"),
    )
    for header, values, separator, above in written:
        path = columns(tmp_path, header, *values, separator=separator, above=above)
        path.write_text(path.read_text().replace(".", ","), encoding="utf-16")
        np.testing.assert_allclose(read(path).values, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("header", "above", "keys"),
    [
        ("x_m,gauge_mm", "", {"nominal_gauge": 1.435}),
        ("x_m,gauge_mm", "# track 1, nominal gauge: 1435 mm", {}),
        ("x_m,gauge_mm,nominal_gauge_mm", "", {}),
    ],
)
def test_the_nominal_gauge_is_taken_off(
    tmp_path: Path, header: str, above: str, keys: dict[str, float]
) -> None:
    values = (X, 1435.0 + wave(20), np.full(len(X), 1435.0))[: header.count(",") + 1]
    track = read(columns(tmp_path, header, *values, above=above), **keys)
    np.testing.assert_allclose(1e3 * track.values[:, 3], wave(20), atol=1e-8)
    assert track.notes == ("gauge_mm: the nominal gauge, 1435 mm, is taken off",)


@pytest.mark.parametrize("way", ["key", "comment", "column"])
@pytest.mark.parametrize("nominal", [1435.0, 1432.0])
def test_a_tracks_gauge_is_the_one_that_was_measured(tmp_path: Path, nominal: float, way: str) -> None:
    """A file's gauge departs from its nominal gauge: the track that it lies on needs to have this."""
    gauge = 1433.5 + wave(20)
    values, header = (X, gauge), "x_m,gauge_mm"
    if way == "column":
        values, header = (X, gauge, np.full(len(X), nominal)), "x_m,gauge_mm,nominal_gauge_mm"
    above = f"# nominal gauge {nominal:g} mm" if way == "comment" else ""
    path = columns(tmp_path, header, *values, above=above)
    keys = [f"irregularity.nominal_gauge={nominal / 1e3!r}"] if way == "key" else []
    track = read_track(str(path), [*keys, f"gauge={nominal / 1e3!r}"])
    assert measured_notes({"track": track}) == (
        f"{path}: gauge_mm: the nominal gauge, {nominal:g} mm, is taken off",
    )
    assert isinstance(track.irregularity, FileConfig)
    whole = 1e3 * (track.gauge + read_measured(track.irregularity).values[:, 3])
    np.testing.assert_allclose(whole, gauge, atol=1e-8)
    other = read_track(str(path), [*keys, "gauge=1.437"])
    message = f"states a nominal gauge of {nominal:g} mm, the track's is 1437 mm: --gauge {nominal:g}"
    with pytest.raises(DataError, match=message):
        measured_notes({"track": other})


def test_a_track_has_one_nominal_gauge(tmp_path: Path) -> None:
    nominal = np.where(X < 500.0, 1435.0, 1445.0)
    path = columns(tmp_path, "x_m,gauge_mm,nominal_gauge_mm", X, nominal + wave(20), nominal)
    with pytest.raises(DataError, match="found 1435 to 1445 mm; a track has one gauge, give the file as a"):
        check_gauge(read(path), 1.435)


def test_a_stated_gauge_counts_for_departures_but_not_without_a_gauge(tmp_path: Path) -> None:
    above = "# nominal gauge 1432 mm"
    path = columns(tmp_path, "x_m,gauge_mm", X, wave(20), above=above)
    with pytest.raises(DataError, match="states a nominal gauge of 1432 mm, the track's is 1435 mm"):
        check_gauge(read(path), 1.435)
    check_gauge(read(columns(tmp_path, "x_m,alignment_mm", X, wave(20), above=above)), 1.435)


def test_german_names_are_the_same_channels(tmp_path: Path) -> None:
    waves = (wave(20), wave(12), wave(30))
    expected = read(columns(tmp_path, "x_m,alignment_mm,vertical_mm,gauge_mm", X, *waves)).values
    for vertical in ("Längshöhe", "Laengshoehe"):
        path = columns(tmp_path, f"x_m,Richtung [mm],{vertical} [mm],Spurweite [mm]", X, *waves)
        np.testing.assert_allclose(read(path).values, expected, atol=1e-12)


@pytest.mark.parametrize(
    "name", ["versine_mm", "10m_chord_mm", "mco [mm]", "mid_chord_mm", "Versine 10 m [mm]"]
)
def test_chords_of_an_unknown_channel_are_no_channel(tmp_path: Path, name: str) -> None:
    with pytest.raises(
        DataError, match=r"line 1: column .* offsets from a chord; name it 'alignment_10m"
    ) as caught:
        read(columns(tmp_path, f"x_m,{name}", X, wave(20)))
    assert "did you mean" not in str(caught.value)


@pytest.mark.parametrize("length", [3.5, 12.0, 40.0])
def test_waves_are_restored_from_a_chord(tmp_path: Path, length: float) -> None:
    """By its geometry a chord of 10 m shows z(x) - (z(x - 5) + z(x + 5)) / 2 at its middle."""

    def true(x: np.ndarray) -> np.ndarray:
        return np.asarray(2.0 * np.sin(2.0 * np.pi * x / length + 1.0))

    offset = true(X) - 0.5 * (true(X - 5.0) + true(X + 5.0))
    track = read(columns(tmp_path, "x_m,alignment_10m_chord_mm", X, offset), recover=(3.0, 70.0))
    np.testing.assert_allclose(1e3 * track.values[MIDDLE, 0], true(X[MIDDLE]), atol=0.02)
    assert "which does not show those of 4.74 to 5.29 m" in track.notes[0]


def test_what_a_chord_does_not_show_is_lost(tmp_path: Path) -> None:
    """Half the chord is a whole wave: its ends and its middle move together."""
    track = read(
        columns(tmp_path, "x_m,alignment_10m_chord_mm", X, wave(12) + wave(5, 0.1)), recover=(3.0, 70.0)
    )
    share = 1.0 - np.cos(np.pi * 10.0 / 12.0)
    np.testing.assert_allclose(1e3 * track.values[MIDDLE, 0], (wave(12) / share)[MIDDLE], atol=0.01)


def test_a_space_curve_loses_its_layout(tmp_path: Path) -> None:
    layout = 5e3 * (X / 1000.0) ** 2  # mm: a curve of 100 km
    track = read(columns(tmp_path, "x_m,alignment_space_curve_mm", X, layout + wave(20)), recover=(3.0, 70.0))
    np.testing.assert_allclose(1e3 * track.values[MIDDLE, 0], wave(20)[MIDDLE], atol=0.01)


def test_wavelength_domains_are_added(tmp_path: Path) -> None:
    path = columns(
        tmp_path, "x_m,vertical_d1_mm,vertical_d2_mm,vertical_d3_mm", X, wave(20), wave(40), wave(90)
    )
    track = read(path, domains=("D1", "D2"))
    np.testing.assert_allclose(1e3 * track.values[:, 1], wave(20) + wave(40), atol=1e-8)
    assert track.notes == ("vertical_d1_mm + vertical_d2_mm: waves of 3 to 70 m, without all others",)


def test_columns_may_be_left_out_by_name(tmp_path: Path) -> None:
    path = columns(tmp_path, "x_m,alignment_mm,twist 3 m [mm/m]", X, wave(20), wave(5))
    np.testing.assert_allclose(
        1e3 * read(path, ignore=["twist 3 m [mm/m]"]).values[:, 0], wave(20), atol=1e-8
    )
    with pytest.raises(
        DataError, match=r"line 1: unknown column 'twist 3 m .mm/m.'; .* or name it under ignore"
    ):
        read(path)
    with pytest.raises(DataError, match="ignore: no column 'twst'"):
        read(path, ignore=["twst"])


@pytest.mark.parametrize(
    ("header", "values", "keys", "message"),
    [
        ("x_m,alignment_mm", (12.0 + X / 1e3, wave(20)), {}, r"rows are 0.00025 m apart, .*is the unit km"),
        ("x_km,alignment_mm", (X, wave(20)), {}, r"rows are 250 m apart, at most 10 m .*is the unit m\?"),
        ("x_m,alignment_mm", (X, 1e3 * wave(20)), {}, r"line 4: .*at most 200 mm is allowed .is the unit mm"),
        (
            "x_m,gauge_m",
            (X, 0.1177 * wave(20)),
            {},
            r"found 0.\d+ m; at most 0.2 m is allowed .is the unit m right\?",
        ),
        (
            "x_m,gauge_m",
            (X, 1.435 + 0.12 * wave(20)),
            {"nominal_gauge": 1.435},
            r"found 1.\d+ m, \d+.?\d* mm off its nominal; at most 0.2 m",
        ),
        ("x_m,space_curve_mm", (X, wave(20)), {}, "a space curve; name it 'alignment_space_curve' or"),
        ("x_m,alignment_mm", (X, 1e-3 * wave(20)), {}, r"no number is above 0.002 mm; no track is as even"),
        ("x_m,alignment", (X, wave(20)), {}, r"its unit is missing; expected 'alignment \[mm\]'"),
        ("x_m,alignment [s]", (X, wave(20)), {}, r"unknown unit 's'; expected 'alignment \[mm\]'"),
        ("x,alignment_mm", (X, wave(20)), {}, r"column 'x': its unit is missing; expected 'x \[m\]' or"),
        ("x_m,alignment_mm", (-X, wave(20)), {}, r"line 3: .* positions must ascend \(turn the rows round"),
        (
            "x_m,alignment_mm",
            (X * 1e300, wave(20)),
            {},
            "line 3: column 'x_m': found 2.5e.299; at most 1e.15",
        ),
        ("x_m,gauge_mm", (X, 1435 + wave(20)), {}, "holds the gauge itself, about 1435 mm; say what"),
        ("x_m,gauge_mm", (X, 1435 + wave(20)), {"nominal_gauge": 1.52}, "nominal gauge is stated as 1520 mm"),
        ("x_m,gauge_mm", (X, 1450 + wave(20)), {"nominal_gauge": 1.435}, "at most 6 mm lie between"),
        ("x_m,gauge_mm", (X, wave(20)), {"nominal_gauge": 1.435}, "holds departures already"),
        ("x_m,cross_level_mm", (X, 120 + wave(20)), {}, "mean over 100 m is 120 mm, .*own layout out"),
        (
            "x_m,alignment_10m_chord_mm",
            (X, wave(20)),
            {},
            "offsets from a chord of 10 m: .* not at all at 5, 2.5",
        ),
        (
            "x_m,vertical_versine_mm",
            (X, wave(20)),
            {},
            "a chord of unknown length; name it 'vertical_10m_chord'",
        ),
        ("x_m,alignment_62ft_mco_mm", (X, wave(20)), {}, r"offsets from a chord of 18.8976 m"),
        ("x_m,alignment_0m_chord_mm", (X, wave(20)), {}, "found a chord of 0 m; expected a length above 0"),
        ("x_m,alignment_mm", (X, wave(20)), {"recover": (3.0, 25.0)}, "recover: has no effect"),
        ("x_m,alignment_mm", (X, wave(20)), {"domains": ["D1"]}, "domains: have no effect"),
        ("x_m,alignment_mm", (X, wave(20)), {"nominal_gauge": 1.432}, "has no effect without a column gauge"),
        ("x_m,alignment_space_curve_mm", (X, wave(20)), {}, "holds a space curve, .* give recover"),
        ("x_m,alignment_d1_mm", (X, wave(20)), {}, r"one domain of EN 13848-1 alone \(D1: 3 to 25 m\)"),
        ("x_m,alignment_d1_mm", (X, wave(20)), {"domains": ["D1", "D2"]}, "has none of D2 beside it"),
        ("x_m,alignment_left_mm", (X, wave(20)), {}, "is of one rail; give the mean of both as 'alignment'"),
        ("x_m,alignment_mm,alignment_d1_mm", (X, wave(20), wave(20)), {}, "name all but one under ignore"),
        (
            "x_m,alignment_10m_chord_mm",
            (X, wave(20)),
            {"recover": (3.0, 90.0)},
            "hardly shows waves above 72.2 m",
        ),
        ("x_m,alignment_10m_chord_mm", (X, wave(20)), {"recover": (0.5, 60.0)}, "show waves from 1 m on"),
        (
            "x_m,alignment_50m_chord_mm",
            (X, wave(20)),
            {"recover": (3.0, 300.0)},
            "6 times the longest wave is",
        ),
    ],
)
def test_what_is_no_track_in_the_unit_stated_is_refused(
    tmp_path: Path, header: str, values: tuple[np.ndarray, ...], keys: dict[str, object], message: str
) -> None:
    with pytest.raises(DataError, match=message) as caught:
        read(columns(tmp_path, header, *values), **keys)
    assert str(caught.value).startswith(str(tmp_path))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"recover": [70.0, 3.0]}, "0 < shortest < longest"),
        ({"domains": ["D1", "D3"]}, "D2 is missing between D1 and D3"),
        ({"domains": ["D2", "D1"]}, "in order"),
        ({"cross_level_base": 5e-324}, "greater than or equal to 0.3"),
    ],
)
def test_keys_that_no_file_can_have(keys: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        FileConfig.model_validate({"type": "file", "path": "a.csv"} | keys)


def test_a_file_of_geometry_is_a_track(tmp_path: Path) -> None:
    """Its section and gauge are those of the packaged even track."""
    path = columns(tmp_path, "x_m,alignment_mm", X, wave(20))
    track, even = read_track(str(path), ["irregularity.ramp=20.0"]), read_track("smooth")
    assert track.irregularity == FileConfig(type="file", path=str(path), ramp=20.0)
    assert (track.section, track.gauge) == (even.section, even.gauge)


def test_the_example_of_the_documentation_is_read(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "tracks.md").read_text(encoding="utf-8")
    track = read(write(tmp_path, text.split("```text\n")[1].split("```")[0]))
    np.testing.assert_allclose(track.x, 12000.0 + 0.25 * np.arange(4))
    np.testing.assert_allclose(1e3 * track.values[0] * [1, 1, 1.5, 1], [0.21, -1.02, 0.40, -0.2], atol=1e-9)
