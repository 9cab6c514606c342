"""A page for every command, made from the program itself: what it does, and all its options in groups."""

from __future__ import annotations

import re
from typing import Any

import typer

from sayd_env.cli.app import app


def pages() -> dict[str, str]:
    """Every command's page, by the command's name."""
    program = typer.main.get_command(app)
    context = typer.Context(program, info_name="sayd")
    commands: dict[str, Any] = program.commands  # type: ignore[attr-defined]
    return {name: _page(name, command, context) for name, command in commands.items()}


def _page(name: str, command: Any, parent: typer.Context) -> str:
    context = typer.Context(command, info_name=name, parent=parent)
    usage = re.sub(r"\s+", " ", " ".join(command.collect_usage_pieces(context)))
    parts = [f"# sayd {name}", _plain(command.help), f"```console\nsayd {name} {usage}\n```"]
    if command.epilog:
        parts.append(f"Example: `{_plain(command.epilog).removeprefix('Example: ')}`")
    panels: dict[str, list[Any]] = {}
    for parameter in command.params:
        panels.setdefault(_panel(parameter), []).append(parameter)
    for panel, parameters in panels.items():
        parts += [f"## {panel}", _table(parameters)]
    return "\n\n".join(parts) + "\n"


def _panel(parameter: Any) -> str:
    kind = "Arguments" if parameter.param_type_name == "argument" else "Options"
    return getattr(parameter, "rich_help_panel", None) or kind


def _table(parameters: list[Any]) -> str:
    rows = [f"| {_names(each)} | {_text(each)} |" for each in parameters]
    return "\n".join(["| option | |", "| --- | --- |", *rows])


def _names(parameter: Any) -> str:
    metavar = parameter.metavar or ""
    names = [] if parameter.param_type_name == "argument" else [*parameter.opts, *parameter.secondary_opts]
    return f"`{' '.join([', '.join(names), metavar]).strip()}`"


def _text(parameter: Any) -> str:
    text = _plain(getattr(parameter, "help", "") or "").replace("|", "&#124;")
    default = parameter.default
    if parameter.param_type_name == "option" and default not in (None, False, ()) and "Default" not in text:
        text += f" Default: `{default}`."
    return text


def _plain(text: str) -> str:
    """A help text without the marks that keep Rich from reading brackets."""
    return text.replace("\\[", "[").strip()
