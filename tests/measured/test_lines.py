"""Measured lines: the same object as of sections, and refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.conditions import Line
from sayd_env.config.track import FileConfig, read_track
from sayd_env.measured.lines import line_content, load_line
from sayd_env.measured.notes import measured_notes
from sayd_env.measured.tracks import read_measured
from sayd_env.physics.track.realisation import realise, realise_line

SECTIONS = """
rails: [null, 60e1_30]
sections:
  - {length: 2000.0, speed_kmh: 252.0, gauge: 1.434, rail: 0.0, friction: 0.3}
  - {<<: &after {length: 3000.0, speed_kmh: 180.0, gauge: 1.440, rail: 1.0, friction: 0.5},
     radius: 4000.0, turn: left, cant: 0.1, transition: 300.0}
  - {<<: *after, radius: 5000.0, turn: right, transition: 400.0}
"""
HEADER = "x_m,radius_m,cant_mm"


def write(folder: Path, text: str, name: str = "line.csv") -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def knots(line: Line) -> set[float]:
    found = (line.curvature, line.cant, line.speed_squared, line.gauge, line.friction, line.rail_blend)
    return {s for each in found if each is not None for s in each.s} | {line.length}


@pytest.mark.parametrize("curvature", ["radius_m", "curvature_1_km"])
def test_a_table_of_a_line_is_the_same_line(tmp_path: Path, curvature: str) -> None:
    """Between the rows of a table with a row at each knot everything is linear, as between knots."""
    line = load_line(write(tmp_path, SECTIONS, "sections.yaml"))
    assert line.speed_squared is not None
    rows = [f"x_km,speed_kmh,{curvature},cant_mm,nominal_gauge_mm,rail,friction"]
    for s in sorted(knots(line)):
        kappa = float(line.curvature.at(s))
        bend = 1e3 * kappa if curvature == "curvature_1_km" else 1 / kappa if kappa else 0.0
        found = [each.at(s) for each in (line.cant, line.gauge, line.rail_blend, line.friction) if each]
        cant, gauge, rail, friction = map(float, found)
        speed = 3.6 * float(line.speed_squared.at(s)) ** 0.5
        rows.append(
            f"{112.5 + s / 1e3!r},{speed!r},{bend!r},{1e3 * cant!r},{1e3 * gauge!r},{rail!r},{friction!r}"
        )
    write(tmp_path, "\n".join(rows))
    measured = load_line(write(tmp_path, "file: line.csv\nrails: [null, 60e1_30]\n", "measured.yaml"))
    assert measured.length == pytest.approx(line.length)
    assert measured.rails == line.rails
    s = np.linspace(-100.0, 8500.0, 8601)
    for name in ("curvature", "cant", "roll", "speed_squared", "gauge", "friction", "rail_blend"):
        one, other = getattr(line, name), getattr(measured, name)
        np.testing.assert_allclose(other.at(s), one.at(s), rtol=1e-9, atol=1e-12, err_msg=name)
    t = np.linspace(0.0, 120.0, 13)
    np.testing.assert_allclose(measured.distance_at(t), line.distance_at(t), atol=1e-6)


def test_what_a_file_lacks_is_the_episodes(tmp_path: Path) -> None:
    path = write(tmp_path, f"{HEADER}\n10,0,0\n210,-800,-100\n510,-800,-100\n")
    line = load_line(path)
    assert line.speed_squared is line.gauge is line.friction is line.rail_blend is line.rails is None
    assert line.tracks == ()
    assert line.curvature.at([-10.0, 100.0, 200.0, 900.0]) == pytest.approx(
        [0.0, -1 / 1600, -1 / 800, -1 / 800]
    )
    assert line.roll.at(300.0) == pytest.approx(0.1 / 1.5)
    assert line.length == 500.0
    with pytest.raises(DataError, match="cant deficiency"):
        load_line(path, speed=50.0)


def test_a_line_in_other_units_is_the_same(tmp_path: Path) -> None:
    path = write(
        tmp_path, "x_m,speed_kmh,radius_m,cant_mm\n0,180,0,0\n200,180,-2000,-100\n900,180,-2000,-100\n"
    )
    other = write(
        tmp_path,
        "# surveyed\nChainage;Curvature;Überhöhung;Speed\nkm;1/m;cm;m/s\n12,0;0;0;50\n"
        "12,2;-0,5e-3;-10;50\n"
        "12,9;-0,5e-3;-10;50\n",
        "other.csv",
    )
    one, two = load_line(path), load_line(other)
    s = np.linspace(0.0, 900.0, 91)
    for name in ("curvature", "cant", "speed_squared"):
        np.testing.assert_allclose(getattr(two, name).at(s), getattr(one, name).at(s), rtol=1e-9, atol=1e-15)


def test_keys_of_its_irregularities_are_the_lines(tmp_path: Path) -> None:
    """A gauge as a whole departs from the nominal one, which the line follows; a chord is asked for."""
    x = np.arange(0.0, 600.25, 0.25)
    rows = "\n".join(f"{a},{1437 + b:.6f},1437" for a, b in zip(x, np.sin(x / 5), strict=True))
    line = load_line(write(tmp_path, f"x_m,gauge_mm,nominal_gauge_mm\n{rows}"))
    assert line.gauge is not None
    assert set(line.gauge.value) == {1.437}
    config = line.tracks[0].irregularity
    assert isinstance(config, FileConfig)
    np.testing.assert_allclose(read_measured(config).values[:, 3], 1e-3 * np.sin(x / 5), atol=1e-9)
    write(tmp_path, f"x_m,gauge_mm,twist_mm\n{rows}", "twist.csv")
    mine = "file: twist.csv\nignore: [twist_mm]\nnominal_gauge: 1.437\n"
    (piece,) = load_line(write(tmp_path, mine, "mine.yaml")).tracks
    assert isinstance(piece.irregularity, FileConfig)
    note = "gauge_mm: the nominal gauge, 1437 mm, is taken off"
    assert read_measured(piece.irregularity).notes == (note,)
    reported = measured_notes({"line": line_content(str(tmp_path / "mine.yaml"))})
    assert reported == (f"{tmp_path / 'twist.csv'}: {note}",)


@pytest.mark.parametrize("way", ["key", "comment", "column"])
@pytest.mark.parametrize("nominal", [1435.0, 1432.0])
def test_a_lines_gauge_is_the_one_that_was_measured(tmp_path: Path, nominal: float, way: str) -> None:
    """Whatever it departs from: the line's gauge and the departure together are what was measured."""
    x = np.arange(0.0, 900.25, 0.25)
    gauge = 1433.5 + np.sin(x / 5)
    names, last = (
        ("x_m,gauge_mm,nominal_gauge_mm", f",{nominal}") if way == "column" else ("x_m,gauge_mm", "")
    )
    rows = "\n".join(f"{a},{b:.9f}{last}" for a, b in zip(x, gauge, strict=True))
    above = f"# nominal gauge {nominal:g} mm\n" if way == "comment" else ""
    write(tmp_path, f"{above}{names}\n{rows}")
    key = f"nominal_gauge: {nominal / 1e3!r}\n" if way == "key" else ""
    line = load_line(write(tmp_path, f"file: line.csv\n{key}", "mine.yaml"))
    assert line.gauge is not None
    (piece,) = line.tracks
    assert isinstance(piece.irregularity, FileConfig)
    whole = 1e3 * (line.gauge.at(x) + read_measured(piece.irregularity).values[:, 3])
    np.testing.assert_allclose(whole, gauge, atol=1e-7)
    realised = realise_line(line, read_track("smooth"), 800.0, 0, origin=350.0)
    value, _ = realised.evaluate(350.0 + np.array([200.0, 300.0]))
    expected = np.interp([200.0, 300.0], x, gauge) - 1435.0
    np.testing.assert_allclose(1e3 * value[:, 3], expected, atol=1e-3)


