"""Recordings of a real train: reading, verdict, and what is said about bad files."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure
from rich.console import Console
from scipy.io import savemat

from sayd_env.cli import main
from sayd_env.config import ConfigError, DataError, StudyError
from sayd_env.config.assessment import load_assessment
from sayd_env.config.scenario import load_scenario
from sayd_env.measured import formats, recordings
from sayd_env.report.figures import Drawing
from sayd_env.report.files import csv_bytes, json_text
from sayd_env.report.html import page_html
from sayd_env.stability import Quantity, Recording, read_recording
from sayd_env.studies.assess import Stated, Train, assess_file

SETTINGS = load_assessment()
TRAIN = Train.of(bogie_mass=5600.0, axle_load=150e3)
RATE = 250.0
SPEED = 75.0
TIME = np.arange(int(1500 / SPEED * RATE)) / RATE
STABLE = 4.0 * np.sin(2 * np.pi * 4 * TIME)  # RMS 2.83 m/s2
UNSTABLE = 50.0 * np.sin(2 * np.pi * 5 * TIME)  # RMS 35.4 kN


def write(path: Path, header: str, columns: list[np.ndarray], separator: str = ",", digits: int = 9) -> Path:
    rows = (separator.join(f"{x:.{digits}g}" for x in row) for row in np.column_stack(columns))
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def ride(tmp_path: Path) -> Path:
    header = "time_s,speed_kmh,bogie1_front_m_s2,wheelset1_kn"
    return write(tmp_path / "ride.csv", header, [TIME, np.full_like(TIME, SPEED * 3.6), STABLE, UNSTABLE])


def test_verdict_on_two_sines(ride: Path) -> None:
    result = assess_file(ride, SETTINGS, TRAIN)
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
    result = assess_file(ride, SETTINGS, TRAIN)
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
    printed = console.file.getvalue()
    assert "unstable by EN 14363 over 1500 m" in printed
    assert "Limit 5.44 m/s² of accelerations: bogie of 5,600 kg (--bogie-mass)." in printed


def test_the_page_has_verdict_pictures_sections_and_what_was_done(ride: Path) -> None:
    """The RMS of a sine over x = 26 2/3 periods, a section of 500 m, and quantiles of the arcsine law."""
    result = assess_file(ride, SETTINGS, TRAIN)
    rows = result.sections()
    assert [row["start_m"] for row in rows] == [0, 0, 500, 500, 1000, 1000]
    assert rows[-1]["end_m"] == pytest.approx(1500.0)
    angle = 4 * np.pi * 80 / 3
    assert rows[0]["rms"] == pytest.approx(4 / np.sqrt(2) * np.sqrt(1 - np.sin(angle) / angle), rel=3e-4)
    assert rows[2]["band_rms"] == pytest.approx(rows[2]["rms"], rel=1e-3)
    assert rows[0]["high"] == pytest.approx(4 * np.cos(np.pi * 0.0015), rel=1e-3)
    drawings = dict.fromkeys(result.plots(), Drawing(b"picture", {}))
    page = page_html(result.page(), drawings, {"config": {}, "command": "sayd assess <ride>"})
    for words in (
        "The ride is unstable",
        "bogie of 5,600 kg",
        "Speed from column",
        "sayd assess &lt;ride&gt;",
    ):
        assert words in page
    assert page.count("<img") == 3
    assert page.count('class="marked"') == 1 + 3


def test_the_page_states_the_settings_that_were_used(ride: Path) -> None:
    changes = {"window_length": 50.0, "window_step": 25.0, "band_half_width": 1.0}
    result = assess_file(ride, SETTINGS.model_copy(update=changes), TRAIN)
    page = page_html(result.page(), dict.fromkeys(result.plots(), Drawing(b"picture", {})), {"config": {}})
    assert "over 50 m, every 25 m" in page
    assert "filter of 1 Hz to both sides" in page


@pytest.mark.parametrize(
    ("key", "why"),
    [
        ("assessment.run_in=10", "--run-in leaves out the start"),
        ("assessment.length=600", "all of a recording is assessed"),
        ("friction=0.2", "only vehicle and assessment are used"),
    ],
)
def test_settings_that_say_nothing_of_a_recording_are_refused(
    key: str, why: str, ride: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["assess", str(ride), "--bogie-mass", "5600", "--set", key]) == 2
    assert why in capsys.readouterr().err


def test_the_limit_asks_for_the_train(ride: Path) -> None:
    with pytest.raises(ConfigError, match="bogie's mass: give --bogie-mass KG; or --config"):
        assess_file(ride, SETTINGS, Train.of(axle_load=150e3))
    with pytest.raises(ConfigError, match="axle load: give --axle-load KN; or --config"):
        assess_file(ride, SETTINGS, Train.of(bogie_mass=5600.0))
    with pytest.raises(ConfigError, match=r"--bogie-mass KG; .* --axle-load KN; or --config"):
        assess_file(ride, SETTINGS, Train.of())
    for wrong, what in (
        ({"bogie_mass": 5.6}, "500 to 50000 kg"),
        ({"axle_load": 150.0}, "30000 to 500000 N"),
    ):
        with pytest.raises(ConfigError, match=what):  # in t and kN
            Train.of(**wrong)
    emu = Train.of(scenario=load_scenario("estimates"), bogie_mass=6000.0)
    assert emu.bogie_mass == Stated(6000.0, "--bogie-mass")
    # Carbody 49,962 kg, two frames of 2,500 kg and four wheelsets of 1,550 kg on four wheelsets.
    assert emu.axle_load == Stated(pytest.approx(61162.0 * 9.81 / 4, rel=1e-3), "vehicle emu-estimate")


def test_options_replace_vehicle_speed_and_run_in(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "bogie_m_s2", [STABLE])
    result = assess_file(path, SETTINGS, Train.of(bogie_mass=5000), speed=SPEED, sample_rate=RATE, run_in=500)
    assert result.channels[0].limit == pytest.approx(5.5)
    assert result.as_dict()["train"] == {
        "bogie_mass_kg": {"value": 5000, "from": "--bogie-mass"},
        "axle_load_kn": None,
    }
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


@pytest.mark.parametrize("name", ["acc_1", "bogie_A", "a_Rahmen_V"])
def test_a_number_or_letter_at_the_end_of_a_name_is_no_unit_beside_a_row_of_units(
    tmp_path: Path, name: str
) -> None:
    path = write(tmp_path / "a.csv", f"t;{name}", [TIME, STABLE], ";")
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join([header, "s;m/s^2", *rows]), encoding="utf-8")
    recording = read_recording(path, SETTINGS, speed=SPEED)
    assert [channel.name for channel in recording.channels] == [name]
    assert recording.channels[0].quantity is Quantity.ACCELERATION


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


def check(path: Path, note: str = "", *, rate: float = RATE, **options: Any) -> Recording:
    """Read a recording of `STABLE` and judge it as the public layouts were: 2.90 m/s2 at 4.00 Hz."""
    result = assess_file(path, SETTINGS, TRAIN, **options)
    recording = result.recording
    assert recording.sample_rate == pytest.approx(rate)
    # The mirrored end adds 2.6 % to the RMS of the last 100 m of a sine.
    assert result.channels[0].rms_max == pytest.approx(2.90, abs=0.01)
    assert result.channels[0].dominant_frequency == pytest.approx(4.0, abs=0.005)
    assert note in " ".join(recording.notes)
    return recording


LONG = np.arange(5500) / RATE
WAVE = 4.0 * np.sin(2 * np.pi * 4 * LONG)


def rounded(rate: float, digits: int, count: int = 5500, first: float = 0.0) -> list[np.ndarray]:
    time = first + np.arange(count) / rate
    return [np.round(time, digits), 0 * time + 270, 4.0 * np.sin(2 * np.pi * 4 * (time - first))]


@pytest.mark.parametrize(("rate", "digits"), [(1024.0, 3), (400.0, 3), (2048.0, 3), (600.0, 3), (1000.0, 2)])
def test_the_rate_behind_rounded_times_is_recognised(tmp_path: Path, rate: float, digits: int) -> None:
    columns = rounded(rate, digits, int(22 * rate), first=36000.0)
    path = write(tmp_path / "a.csv", "time_s;speed_kmh;bogie_m_s2", columns, ";", digits=12)
    check(path, f"recognised behind them: {rate:g} Hz", rate=rate)


def test_times_that_leave_the_rate_open_ask_for_it(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", "time_s;speed_kmh;bogie_m_s2", rounded(RATE, 0), ";")
    with pytest.raises(DataError, match=r"rounded to 1 s leave the sampling rate open .* --sample-rate"):
        read_recording(path, SETTINGS)
    check(path, sample_rate=RATE)


def test_irregular_times_are_resampled(tmp_path: Path) -> None:
    jitter = LONG + 1e-3 * np.sin(17.0 * np.arange(LONG.size))
    wave = 4.0 * np.sin(2 * np.pi * 4 * jitter)
    path = write(tmp_path / "a.csv", "time_s;speed_kmh;bogie_m_s2", [jitter, 0 * LONG + 270, wave], ";")
    found = check(path, "Times are irregular, in steps of 2.")
    at = jitter[0] + np.arange(len(found.signals)) / RATE
    np.testing.assert_allclose(found.signals[:, 0], 4.0 * np.sin(2 * np.pi * 4 * at), atol=0.01)


def test_short_gaps_are_bridged_and_longer_ones_refused_by_place(tmp_path: Path) -> None:
    def lines(name: str, *, empty: int = 0, missing: int = 0) -> Path:
        rows = [f"{t:.3f},270,{a:.6f}" for t, a in zip(LONG, WAVE, strict=True)]
        rows[2000 : 2000 + empty] = [row.rpartition(",")[0] + "," for row in rows[2000 : 2000 + empty]]
        del rows[2000 : 2000 + missing]
        path = tmp_path / name
        path.write_text("\n".join(["time_s,speed_kmh,bogie_m_s2", *rows]))
        return path

    check(lines("a.csv", empty=4), "1 gaps of up to 20 ms were bridged")
    check(lines("b.csv", missing=4), "1 gaps of up to 20 ms were bridged")
    where = r"line 2002: column 'bogie_m_s2': a gap of 24 ms, from 7\.996 to 8\.02 s"
    for path in (lines("c.csv", empty=5), lines("d.csv", missing=5)):
        with pytest.raises(DataError, match=where):
            read_recording(path, SETTINGS)


def test_sparse_speed_is_carried_on_but_not_for_long(tmp_path: Path) -> None:
    def lines(*rows: int) -> Path:
        speed = ["270" if k in rows else "" for k in range(LONG.size)]
        values = zip(LONG, speed, WAVE, strict=True)
        text = "\n".join(["time_s,speed_kmh,bogie_m_s2", *(f"{t:.3f},{v},{a:.6f}" for t, v, a in values)])
        (tmp_path / "a.csv").write_text(text)
        return tmp_path / "a.csv"

    found = check(lines(*range(0, 5500, 250)), "The speed has 22 values, up to 1 s apart")
    np.testing.assert_allclose(found.speed, SPEED)
    with pytest.raises(DataError, match=r"line 252: column 'speed_kmh': no further speed for 1[67]"):
        read_recording(lines(0, 250, 4500), SETTINGS)
    with pytest.raises(DataError, match="holds no speed"):
        read_recording(lines(), SETTINGS)


def test_several_rates_in_one_table(tmp_path: Path) -> None:
    """Forces at half the rate of the accelerations, in every second row."""
    force = [f"{x:.6f}" if k % 2 == 0 else "" for k, x in enumerate(25.0 * np.sin(2 * np.pi * 5 * FAST))]
    wave = 4.0 * np.sin(2 * np.pi * 4 * FAST)
    rows = (f"{t:.3f};270;{a:.6f};{f}" for t, a, f in zip(FAST, wave, force, strict=True))
    (tmp_path / "a.csv").write_text("\n".join(["time_s;speed_kmh;bogie_m_s2;ws_kn", *rows]))
    found = check(tmp_path / "a.csv", "Signals of 250 Hz were resampled to 500 Hz", rate=500.0)
    at = np.arange(len(found.signals)) / 500.0
    np.testing.assert_allclose(found.signals[:, 1], 25e3 * np.sin(2 * np.pi * 5 * at), atol=10.0)


def test_a_last_line_that_was_cut_off_is_left_out_with_a_note(ride: Path) -> None:
    whole = read_recording(ride, SETTINGS)
    text = ride.read_text(encoding="utf-8")
    ride.write_text(text[: text.rstrip().rindex(",")], encoding="utf-8")
    found = read_recording(ride, SETTINGS)
    np.testing.assert_array_equal(found.signals, whole.signals[:-1])
    assert found.notes[0] == f"Line {len(TIME) + 1}, the last one, is left out: it has 3 of 4 cells."
    assert not [note for note in found.notes if "resampled" in note]


def test_channels_of_one_rate_are_read_as_long_as_all_have_values(ride: Path) -> None:
    """Nothing is resampled where one of them ends earlier, or begins later."""
    whole = read_recording(ride, SETTINGS)
    lines = ride.read_text(encoding="utf-8").splitlines()
    lines[-1] = lines[-1][: lines[-1].rindex(",") + 1]
    time, speed, _, force = lines[1].split(",")
    lines[1] = f"{time},{speed},,{force}"
    ride.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = read_recording(ride, SETTINGS)
    np.testing.assert_array_equal(found.signals, whole.signals[1:-1])
    assert "Read is what all channels have, 0.004 to 19.992 s." in found.notes
    assert not [note for note in found.notes if "splines" in note]


def test_a_dead_sensor_is_refused_and_one_that_died_is_noted(tmp_path: Path) -> None:
    header = "time_s,speed_kmh,bogie1_m_s2,bogie2_m_s2"
    speed = np.full_like(TIME, SPEED * 3.6)
    path = write(tmp_path / "a.csv", header, [TIME, speed, STABLE, 0.0 * TIME])
    with pytest.raises(
        DataError, match=r"line 2: column 'bogie2_m_s2': found 0 m/s2 all along, as of a dead"
    ):
        assess_file(path, SETTINGS, TRAIN)
    assert read_recording(path, SETTINGS, columns=["bogie1"]).channels[0].name == "bogie1"
    died = np.where(TIME < 12.0, STABLE, 1.5)
    path = write(tmp_path / "b.csv", header, [TIME, speed, STABLE, died])
    (note,) = (note for note in read_recording(path, SETTINGS).notes if "dead sensor" in note)
    assert note == "Column 'bogie2_m_s2' stands at 1.5 m/s2 from 12 to 19.996 s, as a dead sensor does."


FAST = np.arange(11000) / 500.0


@pytest.mark.parametrize("style", ["time of day", "date", "german date"])
def test_times_of_day(tmp_path: Path, style: str) -> None:
    """Across midnight."""
    start = np.datetime64("2022-11-22T23:59:50.000")
    stamps = [str(start + np.timedelta64(4 * k, "ms")) for k in range(LONG.size)]
    if style == "time of day":
        stamps = [stamp.partition("T")[2] for stamp in stamps]
    elif style == "german date":
        stamps = [f"{s[8:10]}.{s[5:7]}.{s[:4]} {s[11:]}".replace(".", ".").replace(" ", " ") for s in stamps]
    rows = (f"{t};270;{a:.6f}" for t, a in zip(stamps, WAVE, strict=True))
    (tmp_path / "a.csv").write_text("\n".join(["time;speed [km/h];bogie [m/s2]", *rows]))
    check(tmp_path / "a.csv")


@pytest.mark.parametrize(
    "head", ["time [hh:mm:ss.sss];v [km/h];a [m/s2]", "time;v;a\nhh:mm:ss.sss;km/h;m/s2"]
)
def test_the_form_of_times_of_day_is_no_unit(tmp_path: Path, head: str) -> None:
    stamps = [f"10:{int(t // 60):02d}:{t % 60:06.3f}" for t in LONG]
    rows = (f"{t};270;{a:.6f}" for t, a in zip(stamps, WAVE, strict=True))
    (tmp_path / "a.csv").write_text("\n".join([head, *rows]))
    check(tmp_path / "a.csv")


def test_blanks_of_all_kinds_stand_between_columns(tmp_path: Path) -> None:
    rows = (f"{t:.3f}\u00a0 270 {a:.6f}" for t, a in zip(LONG, WAVE, strict=True))
    (tmp_path / "a.txt").write_text("\n".join(["time_s speed_kmh bogie_m_s2", *rows]), encoding="utf-8")
    check(tmp_path / "a.txt")


def test_samples_that_an_mdf_marks_as_invalid_are_gaps(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    marks = np.zeros(LONG.size, dtype=bool)
    marks[100:102] = True
    spoilt = np.where(marks, 99.0, WAVE)
    with asammdf.MDF() as file:
        signal = asammdf.Signal(spoilt, LONG, name="bogie", unit="m/s^2", invalidation_bits=marks)
        file.append([signal])
        file.save(tmp_path / "a.mf4")
    assert np.max(np.abs(check(tmp_path / "a.mf4", speed=SPEED).signals)) < 5.0


def test_mdf_3_has_units(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="3.30") as file:
        file.append([asammdf.Signal(WAVE, LONG, name="bogie", unit="m/s^2")])
        file.save(tmp_path / "a.mdf")
    check(tmp_path / "a.mdf", speed=SPEED)


def test_groups_of_a_tdms_begin_at_their_own_times(tmp_path: Path) -> None:
    """A speed of 70 + t m/s, in a group that begins 4 s before the signal's: 74 m/s there."""
    nptdms = pytest.importorskip("nptdms")
    first = np.datetime64("2022-01-01T00:00:00")
    fast = {"wf_increment": 1 / RATE, "wf_start_time": first + np.timedelta64(4, "s"), "unit_string": "m/s^2"}
    slow = {"wf_increment": 1.0, "wf_start_time": first, "unit_string": "m/s"}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("fast", "bogie", WAVE, fast),
                nptdms.ChannelObject("slow", "speed", 70.0 + np.arange(30.0), slow),
            ]
        )
    recording = read_recording(tmp_path / "a.tdms", SETTINGS, columns=["bogie"])
    assert np.ravel(recording.speed)[0] == pytest.approx(74.0, abs=0.01)


