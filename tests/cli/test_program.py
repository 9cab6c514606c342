"""The program: exit statuses, one message for every error, nothing but JSON on standard output."""

from __future__ import annotations

import inspect
import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from sayd_env.cli import learning, main, policies
from sayd_env.cli.app import app

# One more command, which does what a test asks.
COMMAND = """
import sys, time
from typing import Annotated
import typer
from sayd_env import cli
from sayd_env.cli import app, options, start
from sayd_env.cli.command import Plan, command
from sayd_env.config import ConfigError, StudyError
app.GROUPS  # all commands are there

class Result:
    def as_dict(self): return {"answer": float("nan")}
    def tables(self): return {"answers": (("answer",), [(42,)])}
    def plots(self): return {}
    def summary(self, console, wide=False): console.print("the summary" + " in all its columns" * wide)

@command("Program", "x")
def probe(what: Annotated[str, typer.Argument()], vehicle: options.VehicleOptions,
          speeds: options.Speeds = None, quick: options.Quick = False) -> Plan:
    if what == "config": raise ConfigError("x.yaml: unknown key 'masss', did you mean 'mass'?")
    if what == "escape": raise ConfigError("unknown key '\\x1b[2J\\x00'")
    if what == "long": raise ConfigError("x" * 100000)
    def study(context):
        if what == "study": raise StudyError("the vehicle derails at 400 km/h")
        if what == "defect": raise RuntimeError("first line\\nsecond line")
        if what == "interrupt": raise KeyboardInterrupt
        if what == "lines":
            for line in range(100000): print(line)
        if what == "sleep":
            try:
                print("ready", flush=True)
                time.sleep(60)
            finally:
                print("cleaning up", flush=True)
                time.sleep(0.5)
        if what == "deaf":  # as where a finaliser swallows the interrupt
            cli.PATIENCE = 0.1
            for word in ("ready", "on and on"):
                try:
                    print(word, flush=True)
                    time.sleep(60)
                except KeyboardInterrupt:
                    time.sleep(0.2)
        context.progress(1, 2, "half")
        return Result()
    return Plan(study, {"speeds": speeds}, 3)
"""
PROGRAM = f"{COMMAND}\nstart()\n"

Sayd = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def probe() -> Iterator[None]:
    before = list(app.registered_commands)
    exec(COMMAND, {"__name__": __name__})
    yield
    app.registered_commands[:] = before


