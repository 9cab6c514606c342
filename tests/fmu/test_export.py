"""``sayd export --fmu``: what it writes, and what it says where it cannot."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sayd_env.cli import main
from sayd_env.config import ConfigError
from sayd_env.config.damper import load_sayd
from sayd_env.fmu import unit as units


def test_command_writes_a_vehicle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ("export", "--fmu", "vehicle", "--speed", "320", "--json", "--out", str(tmp_path))
    assert main(arguments) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["needs_python"] is True
    assert [Path(file).name for file in reported["files"]] == [
        "sayd_vehicle_fmi2.fmu",
        "sayd_vehicle_fmi3.fmu",
    ]
    assert all(Path(file).is_file() for file in reported["files"])
    (speed,) = [v["start"] for v in reported["variables"] if v["name"] == "speed"]
    assert speed == pytest.approx(320 / 3.6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--fmu", "damper", "--damper", "passive"), "is passive"),
        (("--fmu", "vehicle", "--damper", "passive"), "needs semi-active dampers"),
        (("--fmu", "damper", "--speed", "300"), "has no track"),
        (("--fmu", "damper", "--track", "china"), "has no vehicle; leave out --track"),
        (("mppt2", "--fmu", "controller", "--wear", "0.5"), "has no vehicle; leave out --wear"),
        (("x.zip", "--fmu", "controller", "--trust-pickles"), "leave out --trust-pickles"),
        (("--fmu", "damper", "ppo"), "leave out ppo"),
        (("--fmu", "controller"), "of which policy?"),
        (("--fmu", "controller", "mppt3"), "mppt3"),
        (("--fmu", "bogie"), "bogie"),
        ((), "or --fmu damper"),
        (("ppo", "--track", "smooth"), "--track: belongs to --fmu"),
    ],
)
def test_what_does_not_fit_is_refused(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(("export", *arguments, "--out", str(tmp_path))) == 2
    assert message in " ".join(capsys.readouterr().err.split())


def test_without_a_compiler_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(ConfigError, match=r"needs a C compiler.*pip install ziglang"):
        units.fmu_files(units.damper_unit(load_sayd("sayd-estimate")))


def test_without_fmpy_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(units.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"sayd-env\[fmu\]"):
        units.fmu_files(units.damper_unit(load_sayd("sayd-estimate")))