def test_times_of_day_in_a_parquet_file(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    ticks = pyarrow.array((1e6 * (86_395 + LONG) % 86_400e6).astype(np.int64)).cast(pyarrow.time64("us"))
    parquet.write_table(pyarrow.table({"time": ticks, "bogie_m_s2": WAVE}), tmp_path / "a.parquet")
    check(tmp_path / "a.parquet", speed=SPEED)


def mdf(path: Path, speed: np.ndarray, at: np.ndarray) -> None:
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(WAVE / 9.80665, LONG, name="bogie", unit="g")])
        file.append([asammdf.Signal(speed, at, name="speed", unit="km/h")])
        file.append([asammdf.Signal(speed, at, name="oil", unit="bar")])
        file.save(path)


def tdms(path: Path, speed: np.ndarray, at: np.ndarray) -> None:
    nptdms = pytest.importorskip("nptdms")
    fast, slow = {"wf_increment": 1 / RATE}, {"wf_increment": float(at[1] - at[0])}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("fast", "bogie", WAVE, fast | {"unit_string": "m/s^2"}),
                nptdms.ChannelObject("slow", "speed", speed, slow | {"unit_string": "km/h"}),
                nptdms.ChannelObject("slow", "oil", speed, slow | {"unit_string": "bar"}),
            ]
        )


