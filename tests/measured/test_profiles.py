"""Files of profiles: layouts, units, directions, faulty points; what is recognised is noted."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError
from sayd_env.config.profile import load_rail, load_wheel
from sayd_env.config.units import Array
from sayd_env.measured.profiles import read_profile_file
from sayd_env.physics.profiles import rail_profile, wheel_profile

GAUGE_FACE = "gauge face: taken to be at negative y; if it is at positive y, set rail.shape.mirror=true"
AWAY = np.array([5.0, 0.0])  # mm
Y = np.round(np.arange(-70.0, 60.01, 0.2), 6)


@pytest.fixture(scope="module")
def wheel() -> Array:
    """Points of S1002 (mm)."""
    curve = wheel_profile(load_wheel("s1002"))
    return np.column_stack([Y, np.interp(Y, curve.y * 1e3, curve.z * 1e3)])


@pytest.fixture(scope="module")
def rail() -> Array:
    """Points of the upright head 60E1 (mm)."""
    curve = rail_profile(load_rail("60e1").model_copy(update={"cant": 0.0}))
    y = np.arange(-36.6, 36.61, 0.2)
    return np.column_stack([y, np.interp(y, curve.y * 1e3, curve.z * 1e3)])


def table(points: Array, separator: str = ",", digits: int = 5, comma: bool = False, header: str = "") -> str:
    rows = (separator.join(f"{value:.{digits}f}" for value in row) for row in points)
    text = "\n".join(rows) + "\n"
    return header + (text.replace(".", ",") if comma else text)


def simpack(points: Array, kind: int = 1, keys: str = "units.len.f = +1.0e+03", weight: str = "") -> str:
    body = "\n".join(f"  {y:.9f}  {z:.9f}{weight}" for y, z in points)
    return (
        f"! a comment\nheader.begin\n  version = 1\n  type = {kind} ! 0=rail\nheader.end\nspline.begin\n"
        f"  comment = 'of ours ! really'\n  {keys}\n  point.begin\n{body}\n  point.end\nspline.end\n"
    )


def miniprof(points: Array, header: str = "ColumnDef=X,Y,*") -> str:
    rows = "\n".join(f"{y:.4f}\t{z:.4f}\t0.0\t0.0\t1" for y, z in points)
    return f"ProgramName=MiniProf\nProgramVer=2.5.1\nWheelID=3\n{header}\n\n{rows}"


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def check(path: Path, points: Array, kind: str = "wheel", within: float = 6e-3) -> tuple[str, ...]:
    """Compare the curve with points (mm); return the notes."""
    found = read_profile_file(path, kind)  # type: ignore[arg-type]
    assert np.all(np.diff(found.y) > 0.0)
    inner = (points[:, 0] > found.y[0] * 1e3 + 0.01) & (points[:, 0] < found.y[-1] * 1e3 - 0.01)
    assert np.mean(inner) > 0.8
    heights = np.interp(points[inner, 0], found.y * 1e3, found.z * 1e3)
    np.testing.assert_allclose(heights, points[inner, 1], atol=within)
    return found.notes


@pytest.mark.parametrize("separator", [";", "\t", " ", "   "])
@pytest.mark.parametrize("every", [1, 5], ids=["0.2 mm", "whole mm"])
def test_decimal_commas(tmp_path: Path, wheel: Array, separator: str, every: int) -> None:
    text = table(wheel[::every], separator, 2, comma=True)
    if every == 5:
        text = text.replace(f",00{separator}", separator)  # y at whole mm without decimals
    check(write(tmp_path / "w.csv", text), wheel[::every])


@pytest.mark.parametrize("whole", [False, True])
def test_decimal_commas_between_commas_are_refused(tmp_path: Path, wheel: Array, whole: bool) -> None:
    text = table(wheel[::5], ",", 2, comma=True)
    path = write(
        tmp_path / "w.csv",
        "\n".join(line.replace(",00,", ",", 1) if whole else line for line in text.splitlines()),
    )
    with pytest.raises(
        DataError, match=rf"w\.csv: line 1: .*{3 if whole else 4} columns.*decimal commas need"
    ):
        read_profile_file(path, "wheel")


@pytest.mark.parametrize(
    ("header", "codec", "note"),
    [
        ("y_mm,z_mm\n", "utf-8-sig", ""),
        ("# Profil für Rad, Maß in mm\n", "cp1252", "encoding: Windows-1252"),
        ("y [mm], z [mm]\n", "utf-16", "encoding: UTF-16"),
        ("% measured\ny,z\nmm,mm\n", "utf-8", ""),
    ],
)
def test_headers_and_encodings(tmp_path: Path, wheel: Array, header: str, codec: str, note: str) -> None:
    path = write(tmp_path / "w.csv", table(wheel, header=header).encode(codec))
    notes = check(path, wheel)
    assert note in " ".join(notes)
    assert not any("unit" in note for note in notes)


@pytest.mark.parametrize(
    ("factor", "unit"), [(1.0, "mm"), (0.1, "cm"), (1e-3, "m"), (1 / 25.4, "in"), (1e3, "um")]
)
@pytest.mark.parametrize("kind", ["wheel", "rail"])
def test_units_by_extent_are_noted(
    tmp_path: Path, wheel: Array, rail: Array, factor: float, unit: str, kind: str
) -> None:
    points = wheel if kind == "wheel" else rail
    path = write(tmp_path / "p.csv", table(points * factor, digits=8))
    notes = check(path, points, kind)
    assert any(note.startswith(f"unit: {unit}, in which points") for note in notes)


def test_units_are_asked_for_and_never_contradicted(tmp_path: Path, wheel: Array) -> None:
    odd = write(tmp_path / "odd.csv", table(wheel * 7.0))
    with pytest.raises(
        DataError, match=r"odd\.csv: its unit is not known: points are 910 wide .*wheel\.shape\.unit"
    ):
        read_profile_file(odd, "wheel")
    metres = write(tmp_path / "m.csv", table(wheel * 1e-3, digits=8, header="y_mm,z_mm\n"))
    with pytest.raises(DataError, match=r"m\.csv: by its unit \(its header: mm, mm\) it is 0\.13 mm wide"):
        read_profile_file(metres, "wheel")
    with pytest.raises(DataError, match=r"shape\.unit: in\) it is .* mm wide"):
        read_profile_file(write(tmp_path / "w.csv", table(wheel)), "wheel", unit="in")
    assert read_profile_file(tmp_path / "w.csv", "wheel", unit="mm").notes == ()
    force = write(tmp_path / "f.csv", table(wheel, header="y_mm,z_kN\n"))
    with pytest.raises(DataError, match=r"f\.csv: line 1: found the unit 'kN'; expected mm, cm"):
        read_profile_file(force, "wheel")


def test_columns_are_found_by_name_or_asked_for(tmp_path: Path, wheel: Array) -> None:
    points = np.column_stack([np.arange(len(wheel)), wheel[:, ::-1]])
    named = write(tmp_path / "n.csv", table(points, header="no,z_mm,y_mm\n"))
    assert check(named, wheel) == ("not used: column 'no'",)
    bare = write(tmp_path / "b.csv", table(points))
    with pytest.raises(DataError, match=r"b\.csv: line 1: found 3 columns; expected two, y and z"):
        read_profile_file(bare, "wheel")


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("invert", [1.0, -1.0])
@pytest.mark.parametrize("order", [1, -1])
def test_directions_are_recognised(
    tmp_path: Path, wheel: Array, mirror: float, invert: float, order: int
) -> None:
    path = write(tmp_path / "w.csv", table((wheel * (mirror, invert))[::order]))
    notes = check(path, wheel)
    assert any("y turned round" in note for note in notes) == (mirror < 0.0)
    assert any("z turned round" in note for note in notes) == (invert < 0.0)
    if mirror < 0.0:
        kept = read_profile_file(path, "wheel", mirror=False)
        assert kept.y[np.argmax(kept.z)] > 0.0


def test_points_that_coincide_are_merged_and_noted(tmp_path: Path, wheel: Array) -> None:
    twice = np.repeat(wheel, np.where(np.arange(len(wheel)) % 50 == 0, 2, 1), axis=0)
    notes = check(write(tmp_path / "w.csv", table(twice)), wheel, within=1e-4)
    assert any(note.startswith(f"{len(twice) - len(wheel)} points merged") for note in notes)
    close = np.insert(wheel, 300, wheel[300] - (0.004, -0.002), axis=0)
    notes = check(write(tmp_path / "c.csv", table(close)), wheel)
    assert any(note.startswith("1 point merged") for note in notes)


def test_overhangs_are_cut_and_noted_behind_the_flange_and_refused_elsewhere(
    tmp_path: Path, wheel: Array, rail: Array
) -> None:
    back = wheel.copy()
    back[:20, 0] = -66.0 + 0.1 * np.arange(20)[::-1]  # the back of the flange leans out
    notes = check(write(tmp_path / "w.csv", table(back)), wheel)
    assert any("points cut behind the flange's top" in note for note in notes)
    sides = np.vstack([rail[0] + (2.0, -20.0), rail, rail[-1] + (-2.0, -20.0)])
    notes = check(write(tmp_path / "r.csv", table(sides)), rail, "rail")
    assert sum("1 point cut" in note for note in notes) == 2
    tread = wheel.copy()
    tread[300, 0] -= 0.5
    with pytest.raises(DataError, match=r"t\.csv: line 301: y goes from -10\.2 to -10\.5 mm, against"):
        read_profile_file(write(tmp_path / "t.csv", table(tread)), "wheel")


def test_points_without_order_and_gaps_are_refused(tmp_path: Path, wheel: Array) -> None:
    shuffled = np.random.default_rng(0).permutation(wheel)
    for name, points, message in (
        ("s.csv", shuffled, r"only \d+ of 651 points follow one another|against the direction"),
        ("t.csv", np.vstack([wheel, wheel]), r"only 651 of 1302 points follow one another"),
        (
            "g.csv",
            np.vstack([wheel[:300], wheel[360:]]),
            r"no points between y = -10\.2 and 2 mm; at most 6 mm",
        ),
    ):
        with pytest.raises(DataError, match=message):
            read_profile_file(write(tmp_path / name, table(points)), "wheel")
    damaged = write(tmp_path / "d.csv", table(wheel).replace("-70.00000", "0x10"))
    with pytest.raises(DataError, match=r"d\.csv: line 1: found '9\.51926' beside what is no number"):
        read_profile_file(damaged, "wheel")


def test_rows_of_separators_alone_are_refused(tmp_path: Path, wheel: Array) -> None:
    rows = table(wheel).split("\n")
    rows.insert(40, rows[40].translate(str.maketrans("", "", "0123456789.- ")))
    with pytest.raises(DataError, match=r"gap\.csv: line 41: found separators alone"):
        read_profile_file(write(tmp_path / "gap.csv", "\n".join(rows)), "wheel")


def test_one_kind_does_not_pass_as_the_other(tmp_path: Path, wheel: Array, rail: Array) -> None:
    for name, text, asked in (
        ("a.prw", simpack(wheel, 0), "wheel"),
        ("b.prr", simpack(rail, 0), "wheel"),
        ("c.prw", simpack(wheel), "rail"),
        ("d.txt", simpack(rail, 0), "wheel"),
        ("e.ban", miniprof(rail), "wheel"),
        ("f.whl", miniprof(wheel), "rail"),
    ):
        with pytest.raises(DataError, match=rf"{name[0]}\{name[1:]}: (its header says|is a)"):
            read_profile_file(write(tmp_path / name, text), asked)  # type: ignore[arg-type]
    # Without a name or a header that tells it, the shape does.
    with pytest.raises(DataError, match=r"profile 'r': no flange .* at positive y. Is it a rail"):
        wheel_profile(load_wheel(str(write(tmp_path / "r.csv", table(rail)))))
    short = wheel[(wheel[:, 0] > -60.0) & (wheel[:, 0] < 50.0)]
    for points, message in ((wheel, "130 wide and 30.64 high, a rail in none"), (short, "from the crown")):
        with pytest.raises(DataError, match=message):
            rail_profile(load_rail(str(write(tmp_path / "w.csv", table(points)))))


def test_simpack_steps_are_taken_in_its_order(tmp_path: Path, wheel: Array) -> None:
    """The file holds what the steps undo: shift, then rotation about x from y to z, then mirroring."""
    turn, shift = 0.02, np.array([3.0, -1.5])
    cos, sin = math.cos(turn), math.sin(turn)
    y, z = (wheel * (-1.0, 1.0)).T
    points = np.column_stack([y * cos + z * sin, z * cos - y * sin]) - shift
    keys = (
        "shift.y = 3.0\n shift.z = -1.5\n rotate = 20\n units.ang.f = 1000\n mirror.y = 1\n inversion = 1\n"
        " mirror.z = 0\n units.len = 'mm'\n units.len.f = 1e3\n approx.smooth = 0.0\n file = '-'\n type = 0"
    )
    assert check(write(tmp_path / "w.prw", simpack(points, keys=keys, weight="  1.0")), wheel) == ()


def test_simpack_bounds_and_distances_are_applied(tmp_path: Path, wheel: Array) -> None:
    keys = "point.dist.min = 0.3\n bound.y.min = -60\n bound.y.max = 40\n bound.z.min = -1\n bound.z.max = 50"
    found = read_profile_file(write(tmp_path / "w.prw", simpack(wheel, keys=keys)), "wheel")
    assert (found.y[0] >= -0.060, found.y[-1] <= 0.040) == (True, True)
    assert np.min(np.hypot(np.diff(found.y), np.diff(found.z))) >= 0.3e-3
    assert np.min(found.z) == pytest.approx(-1e-3)
    assert [note.split()[1] for note in found.notes[:3]] == ["points", "points", "heights"]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("a" * 50 + " = 0.1", "line 8: unknown key '" + "a" * 37 + "...'"),
        ("rotat = 0.1", "line 8: unknown key 'rotat', did you mean 'rotate'"),
        ("approx.smooth = 0.5", "line 8: approx.smooth: found 0.5; SIMPACK's smoothing"),
        ("rotate = 3", "rotate: found 3 rad"),
        ("units.len.f = 0", "units.len.f: found 0; expected a factor above 0"),
        ("units.len.f = -1e3", "units.len.f: found -1e3; expected a factor above 0"),
        ("units.len.f = 1e-300", "by its unit (units.len.f)"),
        ("units.len.f = 1.2.3", "units.len.f: found '1.2.3'; expected a factor"),
        ("units.len = 'mm'\n units.len.f = 1", "units.len = mm has the factor 1000"),
        ("units.len = 'furlong'", "units.len: found 'furlong'; expected mm, cm"),
        ("shift.y = 1e300", "shift.y: found 1e300; expected 1e+06 at most"),
        ("shift.y = 1e999", "shift.y: found '1e999'; expected a number that is finite"),
        ("point.dist.min = -1", "point.dist.min: found -1; expected 0 or more"),
        ("shift.y = \u0663", "expected a number"),
        ("shift.y = .", "shift.y: found '.'; expected a number"),
        ("mirror.y = 2", "mirror.y: found 2; expected 0 or 1"),
        ("rotate = 0\n rotate = 0.025", "line 9: key 'rotate' appears twice"),
        ("rotate 0.025", "expected key = value"),
        ("header.begin", "header.begin is out of place"),
        ("wheel.begin", "unknown section 'wheel'"),
    ],
)
def test_simpack_keys_are_applied_or_refused(tmp_path: Path, wheel: Array, keys: str, message: str) -> None:
    path = write(tmp_path / "w.prw", simpack(wheel, keys=keys))
    with pytest.raises(DataError) as caught:
        read_profile_file(path, "wheel")
    assert str(caught.value).startswith(str(path))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("version = 1", "version = 2", "only version 1"),
        ("type = 1", "type = 7", "type: found 7; expected 0 or 1"),
        ("-70.000000000", "1.2.3", "line 10: found '1.2.3'; expected y and z"),
        ("  point.end\nspline.end\n", "", "ends within section 'point'"),
    ],
)
def test_simpack_files_that_are_damaged(
    tmp_path: Path, wheel: Array, old: str, new: str, message: str
) -> None:
    path = write(tmp_path / "w.prw", simpack(wheel).replace(old, new))
    with pytest.raises(DataError) as caught:
        read_profile_file(path, "wheel")
    assert message in str(caught.value)


def test_miniprof(tmp_path: Path, wheel: Array, rail: Array) -> None:
    notes = check(write(tmp_path / "w.whl", miniprof(wheel * (1.0, -1.0))), wheel)
    assert notes == ("z turned round, so that it is upwards: the flange points to negative z in the file",)
    moved = miniprof(rail - (5.0, -2.0), "XOffset=5.0\nYOffset=-2.0\nMyKey=4\nXYPoints=367")
    assert check(write(tmp_path / "r.ban", moved), rail, "rail") == (
        "keys of the header that are not used: mykey",
        GAUGE_FACE,
    )
    swapped = miniprof(wheel[:, ::-1], "ColumnDef=Y,X,A,C,N").replace(".", ",")
    assert check(write(tmp_path / "s.whl", swapped.replace("2,5,1", "2.5.1")), wheel) == ("decimal commas",)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("ColumnDef=X,Y", "found 5 values; ColumnDef has X,Y"),
        ("ColumnDef=X,A,*", "line 4: ColumnDef: found 'X,A,*'; expected letters"),
        ("XYPoints=12", "line 4: XYPoints: found 12, but the file has 651 points"),
        ("XOffset=1,000", "line 4: XOffset: found '1,000'; expected a number"),
        ("XOffset=two", "line 4: XOffset: found 'two'; expected a number"),
    ],
)
def test_miniprof_headers_that_cannot_be_used(
    tmp_path: Path, wheel: Array, header: str, message: str
) -> None:
    path = write(tmp_path / "w.whl", miniprof(wheel, header))
    with pytest.raises(DataError) as caught:
        read_profile_file(path, "wheel")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no points"),
        (b"# nothing\n", "no points"),
        (b"\x00\x01\x02" * 100, "is not a text file"),
        (b"1,2\n" * 30, "unit is not known"),
        (b"1e300,-1e300\n-1e300,1e300\n" * 30, "unit is not known"),
        (b"y,z\n" + b"1,x\n" * 30, "line 2: column 'z': found 'x'; expected a number"),
    ],
)
def test_files_that_are_no_profiles(tmp_path: Path, content: bytes, message: str) -> None:
    with pytest.raises((ConfigError, DataError), match=r"p\.csv") as caught:
        read_profile_file(write(tmp_path / "p.csv", content), "wheel")
    assert message in str(caught.value)


@pytest.mark.parametrize(("raised", "at"), [(0.05, 350), (-0.05, 350), (0.05, 210), (1.0, 400)])
@pytest.mark.parametrize("digits", [5, 3])
def test_one_point_off_the_tread_is_refused_by_line(
    tmp_path: Path, wheel: Array, raised: float, at: int, digits: int
) -> None:
    path = tmp_path / "w.csv"
    points = wheel.copy()
    points[at, 1] += raised
    write(path, table(points, digits=digits))
    message = (
        rf"w\.csv: line {at + 1}: the point at y = {points[at, 0]:g} mm "
        rf"stands (0\.049|{abs(raised):.2g}1?) mm off"
    )
    with pytest.raises(DataError, match=message):
        read_profile_file(path, "wheel")
    assert len(read_profile_file(path, "wheel", smoothing=3e-3).y) == len(points)
    check(write(path, table(np.delete(points, at, axis=0), digits=digits)), wheel)


def test_one_point_off_the_head_of_a_rail_is_refused(tmp_path: Path, rail: Array) -> None:
    rail = rail.copy()
    rail[180, 1] += 1.0
    with pytest.raises(DataError, match=r"r\.csv: line 181: the point at y = -0\.6 mm stands 1 mm off"):
        read_profile_file(write(tmp_path / "r.csv", table(rail)), "rail")


@pytest.mark.parametrize("name", ["s1002", "s1002cn", "lma", "lmb10", "en15302_a", "en15302_b", "en15302_i"])
@pytest.mark.parametrize("step", [0.2, 2.1])
def test_rounded_rough_and_coarse_wheels_have_no_point_that_stands_off(
    tmp_path: Path, name: str, step: float
) -> None:
    curve = wheel_profile(load_wheel(name))
    y = np.arange(curve.y[0] * 1e3, curve.y[-1] * 1e3, step)
    exact = np.interp(y, curve.y * 1e3, curve.z * 1e3)
    rough = exact + 0.01 * np.random.default_rng(1).standard_normal(len(y))
    for z, digits in ((exact, 5), (exact, 2), (exact, 1), (rough, 4)):
        notes = read_profile_file(
            write(tmp_path / "w.csv", table(np.column_stack([y, z]), digits=digits)), "wheel"
        ).notes
        assert any(note.startswith("points up to 2.1 mm apart on the tread") for note in notes) == (
            step > 1.0
        )


def test_origins_that_are_off_are_refused(tmp_path: Path, wheel: Array) -> None:
    said = (
        "the wheel's back stands at y = -65.0 mm, wheel.tape_to_back says -70: y = 0 must be the tape circle"
    )
    for path in (
        write(tmp_path / "w.csv", table(wheel + AWAY, header="y_mm,z_mm\n")),
        write(tmp_path / "w.whl", miniprof(wheel, "ColumnDef=X,Y,*\nXOffset=5")),
        write(tmp_path / "m.csv", table((wheel + AWAY) * (-1.0, 1.0), header="y_mm,z_mm\n")),
    ):
        with pytest.raises(DataError, match=re.escape(said)):
            read_profile_file(path, "wheel", tape_to_back=0.070)
        assert len(read_profile_file(path, "wheel", tape_to_back=0.065).y) == len(wheel)
    for points in (wheel, wheel + 0.18 * AWAY, wheel[15:] + AWAY):
        path = write(tmp_path / "w.csv", table(points, header="y_mm,z_mm\n"))
        assert read_profile_file(path, "wheel", tape_to_back=0.070).notes == ()
    for points, found in (
        (wheel + 14.0 * AWAY, "y runs from 0 to 130 mm in the file; .*: subtract 70 mm"),
        ((wheel + 14.0 * AWAY) * (-1.0, 1.0), "y runs from -130 to 0 mm in the file; .*: add 70 mm"),
        ((wheel - 12.0 * AWAY) * (-1.0, 1.0), "y runs from 0 to 130 mm in the file; .*: subtract 60 mm"),
    ):
        path = write(tmp_path / "w.csv", table(points, header="y_mm,z_mm\n"))
        with pytest.raises(DataError, match=found):
            read_profile_file(path, "wheel", tape_to_back=0.070)


def test_a_wheel_s_own_numbers_reach_the_reader_of_its_file(tmp_path: Path, wheel: Array) -> None:
    points = wheel.copy()
    points[350, 1] += 0.05
    path = write(tmp_path / "w.csv", table(points, header="y_mm,z_mm\n"))
    with pytest.raises(
        DataError, match=r"line 352: the point at .* smooth by wheel\.shape\.smoothing=0\.003"
    ):
        wheel_profile(load_wheel(str(path)))
    config = load_wheel(str(path))
    shape = config.shape.model_copy(update={"smoothing": 0.003})
    wheel_profile(config.model_copy(update={"shape": shape}))
    path = write(tmp_path / "away.csv", table(wheel + AWAY, header="y_mm,z_mm\n"))
    with pytest.raises(DataError, match=r"set wheel\.tape_to_back=0\.065"):
        wheel_profile(load_wheel(str(path)))
    wheel_profile(load_wheel(str(path)).model_copy(update={"tape_to_back": 0.065}))


def test_side_of_the_gauge_face_is_noted_unless_it_was_set(tmp_path: Path, rail: Array) -> None:
    path = write(tmp_path / "r.csv", table(rail, header="y_mm,z_mm\n"))
    assert read_profile_file(path, "rail").notes == (GAUGE_FACE,)
    assert read_profile_file(path, "rail", mirror=True).notes == ()
