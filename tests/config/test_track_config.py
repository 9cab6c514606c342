"""Track configurations: packaged files and refusals."""

from __future__ import annotations

from pathlib import Path

import pytest

from sayd_env.config import ConfigError, packaged_names
from sayd_env.config.track import FileConfig, SpectrumConfig, read_track

SMOOTH = Path(__file__).parents[2] / "configs/track/smooth.yaml"


def test_all_packaged_tracks_are_valid() -> None:
    names = packaged_names("track")
    assert {"german_low", "german_high", "china", "smooth", "sine", "defect"} <= set(names)
    for name in names:
        track = read_track(name)
        assert track.gauge == 1.435
        assert 40e6 <= track.section.lateral_stiffness <= 70e6


def test_override_of_the_scale() -> None:
    irregularity = read_track("german_low", ["irregularity.scale=0.5"]).irregularity
    assert isinstance(irregularity, SpectrumConfig)
    assert irregularity.scale == 0.5


def test_measured_file_lies_beside_its_yaml(tmp_path: Path) -> None:
    yaml = tmp_path / "line.yaml"
    even = SMOOTH.read_text(encoding="utf-8")
    yaml.write_text(even.replace("type: none", "type: file\n  path: line.csv"), encoding="utf-8")
    irregularity = read_track(str(yaml)).irregularity
    assert isinstance(irregularity, FileConfig)
    assert Path(irregularity.path) == tmp_path / "line.csv"


@pytest.mark.parametrize(
    ("name", "override", "message"),
    [
        ("german_low", "section.mass=-1.0", r"section\.mass: found -1\.0.*greater than 0.*kg"),
        ("german_low", "section.lateral_stiffness=70.0", r"lateral_stiffness: found 70\.0.*100000.*N/m"),
        ("german_low", "section.seat_half_spacing=750.0", r"seat_half_spacing: found 750\.0.*\(?m"),
        ("german_low", "irregularity.wavelength_min=300.0", "must be below wavelength_max"),
        ("german_low", "irregularity.levels.lateral=1.0", "unknown key .*lateral.*alignment"),
        ("german_low", "irregularity.scale=one", "expected a number"),
        ("german_low", "irregularity.scale=.nan", "finite"),
        ("german_low", "irregularity.type=spectrun", "spectrun"),
        ("sine", "irregularity.channel=lateral", "'alignment', 'vertical', 'cross_level' or 'gauge'"),
        ("sine", "irregularity.wavelength=0.0", "greater than 0"),
        ("china", "irregularity.density.percentile=1.0", "less than 1"),
        ("china", "irregularity.density.gauge.limits=[0.3, 0.1]", "limits must ascend"),
        ("china", "irregularity.density.gauge.limits=[0.3]", "1 limits need 2 coefficients"),
        ("china", "irregularity.density.gauge.limits=[true, 0.1]", "valid number|expected a number"),
    ],
)
def test_refusals_name_file_and_key(name: str, override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        read_track(name, [override])
    assert str(caught.value).startswith("--set: ")  # the file itself is sound


def test_unknown_name() -> None:
    with pytest.raises(ConfigError, match="unknown track 'german', did you mean 'german_"):
        read_track("german")
