"""Profiles against their published numbers, and faulty profile files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.config import ConfigError, DataError, packaged_names, validate
from sayd_env.config.profile import (
    MeasuredWear,
    RailProfileConfig,
    Shape,
    WheelProfileConfig,
    load_rail,
    load_wheel,
)
from sayd_env.config.scenario import load_scenario
from sayd_env.measured.profiles import read_profile_file
from sayd_env.physics.profiles import SAMPLING, gauge_point, rail_profile, wheel_profile
from sayd_env.physics.simulator import VehicleModel

RAILS = ("60e1", "60e1_30", "cn60", "en15302_rail_a")
WHEELS = tuple(name for name in packaged_names("profile") if name not in RAILS)


def wheel_config(**shape: object) -> WheelProfileConfig:
    return WheelProfileConfig(
        kind="wheel", name="test", shape=Shape(**shape), back_to_back=1.353, tape_to_back=0.07
    )


@pytest.mark.parametrize("name", WHEELS)
def test_wheels(name: str) -> None:
    profile = wheel_profile(load_wheel(name))
    np.testing.assert_allclose(np.diff(profile.y), SAMPLING, rtol=1e-9)
    assert np.interp(0.0, profile.y, profile.z) == pytest.approx(0.0, abs=1e-12)
    # EN 13715 and the Chinese profiles: flange 28 mm high.
    assert profile.z.max() == pytest.approx(0.028, abs=2e-4)
    # No kink beyond the largest in the published formulas, 1:15 (EN 15302's A and I at 30 mm).
    tread = profile.y > -0.035
    assert np.max(np.abs(np.diff(profile.z[tread], 2))) / SAMPLING < 1.0 / 15.0 + 1e-3


def test_s1002_against_its_published_heights() -> None:
    """EN 13715's S1002 in the coordinates distributed for the Manchester contact benchmark (mm)."""
    profile = wheel_profile(load_wheel("s1002"))
    expected = {-69.612628: 13.485642, -66.901024: 20.356896, -63.414676: 24.573554, 59.302730: -2.5891917}
    for s, z in expected.items():
        assert np.interp(s * 1e-3, profile.y, profile.z) * 1e3 == pytest.approx(z, abs=2e-3)


def test_lma_against_its_coordinate_table() -> None:
    """Public coordinate table of LMA (github.com/zzh158shallow-tech/JBG_SDITT, LMA_UnitMM.txt)."""
    profile = wheel_profile(load_wheel("lma"))
    expected = {
        -65.9081: 20.3251,
        -33.5412: 5.865,
        -24.18: 2.3059,
        -15.1893: 0.8691,
        -6.4401: 0.2681,
        2.6616: -0.0838,
        20.1987: -0.5251,
        50.1757: -2.1152,
    }
    for s, z in expected.items():
        assert np.interp(s * 1e-3, profile.y, profile.z) * 1e3 == pytest.approx(z, abs=1.5e-3)


def test_cn60_uncanted_heights() -> None:
    """Heights of the uncanted CN60 head from its public coordinate file (mm).

    The design's tangent arcs depart from that digitised file by up to 10 um.
    """
    rail = rail_profile(load_rail("cn60").model_copy(update={"cant": 0.0}))
    heights = (-0.028, -0.109, -0.261, -0.594, -1.131, -1.875, -3.101, -6.062)
    for y, z in zip(range(4, 33, 4), heights, strict=True):
        for side in (-1, 1):
            assert np.interp(side * y * 1e-3, rail.y, rail.z) * 1e3 == pytest.approx(z, abs=1e-2)
    np.testing.assert_allclose(rail.z, np.interp(-rail.y, rail.y, rail.z), atol=1e-7)


def test_cant_moves_the_crown_outwards() -> None:
    """1:40 moves the crown of CN60 by 7.40 mm; the gauge face is that of the canted head."""
    canted = rail_profile(load_rail("cn60"))
    plain = rail_profile(load_rail("cn60").model_copy(update={"cant": 0.0}))
    # The face, 16 mm below the crown, follows the tilt by 0.4 mm.
    inner = gauge_point(plain) - gauge_point(canted)
    assert inner == pytest.approx(7.40e-3 - 0.016 * 0.025, abs=2e-4)
    assert canted.z.max() == pytest.approx(0.0, abs=1e-9)


def test_rail_a_lies_750_mm_from_the_centre() -> None:
    """EN 15302: rail A's formulas have their origin at 750 mm when the gauge is 1435.16 mm."""
    rail = rail_profile(load_rail("en15302_rail_a"))
    crown = 14.29829e-3  # highest point of the formulas
    assert 0.5 * 1.43516 - gauge_point(rail) == pytest.approx(0.750 + crown, abs=1e-5)


