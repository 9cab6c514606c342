"""What a comparison has measured: runs, J of every variant, scores, bounds, stability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sayd_env.config.comparison import ComparisonConfig
from sayd_env.config.fingerprint import fingerprint
from sayd_env.config.units import Array
from sayd_env.runs.policies import PAPER
from sayd_env.studies.comparison.entrants import Entrant
from sayd_env.studies.comparison.grid import (
    FILTERS,
    OWN,
    Runs,
    ScenarioGrid,
    Variant,
)
from sayd_env.studies.comparison.scores import (
    Bound,
    Score,
    Stability,
    Target,
    least_stable,
    targets,
)

if TYPE_CHECKING:
    pass

MATRIX = ("J", "J_offline", "acceleration_ratio", "track_shift_ratio", "valve_mean")


@dataclass(frozen=True)
class Comparison:
    """What a comparison has measured."""

    grid: ScenarioGrid
    entrants: tuple[Entrant, ...]
    runs: Mapping[str, Runs]
    """By the titles of all members."""
    costs: Mapping[Variant, Mapping[str, Array]]
    """By entrant: shape (training seeds, conditions, seeds)."""
    scores: Mapping[Variant, Mapping[str, Score]]
    bounds: Mapping[Variant, Bound]
    stability: Mapping[str, Stability]
    """By the titles of all members."""
    learned: tuple[Mapping[str, Any], ...]
    """Where the learned policies come from."""
    quick: bool = False

    @property
    def config(self) -> ComparisonConfig:
        """The conditions."""
        return self.grid.config

    def stability_of(self, entrant: Entrant) -> Stability:
        """Stability of a entrant: that of its least stable member."""
        return least_stable([self.stability[title] for title in entrant.titles])

    def field(self, entrant: Entrant, name: str) -> Array:
        """A field of `MEASURED`, shape (training seeds, conditions, seeds)."""
        return np.stack([self.runs[title][name] for title in entrant.titles])

    def largest_ratios(self, entrant: Entrant) -> tuple[float, float]:
        """Largest ratios of all runs to the limits of acceleration and track shift force."""
        acceleration, force = (
            float(self.field(entrant, name).max()) for name in ("acceleration_ratio", "track_shift_ratio")
        )
        return acceleration, force

    def derailed(self, entrant: Entrant) -> int:
        """Runs that derailed."""
        return int(np.count_nonzero(np.isinf(self.field(entrant, "acceleration_ratio"))))

    @property
    def missing(self) -> tuple[str, ...]:
        """The paper's controllers that do not take part; with one missing there are no targets."""
        names = [entrant.name for entrant in self.entrants]
        return tuple(name for name in PAPER if name not in names)

    @property
    def targets(self) -> list[Target]:
        """What learned policies were to reach."""
        if self.missing:
            return []
        return [
            row
            for each in self.entrants
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
            "scores": {each.name: self._score_dict(each) for each in self.entrants},
            "scenarios": [
                {**condition.as_dict(), "seed": seed}
                for condition in self.grid.conditions
                for seed in self.config.seeds
            ],
            "critical_speed_kmh": {
                each.name: self.stability_of(each).critical_speed_kmh for each in self.entrants
            },
            "stability": {each.name: self._stability_dict(each) for each in self.entrants},
            "targets": [asdict(row) for row in self.targets],
            "best_constant": self._bound_dict(),
            "matrix": {each.name: self._matrix(each) for each in self.entrants},
            "learned": self.learned,
            "frozen": fingerprint(self.grid.scenario, self.grid.environment),
            "quick": self.quick,
        }

    def _score_dict(self, entrant: Entrant) -> dict[str, Any]:
        own = self.scores[OWN][entrant.name]
        acceleration, force = self.largest_ratios(entrant)
        by_filter: dict[str, Any] = {
            filter_: {
                f"{factor:g}": self.scores[Variant(filter_, factor)][entrant.name].as_dict()
                for factor in self.config.force_weights
            }
            for filter_ in FILTERS
        }
        return {
            "iqm": own.to_mppt2.value,
            "ci95": own.to_mppt2.interval,
            "worst_vs_passive": own.worst_vs_passive,
            "J": own.mean,
            "J_offline": self.scores[Variant("offline", 1.0)][entrant.name].mean,
            "largest_acceleration_ratio": acceleration,
            "largest_track_shift_ratio": force,
            "derailed": self.derailed(entrant),
            "force_rms_n": _mean(self.field(entrant, "force_rms_n")),
            "comfort": _mean(self.field(entrant, "comfort")),
            "valve_mean": _mean(self.field(entrant, "valve_mean")),
            "valve_travel_per_km": _mean(self.field(entrant, "valve_travel_per_km")),
            "switching_per_s": _mean(self.field(entrant, "switching_per_s")),
            "training_seeds": len(entrant.members),
            **by_filter,
        }

    def _stability_dict(self, entrant: Entrant) -> dict[str, Any]:
        members = {title: self.stability[title].as_dict() for title in entrant.titles}
        return {**self.stability_of(entrant).as_dict(), "members": members}

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
                for i, condition in enumerate(self.grid.conditions)
            ],
        }

    def _matrix(self, entrant: Entrant) -> dict[str, Any]:
        table = {name: values.reshape(len(values), -1) for name, values in self.columns(entrant).items()}
        return {"training_seeds": entrant.titles, **table}

    def columns(self, entrant: Entrant) -> dict[str, Array]:
        """What the score matrix holds, each of shape (training seeds, conditions, seeds)."""
        costs = {
            "J": self.costs[OWN][entrant.name],
            "J_offline": self.costs[Variant("offline", 1.0)][entrant.name],
        }
        return costs | {name: self.field(entrant, name) for name in MATRIX[2:]}


def _mean(values: Array) -> float:
    """Mean, NaN where nothing was measured, and infinite where a run derailed."""
    return float(values.mean())
