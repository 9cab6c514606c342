"""Which policies come with the program? Controllers, and learned ones with where they come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from typing import Any

from rich.console import Console

from sayd_env import baselines
from sayd_env.agents.pretrained.cards import Origin, origins
from sayd_env.report.columns import Column, Listing, Table, csv_table
from sayd_env.report.files import Result
from sayd_env.runs.policies import PASSIVE


@dataclass(frozen=True)
class PolicyList(Result):
    """Policies that have a name."""

    controllers: Mapping[str, str]
    """What each of `baselines.NAMES` is."""
    ready: list[Origin]
    """Learned ones."""

    def as_dict(self) -> dict[str, Any]:
        """Return what scripts read."""
        groups: dict[str, list[str]] = {}
        for each in self.ready:
            groups.setdefault(each.algorithm, []).append(each.name)
        return {
            "controllers": dict(self.controllers),
            "ready": [asdict(each) for each in self.ready],
            "groups": groups,
        }

    def tables(self) -> Mapping[str, Table]:
        """Return what is known of the learned ones."""
        return {"ready": csv_table([Column(name) for name in Origin.__dataclass_fields__], self.ready)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print all, one line each."""
        controllers = [{"name": name, "what": what} for name, what in self.controllers.items()]
        columns = (Column("name", "name"), Column("what", "what it is"))
        Listing("controllers", columns, controllers).print(console)
        if not self.ready:
            console.print("No ready learned policies come with this installation.")
            return
        Listing("ready learned policies", READY, self.ready).print(console, wide)
        console.print(
            "J: mean over the scenarios that judged it while it learned. An algorithm's name alone, such as "
            f"{self.ready[0].algorithm}, is its first training."
        )


READY = (
    Column("name", "name"),
    Column("algorithm", "algorithm", wide=True),
    Column("seed", "seed", wide=True),
    Column("short_commit", "commit"),
    Column("environment", "environment"),
    Column("steps", "steps"),
    Column("seconds", "training", "min", 1.0 / 60.0, 0),
    Column("J", "J", digits=4),
    Column("sha256", "SHA-256", wide=True),
)
"""What is printed of a learned policy."""


def policies() -> PolicyList:
    """List the policies that come with the program.

    Raises
    ------
    ConfigError, DataError
        The file of a ready policy cannot be read or is damaged.
    """
    return PolicyList({name: about(name) for name in baselines.NAMES}, origins())


def about(name: str) -> str:
    """What one of `baselines.NAMES` is: the first line of its file."""
    if name == PASSIVE:  # it has no parameters, and no file
        return "Passive yaw dampers, which no command reaches."
    text = resources.files("sayd_env.configs").joinpath("control", f"{name}.yaml").read_text(encoding="utf-8")
    return text.partition("\n")[0].lstrip("# ")
