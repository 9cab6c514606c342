"""Assessed runs of the paper's controllers, kept on the disk: what the rows on control are judged from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from sayd_env.config.control import load_controller
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.envs.rollout import Rollout
from sayd_env.runs.cache import RunStore
from sayd_env.runs.controlled import ControlledRun, ControlledRuns, controlled_run_of
from sayd_env.studies.evaluate import environment_of
from sayd_env.runs.kept import run_kept
from sayd_env.report.files import Progress, silent
from sayd_env.runs.policies import PolicySpec, for_policy
from sayd_env.runs.rollouts import Group
from sayd_env.runs.passive import run_name


def controlled_groups(
    scenario: Scenario,
    environment: EnvironmentConfig,
    seeds: Sequence[int],
    required: Sequence[tuple[str, float, float]],
) -> list[Group]:
    """Groups of runs that rows need.

    Parameters
    ----------
    scenario : Scenario
        The vehicle on worn wheels; semi-active dampers replace passive ones.
    environment : EnvironmentConfig
        Sensors and clock of the controllers.
    seeds : sequence of int
        Track seeds.
    required : sequence of tuple
        Controller, speed (m/s) and initial current of each group. The controllers have the parameters of
        their configuration, which stand in the groups' policies.
    """
    groups = []
    for name, speed, current in required:
        spec = PolicySpec(name, load_controller(name, {}).model_dump())
        fitted = for_policy(scenario, spec)
        groups.append(Group(spec, fitted, environment_of(fitted, environment), speed, tuple(seeds), current))
    return groups


def controlled_runs(
    groups: Sequence[Group], folder: Path | None, workers: int | None, progress: Progress = silent
) -> tuple[ControlledRuns, int]:
    """Assess the runs of all groups, those that an earlier start has finished from the disk.

    Parameters
    ----------
    groups : sequence of Group
        By `controlled_groups`.
    folder : Path or None
        Where finished runs are kept; what it keeps of these controllers for other inputs is removed.
    workers : int or None
        Threads.
    progress : Progress
        Told after each group of runs.

    Returns
    -------
    ControlledRuns
    int
        How many runs were there already.

    Raises
    ------
    ConfigError, StudyError
        See `run_groups` and `controlled_run_of`.
    """
    stores: dict[str, RunStore[ControlledRun]] = {}
    for group in groups if folder is not None else ():
        assert folder is not None
        inputs = (group.scenario, group.config, dict(group.policy.parameters))
        stores.setdefault(group.policy.name, RunStore(folder, group.policy.name, ControlledRun, *inputs))

    def place(group: Group, seed: int) -> tuple[RunStore[ControlledRun] | None, str]:
        name = f"{run_name(group.speed, seed)}_V0_{group.initial_current:g}"
        return stores.get(group.policy.name), name

    def analyse(group: Group, rollout: Rollout) -> ControlledRun:
        return controlled_run_of(group.policy.name, rollout, group.scenario.assessment)

    runs = run_kept(groups, analyse, place, workers=workers, progress=progress)
    for store in stores.values():
        store.forget_former()
    return ControlledRuns(run for part in runs for run in part), sum(s.reused for s in stores.values())