def test_sections_are_parts_of_equal_length(tmp_path: Path) -> None:
    rows = "0,0,0\n1200,0,0\n1300,2000,50\n1400,0,0\n2600,0,0\n"
    write(tmp_path, f"{HEADER}\n{rows}")
    line = load_line(write(tmp_path, "file: line.csv\nsection_length: 600.0\n", "mine.yaml"))
    assert [each.name for each in line.sections][:2] == ["0 to 600 m", "600 to 1200 m"]
    assert [each.end for each in line.sections] == [600.0, 1200.0, 1800.0, 2600.0]
    assert [each.straight_from for each in line.sections] == [0.0, 600.0, 1400.0, 1800.0]
    short = load_line(write(tmp_path, "file: line.csv\nsection_length: 1350.0\n", "mine.yaml"))
    assert [each.straight_from for each in short.sections] == [None, 1400.0]


def test_irregularities_of_a_line_are_those_of_its_file(tmp_path: Path) -> None:
    x = np.arange(0.0, 400.5, 0.5)
    wave = 2.0 * np.sin(2 * np.pi * x / 20)
    rows = "\n".join(f"{1000 + a:.1f},300,{b:.9f}" for a, b in zip(x, wave, strict=True))
    line = load_line(write(tmp_path, f"x_m,speed_kmh,alignment_mm\n{rows}"))
    (piece,) = line.tracks
    assert (piece.start, piece.end, piece.scale) == (0.0, 400.0, None)
    assert isinstance(piece.irregularity, FileConfig)
    # s = 0 lies 350 m behind the run's start, and so does the file's first row.
    track = read_track("german_low")
    realised = realise_line(line, track, 800.0, 0, origin=350.0)
    value, _ = realised.evaluate(350.0 + np.array([5.0, 200.0, 205.0, 295.0]))
    np.testing.assert_allclose(
        value[1:, 0], 2e-3 * np.sin(2 * np.pi * np.array([200.0, 205.0, 295.0]) / 20), atol=1e-7
    )
    assert abs(value[0, 0]) < 1e-3  # within the ramp
    # Before it and behind it lies the run's own track.
    away = np.array([100.0, 330.0, 765.0, 790.0])
    own = realise(track.irregularity, 800.0, 0)
    np.testing.assert_allclose(realised.evaluate(away)[0], own.evaluate(away)[0], rtol=0, atol=1e-9)
    # What lies before the line, behind it, and the blends at its ends are not asked of its file.
    same = realise_line(line, track, 800.0, 0, origin=350.0, judged=(300.0, 800.0))
    np.testing.assert_array_equal(same.coefficients, realised.coefficients)


