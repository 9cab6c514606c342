"""Every command: which options it offers, its help, its example."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from sayd_env.cli import main
from sayd_env.cli.app import GROUPS, app

PROGRAM: Any = typer.main.get_command(app)
SHOWN = {"out", "json", "wide", "help"}
RUNS = {"workers", "executor"}
CONFIG = {"config", "set"}
WHEELS = {"profile", "rail", "gauge", "wear", "track", *CONFIG}
VEHICLE = {*WHEELS, "friction"}
FOREIGN = {"trust-pickles", "trained-period", "vec-normalize"}
GRID = {*VEHICLE, "damper", "speeds", "environment", "reward", "policies", *FOREIGN}

OFFERED = {
    "critical-speed": {*VEHICLE, *RUNS, *SHOWN, "speeds", "damper", "policy", "creep-laws", "seed", "seeds"},
    "reproduce": {*CONFIG, *RUNS, *SHOWN, "friction", "track", "strict", "allow", "control-periods"}
    | {"damper", "sayd", "controllers", "assumptions", "creep-laws", "quick", "seed", "seeds"},
    "calibrate": {*CONFIG, *RUNS, *SHOWN, "seed"},
    "modes": {*VEHICLE, *SHOWN, "speeds", "amplitude"},
    "linearise": {*VEHICLE, *SHOWN, "damper", "speed", "shift", "stroke-speed", "current", "frequency"}
    | {"delay-order"},
    "assess": {*CONFIG, *SHOWN, "speed", "sample-rate", "column", "run-in"} | {"bogie-mass", "axle-load"},
    "evaluate": {*GRID, *RUNS, *SHOWN, "line", "initial-current", "seed", "seeds"},
    "map": {*GRID, *RUNS, *SHOWN, "conditions", "constants", "quick", "seed", "seeds"} - {"reward"},
    "hindsight": {*CONFIG, *RUNS, *SHOWN, *FOREIGN, "policies", "quick"},
    "bound": {*CONFIG, *RUNS, *SHOWN, *FOREIGN, "policies", "conditions", "quick", "convergence"},
    "robustness": {*CONFIG, *RUNS, *SHOWN, *FOREIGN, "policies", "quick"},
    "compare": {*CONFIG, *RUNS, *SHOWN, *FOREIGN, "policies", "quick", "seed"},
    "render": {*VEHICLE, *SHOWN, *FOREIGN, "policies", "speed", "environment", "seconds", "fps", "file"}
    | {"exaggeration", "seed", "line"},
    "policies": SHOWN,
    "tune": {*CONFIG, *RUNS, *SHOWN, "quick", "seed", "file"},
    "play": {*VEHICLE, "speed", "environment", "seed", "json", "help"},
    "simulate": {*VEHICLE, *SHOWN, *FOREIGN, "damper", "policy", "speed", "line", "environment", "seconds"}
    | {"initial-current", "signals", "run-in", "format", "seed", "file"},
    "train": {*CONFIG, *RUNS, *SHOWN, "resume", "seed", "seeds", "parallel", "wandb"} - {"wide"},
    "export": {*FOREIGN, *VEHICLE, *SHOWN, "onnx", "fmu", "damper", "speed", "seed"} - {"wide"},
    "conicity": {*WHEELS, *SHOWN},
    "hysteresis": {*CONFIG, *SHOWN, "damper", "amplitudes", "frequencies", "current"},
    "bench": {*VEHICLE, *SHOWN, "speed", "quick", "workers", "executor"},
    "soak": {*SHOWN, "set", "steps", "environment", "environments", "seed", "workers"},
    "new": {"from", "json", "help"},
}
for _plain in ("render", "tune"):
    OFFERED[_plain] -= {"wide"}


def options_of(command: Any) -> list[Any]:
    return [each for each in command.get_params(typer.Context(command)) if each.param_type_name == "option"]


def test_the_program_has_these_commands_in_groups():
    assert list(PROGRAM.commands) == list(OFFERED)
    assert [command.rich_help_panel for command in PROGRAM.commands.values()] == sorted(
        (command.rich_help_panel for command in PROGRAM.commands.values()), key=GROUPS.index
    )


@pytest.mark.parametrize("name", OFFERED)
def test_a_command_offers_the_options_that_it_can_use(name: str):
    found = {
        next(word for word in each.opts if word.startswith("--"))[2:]
        for each in options_of(PROGRAM.commands[name])
    }
    assert found == OFFERED[name]


@pytest.mark.parametrize("name", ["", *OFFERED])
def test_help_fits_80_columns_and_describes_everything(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("COLUMNS", "80")
    assert main([name, "--help"] if name else ["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(len(line) for line in lines) <= 80
    command = PROGRAM.commands[name] if name else PROGRAM
    words = "\n".join(lines).replace(",--", " --").split()  # several long names stand in one column
    for each in options_of(command):
        assert each.help
        assert set(each.opts) <= set(words)
        if each.metavar:  # whole, not broken into two lines
            assert each.metavar in words
    assert "\u2026" not in "".join(words)  # nothing is cut


@pytest.mark.parametrize("name", OFFERED)
def test_the_example_is_one_line_that_can_be_typed(name: str, capsys: pytest.CaptureFixture[str]):
    """It is parsed: each option exists and takes its value."""
    main([name, "--help"])
    shown = [line.strip() for line in capsys.readouterr().out.splitlines() if "Example: " in line]
    assert shown == [PROGRAM.commands[name].epilog.replace("\\[", "[")]
    program, command, *arguments = shlex.split(shown[0].removeprefix("Example: "))
    assert (program, command) == ("sayd", name)
    PROGRAM.commands[name].make_context(name, list(arguments))


def test_an_option_has_one_meaning_wherever_it_is_offered():
    """What --quick, --json, --wide and --set say is the same everywhere."""
    for option in ("--quick", "--json", "--wide", "--set"):
        texts = {
            each.help
            for command in PROGRAM.commands.values()
            for each in options_of(command)
            if option in each.opts
        }
        assert len(texts) == 1


def test_the_page_of_commands_names_them_all() -> None:
    page = (Path(__file__).parents[2] / "docs" / "commands.md").read_text(encoding="utf-8")
    assert {
        name for row in re.findall(r"^\| (.*?) \|", page, re.M) for name in re.findall("`sayd ([a-z-]+)", row)
    } == {*PROGRAM.commands}
