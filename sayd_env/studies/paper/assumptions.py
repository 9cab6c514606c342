"""How much each assumption carries: the rows and the critical speeds, judged again under another one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

from sayd_env.report.columns import Column
from sayd_env.studies.paper.claims import Verdict
from sayd_env.studies.paper.judged import Judged

ByAssumption: TypeAlias = Mapping[str, Judged]
"""The rows under each assumption by its name, the study's own first."""
OWN = "study"
"""Name of the study's own assumptions."""

VERDICTS = tuple(map(Column, ("id", "assumption", "seeds", "expected", "measured", "fraction", "holds")))
"""Of the CSV table."""
CRITICAL_SPEEDS = (
    Column("assumption", "assumption"),
    Column("seeds", "seeds"),
    Column("wheels", "wheels"),
    Column("criterion", "by"),
    Column("critical_speed_kmh", "km/h", digits=0),
    Column("over_seeds", "80 % of the seeds"),
    Column("seeds_10_kmh"),
    Column("seeds_90_kmh"),
    Column("status", "status", wide=True),
    Column("sensitive_to_grid", "sensitive to grid", wide=True),
)


def verdict_rows(found: ByAssumption) -> list[dict[str, Any]]:
    """One entry for each row and assumption, by the names of `VERDICTS`."""
    return [
        {"assumption": name, "seeds": len(judged.new.seeds)}
        | {column.name: column.of(claim) for column in VERDICTS if hasattr(claim, column.name)}
        for claims in zip(*(judged.claims for judged in found.values()), strict=True)
        for (name, judged), claim in zip(found.items(), claims, strict=True)
    ]


def speed_rows(found: ByAssumption) -> list[dict[str, Any]]:
    """One entry for each critical speed, by the names of `CRITICAL_SPEEDS`."""
    return [
        {"assumption": name, "seeds": len(judged.new.seeds)} | row
        for name, judged in found.items()
        for row in judged.critical_speeds()
    ]


def side_by_side(found: ByAssumption) -> tuple[list[Column], list[dict[str, str]]]:
    """Columns and rows of the table that is printed: a row for each statement, a column an assumption."""
    columns = [
        Column("id", "row"),
        *(
            Column(name, f"{name}, {len(judged.new.seeds)} seeds", bad=lambda text: text.startswith("no"))
            for name, judged in found.items()
        ),
    ]
    rows = [
        {"id": claims[0].id} | {name: _words(c.verdict) for name, c in zip(found, claims, strict=True)}
        for claims in zip(*(judged.claims for judged in found.values()), strict=True)
    ]
    return columns, rows


def _words(verdict: Verdict) -> str:
    return f"{'yes' if verdict.holds else 'no'}, {100 * (verdict.fraction or 0.0):.0f} %"
