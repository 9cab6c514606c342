"""What the paper leaves open, found within sourced ranges from its statements on the passive vehicle.

A Latin hypercube screens the ranges with few track seeds; from its best point bounded least-squares searches
(trust-region reflective) go on with more seeds. The residuals are the three critical speeds' distances from
their targets and a penalty for every other row of P1 to P10, zero where the row holds with a margin.
Crossings are extrapolated beyond the speed grid, so that a search can start anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from sayd_env.config import StudyError
from sayd_env.config.calibration import CalibrationConfig, Search
from sayd_env.config.errors import Diverged
from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import KMH, Array
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Column, Table, print_table
from sayd_env.report.figures import Plot, panels
from sayd_env.runs.context import RunContext, silent
from sayd_env.runs.passive import Sweep, sweep
from sayd_env.stability import Limits
from sayd_env.studies.paper.passive_claims import PassiveMeasures
from sayd_env.studies.tuning.search import best_of, draw_costs, provenance_lines

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

WORST = 8.0
"""Largest penalty of one row: beyond it, further away is no worse, and other rows matter more."""
ROWS = tuple(f"P{i}" for i in range(1, 11))
TARGETS = {
    "P2": ("critical_new_kmh", 372.0, 6.0),
    "P5": ("critical_worn_kmh", 331.0, 5.0),
    "P8": ("critical_force_kmh", 361.0, 5.0),
}
"""Critical speeds (km/h) of three rows: target and scale."""
PRIOR = 0.05
"""Weight of a parameter's distance from the middle of its range: settles what the rows do not."""
DIVERGED = 1e3
"""Cost of parameters with which a run does not stay finite."""


@dataclass(frozen=True)
class Trial:
    """One set of parameters and what came out."""

    stage: str
    place: tuple[float, ...]
    """In the unit cube of the parameters' ranges."""
    cost: float
    """Sum of the squared residuals."""
    penalties: dict[str, float]
    measures: dict[str, float]

    @property
    def residuals(self) -> list[float]:
        """What the search makes small."""
        return residuals_of(self.penalties, self.measures) if self.measures else [WORST] * len(ROWS)


@dataclass(frozen=True)
class CalibrationResult:
    """All evaluations, in the order in which they were made."""

    config: CalibrationConfig
    evaluations: list[Trial]

    @property
    def best(self) -> Trial:
        """Best evaluation of the last stage that was reached."""
        return best_of(self.evaluations, self.evaluations[-1].stage)

    @property
    def values(self) -> dict[str, float]:
        """Calibrated value of each parameter, in its unit."""
        return self.config.values(self.best.place)

    def study(self) -> str:
        """Text of a study file that holds the calibrated numbers, as `configs/study/nominal.yaml` does."""
        config = self.config
        seeds = max((search.seeds for search in config.searches), default=config.screening_seeds)
        about = {
            "command": "sayd calibrate",
            "track_seeds": f"{config.first_seed} to {config.first_seed + seeds - 1}",
            "evaluations": len(self.evaluations),
            "cost": f"{self.best.cost:.3g}",
        }
        lines = [HEAD.format(base=config.base), *provenance_lines(about), "set:"]
        for p in config.parameters:
            value = self.values[p.name]
            lines.append(f"  # {p.name}: {value:.5g} {p.unit}, from {p.low:g} to {p.high:g}")
            lines += [f"  {key}: {number!r}" for key, number in p.assignments(value).items()]
        return "\n".join(lines) + "\n"

    def as_dict(self) -> dict[str, Any]:
        """Parameters, the assignments that set them, and the rows' penalties at the best point."""
        best = self.best
        return {
            "parameters": self.values,
            "set": assignments(self.config, best.place),
            "cost": best.cost,
            "penalties": best.penalties,
            "measures": best.measures,
            "evaluations": len(self.evaluations),
            "stage": best.stage,
        }

    def tables(self) -> dict[str, Table]:
        """Every evaluation."""
        rows = sorted({row for e in self.evaluations for row in e.penalties})
        lines = [
            [e.stage, e.cost, *self.config.values(e.place).values(), *map(e.penalties.get, rows)]
            for e in self.evaluations
        ]
        return {"evaluations": (("stage", "cost", *self.values, *rows), lines)}

    def plots(self) -> dict[str, Plot]:
        """Cost over the search."""
        return {"cost": self._draw}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the calibrated values and what is left of each row's penalty."""
        rows = [p.model_dump() | {"value": self.values[p.name]} for p in self.config.parameters]
        title = f"cost {self.best.cost:.3f} ({self.best.stage})"
        print_table(console, title, PARAMETERS, rows, wide=wide)
        left = {k: round(v, 2) for k, v in self.best.penalties.items() if v > 0.0}
        console.print(f"penalties left: {left or 'none'}")

    def _draw(self, figure: Figure) -> None:
        (axes,) = panels(figure, 1, size=(8.0, 4.5))
        draw_costs(axes, self.evaluations)
        axes.set(ylabel="cost", title="calibration", yscale="symlog")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.legend()


