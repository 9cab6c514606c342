"""Which policy is best? All on the same conditions, that none was tuned or trained on, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sayd_env.config.comparison import ComparisonConfig, CriticalSpeedConfig
from sayd_env.config.environment import load_environment
from sayd_env.config.frozen import frozen
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Table
from sayd_env.report.figures import Plot
from sayd_env.report.files import Progress, silent
from sayd_env.runs.policies import PolicySpec
from sayd_env.studies.comparison.entrants import PAPER, Contestant, provenance
from sayd_env.studies.comparison.grid import (
    FILTERS,
    OWN,
    Arena,
    Keeper,
    Runs,
    Variant,
    constant,
    run_all,
    variants,
)
from sayd_env.studies.comparison.scores import (
    STABLE_TO,
    Bound,
    Score,
    Stability,
    Target,
    best_constants,
    least_stable,
    score,
    stability_of,
    targets,
)
from sayd_env.studies.comparison.statistics import Bootstrap
from sayd_env.studies.map import MapGrid, MapResult, stability_map

if TYPE_CHECKING:
    from rich.console import Console

Array = npt.NDArray[np.float64]
KMH = 3.6
MATRIX = ("J", "J_offline", "acceleration_ratio", "track_shift_ratio", "valve_mean")


@dataclass(frozen=True)
class CompareResult:
    """A comparison."""

    arena: Arena
    contestants: tuple[Contestant, ...]
    runs: Mapping[str, Runs]
    """By the titles of all members."""
    costs: Mapping[Variant, Mapping[str, Array]]
    """By contestant: shape (training seeds, conditions, seeds)."""
    scores: Mapping[Variant, Mapping[str, Score]]
    bounds: Mapping[Variant, Bound]
    stability: Mapping[str, Stability]
    """By the titles of all members."""
    learned: tuple[Mapping[str, Any], ...]
    """Where the learned policies come from."""
    quick: bool = False
    reused: int = 0
    """Runs that an earlier start had finished."""

    @property
    def config(self) -> ComparisonConfig:
        """The conditions."""
        return self.arena.config

    def stability_of(self, contestant: Contestant) -> Stability:
        """Stability of a contestant: that of its least stable member."""
        return least_stable([self.stability[title] for title in contestant.titles])

    def field(self, contestant: Contestant, name: str) -> Array:
        """A field of `CompareRun`, shape (training seeds, conditions, seeds)."""
        return np.stack([self.runs[title][name] for title in contestant.titles])

    def largest_ratios(self, contestant: Contestant) -> tuple[float, float]:
        """Largest ratios of all runs to the limits of acceleration and track shift force."""
        acceleration, force = (
            float(self.field(contestant, name).max()) for name in ("acceleration_ratio", "track_shift_ratio")
        )
        return acceleration, force

    def derailed(self, contestant: Contestant) -> int:
        """Runs that derailed."""
        return int(np.count_nonzero(np.isinf(self.field(contestant, "acceleration_ratio"))))

    @property
    def missing(self) -> tuple[str, ...]:
        """The paper's controllers that do not take part; with one missing there are no targets."""
        names = [contestant.name for contestant in self.contestants]
        return tuple(name for name in PAPER if name not in names)

    @property
    def targets(self) -> list[Target]:
        """What learned policies were to reach."""
        if self.missing:
            return []
        return [
            row
            for each in self.contestants
            if each.learned
            for row in targets(
                each,
                {variant: found[each.name] for variant, found in self.scores.items()},
                self.stability_of(each),
                max(self.largest_ratios(each)),
            )
        ]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd compare --json``; arrays over scenarios are in the order of ``scenarios``."""
        return {
            "scores": {each.name: self._score_dict(each) for each in self.contestants},
            "scenarios": [
                {**condition.as_dict(), "seed": seed}
                for condition in self.arena.conditions
                for seed in self.config.seeds
            ],
            "critical_speed_kmh": {
                each.name: self.stability_of(each).critical_speed_kmh for each in self.contestants
            },
            "stability": {each.name: self._stability_dict(each) for each in self.contestants},
            "targets": [asdict(row) for row in self.targets],
            "best_constant": self._bound_dict(),
            "matrix": {each.name: self._matrix(each) for each in self.contestants},
            "learned": self.learned,
            "frozen": frozen(self.arena.scenario, self.arena.environment),
            "quick": self.quick,
        }

    def _score_dict(self, contestant: Contestant) -> dict[str, Any]:
        own = self.scores[OWN][contestant.name]
        acceleration, force = self.largest_ratios(contestant)
        by_filter: dict[str, Any] = {
            filter_: {
                f"{factor:g}": self.scores[Variant(filter_, factor)][contestant.name].as_dict()
                for factor in self.config.force_weights
            }
            for filter_ in FILTERS
        }
        return {
            "iqm": own.to_mppt2.value,
            "ci95": own.to_mppt2.interval,
            "worst_vs_passive": own.worst_vs_passive,
            "J": own.mean,
            "J_offline": self.scores[Variant("offline", 1.0)][contestant.name].mean,
            "largest_acceleration_ratio": acceleration,
            "largest_track_shift_ratio": force,
            "derailed": self.derailed(contestant),
            "force_rms_n": _mean(self.field(contestant, "force_rms_n")),
            "comfort": _mean(self.field(contestant, "comfort")),
            "valve_mean": _mean(self.field(contestant, "valve_mean")),
            "valve_travel_per_km": _mean(self.field(contestant, "valve_travel_per_km")),
            "switching_per_s": _mean(self.field(contestant, "switching_per_s")),
            "training_seeds": len(contestant.members),
            **by_filter,
        }

    def _stability_dict(self, contestant: Contestant) -> dict[str, Any]:
        members = {title: self.stability[title].as_dict() for title in contestant.titles}
        return {**self.stability_of(contestant).as_dict(), "members": members}

    def _bound_dict(self) -> dict[str, Any]:
        own, offline = self.bounds[OWN], self.bounds[Variant("offline", 1.0)]
        return {
            "J": float(own.costs.mean()),
            "J_offline": float(offline.costs.mean()),
            "conditions": [
                {
                    "condition": condition.as_dict(),
                    "current": own.currents[i],
                    "J": own.costs[0, i].mean(),
                    "current_offline": offline.currents[i],
                    "J_offline": offline.costs[0, i].mean(),
                }
                for i, condition in enumerate(self.arena.conditions)
            ],
        }

    def _matrix(self, contestant: Contestant) -> dict[str, Any]:
        table = {name: values.reshape(len(values), -1) for name, values in self.columns(contestant).items()}
        return {"training_seeds": contestant.titles, **table}

    def columns(self, contestant: Contestant) -> dict[str, Array]:
        """What the score matrix holds, each of shape (training seeds, conditions, seeds)."""
        costs = {
            "J": self.costs[OWN][contestant.name],
            "J_offline": self.costs[Variant("offline", 1.0)][contestant.name],
        }
        return costs | {name: self.field(contestant, name) for name in MATRIX[2:]}

    def tables(self) -> dict[str, Table]:
        """Scores of all variants, the score matrix, targets and the best constant commands."""
        from sayd_env.studies.comparison.page import tables  # noqa: PLC0415 - it knows this class

        return tables(self)

    def plots(self) -> dict[str, Plot]:
        """One page."""
        from sayd_env.studies.comparison.figures import draw  # noqa: PLC0415 - it knows this class

        return {"compare": lambda figure: draw(self, figure)}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the scores, then the targets."""
        from sayd_env.studies.comparison.page import show  # noqa: PLC0415 - it knows this class

        show(self, console, wide)


