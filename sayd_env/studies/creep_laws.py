"""What the creep law carries: the critical speed by several creep laws, all else equal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sayd_env.config import ConfigError
from sayd_env.config.scenario import Scenario
from sayd_env.physics.contact.creep import LAWS

if TYPE_CHECKING:
    from rich.console import Console

    from sayd_env.studies.critical_speed import CriticalSpeedResult

KMH = 3.6
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

    def table(self) -> tuple[Sequence[str], list[list[Any]]]:
        """Critical speed (km/h) by law and criterion; empty where the grid does not hold it."""
        rows: list[list[Any]] = []
        for law, result in self.results.items():
            found = result.crossing()
            for name in _CRITERIA:
                speed, status = found[name].speed, found[name].crossing.name.lower()
                rows.append([law, name, None if speed is None else speed * KMH, status])
        return ("creep_law", "criterion", "critical_speed_kmh", "status"), rows

    def summary(self, console: Console, title: str) -> None:
        """Print the critical speeds by law."""
        from rich.table import Table  # noqa: PLC0415 - only who prints pays for it

        table = Table(title=title)
        table.add_column("creep law")
        for name in _CRITERIA:
            table.add_column(f"by {name.replace('_', ' ')}", justify="right")
        for law, result in self.results.items():
            table.add_row(law, *(result.verdict(name) for name in _CRITERIA))
        console.print(table)


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
