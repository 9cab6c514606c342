"""Do the rows on skyhook control hang on the control period? S1 to S6 at several periods, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypeAlias

from sayd_env.config import ConfigError, validate
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.reproduction import ReproductionConfig
from sayd_env.envs.vehicle import model_limits
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.columns import Column
from sayd_env.runs.context import RunContext
from sayd_env.runs.controlled import controlled_runs
from sayd_env.studies.paper.claims import Claim
from sayd_env.studies.paper.controlled_claims import skyhook_claims, skyhook_runs
from sayd_env.studies.paper.judged import Vehicle

PeriodClaims: TypeAlias = Mapping[float, list[Claim]]
"""Rows S1 to S6 by control period (s)."""
COLUMNS = [Column(name) for name in ("id", "control_period_s", "expected", "measured", "fraction", "holds")]


def period_rows(claims: PeriodClaims) -> list[dict[str, Any]]:
    """One entry for each row and period."""
    return [
        {"control_period_s": period, **asdict(claim)}
        for same_row in zip(*claims.values(), strict=True)
        for period, claim in zip(claims, same_row, strict=True)
    ]


def period_claims(
    vehicle: Vehicle,
    study: ReproductionConfig,
    seeds: Sequence[int],
    periods: Sequence[float],
    context: RunContext | None = None,
) -> PeriodClaims:
    """Judge rows S1 to S6 on worn wheels with controllers that act at several periods (s).

    Raises
    ------
    ConfigError
        A period that does not divide a second or is named twice, or dampers that do not fit.
    StudyError
        A run that diverged.
    """
    configs = environments_at(periods, vehicle.environment)
    limits = model_limits(VehicleModel(vehicle.scenario))
    context, required = context or RunContext(), skyhook_runs(study.speeds("sayd"))
    each = len(required) * len(seeds)
    claims: dict[float, list[Claim]] = {}
    for number, (period, config) in enumerate(zip(periods, configs, strict=True)):
        part = context.part(number * each, len(periods) * each, f"control period {1e3 * period:g} ms")
        runs = controlled_runs(vehicle.semi_active, config, seeds, required, part, vehicle.policies)
        claims[period] = skyhook_claims(runs, limits)
    return claims


def environments_at(periods: Sequence[float], base: EnvironmentConfig) -> list[EnvironmentConfig]:
    """Make the environment of each control period (s), all of them before any work.

    Raises
    ------
    ConfigError
        A period that does not divide a second or is named twice, or none at all.
    """
    if len(set(periods)) < len(periods) or not periods:
        raise ConfigError(f"control periods {list(periods)}: expected different ones, at least one")
    return [
        validate(EnvironmentConfig, dict(base) | {"control_period": period}, "control periods")
        for period in periods
    ]
