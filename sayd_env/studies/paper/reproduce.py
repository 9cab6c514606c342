"""Does the model show what the paper shows? Every statement, measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate
from typing import TYPE_CHECKING, Any

from sayd_env.config import ConfigError
from sayd_env.config.control import controller_of
from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.reproduction import ReproductionConfig, load_reproduction
from sayd_env.config.scenario import Scenario
from sayd_env.report.columns import Listing, Table, csv_table, json_rows
from sayd_env.report.figures import Plot
from sayd_env.report.html import Page
from sayd_env.runs.context import RunContext
from sayd_env.runs.passive import Sweep, runs_table
from sayd_env.runs.policies import PAPER, PolicySpec, policy_spec
from sayd_env.studies.components.conicity import conicity, plot_conicity
from sayd_env.studies.critical_speed import (
    AccelerationHistory,
    CreepLawComparison,
    check_laws,
    compare_laws,
    draw_histories,
    draw_trends,
    histories,
)
from sayd_env.studies.paper import assumptions as other
from sayd_env.studies.paper import control_periods as periods
from sayd_env.studies.paper.claims import claim_columns, claim_rows, claims_document
from sayd_env.studies.paper.controlled_claims import skyhook_runs
from sayd_env.studies.paper.figures import controlled_plots
from sayd_env.studies.paper.judged import Judged, Vehicle, judge_rows, runs_of_a_seed
from sayd_env.studies.paper.page import reproduce_page

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


@dataclass(frozen=True)
class ReproduceResult(Judged):
    """The table of claims and what it rests on."""

    least_seeds: int = 1
    """Track realisations that a verdict needs."""
    by_period: periods.PeriodClaims = field(default_factory=dict)
    """Rows S1 to S6 at other control periods."""
    histories: tuple[AccelerationHistory, ...] = ()
    """Of the passive vehicle on new wheels."""
    creep_laws: Mapping[str, CreepLawComparison] = field(default_factory=dict)
    """Critical speeds on new and on worn wheels by creep law."""
    assumptions: Mapping[str, Judged] = field(default_factory=dict)
    """The rows under other assumptions."""

    @property
    def failed(self) -> list[str]:
        """Rows that do not hold."""
        return [c.id for c in self.claims if not c.holds]

    @property
    def _by_assumption(self) -> other.ByAssumption:
        return {other.OWN: self, **self.assumptions}

    def as_dict(self) -> dict[str, Any]:
        """Keys of ``sayd reproduce --json``."""
        laws = {wheels: found.as_dict() for wheels, found in self.creep_laws.items()}
        return {
            "claims": claims_document(self.claims),
            "seeds": list(self.new.seeds),
            "critical_speeds": json_rows(other.CRITICAL_SPEEDS, other.speed_rows(self._by_assumption)),
            **({"assumptions": other.verdict_rows(self._by_assumption)} if self.assumptions else {}),
            **({"control_periods": periods.period_rows(self.by_period)} if self.by_period else {}),
            **({"by_creep_law": laws} if laws else {}),
        }

    def tables(self) -> dict[str, Table]:
        """Claims, critical speeds, and every run."""
        by_period = csv_table(periods.COLUMNS, periods.period_rows(self.by_period))
        verdicts = csv_table(other.VERDICTS, other.verdict_rows(self._by_assumption))
        return {
            "claims": csv_table(claim_columns(self.claims), claim_rows(self.claims)),
            "critical_speeds": csv_table(other.CRITICAL_SPEEDS, other.speed_rows(self._by_assumption)),
            "runs_new": runs_table(self.new, self.wheelsets),
            "runs_worn": runs_table(self.worn, self.wheelsets),
            **self.controlled.tables(self.wheelsets),
            **({"assumptions": verdicts} if self.assumptions else {}),
            **({"control_periods": by_period} if self.by_period else {}),
            **{f"creep_laws_{wheels}": found.table() for wheels, found in self.creep_laws.items()},
        }

    def plots(self) -> dict[str, Plot]:
        """Counterparts of the paper's figures 1, 2, 3, 8 and 10 to 18."""
        loops = self.loops.plots()
        return {
            "figure_01_conicity": self._draw_conicity,
            **{f"figure_{'02' if name == 'curve' else '03'}_{name}": draw for name, draw in loops.items()},
            "figure_08_history": partial(draw_histories, histories=self.histories, bounds=self.limits),
            "figure_08_new_wheels": self._trends(self.new, "new wheels"),
            "figure_10_worn_wheels": self._trends(self.worn, "worn wheels"),
            **controlled_plots(self.controlled, self.limits, self.wheelsets),
        }

    def page(self) -> Page:
        """Claims and figures, beside what the paper shows."""
        return reproduce_page(self.claims, list(self.plots()), len(self.new.seeds), self._by_assumption)

    def summary(self, console: Console, wide: bool = False) -> None:
        """Print the table of claims."""
        title = f"what the paper shows, on {len(self.new.seeds)} track seeds"
        Listing(title, claim_columns(self.claims), claim_rows(self.claims)).print(console, wide)
        if self.assumptions:
            title = "the rows by assumption, all else equal"
            Listing(title, *other.side_by_side(self._by_assumption)).print(console)
        title = "critical speeds of the passive vehicle"
        speeds = other.speed_rows(self._by_assumption)
        Listing(title, other.CRITICAL_SPEEDS, speeds, "assumption").print(console, wide)
        for period, claims in self.by_period.items():
            title = f"rows S1 to S6 with a control period of {1e3 * period:g} ms"
            Listing(title, claim_columns(claims), claim_rows(claims)).print(console, wide)
        for wheels, found in self.creep_laws.items():
            found.summary(console, f"critical speed on {wheels} wheels by creep law, all else equal", wide)
        if len(self.new.seeds) < self.least_seeds:
            console.print(f"fewer than {self.least_seeds} seeds: a look, not a verdict")
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
    seeds: Sequence[int] | None = None,
    *,
    study: ReproductionConfig | None = None,
    sayd: SaydDamperConfig | None = None,
    policies: Mapping[str, PolicySpec] | None = None,
    environment: EnvironmentConfig | None = None,
    control_periods: Sequence[float] = (),
    creep_laws: Sequence[str] = (),
    assumptions: bool = False,
    context: RunContext | None = None,
) -> ReproduceResult:
    """Measure all rows of the paper's statements.

    Parameters
    ----------
    scenario : Scenario
        The configuration, with passive yaw dampers; its wear is set to 0 and 1 in turn.
    seeds : sequence of int, optional
        Track seeds; those of the study by default.
    study : ReproductionConfig, optional
        Speeds, seeds, fixed commands and assumptions; ``configs/study/reproduce.yaml`` by default.
    sayd : SaydDamperConfig, optional
        What replaces the passive dampers in the rows on controllers; the packaged one by default.
    policies : mapping, optional
        Of each controller of the rows what commands in its place; the packaged controllers by default.
    environment : EnvironmentConfig, optional
        Sensors and clock of the controllers; those of ``nominal`` by default.
    control_periods : sequence of float
        Control periods (s) at which rows S1 to S6 are judged besides.
    creep_laws : sequence of str
        Creep laws by which the passive critical speeds are found besides, on a grid wide enough for all.
    assumptions : bool
        Judge the rows again under each assumption of the study, on as many seeds as it says.

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
    study, setup = study or load_reproduction(), environment or load_environment()
    seeds = study.seeds if seeds is None else seeds
    if control_periods:
        periods.environments_at(control_periods, setup)  # refused before any work
    check_laws(creep_laws, "creep laws")
    vehicle = Vehicle(scenario, setup, sayd, policies)
    judged_again = study.assumptions if assumptions else ()
    grid = study.speeds("creep_laws")
    context = context or RunContext()
    runs = [
        len(seeds) * runs_of_a_seed(study, study.fixed),
        len(seeds) * len(control_periods) * len(skyhook_runs(study.speeds("sayd"))),
        *2 * [len(seeds) * len(creep_laws) * len(grid)],
        *(min(a.seeds, len(seeds)) * runs_of_a_seed(study) for a in judged_again),
    ]
    own, others, new_laws, worn_laws, *again = (
        context.part(begin, sum(runs)) for begin in accumulate(runs[:-1], initial=0)
    )
    judged = judge_rows(vehicle, study, seeds, own, study.fixed)
    by_period: periods.PeriodClaims = {}
    if control_periods:
        by_period = periods.period_claims(vehicle, study, seeds, control_periods, others)
    compared = {
        name: compare_laws(vehicle.worn(wear), grid, seeds, creep_laws, part)
        for name, wear, part in (("new", 0.0, new_laws), ("worn", 1.0, worn_laws))
        if creep_laws
    }
    shown = histories(vehicle.worn(0.0), judged.new, judged.limits, own)
    by_assumption = {
        a.name: judge_rows(replace(vehicle, scenario=a.applied(scenario)), study, seeds[: a.seeds], part)
        for a, part in zip(judged_again, again, strict=True)
    }
    return ReproduceResult(
        **vars(judged),
        least_seeds=study.least_seeds,
        by_period=by_period,
        histories=shown,
        creep_laws=compared,
        assumptions=by_assumption,
    )


def row_policies(files: Sequence[str] = (), fixed: Sequence[str] = ()) -> dict[str, PolicySpec]:
    """What the rows' controllers and the fixed commands stand for.

    Parameters
    ----------
    files : sequence of str
        Files of parameters of controllers, which are named after them; the others are packaged ones.
    fixed : sequence of str
        Policies of one command.

    Raises
    ------
    ConfigError
        A file that cannot be used, or one of a controller that no row is about; a policy that is unknown.
    """
    own = {controller_of(file): policy_spec(file) for file in files}
    for name in own:
        if name not in PAPER:
            raise ConfigError(f"controller '{name}': no row is about it; expected {', '.join(PAPER)}")
    if len(own) < len(files):
        raise ConfigError(f"controllers {', '.join(files)}: two files are of the same controller")
    return {name: policy_spec(name) for name in (*PAPER, *fixed)} | own
