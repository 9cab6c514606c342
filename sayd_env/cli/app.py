"""The program ``sayd``: its global options and its commands, in the order of its help."""

from __future__ import annotations

from typing import Annotated

import typer

from sayd_env import __version__
from sayd_env.cli import components, learning, policies, program, tuning, vehicle
from sayd_env.cli.command import app

__all__ = ["app", "components", "learning", "policies", "program", "tuning", "vehicle"]


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sayd {__version__}")
        raise typer.Exit


@app.callback(epilog="Example: sayd evaluate --policies passive,mppt2 --speeds 300 --seeds 2")
def sayd(
    version: Annotated[
        bool,
        typer.Option(
            "--version", metavar="", callback=_show_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """High-speed rail vehicle with semi-active yaw dampers: simulation and EN 14363 assessment."""
