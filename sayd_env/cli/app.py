"""The program ``sayd``: its global options, and its commands in the order of its help."""

from __future__ import annotations

import typer

from sayd_env import __version__
from sayd_env.cli import learning, policies, program, simulate, vehicle
from sayd_env.cli.command import app
from sayd_env.cli.options import option

__all__ = ["app", "simulate"]

GROUPS = (vehicle.GROUP, policies.GROUP, learning.GROUP, vehicle.COMPONENTS, program.GROUP)
app.registered_commands.sort(key=lambda command: GROUPS.index(str(command.rich_help_panel)))


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sayd {__version__}")
        raise typer.Exit


@app.callback(epilog="Example: sayd evaluate --policies passive,mppt2 --speeds 300 --seeds 2")
def sayd(
    version: bool = option(
        "--version", "Print the version.", default=False, callback=_show_version, is_eager=True
    ),
) -> None:
    """High-speed rail vehicle with semi-active yaw dampers: simulation and EN 14363 assessment."""