def test_wear_blends_between_new_and_worn() -> None:
    config = load_wheel("s1002cn-estimate")
    new, half, worn, beyond = (wheel_profile(config, wear).z for wear in (0.0, 0.5, 1.0, 1.2))
    np.testing.assert_allclose(half, 0.5 * (new + worn), atol=1e-12)
    np.testing.assert_allclose(beyond - new, 1.2 * (worn - new), atol=1e-12)
    y = wheel_profile(config).y
    # Hollow wear of depth 1 mm about s = 3 mm, half width 30 mm; heights are relative to the tape circle.
    loss = 1e-3 * (np.cos(np.pi * (y - 3e-3) / 60e-3) ** 2) * (np.abs(y - 3e-3) < 30e-3)
    at_tape = 1e-3 * np.cos(np.pi * 3e-3 / 60e-3) ** 2
    np.testing.assert_allclose(new - worn, loss - at_tape, atol=1e-8)


def test_measured_worn_end_of_the_blend(tmp_path: Path) -> None:
    reference = wheel_profile(load_wheel("s1002"))
    worn = reference.z - 4e-4 * np.exp(-((reference.y / 12e-3) ** 2))
    path = tmp_path / "worn.csv"
    every = slice(None, None, 6)
    np.savetxt(path, np.column_stack([reference.y, worn])[every] * 1e3, delimiter=",", header="y_mm, z_mm")
    config = load_wheel("s1002").model_copy(
        update={"wear": MeasuredWear(type="measured", shape=Shape(file=str(path)))}
    )
    tread = (reference.y > -0.035) & (reference.y < 0.05)
    for wear in (0.0, 0.3, 1.0, 1.1):
        profile = wheel_profile(config, wear)
        z = np.interp(reference.y, profile.y, profile.z)
        expected = (1.0 - wear) * reference.z + wear * worn
        expected = expected - np.interp(0.0, reference.y, expected)
        np.testing.assert_allclose(z[tread], expected[tread], atol=2e-6)


def test_a_file_that_is_edited_makes_another_table(tmp_path: Path) -> None:
    """In one process as well, where tables are kept: a tread worn flat by 0.5 mm rolls on another radius."""
    reference, path = wheel_profile(load_wheel("s1002")), tmp_path / "wheel.csv"
    scenario, found = None, []
    for depth in (0.0, 5e-4):
        z = reference.z - depth * np.exp(-((reference.y / 12e-3) ** 2))
        points = np.column_stack([reference.y, z])[::6] * 1e3
        np.savetxt(path, points, delimiter=",", header="y_mm, z_mm")
        scenario = scenario or load_scenario("estimates", [f"wheel={path}", "wear=0.0"])
        found.append(VehicleModel(scenario).table.delta_r)
    assert np.abs(found[0] - found[1]).max() > 1e-4


def test_smoothing_removes_noise_but_keeps_the_curve() -> None:
    exact = wheel_profile(load_wheel("s1002"))
    coarse = slice(0, None, 10)
    noise = np.random.default_rng(1).normal(0.0, 2e-6, exact.y[coarse].shape)
    points = tuple(
        (float(y * 1e3), float(z * 1e3))
        for y, z in zip(exact.y[coarse], exact.z[coarse] + noise, strict=True)
    )
    rough, smooth = (wheel_profile(wheel_config(points=points, smoothing=s)) for s in (0.0, 5e-3))
    tread = (smooth.y > -0.02) & (smooth.y < 0.025)

    def slope_error(profile_z: np.ndarray) -> float:
        want = np.gradient(np.interp(smooth.y, exact.y, exact.z), SAMPLING)
        return float(np.std((np.gradient(profile_z, SAMPLING) - want)[tread]))

    assert slope_error(smooth.z) < 0.3 * slope_error(rough.z)


def test_wear_out_of_range() -> None:
    with pytest.raises(ConfigError, match="allowed is 0"):
        wheel_profile(load_wheel("s1002cn"), 1.21)
    with pytest.raises(ConfigError, match="has no wear section"):
        wheel_profile(load_wheel("s1002"), 0.5)


def test_kinds_are_not_interchangeable() -> None:
    with pytest.raises(
        ConfigError, match=r"cn60\.yaml: is a rail profile; as wheel are available: .*lma.*s1002cn"
    ):
        load_wheel("cn60")
    with pytest.raises(ConfigError, match="did you mean 's1002cn'"):
        load_wheel("s1002c")


GOOD = "\n".join(f"{y}, {z}" for y, z in [(-70 + 2 * i, 28 - 0.5 * i) for i in range(66)])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found no points"),
        ("# only a comment\n", "found no points"),
        ("y,z\n" + "\n".join(f"{i},0" for i in range(5)), "found 5 points, at least 20"),
        (GOOD.replace("-60, 25.5", "-65, 25.5"), "line 6: y goes from -62 to -65 mm"),
        (GOOD.replace("-60, 25.5", "-60, nan"), "line 6: column 2: found 'nan'; expected a finite number"),
        (GOOD.replace("-60, 25.5", "-60, inf"), "line 6: column 2: found 'inf'; expected a finite number"),
        (GOOD.replace("-60, 25.5", "-60, abc"), "line 6: column 2: found 'abc'; expected a number"),
        (GOOD.replace("-60, 25.5", "-60"), "line 6: found 1 cell, '-60'; expected 2"),
    ],
)
def test_faulty_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "wheel.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=r"wheel\.csv") as caught:
        wheel_profile(wheel_config(file=str(path)))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("separator", [" ", "\t", ";", ", "])
