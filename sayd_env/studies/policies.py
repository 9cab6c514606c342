"""Which policies come with the program? Controllers, and learned ones with where they come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

from sayd_env import baselines
from sayd_env.agents.pretrained.cards import COLUMNS, Origin, origins
from sayd_env.report.files import Plot, Table
from sayd_env.runs.policies import PASSIVE

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class PolicyList:
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
        header = tuple(Origin.__dataclass_fields__)
        return {"ready": (header, [tuple(asdict(each).values()) for each in self.ready])}

    def plots(self) -> Mapping[str, Plot]:
        """Return none."""
        return {}

    def summary(self, console: Console) -> None:
        """Print all, one line each."""
        from rich.table import Table as RichTable  # noqa: PLC0415 - only who prints pays for it

        grid = RichTable(title="controllers", title_justify="left")
        for name in ("name", "what it is"):
            grid.add_column(name)
        for name, what in self.controllers.items():
            grid.add_row(name, what)
        console.print(grid)
        if not self.ready:
            console.print("No ready learned policies come with this installation.")
            return
        grid = RichTable(title="ready learned policies", title_justify="left")
        for name in COLUMNS:
            grid.add_column(name, justify="right" if name in {"seed", "steps", "training", "J"} else "left")
        for each in self.ready:
            *cells, digest = each.cells()
            grid.add_row(*cells, digest[:12])
        console.print(grid)
        console.print(
            "J: mean over the scenarios that judged it while it learned. An algorithm's name alone, such as "
            f"{self.ready[0].algorithm}, is its first training."
        )


def policies() -> PolicyList:
    """List the policies that come with the program.

    Raises
    ------
    ConfigError, DataError
        The file of a ready policy cannot be read or is damaged.
    """
    return PolicyList({name: about(name) for name in baselines.NAMES}, origins())


def about(name: str) -> str:
    """What a controller is: the first line of its file.

    Parameters
    ----------
    name : str
        One of `baselines.NAMES`.
    """
    if name == PASSIVE:  # it has no parameters, and no file
        return "Passive yaw dampers, which no command reaches."
    text = resources.files("sayd_env.configs").joinpath("control", f"{name}.yaml").read_text(encoding="utf-8")
    return text.partition("\n")[0].lstrip("# ")
