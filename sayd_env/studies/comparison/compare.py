"""Which policy is best? All on the same conditions, that none was tuned or trained on, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from sayd_env.config.comparison import ComparisonConfig, CriticalSpeedConfig
from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.units import KMH, Array
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Table
from sayd_env.report.figures import Plot
from sayd_env.runs.context import RunContext
from sayd_env.runs.policies import PolicySpec
from sayd_env.studies.comparison import page
from sayd_env.studies.comparison.entrants import Entrant, provenance
from sayd_env.studies.comparison.figures import draw
from sayd_env.studies.comparison.grid import (
    ScenarioGrid,
    Variant,
    constant,
    run_all,
    variants,
)
from sayd_env.studies.comparison.result import Comparison
from sayd_env.studies.comparison.scores import (
    STABLE_TO,
    Bound,
    Score,
    best_constants,
    score,
    stability_of,
)
from sayd_env.studies.comparison.statistics import Bootstrap
from sayd_env.studies.map import MapGrid, MapResult, stability_map

if TYPE_CHECKING:
    from rich.console import Console


class CompareResult(Comparison):
    """A comparison and how it is shown."""

    def tables(self) -> dict[str, Table]:
        """Scores of all variants, the score matrix, targets and the best constant commands."""
        return page.tables(self)

    def plots(self) -> dict[str, Plot]:
        """One page."""
        return {"compare": lambda figure: draw(self, figure)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the scores, then the targets."""
        page.show(self, console, wide)


def compare(
    config: ComparisonConfig,
    entrants: Sequence[Entrant],
    *,
    quick: bool = False,
    context: RunContext | None = None,
) -> CompareResult:
    """Compare policies on the same conditions.

    Parameters
    ----------
    config : ComparisonConfig
    entrants : sequence of Entrant
        The passive vehicle and MPPT2 among them.
    quick : bool
        A look at a few of the conditions, see `fewer`.
    context : RunContext, optional

    Raises
    ------
    ConfigError
        Conditions that cannot be, a policy that does not fit.
    StudyError
        A run that diverged.
    """
    chosen = fewer(config) if quick else config
    grid = ScenarioGrid.of(chosen)
    study = _critical_study(chosen.critical_speed)
    learned = tuple(provenance(p) for each in entrants if each.learned for p in each.members)
    members = [member for each in entrants for member in each.members]
    bounding = [constant(current) for current in chosen.constants]
    context = context or RunContext()
    runs = run_all(grid, members, context, "conditions")
    new = [policy for policy in bounding if policy.title not in runs]
    constants = runs | run_all(grid, new, context, "constant currents")
    cells = _critical_speeds(study, chosen.critical_speed, members, context)
    costs = {
        variant: {
            each.name: np.stack([grid.costs(runs[title], variant) for title in each.titles])
            for each in entrants
        }
        for variant in variants(chosen)
    }
    bounds = {
        variant: best_constants(
            chosen.constants, [grid.costs(constants[policy.title], variant)[None] for policy in bounding]
        )
        for variant in costs
    }
    return CompareResult(
        grid=grid,
        entrants=tuple(entrants),
        runs=runs,
        costs=costs,
        scores=_scores(grid, costs, bounds, [each.name for each in entrants if not each.learned]),
        bounds=bounds,
        stability={cell.policy: stability_of(cell) for cell in cells.cells},
        learned=learned,
        quick=quick,
    )


def _critical_study(settings: CriticalSpeedConfig) -> Scenario:
    """Scenario in which the critical speed is looked for; refused before any work."""
    study = load_scenario(settings.study, [f"wear={settings.wear!r}"], option="critical_speed")
    model = VehicleModel(study)
    for kmh in settings.speeds_kmh:
        model.check_speed(kmh / KMH)
    return study


def _critical_speeds(
    study: Scenario,
    settings: CriticalSpeedConfig,
    policies: Sequence[PolicySpec],
    context: RunContext,
) -> MapResult:
    """One cell of the map for each policy."""
    speeds = tuple(kmh / KMH for kmh in settings.speeds_kmh)
    return stability_map(
        study,
        policies,
        settings.seeds,
        grid=MapGrid(wear=(study.wear,), friction=(study.friction,), speeds=speeds),
        best_constant=False,
        environment=load_environment(),
        context=context,
    )


def _scores(
    grid: ScenarioGrid,
    costs: Mapping[Variant, Mapping[str, Array]],
    bounds: Mapping[Variant, Bound],
    controllers: Sequence[str],
) -> dict[Variant, dict[str, Score]]:
    settings = grid.config
    bootstrap = Bootstrap(len(grid.conditions), len(settings.seeds), settings.bootstrap)
    return {
        variant: {
            name: score(name, table, bounds[variant].costs, grid.conditions, bootstrap, controllers)
            for name in table
        }
        for variant, table in costs.items()
    }


def fewer(config: ComparisonConfig) -> ComparisonConfig:
    """A few of the conditions, one seed: for a look at what comes out."""
    speeds, grid = config.speeds_kmh, config.critical_speed
    judged = [kmh for kmh in grid.speeds_kmh if kmh <= STABLE_TO][-1:]
    few = tuple(sorted({grid.speeds_kmh[0], *judged, grid.speeds_kmh[-1]}))
    reduced = grid.model_copy(update={"speeds_kmh": few, "seeds": grid.seeds[:1]})
    return config.model_copy(
        update={
            "tracks": config.tracks[:1],
            "speeds_kmh": tuple(dict.fromkeys((speeds[len(speeds) // 2], speeds[-1]))),
            "wear": config.wear[-1:],
            "friction": config.friction[-1:],
            "seeds": config.seeds[:1],
            "constants": config.constants[:: max(len(config.constants) // 4, 1)],
            "critical_speed": reduced,
            "bootstrap": config.bootstrap.model_copy(update={"samples": min(config.bootstrap.samples, 1000)}),
        }
    )