def compare(
    config: ComparisonConfig,
    contestants: Sequence[Contestant],
    *,
    quick: bool = False,
    folder: Path | None = None,
    workers: int | None = None,
    progress: Progress = silent,
) -> CompareResult:
    """Compare policies on the same conditions.

    Parameters
    ----------
    config : ComparisonConfig
    contestants : sequence of Contestant
        The passive vehicle and MPPT2 among them.
    quick : bool
        A look at a few of the conditions, see `fewer`.
    folder : Path, optional
        Where finished runs are kept, so that an interrupted comparison goes on from there.
    workers : int, optional
        Threads.
    progress : Progress
        Told after each run.

    Raises
    ------
    ConfigError
        Conditions that cannot be, a policy that does not fit, a folder that cannot be written to.
    StudyError
        A run that diverged.
    """
    chosen = fewer(config) if quick else config
    arena = Arena.of(chosen)
    study = _critical_study(chosen.critical_speed)
    learned = tuple(provenance(p) for each in contestants if each.learned for p in each.members)
    members = [member for each in contestants for member in each.members]
    bounding = [constant(current) for current in chosen.constants]
    keeper = Keeper(folder, arena)
    runs = run_all(arena, members, keeper, workers=workers, progress=_named(progress, "conditions"))
    new = [policy for policy in bounding if policy.title not in runs]
    constants = runs | run_all(
        arena, new, keeper, workers=workers, progress=_named(progress, "constant currents")
    )
    cells = _critical_speeds(study, chosen.critical_speed, members, folder, workers, progress)
    costs = {
        variant: {
            each.name: np.stack([arena.costs(runs[title], variant) for title in each.titles])
            for each in contestants
        }
        for variant in variants(chosen)
    }
    bounds = {
        variant: best_constants(
            chosen.constants, [arena.costs(constants[policy.title], variant)[None] for policy in bounding]
        )
        for variant in costs
    }
    return CompareResult(
        arena=arena,
        contestants=tuple(contestants),
        runs=runs,
        costs=costs,
        scores=_scores(arena, costs, bounds, [each.name for each in contestants if not each.learned]),
        bounds=bounds,
        stability={cell.policy: stability_of(cell) for cell in cells.cells},
        learned=learned,
        quick=quick,
        reused=keeper.finish() + cells.reused,
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
    folder: Path | None,
    workers: int | None,
    progress: Progress,
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
        folder=folder,
        workers=workers,
        progress=lambda done, total, what="": progress(done, total, f"critical speed: {what}"),
    )


def _scores(
    arena: Arena,
    costs: Mapping[Variant, Mapping[str, Array]],
    bounds: Mapping[Variant, Bound],
    controllers: Sequence[str],
) -> dict[Variant, dict[str, Score]]:
    settings = arena.config
    bootstrap = Bootstrap(len(arena.conditions), len(settings.seeds), settings.bootstrap)
    return {
        variant: {
            name: score(name, table, bounds[variant].costs, arena.conditions, bootstrap, controllers)
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


def _named(progress: Progress, what: str) -> Progress:
    return lambda done, total, _="": progress(done, total, what)


def _mean(values: Array) -> float:
    """Mean, NaN where nothing was measured, and infinite where a run derailed."""
    return float(values.mean())
