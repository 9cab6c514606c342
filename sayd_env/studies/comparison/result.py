"""What a comparison has measured: runs, J of every variant, scores, bounds, stability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sayd_env.config.comparison import ComparisonConfig
from sayd_env.config.digests import digests
from sayd_env.config.units import Array
from sayd_env.runs.metrics import RATIOS
from sayd_env.runs.policies import PAPER, TUNED
from sayd_env.studies.comparison.entrants import Entrant
from sayd_env.studies.comparison.grid import (
    AVERAGED,
    FILTERS,
    OFFLINE,
    OWN,
    TOGETHER,
    Runs,
    ScenarioGrid,
    Variant,
)
from sayd_env.studies.comparison.scores import Bound, Score, Stability, Target, least_stable, targets

MATRIX = ("J", "J_offline", *RATIOS, "valve_mean")


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
    """Of all conditions together."""
    parts: Mapping[str, Mapping[Variant, Mapping[str, Score]]]
    """Of stationary conditions and of lines, where there are some, by themselves."""
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

    @property
    def by_part(self) -> Mapping[str, Mapping[Variant, Mapping[str, Score]]]:
        """Scores by part, the last one all together; of a comparison without parts that one alone."""
        return {**(self.parts if len(self.parts) > 1 else {}), TOGETHER: self.scores}

    @property
    def missing(self) -> tuple[str, ...]:
        """Controllers of the paper and tuned ones that do not take part; with any missing no targets."""
        names = [entrant.name.partition("@")[0] for entrant in self.entrants]
        return tuple(name for name in (*PAPER, *TUNED) if name not in names)

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
                {
                    part: {
                        variant: found[each.name]
                        for variant, found in variants.items()
                        if variant.factor in self.config.force_weights
                    }
                    for part, variants in self.parts.items()
                },
                self.stability_of(each),
                max(float(self.field(each, name).max()) for name in RATIOS),
            )
        ]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd compare --json``; arrays over scenarios are in the order of ``scenarios``."""
        stability = {each.name: self.stability_of(each).as_dict() for each in self.entrants}
        return {
            "scores": {each.name: self.overview(each) | self._by_filter(each) for each in self.entrants},
            "scenarios": [
                {**condition.as_dict(), "seed": seed}
                for condition in self.grid.conditions
                for seed in self.config.seeds
            ],
            "critical_speed_kmh": {name: found["critical_speed_kmh"] for name, found in stability.items()},
            "stability": {
                each.name: stability[each.name]
                | {"members": {title: self.stability[title].as_dict() for title in each.titles}}
                for each in self.entrants
            },
            "targets": [asdict(row) for row in self.targets],
            "best_constant": {
                "J": self.bounds[OWN].costs.mean(),
                "J_offline": self.bounds[OFFLINE].costs.mean(),
                "conditions": self.best_constants(),
            },
            "matrix": {
                each.name: {"training_seeds": each.titles}
                | {name: values.reshape(len(values), -1) for name, values in self.columns(each).items()}
                for each in self.entrants
            },
            "learned": self.learned,
            "frozen": digests(self.grid.scenario, self.grid.environment),
            "quick": self.quick,
        }

    def overview(self, entrant: Entrant) -> dict[str, Any]:
        """How an entrant did on line, and how the vehicle fared; means are infinite where a run derailed."""
        own = self.scores[OWN][entrant.name]
        fields = {name: self.field(entrant, name) for name in (*RATIOS, *AVERAGED)}
        parts = {part: found[OWN][entrant.name] for part, found in self.by_part.items()}
        return {
            **own.relative_to_mppt2.as_dict(),
            "worst_vs_passive": own.worst_vs_passive,
            "J": own.J,
            "geometric_mean": {part: found.geometric.value for part, found in parts.items()},
            **{f"J_{part}": found.J for part, found in parts.items() if part != TOGETHER},
            **{
                column: self.scores[Variant("online", factor)][entrant.name].J
                for column, factor in self.grid.reported.items()
            },
            "J_offline": self.scores[OFFLINE][entrant.name].J,
            **{f"largest_{name}": float(fields[name].max()) for name in RATIOS},
            "derailed": int(np.count_nonzero(np.isinf(fields["acceleration_ratio"]))),
            **{name: float(fields[name].mean()) for name in AVERAGED},
            "training_seeds": len(entrant.members),
        }

    def _by_filter(self, entrant: Entrant) -> dict[str, Any]:
        def of(scores: Mapping[Variant, Mapping[str, Score]]) -> dict[str, Any]:
            return {
                filter_: {
                    f"{factor:g}": scores[Variant(filter_, factor)][entrant.name].as_dict()
                    for factor in self.grid.factors
                }
                for filter_ in FILTERS
            }

        parts = self.parts if len(self.parts) > 1 else {}
        return of(self.scores) | {part: of(scores) for part, scores in parts.items()}

    def best_constants(self) -> list[dict[str, Any]]:
        """The best constant command of each condition, and what it costs."""
        own, offline = self.bounds[OWN], self.bounds[OFFLINE]
        return [
            {
                "condition": condition.as_dict(),
                "current": own.currents[i],
                "J": own.costs[0, i].mean(),
                "current_offline": offline.currents[i],
                "J_offline": offline.costs[0, i].mean(),
            }
            for i, condition in enumerate(self.grid.conditions)
        ]

    def columns(self, entrant: Entrant) -> dict[str, Array]:
        """What the score matrix holds, each of shape (training seeds, conditions, seeds)."""
        costs = {"J": self.costs[OWN][entrant.name], "J_offline": self.costs[OFFLINE][entrant.name]}
        return costs | {name: self.field(entrant, name) for name in MATRIX[2:]}