HEAD = """\
# The paper's conditions: the estimates, with calibrated numbers on top.
#
# Written by `sayd calibrate`, which found every number under `set` from rows P1 to P10 of
# the paper's statements on the passive vehicle, within the ranges that
# configs/study/calibration.yaml gives with their sources.
base: {base}
description: the EMU of the paper with passive yaw dampers"""
PARAMETERS = (
    Column("name", "parameter"),
    Column("value", "value"),
    Column("unit", "unit"),
    Column("low", "from"),
    Column("high", "to"),
    Column("source", "source", wide=True),
)
"""Of the printed table."""


def assignments(config: CalibrationConfig, place: Sequence[float]) -> dict[str, float]:
    """Scenario keys and their values at a place of the unit cube, to five digits."""
    places = zip(config.parameters, place, strict=True)
    return {key: number for p, u in places for key, number in p.assignments(p.value(float(u))).items()}


def calibrate(
    config: CalibrationConfig, *, seed: int = 0, context: RunContext | None = None
) -> CalibrationResult:
    """Search for the parameters that meet most of rows P1 to P10.

    The seed is that of the Latin hypercube, not of the tracks.

    Raises
    ------
    StudyError
        No parameters gave a finite run.
    """
    context = context or RunContext()
    runs = replace(context, progress=silent)
    each = len(config.parameters) + 1
    total = config.screening_samples + sum(1 + s.iterations * each for s in config.searches)
    evaluations: list[Trial] = []

    def evaluate(stage: str, place: Array, seeds: int) -> Trial:
        key = tuple(round(float(u), 9) for u in np.clip(place, 0.0, 1.0))
        found = _evaluate(config, stage, key, seeds, runs)
        evaluations.append(found)
        best = best_of(evaluations, stage)
        context.progress(min(len(evaluations), total), total, f"{stage}, best cost {best.cost:.2f}")
        return found

    guess = [p.place(p.guess) for p in config.parameters]
    cube = qmc.LatinHypercube(len(guess), seed=seed).random(config.screening_samples - 1)
    for place in [np.array(guess), *cube]:
        evaluate("screening", place, config.screening_seeds)
    if best_of(evaluations).cost >= DIVERGED:
        raise StudyError("calibration: no parameters within the ranges gave a finite run")
    result = CalibrationResult(config, evaluations)
    for search in config.searches:
        _search(search, np.array(result.best.place), evaluate)
    return result


def _search(search: Search, start: Array, evaluate: Callable[[str, Array, int], Trial]) -> None:
    def residuals(shifted: Array) -> Array:
        found = evaluate(search.name, shifted - 1.0, search.seeds)
        return np.array([*found.residuals, *(PRIOR * (shifted - 1.5))])

    # Places run from 1 to 2 here: the difference step is relative, and 0 would have none.
    least_squares(
        residuals,
        np.clip(start, 0.01, 0.99) + 1.0,
        bounds=(1.0, 2.0),
        diff_step=search.step,
        max_nfev=search.iterations + 1,
        x_scale=0.2,
    )


