"""Does the model show what the paper shows? Every statement, measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import TYPE_CHECKING, Any

from sayd_env.config import ConfigError
from sayd_env.config.damper import PassiveDamperConfig
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.scenario import Scenario
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics import sayd
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Table, csv_table, json_rows, print_table
from sayd_env.report.figures import Plot
from sayd_env.runs.context import RunContext
from sayd_env.runs.controlled import ControlledRuns, controlled_runs
from sayd_env.runs.passive import LAW_SPEEDS, NEW_SPEEDS, WORN_SPEEDS, Sweep, runs_table, sweep
from sayd_env.stability import Limits
from sayd_env.studies.components.conicity import conicity, plot_conicity
from sayd_env.studies.components.hysteresis import HysteresisResult, hysteresis
from sayd_env.studies.critical_speed import (
    CreepLawComparison,
    check_laws,
    compare_laws,
    draw_trends,
    wheelset_names,
)
from sayd_env.studies.paper import control_periods as periods
from sayd_env.studies.paper.claims import CLAIMS, Claim, once
from sayd_env.studies.paper.controlled_claims import controlled_claims, required_runs, skyhook_runs
from sayd_env.studies.paper.figures import controlled_plots
from sayd_env.studies.paper.page import reproduce_page
from sayd_env.studies.paper.passive_claims import passive_claims

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

ROWS = (
    *(f"P{i}" for i in range(1, 12)),
    *(f"M{i}" for i in range(1, 10)),
    *(f"S{i}" for i in range(1, 7)),
    "C1",
    "C2",
)
"""Names of the rows, in the order of the table."""
LEAST_SEEDS = 10
"""Track realisations that a verdict needs."""


@dataclass(frozen=True)
class ReproduceResult:
    """The table of claims and what it rests on."""

    scenario: Scenario
    claims: list[Claim]
    new: Sweep
    worn: Sweep
    limits: Limits
    wheelsets: tuple[str, ...]
    loops: HysteresisResult
    controlled: ControlledRuns
    """Runs with semi-active dampers."""
    by_period: periods.PeriodClaims = field(default_factory=dict)
    """Rows S1 to S6 at other control periods."""
    creep_laws: Mapping[str, CreepLawComparison] = field(default_factory=dict)
    """Critical speeds on new and on worn wheels by creep law."""

    @property
    def failed(self) -> list[str]:
        """Rows that do not hold."""
        return [c.id for c in self.claims if not c.holds]

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd reproduce --json``."""
        laws = {wheels: found.as_dict() for wheels, found in self.creep_laws.items()}
        return {
            "claims": json_rows(CLAIMS, self.claims),
            "seeds": list(self.new.seeds),
            **({"control_periods": periods.period_rows(self.by_period)} if self.by_period else {}),
            **({"by_creep_law": laws} if laws else {}),
        }

    def tables(self) -> dict[str, Table]:
        """Claims, and every run."""
        by_period = csv_table(periods.COLUMNS, periods.period_rows(self.by_period))
        return {
            "claims": csv_table(CLAIMS, self.claims),
            "runs_new": runs_table(self.new, self.wheelsets),
            "runs_worn": runs_table(self.worn, self.wheelsets),
            **self.controlled.tables(self.wheelsets),
            **({"control_periods": by_period} if self.by_period else {}),
            **{f"creep_laws_{wheels}": found.table() for wheels, found in self.creep_laws.items()},
        }

    def plots(self) -> dict[str, Plot]:
        """Counterparts of the paper's figures 1, 2, 3, 8 and 10 to 18."""
        loops = self.loops.plots()
        return {
            "figure_01_conicity": self._draw_conicity,
            **{f"figure_{'02' if name == 'curve' else '03'}_{name}": draw for name, draw in loops.items()},
            "figure_08_new_wheels": self._trends(self.new, "new wheels"),
            "figure_10_worn_wheels": self._trends(self.worn, "worn wheels"),
            **controlled_plots(self.controlled, self.limits, self.wheelsets),
        }

    def pages(self, images: Mapping[str, bytes], document: Mapping[str, Any]) -> dict[str, str]:
        """Claims and figures on one page, beside what the paper shows."""
        return {"report": reproduce_page(self.claims, images, document, len(self.new.seeds))}

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the table of claims."""
        title = f"what the paper shows, on {len(self.new.seeds)} track seeds"
        print_table(console, title, CLAIMS, self.claims, wide=wide)
        for period, claims in self.by_period.items():
            title = f"rows S1 to S6 with a control period of {1e3 * period:g} ms"
            print_table(console, title, CLAIMS, claims, wide=wide)
        for wheels, found in self.creep_laws.items():
            found.summary(console, f"critical speed on {wheels} wheels by creep law, all else equal", wide)
        if len(self.new.seeds) < LEAST_SEEDS:
            console.print(f"fewer than {LEAST_SEEDS} seeds: a look, not a verdict")
        held = len(self.claims) - len(self.failed)
        console.print(
            f"{held} of {len(self.claims)} rows hold"
            + (f"; not: {', '.join(self.failed)}" if self.failed else "")
        )

    def _trends(self, runs: Sweep, wheels: str) -> Plot:
        title = f"passive yaw dampers, {wheels}"
        return lambda figure: draw_trends(figure, runs, self.limits, self.wheelsets, title)

    def _draw_conicity(self, figure: Figure) -> None:
        ends = [self.scenario.model_copy(update={"wear": wear}) for wear in (0.0, 1.0)]
        plot_conicity(figure, [conicity(s) for s in ends])


def reproduce(
    scenario: Scenario,
    seeds: Sequence[int] = range(10),
    *,
    environment: EnvironmentConfig | None = None,
    control_periods: Sequence[float] = (),
    creep_laws: Sequence[str] = (),
    context: RunContext | None = None,
) -> ReproduceResult:
    """Measure all rows of the paper's statements.

    Parameters
    ----------
    scenario : Scenario
        The configuration, with passive yaw dampers; its wear is set to 0 and 1 in turn. For the rows on
        controllers, the packaged semi-active dampers replace the passive ones.
    seeds : sequence of int
        Track seeds.
    environment : EnvironmentConfig, optional
        Sensors and clock of the controllers; those of ``nominal`` by default.
    control_periods : sequence of float
        Control periods (s) at which rows S1 to S6 are judged besides.
    creep_laws : sequence of str
        Creep laws by which the passive critical speeds are found besides, on a grid wide enough for all.
    context : RunContext, optional

    Raises
    ------
    ConfigError
        A scenario without passive yaw dampers, a control period that cannot be, a name that is no creep law,
        or a folder that cannot be written to.
    StudyError
        A run that diverged.
    """
    if not isinstance(scenario.damper, PassiveDamperConfig):
        raise ConfigError(f"damper '{scenario.damper.name}': rows P1 to P11 are about the passive yaw damper")
    setup = environment or load_environment()
    if control_periods:
        periods.environments_at(control_periods, setup)  # refused before any work
    check_laws(creep_laws, "creep laws")
    models = [VehicleModel(scenario.model_copy(update={"wear": wear})) for wear in (0.0, 1.0)]
    wheels = dict(zip(("new", "worn"), (model.scenario for model in models), strict=True))
    new, worn, controlled, others, *by_law = _parts(
        context or RunContext(),
        len(seeds),
        (len(NEW_SPEEDS), len(WORN_SPEEDS), len(required_runs()), len(control_periods) * len(skyhook_runs()))
        + 2 * (len(creep_laws) * len(LAW_SPEEDS),),
    )
    new_runs = sweep(wheels["new"], NEW_SPEEDS, seeds, new)
    worn_runs = sweep(wheels["worn"], WORN_SPEEDS, seeds, worn)
    runs = controlled_runs(wheels["worn"], setup, seeds, required_runs(), controlled)
    by_period: periods.PeriodClaims = {}
    if control_periods:
        by_period = periods.period_claims(
            wheels["worn"], seeds, control_periods, environment=setup, context=others
        )
    compared = {
        name: compare_laws(vehicle, LAW_SPEEDS, seeds, creep_laws, part)
        for (name, vehicle), part in zip(wheels.items(), by_law, strict=True)
        if creep_laws
    }
    limits = model_limits(models[0])
    loops = hysteresis(scenario)
    claims = [
        *passive_claims(new_runs, worn_runs, limits, scenario.assessment),
        damper_claim(loops),
        *controlled_claims(runs, limits, scenario.assessment),
        model_claim(models[0]),
    ]
    names = wheelset_names(models[0])
    return ReproduceResult(
        scenario, claims, new_runs, worn_runs, limits, names, loops, runs, by_period, compared
    )


def _parts(context: RunContext, seeds: int, runs: Sequence[int]) -> list[RunContext]:
    """Contexts of the parts of the study, each of so many runs of a seed."""
    begins = accumulate((seeds * count for count in runs[:-1]), initial=0)
    return [context.part(begin, seeds * sum(runs)) for begin in begins]


def damper_claim(result: HysteresisResult) -> Claim:
    """Row P11: loops that dissipate, with a force below the curve at the peak velocity."""
    excess = [loop.force_peak / loop.force_limit for loop in result.loops]
    least = min(loop.energy for loop in result.loops)
    holds = least > 0.0 and max(excess) <= 1.0
    damper = result.damper
    assert isinstance(damper, PassiveDamperConfig)  # `reproduce` has refused any other
    stiffness = [loop.zero_force_slope / damper.series_stiffness for loop in result.loops]
    measured = (
        f"smallest loop {least:.2f} J; largest peak force {100 * max(excess):.1f} % of the curve; "
        f"slope at zero force {min(stiffness):.2f} to {max(stiffness):.2f} of the series stiffness"
    )
    return once("P11", "hysteresis: loops dissipate, peak force <= curve at peak velocity", holds, measured)


def model_claim(model: VehicleModel) -> Claim:
    """Row C2: counted from the assembled model and from the semi-active damper's unknowns."""
    n, d = model.multibody.n, len(model.multibody.yaw_dampers)
    mechanical = (sayd.STROKE, sayd.STROKE_RATE, sayd.ROD, sayd.ROD_RATE)
    states = len({*mechanical, sayd.PRESSURE_A, sayd.PRESSURE_B})
    holds = (n, d, states) == (62, 8, 6)
    return once("C2", "62 degrees of freedom, 8 yaw dampers of 6 states", holds, f"{n}, {d} and {states}")
