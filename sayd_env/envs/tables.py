"""The tables of an environment's documentation page, made from what the environment itself says."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from sayd_env.envs.interface import ACTIONS, BOGIES, DAMPERS, Signal

LAYOUTS = {
    "bogie": [f"the four valves of the {bogie} bogie" for bogie in BOGIES],
    "damper": [f"{bogie}.{place}" for bogie in BOGIES for place in DAMPERS],
    "vehicle": ["all eight valves"],
}
"""What the numbers of an action command."""


def observation_table(signals: Sequence[Signal]) -> str:
    """Table of an observation's numbers, one row for each quantity."""
    rows, first = [], 0
    for quantity, group in groupby(signals, key=lambda signal: signal.name.partition(".")[0]):
        members = list(group)
        numbers = str(first) if len(members) == 1 else f"{first} to {first + len(members) - 1}"
        places = [member.name.partition(".")[2] for member in members]
        head = members[0]
        rows.append((numbers, quantity, _places(places), head.unit, f"{head.low:g}", f"{head.high:g}"))
        first += len(members)
    return _table(("number", "quantity", "places, the last changes first", "unit", "low", "high"), rows)


def action_table() -> str:
    """Table of an action's numbers for each layout of the valves."""
    rows = [
        (f"'{valves}'", str(number), what, "0", "1")
        for valves in ACTIONS
        for number, what in enumerate(LAYOUTS[valves])
    ]
    return _table(("valves", "number", "command of", "closed", "open"), rows)


def _places(places: Sequence[str]) -> str:
    """Places in a row: the values of each part of their names."""
    parts = [
        list(dict.fromkeys(column)) for column in zip(*(place.split(".") for place in places), strict=True)
    ]
    return ", ".join("/".join(part) for part in parts if part != [""]) or "-"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = [head, ["-" * width for width in widths], *rows]
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |"
        for line in lines
    )
