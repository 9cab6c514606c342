"""A unit for co-simulation as a result to keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from sayd_env.config.storage import write_files
from sayd_env.fmu.unit import Unit, fmu_files
from sayd_env.report.columns import Column, Listing, Table, csv_table, json_rows
from sayd_env.report.files import Result

COLUMNS = (
    Column("name", "variable"),
    Column("unit", "unit"),
    Column("causality", "kind"),
    Column("start", "start"),
    Column("text"),
)


@dataclass(frozen=True)
class UnitResult(Result):
    """Files of a unit and its variables."""

    unit: Unit
    files: list[Path]

    def as_dict(self) -> dict[str, Any]:
        """Return what scripts read."""
        return {
            "fmu": self.unit.name,
            "files": [str(file) for file in self.files],
            "needs_python": not self.unit.plain,
            "variables": json_rows(COLUMNS, self.unit.variables),
        }

    def tables(self) -> Mapping[str, Table]:
        """Return the variables."""
        return {"variables": csv_table(COLUMNS, self.unit.variables)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the files and the variables."""
        for file in self.files:
            console.print(str(file), markup=False, highlight=False, soft_wrap=True)
        needs = "runs without Python" if self.unit.plain else "needs Python with sayd-env where it runs"
        Listing(f"{self.unit.name}: {needs}", COLUMNS, self.unit.variables).print(console, wide)


def export(unit: Unit, target: Path) -> UnitResult:
    """Write a unit for FMI 2.0 and 3.0 into a folder.

    Raises
    ------
    ConfigError
        No C compiler, or FMPy is not installed.
    StudyError
        The C compiler failed, or a file cannot be written.
    """
    return UnitResult(unit, write_files(target, fmu_files(unit)))