def test_separators_and_headers(tmp_path: Path, separator: str) -> None:
    path = tmp_path / "wheel.txt"
    path.write_text("% measured\ny z\n" + GOOD.replace(", ", separator))
    found = read_profile_file(path, "wheel")
    assert (len(found.y), found.y[0], found.z[0]) == (66, pytest.approx(-0.07), pytest.approx(0.028))


def test_file_that_is_not_there() -> None:
    with pytest.raises(ConfigError, match="no such profile file"):
        wheel_profile(wheel_config(file="nowhere.csv"))


def test_flange_on_the_wrong_side(tmp_path: Path) -> None:
    profile = wheel_profile(load_wheel("s1002"))
    path = tmp_path / "wheel.csv"
    np.savetxt(path, np.column_stack([-profile.y, profile.z])[::-8] * 1e3, delimiter=",")
    with pytest.raises(DataError, match=r"rises by 0\.0 mm there and by .* Is it a rail\? .* set mirror or"):
        wheel_profile(wheel_config(file=str(path), mirror=False))
    for note in ("y turned round, so that the flange is at negative y", "backs 1353 mm apart"):
        assert note in " ".join(wheel_profile(wheel_config(file=str(path))).notes)
    turned = wheel_profile(wheel_config(file=str(path), mirror=True))
    tread = (profile.y > -0.06) & (profile.y < 0.055)
    np.testing.assert_allclose(np.interp(profile.y, turned.y, turned.z)[tread], profile.z[tread], atol=2e-5)


def test_profiles_that_are_too_short() -> None:
    short = tuple((float(y), 28.0 if y < -40 else 0.0) for y in range(-60, 5))
    with pytest.raises(DataError, match=r"covers -60\.0 to 4\.0 mm from the tape circle"):
        wheel_profile(wheel_config(points=short))
    head = tuple((float(y), -0.002 * y**2) for y in range(-30, 31))
    config = RailProfileConfig(
        kind="rail", name="stub", shape=Shape(points=head), cant=0.0, gauge_depth=0.014
    )
    with pytest.raises(DataError, match=r"inner side ends 1\.8 mm below the crown"):
        rail_profile(config)


@pytest.mark.parametrize("smoothing", [0.0, 0.005])
def test_profiles_in_another_unit_are_narrow(smoothing: float) -> None:
    """Metres for millimetres."""
    points = tuple((1e-3 * y, -2e-9 * y**2) for y in range(-30, 31))
    shape = Shape(points=points, smoothing=smoothing)
    with pytest.raises(DataError, match=r"is 0 mm wide, at least 21 mm are needed; .* are in mm"):
        rail_profile(RailProfileConfig(kind="rail", name="stub", shape=shape, cant=0.0, gauge_depth=0.014))


def test_zones_that_do_not_meet() -> None:
    data = {
        "kind": "wheel",
        "name": "gap",
        "back_to_back": 1.353,
        "tape_to_back": 0.07,
        "shape": {
            "zones": [
                {"type": "line", "start": -70, "end": 0, "offset": 0.0, "slope": -0.4},
                {"type": "line", "start": 0, "end": 60, "offset": -0.5, "slope": -0.05},
            ]
        },
    }
    with pytest.raises(DataError, match=r"do not meet at y = 0 mm: step of -0.500 mm"):
        wheel_profile(validate(WheelProfileConfig, data, "gap.yaml"))
    data["shape"]["zones"][1]["start"] = 3  # type: ignore[index]
    with pytest.raises(ConfigError, match="zones must join: one ends at 0 mm, the next starts at 3 mm"):
        validate(WheelProfileConfig, data, "gap.yaml")
    data["shape"]["points"] = [[0.0, 0.0]] * 8  # type: ignore[index]
    with pytest.raises(ConfigError, match="exactly one of zones, points, file"):
        validate(WheelProfileConfig, data, "gap.yaml")


def test_a_data_file_is_found_beside_its_yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "wheel.csv").write_text(GOOD)
    yaml = tmp_path / "wheel.yaml"
    yaml.write_text(
        "kind: wheel\nname: w\nback_to_back: 1.353\ntape_to_back: 0.07\nshape: {file: wheel.csv}\n"
    )
    monkeypatch.chdir(tmp_path.parent)
    assert wheel_profile(load_wheel(str(yaml))).name == "w"