def _evaluate(
    config: CalibrationConfig, stage: str, place: tuple[float, ...], seeds: int, context: RunContext
) -> Trial:
    keys = [f"{key}={value!r}" for key, value in assignments(config, place).items()]
    tracks = range(config.first_seed, config.first_seed + seeds)
    try:
        new_wheels, worn_wheels = (load_scenario(config.base, [*keys, f"wear={wear}"]) for wear in (0.0, 1.0))
        new = sweep(new_wheels, config.new_speeds, tracks, context)
        worn = sweep(worn_wheels, config.worn_speeds, tracks, context)
    except Diverged:
        return Trial(stage, place, DIVERGED, {}, {})
    penalties, measures = penalties_of(new, worn, model_limits(VehicleModel(new_wheels)))
    cost = float(np.sum(np.square(residuals_of(penalties, measures))))
    return Trial(stage, place, cost, penalties, measures)


def residuals_of(penalties: dict[str, float], measures: dict[str, float]) -> list[float]:
    """Distances of the critical speeds from their targets, and the other rows' penalties."""
    signed = [(measures[key] - target) / scale for key, target, scale in TARGETS.values()]
    others = [value for row, value in penalties.items() if row not in TARGETS]
    return [*np.clip(signed, -WORST, WORST).tolist(), *others]


def penalties_of(new: Sweep, worn: Sweep, limits: Limits) -> tuple[dict[str, float], dict[str, float]]:
    """Penalty of each row P1 to P10 (0: holds with a margin), and the numbers behind them."""
    m = PassiveMeasures(new, worn, limits)
    spread = m.frequency_spread(m.all)
    above = float(np.max(spread[m.high]))
    crossing = (m.new_acceleration, m.worn_acceleration, m.worn_force)
    v2, v5, v8 = (criterion.extrapolated_kmh() for criterion in crossing)
    x = measures = {
        "stable_280": float(np.quantile(m.stable_280(), 0.8)),
        "critical_new_kmh": v2,
        "frequency_hz": float(np.interp(v2 / KMH, new.speeds, np.median(new.frequency, axis=(1, 2)))),
        "ratio_320": float(np.quantile(m.ratios_320(), 0.85)),
        "critical_worn_kmh": v5,
        "ratio_350": float(np.quantile(m.lowest_ratio_above(), 0.15)),
        "smallest_rise": m.smallest_rise(m.all),
        "critical_force_kmh": v8,
        "trailing_ratio": float(np.quantile(m.trailing_ratio(), 0.2)),
        "spread_350_hz": above,
        "spread_320_hz": float(spread[m.low]),
        "frequency_rise_hz": m.frequency_rise(m.all),
    }
    penalties = {
        "P1": _over(x["stable_280"], 0.42, 0.05),
        "P2": _over(abs(v2 - 372.0), 4.0, 6.0),
        "P3": _over(abs(x["frequency_hz"] - 4.0), 0.3, 0.1),
        "P4": _over(x["ratio_320"], 0.96, 0.04),
        "P5": _over(abs(v5 - 331.0), 4.0, 5.0),
        "P6": _over(1.05, x["ratio_350"], 0.04),
        "P7": _over(0.02, x["smallest_rise"], 0.02),
        "P8": _over(abs(v8 - 361.0), 6.0, 5.0),
        "P9": _over(1.15, x["trailing_ratio"], 0.05),
        "P10": _over(above, 0.22, 0.1)
        + _over(0.05, x["frequency_rise_hz"], 0.05)
        + _over(above + 0.1, x["spread_320_hz"], 0.1),
    }
    return {k: min(v, WORST) for k, v in penalties.items()}, measures


def _over(value: float, bound: float, scale: float) -> float:
    """How far a value exceeds a bound, in units of the scale."""
    return max(0.0, (value - bound) / scale)
