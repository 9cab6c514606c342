"""Recordings of a real train: reading, verdict, and what is said about bad files."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from sayd_env.config import ConfigError, DataError
from sayd_env.config.assessment import load_assessment
from sayd_env.report.files import csv_bytes, json_text
from sayd_env.stability import Quantity, read_recording
from sayd_env.studies.assess import assess_file

SETTINGS = load_assessment()
RATE = 250.0
SPEED = 75.0
TIME = np.arange(int(1500 / SPEED * RATE)) / RATE
STABLE = 4.0 * np.sin(2 * np.pi * 4 * TIME)  # RMS 2.83 m/s2
UNSTABLE = 50.0 * np.sin(2 * np.pi * 5 * TIME)  # RMS 35.4 kN


def write(path: Path, header: str, columns: list[np.ndarray], separator: str = ",") -> Path:
    rows = (separator.join(f"{x:.9g}" for x in row) for row in np.column_stack(columns))
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def ride(tmp_path: Path) -> Path:
    header = "time_s,speed_kmh,bogie1_front_m_s2,wheelset1_kn"
    return write(tmp_path / "ride.csv", header, [TIME, np.full_like(TIME, SPEED * 3.6), STABLE, UNSTABLE])


def test_verdict_on_two_sines(ride: Path) -> None:
    result = assess_file(ride, SETTINGS)
    acceleration, force = result.channels
    assert acceleration.channel.quantity is Quantity.ACCELERATION
    assert acceleration.dominant_frequency == pytest.approx(4, abs=0.01)
    assert force.dominant_frequency == pytest.approx(5, abs=0.01)
    # 100 m hold 5.3 and 6.7 periods: windows within 1.5 % of A / sqrt(2), mirrored ends within 3 %.
    assert acceleration.rms_max == pytest.approx(4 / np.sqrt(2), rel=0.03)
    assert force.rms_max == pytest.approx(50e3 / np.sqrt(2), rel=0.03)
    assert acceleration.limit == pytest.approx(5.44)
    assert force.limit == pytest.approx(30e3)
    assert acceleration.stable
    assert not force.stable
    assert not result.stable
    assert result.as_dict()["assessed_distance_m"] == pytest.approx(1500)


def test_result_goes_to_json_tables_plots_and_console(ride: Path) -> None:
    result = assess_file(ride, SETTINGS)
    channels = json.loads(json_text(result.as_dict()))["channels"]
    assert [c["unit"] for c in channels] == ["m_s2", "kn"]
    assert channels[1]["ratio"] == pytest.approx(channels[1]["rms_max"] / 30.0)
    for header, rows in result.tables().values():
        assert csv_bytes(header, rows)
    figure = Figure()
    result.plots()["signals"](figure)
    assert len(figure.axes) == 2
    console = Console(file=io.StringIO(), width=120)
    result.summary(console)
    assert "unstable by EN 14363 over 1500 m" in console.file.getvalue()


def test_options_replace_vehicle_speed_and_run_in(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "bogie_m_s2", [STABLE])
    result = assess_file(
        path, SETTINGS, speed=SPEED, sample_rate=RATE, run_in=500, axle_load=120e3, bogie_mass=5000
    )
    assert result.limits.acceleration == pytest.approx(5.5)
    assert result.limits.track_shift_force == pytest.approx(25e3)
    assert result.as_dict()["assessed_distance_m"] == pytest.approx(1000, abs=0.5)
    assert result.assessment.position[0] == pytest.approx(550, abs=0.5)


@pytest.mark.parametrize(
    ("header", "factor", "quantity"),
    [
        ("a [m/s2]", 1.0, Quantity.ACCELERATION),
        ("a [m/s^2]", 1.0, Quantity.ACCELERATION),
        ("a (m/s²)", 1.0, Quantity.ACCELERATION),
        ("a_g", 9.80665, Quantity.ACCELERATION),
        ("a_n", 1.0, Quantity.TRACK_SHIFT_FORCE),
        ("a [kN]", 1e3, Quantity.TRACK_SHIFT_FORCE),
    ],
)
def test_units_become_si(tmp_path: Path, header: str, factor: float, quantity: Quantity) -> None:
    path = write(tmp_path / "a.csv", f"t [ms];V [km/h];{header}", [TIME * 1e3, 270 + 0 * TIME, STABLE], ";")
    recording = read_recording(path, SETTINGS)
    assert recording.sample_rate == pytest.approx(RATE)
    assert np.asarray(recording.speed)[0] == pytest.approx(75)
    assert recording.channels[0].name == "a"
    assert recording.channels[0].quantity is quantity
    np.testing.assert_allclose(recording.signals[:, 0], STABLE * factor, rtol=1e-7)


def test_comments_tabs_and_chosen_columns(tmp_path: Path) -> None:
    columns = [TIME, SPEED + 0 * TIME, 20 + 0 * TIME, STABLE]
    path = write(tmp_path / "a.csv", "time_s\tspeed_m_s\toil_degc\tbogie_m_s2", columns, "\t")
    path.write_text("# line 12 to 14\n\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(DataError, match="column 'oil_degc': found unit 'degc'; allowed"):
        read_recording(path, SETTINGS)
    for name in ("bogie", "bogie_m_s2"):
        recording = read_recording(path, SETTINGS, columns=[name])
        assert [channel.name for channel in recording.channels] == ["bogie"]
    with pytest.raises(DataError, match="no column 'bogey', did you mean 'bogie'"):
        read_recording(path, SETTINGS, columns=["bogey"])


SHORT = "time_s,speed_kmh,a_n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("# nothing\n\n", "is empty"),
        (f"{SHORT}\n", "found 0 samples"),
        ("0,300,1\n0.1,300,1\n0.2,300,1\n", "line 1: found no header"),
        ("time_s,speed_kmh\n0,300\n0.001,300\n", "no column to assess"),
        ("time_s,a_m_s2\n0,1\n0.001,1\n", "no column speed_kmh"),
        ("speed_kmh,a_m_s2\n300,1\n300,1\n", "no column time_s.*--sample-rate"),
        ("time_s,speed_kmh,a_furlong\n0,300,1\n0.001,300,1\n", "column 'a_furlong': found no unit"),
        ("time_s,speed_kmh,a [bar],b_g\n0,3,1,1\n1,3,1,1\n", "'a .bar.': found unit 'bar'.*--column \"b\""),
        ("time_s,speed_kmh,a\n0,300,1\n0.001,300,1\n", "column 'a': found no unit"),
        ("time_kn,speed_kmh,a_n\n0,300,1\n0.001,300,1\n", "column 'time_kn': found a unit of force"),
        ("time_s,speed_kn,a_n\n0,300,1\n0.001,300,1\n", "column 'speed_kn': found a unit of force"),
        ("time_s,delay_s,speed_kmh,a_n\n0,1,1,1\n1,1,1,1\n", "column 'delay_s': found a unit of time"),
        ("time_s,damper_m_s,a_n\n0,1,1\n1,1,1\n", "column 'damper_m_s': found a unit of speed"),
        ("time_s,speed_kmh,gps_kmh,a_n\n0,1,1,1\n1,1,1,1\n", "'speed_kmh' and 'gps_kmh' both give the speed"),
        (f"{SHORT},a_n\n0,1,1,1\n1,1,1,1\n", "'a_n' appears twice"),
        ("time_s,speed_kmh,vertical_g\n0,1,1\n1,1,1\n", "its name says 'vert'.*lateral"),
        (f"{SHORT}\n0,300,1\n0.001,300,x\n", "line 3: column 'a_n': found 'x'"),
        (f"{SHORT}\n0,300,1\n0.001,300,1\n0,001,300,1\n", "line 4: found 4 cells.*decimal comma"),
        (f"{SHORT}\n0,300,1\n0.001,300,inf\n", "line 3: column 'a_n': found 'inf'"),
        (f"{SHORT}\n0,300,1\n,300,1\n0.2,300,1\n", "line 3: column 'time_s': found no time"),
        (f"{SHORT}\n0,300,1\n0.002,300,1\n0.001,300,1\n", "line 4.*time falls from 0.002 to 0.001 s"),
        (f"{SHORT}\n0,300,1\n0,300,1\n0,300,1\n", "line 3.*the time steps by 0 s"),
        (f"{SHORT}\n0,300,1\n0.01,300,1\n0.02,300,1\n", "100 Hz; expected 200 Hz or more"),
        (f"{SHORT}\n0,300,1\n0.001,0,1\n", "line 3: column 'speed_kmh': speed 0 km/h"),
        ("time_s,speed_m_s,a_n\n0,300,1\n0.001,300,1\n", "line 2: .*speed 1080 km/h.*unit"),
        (f"{SHORT}\n0,300,1\n0.001,300,1\n0.002,300,2\n", "a.csv: the signal covers 0 m"),
        ("time,speed_kmh,a_n\n1:02:60,300,1\n1:02:3x,300,1\n", "line 3: column 'time': found '1:02:3x'; expected"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=message) as caught:
        assess_file(path, SETTINGS, TRAIN)
    assert str(caught.value).startswith(str(path))


def test_bad_options(ride: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="use one of them"):
        assess_file(ride, SETTINGS, speed=SPEED)
    plain = write(tmp_path / "a.csv", "time_s,a_n", [TIME, STABLE])
    for speed in (0.0, -5.0, 250.0, float("nan")):
        with pytest.raises(DataError, match="speed: found"):
            assess_file(plain, SETTINGS, speed=speed)
    for rate in (0.0, 100.0, float("nan")):
        with pytest.raises(DataError, match="sampling rate"):
            assess_file(plain, SETTINGS, speed=SPEED, sample_rate=rate)
    for run_in in (-1.0, float("nan")):
        with pytest.raises(ConfigError, match="run-in"):
            assess_file(ride, SETTINGS, run_in=run_in)
    with pytest.raises(DataError, match="1200 m of run-in and 500 m to assess"):
        assess_file(ride, SETTINGS, run_in=1200.0)
    with pytest.raises(ConfigError, match="no such recording"):
        assess_file(tmp_path / "none.csv", SETTINGS)