def test_a_section_lies_on_the_file_of_its_track(tmp_path: Path) -> None:
    """Of the second section, 300 to 600 m, the blends of 25 m at its ends are not asked for."""
    rows = "\n".join(f"{a},{np.sin(a / 5):.6f}" for a in range(301))
    write(tmp_path, f"x_m,alignment_mm\n{rows}", "own.csv")
    own = write(tmp_path, "base: own.csv\nirregularity: {offset: 300.0, ramp: 25.0}\n", "own.yaml")
    sections = "sections:\n  - {length: 300.0}\n  - {length: %s, track: %s}\n"
    good, bad = (
        load_line(write(tmp_path, sections % (length, own), "mine.yaml"), speed=80.0)
        for length in (300.0, 310.0)
    )
    track = read_track("german_low")
    realise_line(good, track, 1200.0, 0, origin=500.0, judged=(500.0, 1150.0))
    realise_line(bad, track, 1200.0, 0, origin=500.0, judged=(500.0, 1050.0))
    with pytest.raises(DataError, match=r"own\.csv: covers 800 to 1100 m, .* judged from 825 to 1085 m"):
        realise_line(bad, track, 1200.0, 0, origin=500.0, judged=(500.0, 1150.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "x_m,speed_kmh\n0,300\n500,-300\n",
            "line 3: column 'speed_kmh': found -300 km/h; expected more than 0",
        ),
        (
            "x_m,cant_mm\n0,0\n500,0.12\n",
            "line 1: column 'cant_mm': no number is above 0.12 mm; .* unit mm right",
        ),
        (
            "x_m,radius_m,cant_mm\n0,0,0\n400,7000,-120\n900,7000,-120\n",
            "line 3: column 'cant_mm': found -120 mm in a curve to the left, and alike in most",
        ),
        (
            "x_m,radius_m,cant_mm\n0,0,0\n400,7000,120\n900,7000,120\n1300,0,0\n1700,-9000,100\n2200,-9000,100\n",
            "line 6: column 'cant_mm': found 100 mm in a curve to the right, and alike in most of it",
        ),
        (
            "x_m,radius_m\n0,0\n100,0\n100.1,7000\n900,7000\n",
            "line 4: column 'radius_m': most of a change, about x_m 100.1, lies within 10 m",
        ),
        ("x_m,radius_m\n0,0\n50,800\n90,800\n90.5,-800\n900,-800\n", "most of a change, about x_m 90"),
        ("x_m,curvature_1_km\n0,0\n100,0\n101,3.3\n900,3.3\n", "column 'curvature_1_km': most of a change"),
        (
            "x_m,nominal_gauge_mm\n0,1435\n100,1435\n100.1,1445\n900,1445\n",
            "column 'nominal_gauge_mm': most of a change, about x_m 100",
        ),
        ("# nominal gauge 1432 mm\nx_m,friction\n0,0.3\n900,0.3\n", "nominal gauge: has no effect without"),
        ("x_m\n0\n100\n", "nothing to read beside 'x_m'; expected any of speed_kmh, "),
        ("x_m,x_km,cant_mm\n0,0,0\n", "found x_m and x_km; expected one of them"),
        ("x_m,raduis_m\n0,0\n100,0\n", "unknown column 'raduis_m', did you mean 'radius_m'"),
        ("x_m,gauge\n0,0\n100,0\n", "column 'gauge': its unit is missing"),
        ("x_m,friction\n0,0.3\n", "found 1 rows of numbers; at least 2"),
        ("x_m,radius_m\n0,0\n0.3,0\n56.2,0\n", "line is 56.2 m long; at least 100 m .*is the unit km"),
        ("x_km,radius_m\n0,0\n300,0\n56200,0\n", "file is 56200 km long, at most 1000 km .*is the unit m"),
        ("x_m,friction\n0,0.3\n0,0.3\n", "line 3: x_m 0 appears twice"),
        ("x_km,friction\n1.5,0.3\n1.2,0.3\n", "line 3: x_km 1.2 comes after x_km 1.5; positions must ascend"),
        ("x_m,friction\n0,0.3\n100,\n", "line 3: column 'friction': found ''; expected a number"),
        ("x_m,radius_m\n0,inf\n100,800\n", "line 2: column 'radius_m': found 'inf'; .* radius is 0, or"),
        ("x_m,friction\n0,0.3\n100,1.3\n", r"at 100 m: friction: found 1\.3; allowed are 0.05 to 1"),
        ("x_m,nominal_gauge_mm\n0,2\n100,3\n", "at 0 m: gauge: found 0.002; allowed are 0.9 to 1.7 m"),
        ("x_m,speed_kmh\n0,300\n100,600\n", "at 100 m: speed: found 600; allowed are 30 to 500 km/h"),
        ("x_m,speed_kmh\n0,180\n1000,252\n", r"at 0 m: acceleration: found 1\.2 m/s2; at most 0\.7 m/s2"),
        (f"{HEADER}\n0,0,0\n200,100,0\n", "at 200 m: radius: found 100 m; allowed are 150 m and more"),
        (f"{HEADER}\n0,0,0\n200,800,190\n", r"at 200 m: cant: found 0\.19 m; at most 0\.18 m"),
        (f"{HEADER}\n0,0,0\n20,800,100\n900,800,100\n", "slope of the cant: found 0.005"),
        (f"{HEADER}\n0,800,100\n200,800,100\n", "line 2: begins with curvature or cant"),
        ("x_m,radius_m,curvature_1_km\n0,0,0\n900,0,0\n", "found radius_m and curvature_1_km"),
        ("x_m,rail\n0,0\n900,1\n", "column 'rail': the line's two rails are missing"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(DataError, match=message) as caught:
        load_line(path)
    assert str(caught.value).startswith(path)


def test_a_remark_about_the_usual_gauge_is_one(tmp_path: Path) -> None:
    assert load_line(write(tmp_path, "# track 1; nominal gauge 1435 mm\nx_m,friction\n0,0.3\n900,0.3\n"))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("nominal_gauge: 1.432", "nominal gauge: has no effect without a column gauge"),
        ("domains: [D1]", "domains: have no effect: no column holds one"),
        ("recover: [3.0, 25.0]", "recover: has no effect: no column holds a chord"),
        ("cross_level_base: 1.435", "cross_level_base: has no effect without a column of the cross-level"),
        ("rails: [null, 60e1_30]", "rails: have no effect without a column 'rail'"),
    ],
)
def test_keys_of_columns_that_a_file_lacks(tmp_path: Path, keys: str, message: str) -> None:
    write(tmp_path, "x_m,friction\n0,0.3\n900,0.3\n")
    with pytest.raises(DataError, match=rf"line\.csv: .*{message}"):
        load_line(write(tmp_path, f"file: line.csv\n{keys}\n", "mine.yaml"))


