"""The Python side of a unit that needs Python: a process that a unit's library starts and talks to.

It is `python -m sayd_env.fmu.serve RESOURCES`; standard input is the socket, see ``source/process.c``.
"""

from __future__ import annotations

import json
import socket
import struct
import sys
from pathlib import Path
from typing import Protocol

import numpy as np

from sayd_env.config import ConfigError, SaydError
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import Array
from sayd_env.fmu.controller import ControllerUnit, read_policy
from sayd_env.fmu.variable import Variable
from sayd_env.fmu.vehicle import VehicleUnit

MODEL = "model.json"
"""File among a unit's resources that says what it is."""


class Stepped(Protocol):
    """What a unit's library asks of its Python side."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        """In the order of the values."""

    def begin(self, value: Array) -> None:
        """Start; `value` holds all variables, outputs are set in place."""

    def step(self, h: float, value: Array) -> None:
        """Advance over a communication step (s)."""


def restored(resources: Path) -> Stepped:
    """What a unit's resources describe.

    Raises
    ------
    ConfigError
        Resources of another version of this software, or a policy that does not fit.
    """
    try:
        content = json.loads((resources / MODEL).read_text())
        scenario = Scenario.model_validate(content["scenario"])
        policy = None if content["kind"] == "vehicle" else read_policy(content, resources)
    except (OSError, ValueError, KeyError) as error:
        raise ConfigError(f"{resources / MODEL}: another version of sayd-env has made it ({error})") from None
    return VehicleUnit(scenario) if policy is None else ControllerUnit(policy, scenario)


def serve(connection: socket.socket, resources: Path) -> None:
    """Answer until the other side closes."""
    unit: Stepped | None = None
    head = struct.Struct("=cd")
    with connection.makefile("rb") as asked:
        while len(request := asked.read(head.size)) == head.size:
            what, h = head.unpack(request)
            if unit is None:
                try:
                    unit = restored(resources)
                except SaydError as error:
                    connection.sendall(b"\1" + _line(error))
                    return
            value = np.frombuffer(asked.read(8 * len(unit.variables))).copy()
            try:
                if what == b"b":
                    unit.begin(value)
                else:
                    unit.step(h, value)
            except SaydError as error:
                connection.sendall(b"\1" + _line(error))
            else:
                connection.sendall(b"\0" + value.tobytes())


def _line(error: SaydError) -> bytes:
    return " ".join(str(error).split()).encode() + b"\n"


if __name__ == "__main__":
    serve(socket.socket(fileno=0), Path(sys.argv[1]))
