"""Which policy is best? All on the same conditions, that none was tuned or trained on, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np

from sayd_env.config.comparison import BootstrapConfig, ComparisonConfig
from sayd_env.config.environment import load_environment
from sayd_env.config.units import KMH
from sayd_env.runs.context import RunContext
from sayd_env.runs.policies import constant_spec
from sayd_env.studies.comparison.entrants import Entrant, provenance
from sayd_env.studies.comparison.grid import (
    FILTERS,
    STATIONARY,
    ScenarioGrid,
    Variant,
    checked_scenario,
    run_all,
)
from sayd_env.studies.comparison.page import CompareResult
from sayd_env.studies.comparison.scores import (
    STABLE_TO,
    Bound,
    CostsByPolicy,
    Score,
    best_constants,
    score,
    stability_of,
)
from sayd_env.studies.comparison.statistics import Bootstrap
from sayd_env.studies.map import MapGrid, stability_map


def compare(
    config: ComparisonConfig,
    entrants: Sequence[Entrant],
    *,
    quick: bool = False,
    context: RunContext | None = None,
) -> CompareResult:
    """Compare policies, the passive vehicle and MPPT2 among them, on the same conditions.

    `quick` is a look at a few of the conditions, see `fewer`.

    Raises
    ------
    ConfigError
        Conditions that cannot be, a policy that does not fit.
    StudyError
        A run that diverged.
    """
    chosen = fewer(config) if quick else config
    grid = ScenarioGrid.of(chosen)
    worn = chosen.critical_speed
    study = checked_scenario(worn.study, f"wear={worn.wear!r}", "critical_speed", worn.speeds_kmh)
    learned = tuple(provenance(p) for each in entrants if each.learned for p in each.members)
    members = [member for each in entrants for member in each.members]
    bounding = [constant_spec(current) for current in chosen.constants]
    context = context or RunContext()
    runs = run_all(grid, members, context, "conditions")
    new = [policy for policy in bounding if policy.title not in runs]
    constants = runs | run_all(grid, new, context, "constant currents")
    mapped = stability_map(
        study,
        members,
        worn.seeds,
        grid=MapGrid((study.wear,), (study.friction,), tuple(kmh / KMH for kmh in worn.speeds_kmh)),
        environment=load_environment(),
        context=context,
    )
    ways = [Variant(*each) for each in product(FILTERS, grid.factors)]
    costs = {
        variant: {
            each.name: np.stack([grid.costs(runs[title], variant) for title in each.titles])
            for each in entrants
        }
        for variant in ways
    }
    bounds = {
        variant: best_constants(
            chosen.constants, [grid.costs(constants[policy.title], variant)[None] for policy in bounding]
        )
        for variant in ways
    }
    bootstrap = chosen.bootstrap
    scores = _scores(grid, entrants, costs, bounds, bootstrap, slice(None))
    parts = {
        part: _scores(grid, entrants, costs, bounds, bootstrap, which) for part, which in grid.parts.items()
    }
    return CompareResult(
        grid=grid,
        entrants=tuple(entrants),
        runs=runs,
        costs=costs,
        scores=scores,
        parts=parts or {STATIONARY: scores},
        bounds=bounds,
        stability={cell.policy: stability_of(cell) for cell in mapped.cells},
        learned=learned,
        quick=quick,
    )


def _scores(
    grid: ScenarioGrid,
    entrants: Sequence[Entrant],
    costs: Mapping[Variant, CostsByPolicy],
    bounds: Mapping[Variant, Bound],
    settings: BootstrapConfig,
    which: slice,
) -> dict[Variant, dict[str, Score]]:
    """Scores of all in some of the conditions."""
    conditions = grid.conditions[which]
    controllers = [each.name for each in entrants if not each.learned]
    found = {}
    for variant, table in costs.items():
        bootstrap = Bootstrap(len(conditions), len(grid.config.seeds), settings)
        mine = {name: np.ascontiguousarray(values[:, which]) for name, values in table.items()}
        bound = np.ascontiguousarray(bounds[variant].costs[:, which])
        found[variant] = {name: score(name, mine, bound, conditions, bootstrap, controllers) for name in mine}
    return found


def fewer(config: ComparisonConfig) -> ComparisonConfig:
    """A few of the conditions, one line, one seed: for a look at what comes out."""
    speeds, lines, grid = config.speeds_kmh, config.lines, config.critical_speed
    judged = [kmh for kmh in grid.speeds_kmh if kmh <= STABLE_TO][-1:]
    few = tuple(sorted({grid.speeds_kmh[0], *judged, grid.speeds_kmh[-1]}))
    reduced = grid.model_copy(update={"speeds_kmh": few, "seeds": grid.seeds[:1]})
    return config.model_copy(
        update={
            "tracks": config.tracks[:1],
            "speeds_kmh": tuple(dict.fromkeys((speeds[len(speeds) // 2], speeds[-1]))),
            "wheels": config.wheels[-1:],
            "lines": None if lines is None else lines.model_copy(update={"seeds": lines.seeds[:1]}),
            "friction": config.friction[-1:],
            "seeds": config.seeds[:1],
            "constants": config.constants[:: max(len(config.constants) // 4, 1)],
            "critical_speed": reduced,
            "bootstrap": config.bootstrap.model_copy(update={"samples": min(config.bootstrap.samples, 1000)}),
        }
    )
