"""Templates: valid as they are written, taken by the commands that they name, and nothing is overwritten."""

from __future__ import annotations

import errno
import json
import os
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from sayd_env import baselines
from sayd_env.cli import main
from sayd_env.cli.app import app
from sayd_env.config import ConfigError, packaged_names, validate
from sayd_env.config.damper import DAMPER
from sayd_env.config.layers import Kind, layered
from sayd_env.config.line import read_line
from sayd_env.config.profile import load_rail, load_wheel
from sayd_env.config.scenario import STUDY, Scenario, load_scenario
from sayd_env.config.vehicle import VEHICLE, VehicleConfig
from sayd_env.studies.new import TEMPLATES, new

SHORT = ["--set", "assessment.run_in=200", "--set", "assessment.length=600"]
PROGRAM: Any = typer.main.get_command(app)


@pytest.mark.parametrize("kind", ["vehicle", "damper", "profile", "line", "study"])
def test_every_packaged_file_is_a_template_that_says_the_same(kind: str, tmp_path: Path) -> None:
    """But for its name: what is read from the copy is what is read from the packaged file."""
    for start in TEMPLATES[kind].others or packaged_names(kind):
        path = str(new(kind, f"own-{start}", start, tmp_path).file)
        if kind == "line":
            assert read_line(path) == read_line(start)
            continue
        if kind == "study":
            copied, former = layered(STUDY, path).data, layered(STUDY, start).data
            assert _plain(copied) == _plain(former)
            continue
        one = {"vehicle": VEHICLE, "damper": DAMPER}.get(kind)
        if one is not None:
            data, former = layered(one, path).data, layered(one, start).data
            assert data.pop("name") == f"own-{start}"
            del former["name"]
            assert _plain(data) == _plain(former)
        else:
            load = load_rail if layered(Kind("profile"), path).data["kind"] == "rail" else load_wheel
            assert load(path).name == f"own-{start}"
            kept = {"name", "provenance"}
            assert load(path).model_dump(exclude=kept) == load(start).model_dump(exclude=kept)


def _plain(data: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key != "provenance"}


@pytest.mark.parametrize("kind", TEMPLATES)
def test_the_commands_to_run_next_can_be_typed(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", kind, "mine", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert [entry.name for entry in tmp_path.iterdir()] == [shown["file"]]
    for text in shown["next"]:
        program, command, *arguments = shlex.split(text)
        assert program == "sayd"
        PROGRAM.commands[command].make_context(command, list(arguments))
        assert shown["file"] in text


RUNS = {
    "vehicle": ["modes", "--set", "vehicle=mine.yaml", "--speeds", "300"],
    "damper": ["hysteresis", "--damper", "mine.yaml", "--amplitudes", "2", "--frequencies", "2"],
    "profile": ["conicity", "--profile", "mine.yaml"],
    "line": ["simulate", "--line", "mine.yaml", "--seconds", "0.2", "--signals", "speed"],
    "controller": ["evaluate", "--policies", "mine.py:controller", "--speeds", "250", "--seeds", "1", *SHORT],
    "study": ["evaluate", "--config", "mine.yaml", "--speeds", "250", "--seeds", "1", *SHORT],
}


@pytest.mark.parametrize("kind", TEMPLATES)
def test_a_template_is_taken_by_a_run(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", kind, "mine"]) == 0
    assert "mine." in capsys.readouterr().out
    assert main([*RUNS[kind], "--out", "results"]) == 0
    assert (tmp_path / "results" / "result.json").is_file()


def test_the_controller_opens_in_proportion_to_pressure(tmp_path: Path) -> None:
    """40 % and 0.56 % for each bar of the mean over a bogie's dampers, as its parameters say."""
    new("controller", "mine", folder=tmp_path)
    from sayd_env.runs.policies import policy_spec  # noqa: PLC0415

    policy = policy_spec(f"{tmp_path}/mine.py:controller").make("SAYD/Nominal-v1")
    names = [signal.name for signal in baselines.interface_of("SAYD/Nominal-v1").signals]
    observation = np.zeros(len(names), np.float32)
    for damper, bar in zip(
        ("left.upper", "left.lower", "right.upper", "right.lower"), (10, 20, 30, 40), strict=True
    ):
        observation[names.index(f"pressure_b.rear.{damper}")] = 1e5 * bar
    action, _ = policy.predict(observation)
    np.testing.assert_allclose(action, [0.40, 0.40 + 0.0056 * 25.0], rtol=1e-6)


@pytest.mark.parametrize(
    "name",
    ["", "a/b", "../a", "a\\b", ".hidden", "-x", "a.yaml", "a b", "a\n", "a\x1b[2J", "x" * 65, "a:b", "a,b"],
)
def test_names_that_are_none(name: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^NAME .*neither a folder nor an ending$") as error:
        new("vehicle", name, folder=tmp_path)
    assert str(error.value).isprintable()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["no", "123", "60e1", "1e3", "Wagen_7", "züge"])
def test_a_name_stays_a_name(name: str, tmp_path: Path) -> None:
    """Also one that YAML would read as a number or as false."""
    file = new("vehicle", name, folder=tmp_path).file
    data = layered(VEHICLE, str(file)).data
    assert validate(VehicleConfig, data, str(file)).name == name


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text("precious")
    Path("link.yaml").symlink_to("nowhere")
    for name in ("mine", "link"):
        assert main(["new", "line", name]) == 2
        assert f"{name}.yaml: is there already; nothing is overwritten" in capsys.readouterr().err
    assert Path("mine.yaml").read_text() == "precious"
    assert main(["new", "vehicle", "x", "--from", "emv"]) == 2
    assert "--from 'emv': no such vehicle, did you mean 'emu'?; available: emu, " in capsys.readouterr().err
    assert not Path("x.yaml").exists()


def test_a_full_disk_leaves_no_half_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "fsync", full)
    assert main(["new", "line", "mine"]) != 0
    assert "No space left on device" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_study_that_names_the_vehicle_beside_it(tmp_path: Path) -> None:
    new("vehicle", "train", folder=tmp_path)
    study = new("study", "mine", folder=tmp_path).file
    study.write_text(study.read_text().replace("vehicle: emu-estimate", "vehicle: train.yaml"))
    assert load_scenario(str(study)).vehicle.name == "train"
    same = load_scenario(str(study)).model_dump(exclude={"vehicle": {"name"}})
    assert same == load_scenario("estimates").model_dump(exclude={"vehicle": {"name"}})
    assert isinstance(load_scenario(str(study)), Scenario)
