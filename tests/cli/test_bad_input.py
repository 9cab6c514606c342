"""Bad input of any kind is one message, the right exit status, no traceback and no result file."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest

from sayd_env.cli import main

COMMANDS = (
    "critical-speed",
    "evaluate",
    "reproduce",
    "conicity",
    "hysteresis",
    "modes",
    "linearise",
    "calibrate",
    "hindsight",
    "bound",
    "bench",
)
RUNS = ("critical-speed", "evaluate", "modes")
SHORT = ["--config", "estimates", "--set", "assessment.run_in=200", "--set", "assessment.length=600"]
EVALUATE = ["evaluate", *SHORT, "--speeds", "300", "--seeds", "1", "--json"]

Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Run a command in an empty directory; it must refuse in one line."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str, status: int = 2) -> str:
        assert main(arguments) == status
        out, err = capsys.readouterr()
        assert out == ""
        # In a cold cache.
        err = re.sub(r"^sayd [\w-]+: (still )?compil(ing|ed in) .*\n", "", err, flags=re.MULTILINE)
        assert err.startswith("sayd: error: ")
        assert err.count("\n") == 1
        assert "Traceback" not in err
        assert list(tmp_path.rglob("result.json")) == []
        return err

    return run


def write(path: str, text: str | bytes = "") -> str:
    file = Path(path)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def test_files_that_are_no_configuration_are_refused(refused: Refused):
    Path("folder.yaml").mkdir()
    write("binary.yaml", bytes(range(256)))
    write("empty.yaml")
    write("list.yaml", "- 1\n- 2\n")
    for file, message in (
        ("folder.yaml", "folder.yaml: is a directory, expected a file"),
        ("binary.yaml", "binary.yaml: is not a text file"),
        ("empty.yaml", "empty.yaml: is empty; expected keys and values"),
        ("list.yaml", "list.yaml: found [1, 2]; expected keys and values"),
        ("nominl", "did you mean 'nominal'?; available: "),
        ("", "unknown study ''"),
    ):
        assert message in refused("evaluate", "--config", file)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_refuses_bad_options(command: str, refused: Refused):
    write("file")
    assert "nowhere.yaml: no such file" in refused(command, "--config", "nowhere.yaml")
    assert "--set wear: expected key=value" in refused(command, "--set", "wear")
    assert "--set: unknown key 'weer'" in refused(command, "--set", "weer=1")
    assert "--out file: a file is in the way, expected a directory" in refused(command, "--out", "file")
    assert "No such option: --bogus" in refused(command, "--bogus")


def test_bad_assignments_and_directories_are_refused(refused: Refused):
    write("file")
    assert "--set =3: expected key=value" in refused("evaluate", "--set", "=3")
    for path, message in (
        ("file/below", "a file is in the way, expected a directory"),
        ("/proc/none", "cannot be written"),
    ):
        assert f"--out {path}: {message}" in refused("evaluate", "--out", path)


@pytest.mark.parametrize("command", RUNS)
@pytest.mark.parametrize(
    ("speeds", "message"),
    [
        ("0", "--speeds 0: expected a finite number above 0 km/h"),
        ("-300", "--speeds -300: expected a finite number above 0 km/h"),
        ("nan", "--speeds nan: expected a finite number"),
        ("inf", "--speeds inf: expected a finite number"),
        ("", "--speeds an empty place: expected a finite number above 0 km/h"),
        ("300km/h", "--speeds 300km/h: expected a finite number above 0 km/h"),
        ("400,300", "300 follows 400; speeds must rise"),
        ("5", "speed 5 km/h is outside the range of vehicle 'emu': 28.8 to 504 km/h"),
        ("300,900", "speed 900 km/h is outside the range of vehicle 'emu': 28.8 to 504 km/h"),
    ],
)
def test_bad_speeds_are_refused_before_any_work(command: str, speeds: str, message: str, refused: Refused):
    assert message in refused(command, "--speeds", speeds, "--json")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--friction", "0"], "--friction 0: expected a finite number above 0, at most 1"),
        (["--friction", "2"], "--friction 2: expected a finite number above 0, at most 1"),
        (["--friction", "nan"], "--friction nan: expected a finite number above 0, at most 1"),
        (["--policies", ""], "--policies found an empty place; expected names"),
        (["--policies", "mppt1,"], "--policies found an empty place; expected names"),
        (["--wear", "2"], "--wear 2: expected a number from 0 to 1"),
        (["--wear", "-1"], "--wear -1: expected a number from 0 to 1"),
        (["--seeds", "0"], "--seeds 0: expected a whole number from 1 to 10000"),
        (["--seeds", "1e3"], "--seeds 1e3: expected a whole number"),
        (["--seed", "-1"], "--seed -1: expected a whole number from 0"),
        (["--workers", "0"], "--workers 0: expected a whole number from 1 to"),
        (["--profile", "s1002cm"], "unknown profile 's1002cm', did you mean 's1002cn'?; available: "),
        (["--profile", "60e1"], "configs/profile/60e1.yaml: is a rail profile; as wheel are available: "),
        (["--track", "chinna"], "unknown track 'chinna', did you mean 'china'?"),
        (["--set", "numerics.step=1e-12"], "numerics.step: found 1e-12; expected a number greater than"),
        (["--set", "assessment.length=null"], "assessment.length: a simulation needs a distance, found null"),
        (["--set", "assessment.length=1e12"], "track length: found 1e+12 m"),
        (["--set", "assessment.sample_rate=1e9"], "assessment.sample_rate: found 1000000000.0; expected"),
        (["--set", "assessment.frequency_step=1e-30"], "expected a number greater than or equal to 0.001"),
        (
            ["--set", "track.section.mass=5e-324"],
            "section.mass: found 5e-324; expected 0 or ",
        ),
        (["--set", "track.section.mass=1.4e-9"], "track.section need steps of "),
        (["--set", "damper.friction.width=5e-5"], "of type 'passive'; for keys of another, set damper=NAME"),
        (
            ["--reward", "mppt1", "--set", "cost.force_weight=0.1,0.3"],
            "--reward mppt1: sets the weights, as --set cost.force_weight does; give one",
        ),
        (["--wear", "0.3", "--set", "wear=0.9"], "--wear: sets what --set wear does; give one"),
        (
            ["--friction", "0.3", "--set", "friction=0.4"],
            "--friction: sets what --set friction does; give one",
        ),
        (["--profile", "new", "--set", "wear=0.5,1"], "--profile: sets what --set wear does; give one"),
        (["--wear", "0", "--set", "wear=0.5,1"], "--wear: sets what --set wear does; give one"),
        (["--profile", "lma", "--set", "wheel=s1002,lma"], "--profile: sets what --set wheel does; give one"),
        (["--gauge", "1435", "--set", "track.gauge=1.43,1.44"], "--gauge: sets what --set track.gauge does"),
        (["--policies", "mppt1", "--policies", "mppt2"], "--policies: found 2 times; expected once"),
        (
            ["--policies", "mppt1", "--set", "damper.series_stiffness=5e6"],
            "--set damper.series_stiffness: has no effect: every policy commands valves",
        ),
        (["--out", ""], "--out: found nothing; expected a path"),
        (["--gauge", "1400"], "gauge 1400 mm: the flanges of wheel 's1002cn-estimate', whose"),
        (["--environment", "line"], "environment: goes along lines of its own; expected one without"),
        (["--gauge", "2024.yaml"], "2024.yaml: no such"),
        (["--set", "track.gauge=1.6"], "check gauge and back-to-back distance"),
        (["--set", "vehicle.bodies.carbody.mass=-1"], "vehicle.bodies.carbody.mass: found -1; expected"),
    ],
)
def test_bad_values_are_refused(arguments: list[str], message: str, refused: Refused):
    assert message in refused(*EVALUATE, *arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fps", "0"], "--fps 0: expected a finite number above 0 per second, at most 1000"),
        (["--exaggeration", "-1"], "--exaggeration -1: expected a finite number above 0, at most 1000"),
    ],
)
def test_bad_pictures_are_refused(arguments: list[str], message: str, refused: Refused):
    assert message in refused("render", *arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--conditions", "mapp"], "unknown study 'mapp', did you mean 'map'?"),
        (["--conditions", "heldout"], "configs/study/heldout.yaml: "),
        (["--speeds", "300,900"], "speed 900 km/h is outside the range of vehicle 'emu-estimate'"),
        (["--conditions", "map", "--no-constants"], "--conditions: are those of the best constant commands"),
    ],
)
def test_bad_maps_are_refused_before_any_work(arguments: list[str], message: str, refused: Refused):
    assert message in refused("map", *SHORT, "--quick", *arguments, "--out", "here")
    assert not Path("here").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("map", "--set", "wear=0.5"), "--set wear: has no effect; --wear is an axis of the map"),
        (("map", "--set", "friction=0.5"), "--set friction: has no effect; --friction is an axis of the map"),
        (("map", "--profile", "worn"), "--profile worn: has no effect; --wear is an axis of the map"),
        (
            ("reproduce", "--set", "wear=0.5"),
            "--set wear: has no effect; the rows are about new and",
        ),
    ],
)
def test_settings_that_a_study_makes_itself_are_refused(
    arguments: tuple[str, ...], message: str, refused: Refused
):
    assert message in refused(*arguments)


@pytest.mark.parametrize("periods", ["0.003", "0.01,0.003", "0.01,0.01"])
def test_bad_control_periods_are_refused_before_any_work(periods: str, refused: Refused):
    found = refused("reproduce", *SHORT, "--quick", "--control-periods", periods, "--out", "here")
    assert "control periods" in found
    assert not Path("here").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--amplitudes", "1e300"], "--amplitudes 1e300: expected a finite number above 0 mm, at most 1000"),
        (["--frequencies", "1e9"], "--frequencies 1e9: expected a finite number above 0 Hz, at most 1000"),
        (["--damper", "pasive"], "unknown damper 'pasive', did you mean 'passive'?"),
    ],
)
def test_bad_test_rigs_are_refused(arguments: list[str], message: str, refused: Refused):
    assert message in refused("hysteresis", *arguments)


def test_a_bad_vehicle_file_is_named_with_the_part(refused: Refused):
    text = (
        resources.files("sayd_env.configs")
        .joinpath("vehicle", "emu-estimate.yaml")
        .read_text(encoding="utf-8")
    )
    for old, new, message in (
        ("mass: 49962.0", "mass: -49962.0", "bodies.carbody.mass: found -49962.0; expected a number greater"),
        ("body: axlebox", "body: axelbox", "primary_spring: unknown body 'axelbox', did you mean 'axlebox'?"),
        (
            "stiffness: 2.0e+6",
            "stifness: 2.0e+6",
            "unknown key 'elements.anti_roll_bar.stifness', did you mean",
        ),
        ("type: bush", "type: bsh", "elements.primary_spring.type: found 'bsh', did you mean 'bush'?"),
        ("[0.1, 1960.0]", "[0.5, 1960.0]", "elements.primary_damper.curve: "),
    ):
        assert old in text
        write("my/vehicle.yaml", text.replace(old, new, 1))
        found = refused(*EVALUATE, "--set", "vehicle=my/vehicle.yaml")
        assert found.startswith("sayd: error: my/vehicle.yaml: ")
        assert message in found


WHEEL = """
wear: 0.0
wheel: {kind: wheel, name: mine, back_to_back: 1.353, tape_to_back: 0.07, shape: {file: measured.csv}}
"""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "found no points, at least 20 are needed"),
        ("y,z\n1,2\n2,3\n", "found 2 points, at least 20 are needed"),
        ("y,z\n" + "a,b\n" * 30, "found no points, at least 20 are needed"),
        (
            "".join(f"{y},{'nan' if y == 5 else 0}\n" for y in range(30)),
            "line 6: column 2: found 'nan'; expected a finite number",
        ),
        (
            "".join(f"{40 if y == 7 else y},0\n" for y in range(30)),
            "its unit is not known: points are 40 wide and 0 high",
        ),
        (bytes(range(256)), "is not a text file"),
        (None, "no such profile file"),
    ],
)
def test_a_bad_profile_file_is_named(content: str | bytes | None, message: str, refused: Refused):
    """The file lies beside the YAML file that names it."""
    if content is not None:
        write("my/measured.csv", content)
    write("my/study.yaml", WHEEL)
    found = refused("evaluate", "--config", "my/study.yaml", "--speeds", "300", "--json")
    assert found.startswith("sayd: error: my/measured.csv: ")
    assert message in found


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty; expected a header and rows of numbers"),
        ("x_m,alignment_mm\n0,1\n", "found 1 rows of numbers; at least 4 are needed"),
        ("x_m,alignmnt_mm\n0,1\n", "line 1: unknown column 'alignmnt_mm', did you mean 'alignment_mm'?"),
        ("x_m,alignment_mm\n0,1\n1,nan\n2,1\n3,1\n", "line 3: column 'alignment_mm': found 'nan'"),
        ("x_m,alignment_mm\n0,1\n2,1\n1,1\n3,1\n", "line 4: x_m 1 comes after x_m 2; positions must ascend"),
        ("x_m,alignment_mm\n0,a\n1,1\n2,1\n3,1\n", "line 2: column 'alignment_mm': found 'a'"),
        ("x_m,alignment_mm\n0,1\n1,1\n2,1\n3,1\n", "covers 0 to 3 m of a run from 0 to"),
        (None, "no such table over distance"),
    ],
)
def test_a_bad_irregularity_file_is_named(content: str | None, message: str, refused: Refused):
    """The file lies beside the YAML file that names it."""
    if content is not None:
        write("my/measured.csv", content)
    write("my/study.yaml", "track: {irregularity: {type: file, path: measured.csv}}\n")
    found = refused("evaluate", "--config", "my/study.yaml", "--speeds", "300", "--json")
    assert found.startswith("sayd: error: my/measured.csv: ")
    assert message in found


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("evaluate", " at 300 km/h diverged"),  # of either seed: they run side by side
        ("critical-speed", "the simulation at 300 km/h diverged after"),
    ],
)
def test_a_run_that_diverges_is_a_failed_study(command: str, message: str, refused: Refused):
    stiff = ["--set", "vehicle.elements.arm_joint.stiffness=[1e12, 1e12, 1e12]"]
    run = [command, *SHORT, "--speeds", "300", "--seeds", "2", *stiff, "--out", "here"]
    assert message in refused(*run, status=1)
    assert not Path("here").exists()


def test_too_little_memory_is_one_message(refused: Refused, monkeypatch: pytest.MonkeyPatch):
    def exhausted(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr("sayd_env.studies.evaluate.rows", exhausted)
    assert "not enough memory" in refused(*EVALUATE, status=1)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs POSIX signals")
def test_an_interrupted_study_ends_soon_and_leaves_its_runs_alone(tmp_path: Path):
    """Interrupted when the first runs are made, long before the end."""
    with subprocess.Popen(
        [sys.executable, "-m", "sayd_env", "critical-speed", "--seeds", "1000", "--out", "here"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if re.search(r": [1-9][\d,]* of ", line):
                break
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (130, ""), err
    kept = "sayd: interrupted; finished runs are in here/runs; the same command goes on"
    assert err.splitlines()[-1] == kept
    assert "Traceback" not in err
    assert [path.name for path in (tmp_path / "here").iterdir()] == ["runs"]
    assert list((tmp_path / "here" / "runs").glob("*/*.npz"))


def test_no_warning_reaches_the_user(tmp_path: Path):
    """A process with every warning shown prints none: for good and derailed runs, and for a failed study."""
    level = "track.irregularity.scale="
    critical = ["critical-speed", *SHORT, "--speeds", "300,350", "--seeds", "1", "--json"]
    for arguments, status in (
        ([*EVALUATE, "--set", f"{level}1,1e6"], 0),
        ([*critical, "--set", f"{level}1e6"], 1),
    ):
        done = subprocess.run(
            [sys.executable, "-W", "always", "-m", "sayd_env", *arguments],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            env=os.environ | {"PYTHONWARNINGS": "always"},
        )
        assert done.returncode == status
        assert "Warning" not in done.stderr