def test_a_nominal_gauge_beside_its_column(tmp_path: Path) -> None:
    write(tmp_path, "x_m,nominal_gauge_mm\n0,1435\n900,1435\n")
    with pytest.raises(DataError, match="nominal_gauge: has no effect beside a column of it"):
        load_line(write(tmp_path, "file: line.csv\nnominal_gauge: 1.432\n", "mine.yaml"))


@pytest.mark.parametrize("shape", ["linear", "smooth"])
@pytest.mark.parametrize("length", [20.0, 60.0])
def test_recorded_transitions_are_no_jumps(tmp_path: Path, length: float, shape: str) -> None:
    """Four rows a metre, with noise: from 20 m on, where a section's may begin, linear or a half cosine."""
    rng = np.random.default_rng(1)
    s = np.arange(0.0, 2000.25, 0.25)
    share = np.clip((s - 500.0) / length, 0.0, 1.0) - np.clip((s - 1200.0) / length, 0.0, 1.0)
    if shape == "smooth":
        share = 0.5 - 0.5 * np.cos(np.pi * share)
    noise = rng.normal(size=(2, len(s))) * (s > 1.0)
    columns = s, 0.5 * share + 0.03 * noise[0], 1435.0 + 8.0 * share + noise[1]
    rows = "\n".join(f"{a},{b},{c}" for a, b, c in zip(*columns, strict=True))
    assert load_line(write(tmp_path, f"x_m,curvature_1_km,nominal_gauge_mm\n{rows}")).length == 2000.0


def test_the_sign_of_a_cant_is_judged_where_there_is_a_curve(tmp_path: Path) -> None:
    """Noise on the straights, which leaves curvature and cant of opposite signs, is none."""
    rng = np.random.default_rng(2)
    s = np.arange(0.0, 2000.25, 0.25)
    share = np.clip((s - 500.0) / 100.0, 0.0, 1.0) - np.clip((s - 1200.0) / 200.0, 0.0, 2.0)
    noise = np.cumsum(rng.normal(size=len(s))) * 0.05 * (s > 1.0)
    columns = s, 0.5 * share + 0.02 * rng.normal(size=len(s)) * (s > 1.0), 80.0 * share + np.sin(noise)
    rows = "\n".join(f"{a},{b},{c}" for a, b, c in zip(*columns, strict=True))
    assert load_line(write(tmp_path, f"x_m,curvature_1_km,cant_mm\n{rows}")).length == 2000.0


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv: no such table"):
        load_line(str(tmp_path / "none.csv"))


def test_a_packaged_line_by_name() -> None:
    assert load_line("slow_curve", ["sections.curve.radius=900.0"]).curvature.at(500.0) == pytest.approx(
        1 / 900
    )
