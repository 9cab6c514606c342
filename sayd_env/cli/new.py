"""The command that begins something of one's own."""

from __future__ import annotations

from typing import Literal

from sayd_env.cli.command import Plan, command
from sayd_env.cli.options import argument, option
from sayd_env.cli.program import GROUP


@command(GROUP, "vehicle my_train", without=("out", "wide"))
def new(
    kind: Literal["vehicle", "damper", "profile", "line", "controller", "study"] = argument(
        "KIND", "vehicle, damper, profile, line, controller or study."
    ),
    name: str = argument("NAME", "Of what it describes, and of the file, without an ending."),
    *,
    start: str | None = option(
        "--from NAME",
        "Packaged file of this kind to copy. Default: emu-estimate, passive-estimate, s1002, curve_400, "
        "own_controller, estimates.",
    ),
) -> Plan:
    """Write a template into the working directory: a packaged file with all its comments, under a new name.

    Nothing is overwritten. It is valid as it stands, and the program says which commands take it.
    """
    from sayd_env.studies.new import new as study  # noqa: PLC0415 - keeps --help fast

    return Plan(lambda _: study(kind, name, start), stored=False)
