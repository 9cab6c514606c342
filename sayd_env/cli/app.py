"""The program ``sayd``: its global options and the list of its commands."""

from __future__ import annotations

import inspect
from typing import Annotated

import typer
from rich.markup import escape

from sayd_env import __version__
from sayd_env.cli import (
    comparison,
    components,
    learning,
    performance,
    pictures,
    policies,
    stability,
    tuning,
    vehicle,
)

app = typer.Typer(
    name="sayd",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sayd {__version__}")
        raise typer.Exit


@app.callback()
def sayd(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """High-speed rail vehicle with semi-active yaw dampers: simulation and EN 14363 assessment."""


app.command()(vehicle.critical_speed)
app.command()(policies.evaluate)
app.command("map")(policies.map_)
app.command()(policies.policies)
app.command()(vehicle.reproduce)
app.command()(vehicle.calibrate)
app.command()(stability.assess)
app.command()(components.conicity)
app.command()(components.hysteresis)
app.command()(stability.modes)
app.command()(tuning.tune)
app.command()(comparison.compare)
app.command()(learning.train)
app.command()(learning.export)
app.command()(pictures.render)
app.command()(performance.bench)
app.command()(performance.soak)

for command in app.registered_commands:
    # Help is shown by rich, to which an extra's name in brackets would be markup.
    command.help = escape(inspect.getdoc(command.callback) or "")