@pytest.fixture
def sayd(
    probe: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Sayd:
    """Run the program with its further command, in an empty directory."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(arguments, main(arguments), *capsys.readouterr())

    return run


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["probe", "config"], 2, "sayd: error: x.yaml: unknown key 'masss', did you mean 'mass'?"),
        (["probe", "study"], 1, "sayd: error: the vehicle derails at 400 km/h"),
        (["probe", "defect"], 1, "sayd: internal error: RuntimeError: first line second line; please report"),
        (["probe", "interrupt"], 130, "sayd: interrupted"),
        (["probe"], 2, "sayd: error: Missing argument 'what' (see 'sayd probe --help')"),
        (["tune"], 2, "sayd: error: Missing argument 'CONTROLLER'. Choose from: constant, speed-schedule, "),
        (["probe", "x", "--quick", "--quick"], 2, "sayd: error: --quick: found 2 times; expected once"),
        (["probe", "x", "--out="], 2, "sayd: error: --out: found nothing; expected a path"),
        (["probe", "escape"], 2, "sayd: error: unknown key '\\x1b[2J\\x00'"),
        (["probe", "long"], 2, "sayd: error: xxx"),
        (["probe", "x", "--seed", "3"], 2, "sayd: error: No such option: --seed"),
        (["probe", "x", "--json=1"], 2, "sayd: error: Option '--json' does not take a value"),
        (
            ["probe", "x", "--speeds", "0"],
            2,
            "sayd: error: --speeds 0: expected a finite number above 0 km/h",
        ),
        (["probe", "x", "--wear", "2"], 2, "sayd: error: --wear 2: expected a number from 0 to 1"),
        (["probe", "x", "--sped", "300"], 2, "sayd: error: No such option: --sped"),
        (["probe", "x", "--out", "/proc/none"], 2, "sayd: error: --out /proc/none: cannot be written"),
        (["prob"], 2, "sayd: error: No such command 'prob'"),
    ],
)
def test_every_error_is_one_line_with_its_status(
    arguments: list[str], status: int, message: str, sayd: Sayd, tmp_path: Path
):
    done = sayd(*arguments)
    assert done.returncode == status
    assert done.stderr.startswith(message)
    assert done.stderr.count("\n") == 1
    assert done.stderr[:-1].isprintable()
    assert len(done.stderr) < 2100
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_without_a_command_there_is_the_help_alone(sayd: Sayd):
    done = sayd()
    assert done.returncode == 2
    assert "sayd evaluate --policies" in done.stdout
    assert done.stderr == ""


def test_a_defect_shows_its_place_on_demand(sayd: Sayd, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SAYD_DEBUG", "1")
    assert "Traceback" in sayd("probe", "defect").stderr


def test_json_stands_alone_on_standard_output_and_writes_no_file(sayd: Sayd, tmp_path: Path):
    done = sayd("probe", "x", "--json", "--speeds", "300:400:50")
    assert done.returncode == 0
    content = json.loads(done.stdout)
    assert content["answer"] is None
    assert content["config"] == {"speeds": [300.0 / 3.6, 350.0 / 3.6, 400.0 / 3.6]}
    assert "quick" not in content
    assert content["seed"] == 3
    assert "the summary" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_results_go_to_a_directory_named_by_the_command(sayd: Sayd, tmp_path: Path):
    done = sayd("probe", "x")
    assert done.returncode == 0
    assert done.stdout.splitlines() == ["the summary", "results/probe: answers.csv, result.json"]
    assert done.stderr == ""
    assert sorted(path.name for path in (tmp_path / "results/probe").iterdir()) == [
        "answers.csv",
        "result.json",
    ]


def test_a_look_says_so_and_never_replaces_a_result(sayd: Sayd, tmp_path: Path):
    sayd("probe", "x")
    done = sayd("probe", "x", "--quick")
    assert done.stdout.splitlines()[1:] == [
        "--quick: a look, not a result",
        "results/probe-quick: answers.csv, result.json",
    ]
    assert json.loads((tmp_path / "results/probe-quick/result.json").read_text())["quick"] is True
    assert "quick" not in json.loads((tmp_path / "results/probe/result.json").read_text())


def test_all_columns_are_an_option(sayd: Sayd):
    assert "the summary in all its columns" in sayd("probe", "x", "--wide", "--json").stderr


def test_json_with_a_directory_writes_the_same_document(sayd: Sayd, tmp_path: Path):
    done = sayd("probe", "x", "--json", "--out", "here")
    assert json.loads(done.stdout) == json.loads((tmp_path / "here/result.json").read_text())


def test_a_result_of_another_command_is_not_replaced_in_silence(sayd: Sayd, tmp_path: Path):
    first = sayd("probe", "x", "--out", "here")
    again = sayd("probe", "x", "--out", "here")
    assert "replaces" not in first.stdout + again.stdout
    other = sayd("probe", "y", "--out", "here")
    assert other.stdout.endswith("here: replaces the result of 'sayd probe x --out here'\n")


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_says_so_and_leaves_no_result(kind: signal.Signals, tmp_path: Path):
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "probe", "sleep", "--out", "here"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(kind)
        assert process.stdout.readline() == "cleaning up\n"
        process.send_signal(signal.SIGTERM)  # as `timeout` sends it to a child and to its group
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors == "sayd: interrupted; no result was written\n"
    assert list(tmp_path.iterdir()) == []


def test_a_program_that_swallowed_an_interrupt_ends_by_the_next_one():
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "probe", "deaf"], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        for word in ("ready\n", "on and on\n"):
            assert process.stdout.readline() == word
            process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) == 130


def test_a_reader_that_leaves_early_causes_no_complaint():
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, "probe", "lines"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.stderr.read() == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_a_full_standard_output_is_one_message():
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, "probe", "lines"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr == "sayd: error: standard output: No space left on device\n"


@pytest.mark.parametrize(
    ("arguments", "closed", "status"),
    [
        ("--version", ">&-", 0),
        ("probe x --json", ">&- 2>&-", 0),
        ("nothing", "2>&-", 2),
        ("probe config", "<&- >&- 2>&-", 2),
        ("probe study", ">&- 2>&-", 1),
    ],
)
def test_closed_streams_change_no_status(arguments: str, closed: str, status: int, tmp_path: Path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    shell = f"exec {sys.executable} program.py {arguments} {closed}"
    done = subprocess.run(["sh", "-c", shell], cwd=tmp_path, check=False, capture_output=True, text=True)
    assert done.returncode == status
    assert "Traceback" not in done.stderr + done.stdout
    assert "internal error" not in done.stderr + done.stdout


def test_help_and_version_import_no_compiler():
    for option in ("--help", "--version"):
        code = (
            "import sys; from sayd_env.cli import main\n"
            f"assert main(['{option}']) == 0\n"
            "print(sorted({'scipy', 'numba', 'matplotlib', 'torch'} & set(sys.modules)))"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("command", ["train", "render", "export"])
def test_help_shows_the_names_of_all_extras(command: str, capsys: pytest.CaptureFixture[str]):
    """Rich would take a name in brackets for a style."""
    function = {"train": learning.train, "render": policies.render, "export": learning.export}[command]
    named = set(re.findall(r"sayd-env\[\w+\]", inspect.getsource(function)))
    assert named
    assert main([command, "--help"]) == 0
    assert named <= set(re.findall(r"sayd-env\[\w+\]", capsys.readouterr().out))


def test_the_list_of_commands_shows_the_extra(capsys: pytest.CaptureFixture[str]):
    assert main(["--help"]) == 0
    assert "sayd-env[train]" in capsys.readouterr().out


Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Run a command that must refuse its input; return the message."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> str:
        assert main(arguments) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("sayd: error: ")
        assert "Traceback" not in err
        assert list(tmp_path.rglob("result.json")) == []
        return err

    return run


@pytest.fixture(scope="module")
def ride(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 2.5 km: 4 Hz hunting of 2 m/s2 and 60 kN."""
    path = tmp_path_factory.mktemp("ride") / "ride.csv"
    time_s = np.arange(0.0, 30.0, 1 / 500)
    wave = np.sin(2 * np.pi * 4.0 * time_s)
    table = np.column_stack([time_s, 2.0 * wave, 60.0 * wave])
    np.savetxt(path, table, delimiter=",", header="time_s,frame_m_s2,ws1_kn", comments="", fmt="%.6f")
    return path


def test_assess_judges_a_recording_by_the_limits_of_en_14363(ride: Path, sayd: Sayd, tmp_path: Path):
    """Limits 5.44 m/s2 and 30 kN: Wang et al. (2022), eq. 25 and 26, for P = 150 kN and m_b = 5.6 t."""
    train = ("--bogie-mass", "5600", "--axle-load", "150")
    done = sayd("assess", str(ride), "--speed", "300", *train, "--json", "--out", "here")
    assert done.returncode == 0
    content = json.loads(done.stdout)
    assert content["limits"] == pytest.approx({"acceleration_rms": 5.44, "track_shift_rms_kn": 30.0})
    assert [channel["stable"] for channel in content["channels"]] == [True, False]
    for channel in content["channels"]:
        assert channel["dominant_frequency_hz"] == pytest.approx(4.0, abs=0.01)
    assert content["train"]["axle_load_kn"] == {"value": 150.0, "from": "--axle-load"}
    assert {"result.json", "channels.csv", "sections.csv", "signals.png", "report.html"} <= {
        path.name for path in (tmp_path / "here").iterdir()
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.csv"], "nowhere.csv: no such"),
        (["RIDE"], "speed"),
        (["RIDE", "--speed", "-300"], "--speed -300: expected a finite number above 0 km/h"),
        (["RIDE", "--speed", "300", "--run-in", "nan"], "run-in"),
        (["RIDE", "--speed", "300", "--column", "frame_ms2"], "frame_ms2"),
        (["RIDE", "--speed", "300", "--set", "assessment.filter_ordr=2"], "did you mean 'filter_order'"),
        (["RIDE", "--speed", "300", "--axle-load", "150"], "mass: give --bogie-mass KG; or --config"),
        (["RIDE", "--speed", "300", "--bogie-mass", "5600"], "load: give --axle-load KN; or --config"),
        (["RIDE", "--speed", "300", "--axle-load", "15"], "--axle-load 15: expected"),
        (["RIDE", "--speed", "300", "--bogie-mass", "5.6"], "--bogie-mass 5.6: expected a number from 500"),
        (["RIDE", "--speed", "300", "--config", "manchestr"], "did you mean 'manchester'"),
    ],
)
def test_bad_input_of_assess_is_one_message(arguments: list[str], message: str, ride: Path, refused: Refused):
    assert message in refused("assess", *(str(ride) if part == "RIDE" else part for part in arguments))


def test_conicity_of_lmb10_on_cn60_is_its_design_value(sayd: Sayd, tmp_path: Path):
    """The LMB10 tread was designed for an equivalent conicity of 0.10 on CN60 rails."""
    done = sayd("conicity", "--profile", "lmb10", "--json", "--out", "here")
    assert done.returncode == 0
    content = json.loads(done.stdout)
    at = np.isclose(content["amplitude_mm"], 3.0)
    assert np.array(content["tan_gamma_e"])[at] == pytest.approx(0.10, abs=0.005)
    assert content["config"]["wheel"]["name"] == "lmb10"
    files = {path.name for path in (tmp_path / "here").iterdir()}
    assert files == {"result.json", "conicity.csv", "delta_r.csv", "conicity.png"}
