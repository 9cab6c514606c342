"""The damper and the vehicle as units for co-simulation, as a result to keep."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.storage import write_files
from sayd_env.fmu.unit import Unit, controller_unit, damper_unit, fmu_files, vehicle_unit
from sayd_env.report.columns import Column, Table, print_table
from sayd_env.report.figures import Plot

if TYPE_CHECKING:
    from rich.console import Console

COLUMNS = (
    Column("name", "variable"),
    Column("unit", "unit"),
    Column("causality", "kind"),
    Column("start", "start"),
    Column("text"),
)


@dataclass(frozen=True)
class UnitResult:
    """Files of a unit and its variables."""

    unit: Unit
    files: list[Path]

    def as_dict(self) -> dict[str, Any]:
        """Return what scripts read."""
        return {
            "fmu": self.unit.name,
            "files": [str(file) for file in self.files],
            "needs_python": not self.unit.plain,
            "variables": self._rows(),
        }

    def tables(self) -> Mapping[str, Table]:
        """Return the variables."""
        header = [column.name for column in COLUMNS]
        return {"variables": (header, [[row[key] for key in header] for row in self._rows()])}

    def plots(self) -> Mapping[str, Plot]:
        """Return none."""
        return {}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the files and the variables."""
        for file in self.files:
            console.print(str(file), markup=False, highlight=False, soft_wrap=True)
        needs = "runs without Python" if self.unit.plain else "needs Python with sayd-env where it runs"
        print_table(console, f"{self.unit.name}: {needs}", COLUMNS, self._rows(), wide=wide)

    def _rows(self) -> list[dict[str, Any]]:
        return [{column.name: getattr(v, column.name) for column in COLUMNS} for v in self.unit.variables]


def export_damper(config: SaydDamperConfig, target: Path) -> UnitResult:
    """Write the semi-active damper as units for FMI 2.0 and 3.0 into a folder.

    Raises
    ------
    ConfigError
        No C compiler, or FMPy is not installed.
    DataError
        A throttle table that cannot be used.
    StudyError
        The C compiler failed, or a file cannot be written.
    """
    return _written(damper_unit(config), target)


def export_vehicle(scenario: Scenario, speed: float, seed: int, target: Path) -> UnitResult:
    """Write the vehicle at a speed (m/s) on the track of a seed as units for FMI 2.0 and 3.0 into a folder.

    Raises
    ------
    ConfigError
        Passive dampers, no C compiler, or FMPy is not installed.
    StudyError
        The C compiler failed, or a file cannot be written.
    """
    return _written(vehicle_unit(scenario, speed, seed), target)


def export_controller(policy: str, scenario: Scenario, target: Path) -> UnitResult:
    """Write a policy as units for FMI 2.0 and 3.0 into a folder.

    Raises
    ------
    ConfigError
        An unknown policy or one that a unit cannot hold, no C compiler, or FMPy is not installed.
    DataError
        A damaged file.
    StudyError
        The C compiler failed, or a file cannot be written.
    """
    return _written(controller_unit(policy, scenario), target)


def _written(unit: Unit, target: Path) -> UnitResult:
    return UnitResult(unit, write_files(target, fmu_files(unit)))
