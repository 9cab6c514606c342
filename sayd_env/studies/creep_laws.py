"""What the creep law carries: the critical speed by several creep laws, all else equal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sayd_env.config import ConfigError
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.physics.contact.creep import LAWS
from sayd_env.report.columns import Column, Table, csv_table, print_table

if TYPE_CHECKING:
    from rich.console import Console

    from sayd_env.studies.critical_speed import CriticalSpeedResult

SPEEDS = tuple(v / KMH for v in range(260, 441, 20))
"""Speeds of a comparison (m/s): wide enough for the critical speeds of all laws on new and on worn wheels."""
_CRITERIA = ("acceleration", "track_shift_force")


@dataclass(frozen=True)
class CreepLawComparison:
    """Critical speeds by creep law."""

    results: Mapping[str, CriticalSpeedResult]
    """By the law's name."""

    def as_dict(self) -> dict[str, Any]:
        """Critical speed and criteria by law, with the keys of ``sayd critical-speed --json``."""
        kept = ("critical_speed_kmh", "criterion", "by_criterion")
        return {
            law: {key: value for key, value in result.as_dict().items() if key in kept}
            for law, result in self.results.items()
        }

    def table(self) -> Table:
        """Critical speed (km/h) by law and criterion; empty where the grid does not hold it."""
        return csv_table(_COLUMNS, self._rows())

    def _rows(self) -> list[dict[str, Any]]:
        rows = []
        for law, result in self.results.items():
            found = result.crossing()
            for name in _CRITERIA:
                speed, status = found[name].speed, found[name].crossing.name.lower()
                kmh = None if speed is None else speed * KMH
                rows.append(dict(zip(_NAMES, (law, name, kmh, status), strict=True)))
        return rows

    def summary(self, console: Console, title: str, wide: bool = False) -> None:
        """Print the critical speeds by law."""
        rows = [
            row | {"verdict": self.results[row["creep_law"]].verdict(row["criterion"])}
            for row in self._rows()
        ]
        print_table(console, title, (*_COLUMNS, Column("verdict", "critical speed")), rows, wide=wide)


_COLUMNS = (
    Column("creep_law", "creep law"),
    Column("criterion", "by"),
    Column("critical_speed_kmh"),
    Column("status"),
)
_NAMES = tuple(column.name for column in _COLUMNS)


def check_laws(laws: Sequence[str], option: str) -> None:
    """Refuse names that are no creep law, or stand there twice.

    Raises
    ------
    ConfigError
        Naming the option, the name and what is expected.
    """
    for law in laws:
        if law not in LAWS:
            raise ConfigError(f"{option} {law}: unknown creep law; expected {', '.join(LAWS)}")
        if laws.count(law) > 1:
            raise ConfigError(f"{option}: '{law}' stands there twice")


def with_law(scenario: Scenario, law: str) -> Scenario:
    """Return the same scenario with another creep law."""
    contact = scenario.contact.model_copy(update={"creep_law": law})
    return scenario.model_copy(update={"contact": contact})