def matlab(path: Path, speed: np.ndarray, at: np.ndarray) -> None:
    bogie = {"data": WAVE, "unit": "m/s^2", "fs": RATE}
    savemat(path, {"bogie": bogie, "train": {"speed": {"values": speed, "units": "km/h", "time": at}}})


def parquet(path: Path, speed: np.ndarray, at: np.ndarray) -> None:
    pytest.importorskip("pyarrow")
    sparse = np.full(LONG.size, np.nan)
    sparse[np.round(at * RATE).astype(int)] = speed
    frame = {"time_s": LONG, "speed_kmh": sparse, "bogie_m_s2": WAVE, "oil_bar": sparse}
    pd.DataFrame(frame).to_parquet(path)


@pytest.mark.parametrize("save", [mdf, tdms, matlab, parquet])
def test_formats_of_measuring_systems(
    tmp_path: Path, save: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each with a speed of 10 Hz and a channel that is not asked for."""
    pytest.importorskip("pymatreader")
    at = np.arange(220) / 10.0
    save(tmp_path / "a.dat" if save is not mdf else tmp_path / "a.mf4", np.full(220, 270.0), at)
    (path,) = tmp_path.iterdir()
    found = check(path, "The speed has 220 values", columns=["bogie"])
    np.testing.assert_allclose(found.signals[:, 0], WAVE, atol=1e-9)
    if save is not matlab:
        with pytest.raises(DataError, match="unit 'bar'; allowed"):
            read_recording(path, SETTINGS)
    monkeypatch.setattr(formats, "MOST_VALUES", 5000)
    monkeypatch.setattr(recordings, "MOST_VALUES", 5000)
    with pytest.raises(DataError, match=r"declares .* values; at most 5e"):
        read_recording(path, SETTINGS, columns=["bogie"])
    monkeypatch.undo()
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] + bytes(50))
    with pytest.raises(DataError, match=r"cannot be read as|samples|gap|speed"):
        read_recording(path, SETTINGS, columns=["bogie"])


def test_matlab_7_3_and_matrices_with_names(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    pytest.importorskip("pymatreader")
    table = np.column_stack([LONG, 270 + 0 * LONG, WAVE])
    names = np.array(["time", "speed", "bogie"], dtype=object)
    units = np.array(["s", "km/h", "m/s^2"], dtype=object)
    savemat(tmp_path / "v5.mat", {"data": table, "names": names, "units": units, "fs": 999.0})
    check(tmp_path / "v5.mat")
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        for name, values in zip(("time_s", "speed_kmh", "bogie_m_s2"), table.T, strict=True):
            file.create_dataset(name, data=values[None]).attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "v73.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    check(tmp_path / "v73.mat")


def test_a_missing_library_is_named(ride: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "nptdms", None)
    path = ride.with_name("a.tdms")
    path.write_bytes(b"TDSm" + bytes(200))
    with pytest.raises(ConfigError, match=r"TDMS files need nptdms: pip install 'sayd-env\[measured\]'"):
        read_recording(path, SETTINGS)


SHORT = "time_s,speed_kmh,a_n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("# nothing\n\n", "is empty"),
        (f"{SHORT}\n", "line 1: found a header and no rows of numbers below it"),
        ("Time [s];Speed [km/h];Bogie 1 front [m/s2]\n", "line 1: found a header and no rows of numbers"),
        (f"{SHORT}\n0,0,300,1,5\n0,1,300,1,5\n", "line 2: found no header .*; commas stand between columns"),
        (f"{SHORT}\n0,300,1\n0.1,300\n0.2,300,1\n", "line 3: found 2 cells, '0.1,300'; expected 3"),
        ("0,300,1\n0.1,300,1\n0.2,300,1\n", "line 1: found no header"),
        ("time_s,speed_kmh\n0,300\n0.001,300\n", "no column to assess"),
        ("time_s,a_m_s2\n0,1\n0.001,1\n", "no column speed_kmh"),
        ("speed_kmh,a_m_s2\n300,1\n300,1\n", "no column time_s.*--sample-rate"),
        ("time_s,speed_kmh,a_furlong\n0,300,1\n0.001,300,1\n", "column 'a_furlong': found no unit"),
        ("time_s,speed_kmh,a [bar],b_g\n0,3,1,1\n1,3,1,1\n", "'a .bar.': found unit 'bar'.*--column \"b\""),
        ("time_s,speed_kmh,a\n0,300,1\n0.001,300,1\n", "column 'a': found no unit"),
        ("time_s;v_kmh;a_n\nms;km/h;N\n0;1;1\n1;1;1\n", "column 'time_s': its name says 's', .* 'ms'"),
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
        (f"{SHORT}\n0,300,1\n0.001,0,1\n0.002,300,1\n", "line 3: column 'speed_kmh': speed 0 km/h"),
        ("time_s,speed_m_s,a_n\n0,300,1\n0.001,300,1\n0.002,300,1\n", "line 2: .*speed 1080 km/h.*unit"),
        (f"{SHORT}\n0,300,1\n0.001,300,1\n0.002,300,2\n", "a.csv: the signal covers 0 m"),
        (
            "time,speed_kmh,a_n\n1:02:60,300,1\n1:02:3x,300,1\n",
            "line 3: column 'time': found '1:02:3x'; expected",
        ),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=message) as caught:
        assess_file(path, SETTINGS, TRAIN)
    assert str(caught.value).startswith(str(path))


def columns(path: Path, *headers: str) -> Path:
    """A ride with the same sine in each column."""
    header = ";".join(["time_s", "speed_kmh", *headers])
    return write(path, header, [TIME, np.full_like(TIME, 270.0), *[STABLE] * len(headers)], ";")


@pytest.mark.parametrize(
    "header",
    [
        *(
            f"{name} [m/s2]"
            for name in (
                "az_bogie1",
                "acc_x",
                "acc_z",
                "Radsatzlager quer",
                "Fahrzeugkasten quer",
                "DG1 längs",
                "DG1 la\u0308ngs",
                "DG1 hoch",
                "DG1_hoch",
                "acc caisse y",
                "boite d'essieu",
                "boîte d'essieu",
            )
        ),
        *(
            f"{name} [kN]"
            for name in (
                "Q1",
                "Y11",
                "Radlast",
                "Zugkraft",
                "damper force",
                "yaw damper",
                "spring force",
                "Primärfeder 1",
            )
        ),
        "damper_force.front.left.upper_n",
        "Q.front.leading.left_n",
        "Y.front.leading.left_n",
    ],
)
def test_signals_without_these_limits_are_refused_unless_named(tmp_path: Path, header: str) -> None:
    path = columns(tmp_path / "a.csv", header, "bogie_m_s2")
    with pytest.raises(DataError, match=r"its name says .* --column") as caught:
        read_recording(path, SETTINGS)
    assert f"column '{header}'" in str(caught.value)
    assert str(caught.value).endswith('for example --column "bogie"')
    assert len(read_recording(path, SETTINGS, columns=[header]).channels) == 1


@pytest.mark.parametrize(
    "header",
    [
        *("ay_bogie1 [m/s2]", "acc, bogie 1, lateral [m/s2]", "DG1 quer [m/s2]", "bogie_m_s2"),
        *("lateral_acceleration.front.leading_m_s2", "wheelset1_kn", "track_shift.front.leading_n"),
        *("sum Y [kN]", "ΣY [kN]", "sumY ws 1 [kN]", "Summe Y RS1 [kN]", "sum of Y [kN]"),
    ],
)
def test_signals_with_these_limits_are_taken(tmp_path: Path, header: str) -> None:
    assert len(read_recording(columns(tmp_path / "a.csv", header), SETTINGS).channels) == 1


@pytest.mark.parametrize(
    ("header", "value", "message"),
    [
        ("bogie [m/s2]", 1e200, r"found 1e\+200 m/s2; allowed: up to 1000 m/s2 .*unit right\? an error code"),
        ("bogie [m/s2]", -9999.0, "found -9999 m/s2; allowed: up to 1000 m/s2"),
        ("bogie [mm/s2]", 9999.0, "found 9999 mm/s2; nearly all others are below 4 mm/s2"),
        ("ws [N]", -9999.0, "found -9999 N; nearly all others are below 4 N"),
        ("ws [kN]", 1001.0, "found 1001 kN; allowed: up to 1 MN"),
    ],
)
def test_what_no_train_does_is_refused_by_place(
    tmp_path: Path, header: str, value: float, message: str
) -> None:
    signal = STABLE.copy()
    signal[100] = value
    path = write(tmp_path / "a.csv", f"time_s;{header}", [TIME, signal], ";")
    with pytest.raises(DataError, match=message) as caught:
        read_recording(path, SETTINGS, speed=SPEED)
    assert f"line 102: column '{header}'" in str(caught.value)


def test_large_but_possible_samples_are_taken(tmp_path: Path) -> None:
    signal = STABLE.copy()
    signal[100] = 999.5
    path = write(tmp_path / "a.csv", "time_s;bogie [m/s2]", [TIME, signal], ";")
    assert read_recording(path, SETTINGS, speed=SPEED).signals.max() == pytest.approx(999.5)
    forces = write(tmp_path / "b.csv", "time_s;ws [N]", [TIME, 9999.0 * np.sign(STABLE + 0.1)], ";")
    assert read_recording(forces, SETTINGS, speed=SPEED).signals.max() == 9999.0


def test_no_number_is_no_verdict(ride: Path) -> None:
    channel = assess_file(ride, SETTINGS, TRAIN).channels[0]
    with pytest.raises(StudyError, match="'bogie1_front': its largest sliding RMS is no number"):
        _ = replace(channel, rms_max=float("nan")).stable


@pytest.mark.parametrize("name", ["temps", "Uhrzeit", "heure", "Datum", "date"])
def test_other_names_of_times(tmp_path: Path, name: str) -> None:
    rows = (f"{t:.3f}\t270\t{a:.6f}" for t, a in zip(TIME, STABLE, strict=True))
    text = "\r\n".join([f"{name} (s)\tv (km/h)\tAccélération latérale bogie (m/s²)", *rows])
    (tmp_path / "a.txt").write_text(text, encoding="utf-16", newline="")
    found = read_recording(tmp_path / "a.txt", SETTINGS)
    assert found.sample_rate == pytest.approx(RATE)
    assert found.channels[0].name == "Accélération latérale bogie"
    np.testing.assert_allclose(found.signals[:, 0], STABLE, atol=1e-6)


@pytest.mark.parametrize("stamp", ["11/22/2022 07:00:{:06.3f}", "{:.3f}"])
def test_times_that_are_not_understood_ask_for_the_rate(tmp_path: Path, stamp: str) -> None:
    rows = (f"{stamp.format(t)};270;{a:.6f}" for t, a in zip(TIME, STABLE, strict=True))
    (tmp_path / "a.csv").write_text("\n".join(["time;speed_kmh;bogie_m_s2", *rows]))
    with pytest.raises(DataError, match=r"column 'time'.* s or ms .*dd.mm.yyyy.*--sample-rate HZ") as caught:
        read_recording(tmp_path / "a.csv", SETTINGS)
    assert "--column" not in str(caught.value)
    found = read_recording(tmp_path / "a.csv", SETTINGS, sample_rate=RATE)
    np.testing.assert_allclose(found.signals[:, 0], STABLE, atol=1e-6)


@pytest.mark.parametrize("stamp", ["11/22/2022 07:00:00.000", "22-11-2022 07:00:00", "07:00"])
def test_dates_under_a_unit_of_time_ask_for_the_rate(tmp_path: Path, stamp: str) -> None:
    rows = "\n".join(f"{stamp};270;{k}" for k in range(4))
    (tmp_path / "a.csv").write_text(f"time_s;speed_kmh;ws_n\n{rows}\n", encoding="utf-8")
    with pytest.raises(DataError, match=rf"line 2: .*'{stamp}'; expected .*dd.mm.yyyy.*--sample-rate HZ"):
        read_recording(tmp_path / "a.csv", SETTINGS)


def test_a_header_with_too_few_names_is_noted(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time_s;speed_kmh;ws_n\n" + "0.0;270;1;1\n" * 4)
    with pytest.raises(DataError, match=r"line 2: found no header \(what stands above has not 4 names\)"):
        read_recording(tmp_path / "a.csv", SETTINGS)


@pytest.mark.parametrize("cell", ['"1,004.9"', "1'004.9", "1 004,9", "1\u202f004,9", '"1,004,000.5"'])
def test_thousands_separators_are_named(tmp_path: Path, cell: str) -> None:
    rows = "\n".join(f"{k};270;{value}" for k, value in enumerate(["5", cell, "7", "8"]))
    (tmp_path / "a.csv").write_text(f"time_s;speed_kmh;ws_n\n{rows}\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"line 3: column 'ws_n'.*; thousands separators are not read"):
        read_recording(tmp_path / "a.csv", SETTINGS)


def test_bad_options(ride: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="use one of them"):
        assess_file(ride, SETTINGS, TRAIN, speed=SPEED)
    plain = write(tmp_path / "a.csv", "time_s,a_n", [TIME, STABLE])
    for speed in (0.0, -5.0, 250.0, float("nan")):
        with pytest.raises(DataError, match="speed: found"):
            assess_file(plain, SETTINGS, TRAIN, speed=speed)
    for rate in (0.0, 100.0, float("nan")):
        with pytest.raises(DataError, match="sampling rate"):
            assess_file(plain, SETTINGS, TRAIN, speed=SPEED, sample_rate=rate)
    for run_in in (-1.0, float("nan")):
        with pytest.raises(ConfigError, match="run-in"):
            assess_file(ride, SETTINGS, TRAIN, run_in=run_in)
    with pytest.raises(DataError, match="1200 m of run-in and 500 m to assess"):
        assess_file(ride, SETTINGS, TRAIN, run_in=1200.0)
    with pytest.raises(ConfigError, match="no such recording"):
        assess_file(tmp_path / "none.csv", SETTINGS, TRAIN)
