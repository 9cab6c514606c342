"""All rows of the paper's statements on one vehicle, and the runs that they are judged by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sayd_env.config.damper import PassiveDamperConfig, SaydDamperConfig, load_sayd
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.reproduction import ReproductionConfig
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics import sayd
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.context import RunContext
from sayd_env.runs.controlled import ControlledRuns, controlled_runs
from sayd_env.runs.passive import Sweep, sweep
from sayd_env.runs.policies import PolicySpec
from sayd_env.stability import Limits
from sayd_env.studies.components.hysteresis import HysteresisResult, hysteresis
from sayd_env.studies.critical_speed import wheelset_names
from sayd_env.studies.paper.claims import Claim, once
from sayd_env.studies.paper.controlled_claims import (
    controlled_claims,
    fixed_verdicts,
    required_runs,
    runs_over_speed,
)
from sayd_env.studies.paper.passive_claims import passive_claims


@dataclass(frozen=True)
class Judged:
    """The rows, and the runs behind them."""

    scenario: Scenario
    """With passive yaw dampers."""
    claims: list[Claim]
    new: Sweep
    worn: Sweep
    limits: Limits
    wheelsets: tuple[str, ...]
    loops: HysteresisResult
    controlled: ControlledRuns
    """Runs with semi-active dampers."""

    def critical_speeds(self) -> list[dict[str, Any]]:
        """Critical speeds (km/h) of the passive vehicle, with the 10 and 90 % quantiles of single seeds.

        None and infinite where they lie beyond the grid.
        """
        found = []
        for wheels, grid in (("new", self.new), ("worn", self.worn)):
            for name, criterion in grid.criteria(self.limits).items():
                crossing = criterion.critical_speed()
                low, high = criterion.over_seeds_kmh()
                found.append(
                    {
                        "wheels": wheels,
                        "criterion": name,
                        "critical_speed_kmh": None if crossing.speed is None else crossing.speed * KMH,
                        "status": crossing.crossing.value,
                        "over_seeds": criterion.over_seeds_text(),
                        "seeds_10_kmh": low,
                        "seeds_90_kmh": high,
                        "sensitive_to_grid": criterion.sensitive(self.scenario.assessment.grid_tolerance),
                    }
                )
        return found


@dataclass(frozen=True)
class Vehicle:
    """What the rows are about: a vehicle with passive dampers, what may replace them, and who commands it."""

    scenario: Scenario
    environment: EnvironmentConfig
    """Sensors and clock of the controllers."""
    sayd: SaydDamperConfig | None = None
    """Semi-active dampers; the packaged ones by default."""
    policies: Mapping[str, PolicySpec] | None = None
    """What names of controllers stand for; the packaged controllers by default."""

    def worn(self, wear: float) -> Scenario:
        """The vehicle with its passive dampers."""
        return self.scenario.model_copy(update={"wear": wear})

    @property
    def semi_active(self) -> Scenario:
        """The vehicle on worn wheels with semi-active dampers."""
        damper = load_sayd("sayd") if self.sayd is None else self.sayd
        return self.worn(1.0).model_copy(update={"damper": damper})


def runs_of_a_seed(study: ReproductionConfig, fixed: Sequence[str] = ()) -> int:
    """How many runs `judge_rows` makes of each seed."""
    grid = study.speeds("sayd")
    passive = len(study.speeds("new")) + len(study.speeds("worn"))
    return passive + len(required_runs(grid)) + len(runs_over_speed(fixed, grid))


def judge_rows(
    vehicle: Vehicle,
    study: ReproductionConfig,
    seeds: Sequence[int],
    context: RunContext,
    fixed: Sequence[str] = (),
) -> Judged:
    """Make the runs of every row on the tracks of some seeds, and judge the rows.

    Parameters
    ----------
    study : ReproductionConfig
        Grids of speeds.
    seeds : sequence of int
        Track seeds.
    fixed : sequence of str
        Policies of one command that go through the rows, too, each in the place of the row's controller.

    Raises
    ------
    ConfigError
        Dampers or controllers that do not fit.
    StudyError
        A run that diverged.
    """
    new_grid, worn_grid, grid = (study.speeds(which) for which in ("new", "worn", "sayd"))
    whole = runs_of_a_seed(study, fixed) * len(seeds)
    ends = len(new_grid) * len(seeds), (len(new_grid) + len(worn_grid)) * len(seeds)
    new = sweep(vehicle.worn(0.0), new_grid, seeds, context.part(0, whole))
    worn = sweep(vehicle.worn(1.0), worn_grid, seeds, context.part(ends[0], whole))
    runs = controlled_runs(
        vehicle.semi_active,
        vehicle.environment,
        seeds,
        [*required_runs(grid), *runs_over_speed(fixed, grid)],
        context.part(ends[1], whole),
        vehicle.policies,
    )
    model, assessment = VehicleModel(vehicle.worn(0.0)), vehicle.scenario.assessment
    limits, loops = model_limits(model), hysteresis(vehicle.scenario)
    claims = [
        *passive_claims(new, worn, limits, assessment),
        damper_claim(loops),
        *controlled_claims(runs, limits, assessment),
        model_claim(model),
    ]
    beside = {command: fixed_verdicts(runs, limits, command, assessment) for command in fixed}
    claims = [
        replace(claim, fixed={name: found[claim.id] for name, found in beside.items() if claim.id in found})
        for claim in claims
    ]
    return Judged(vehicle.scenario, claims, new, worn, limits, wheelset_names(model), loops, runs)


def damper_claim(result: HysteresisResult) -> Claim:
    """Row P11: loops that dissipate, with a force below the curve at the peak velocity."""
    excess = [loop.force_peak / loop.force_limit for loop in result.loops]
    least = min(loop.energy for loop in result.loops)
    holds = least > 0.0 and max(excess) <= 1.0
    damper = result.damper
    assert isinstance(damper, PassiveDamperConfig)  # `reproduce` refuses any other
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
