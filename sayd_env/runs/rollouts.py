"""Policies on the environment's vehicles, as studies run them: groups of episodes in threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.scenario import Scenario
from sayd_env.envs.draw import draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.rollout import Rollout, assessed_steps, roll_out
from sayd_env.physics.simulator import VehicleModel
from sayd_env.report.files import Progress, silent
from sayd_env.runs.passive import parallel
from sayd_env.runs.policies import PolicySpec

T = TypeVar("T")
KMH = 3.6

LANES = 5
"""Vehicles side by side in one thread: enough to hide the controllers' time behind the vehicles'."""


@dataclass(frozen=True, eq=False)
class Group:
    """Runs that differ in their seeds alone."""

    policy: PolicySpec
    scenario: Scenario
    """With the dampers that the policy needs: `for_policy`."""
    config: EnvironmentConfig
    speed: float
    """m/s."""
    seeds: tuple[int, ...]
    initial_current: float = 0.0


def run_groups(
    groups: Sequence[Group],
    analyse: Callable[[Group, Rollout], T],
    *,
    workers: int | None = None,
    progress: Progress = silent,
) -> list[list[T]]:
    """Run the assessed distance with every seed of every group.

    Parameters
    ----------
    groups : sequence of Group
    analyse : callable
        What is kept of each run; called in the thread that ran it.
    workers : int, optional
        Threads; all cores by default. The results do not depend on it.
    progress : Progress
        Told the number of finished runs.

    Returns
    -------
    list of list
        The results of each group in the order of its seeds.

    Raises
    ------
    ConfigError
        A speed outside the vehicle's range, or a policy that does not fit.
    StudyError
        A run that diverged.
    """
    for group in groups:
        VehicleModel(group.scenario).check_speed(group.speed)  # refused before any work
    parts = [
        (i, group.seeds[start : start + LANES])
        for i, group in enumerate(groups)
        for start in range(0, len(group.seeds), LANES)
    ]

    def work(part: tuple[int, tuple[int, ...]]) -> list[T]:
        group, seeds = groups[part[0]], part[1]
        return [analyse(group, rollout) for rollout in _roll_out(group, seeds)]

    runs = sum(len(seeds) for _, seeds in parts)

    def report(done: float, total: float, what: str = "") -> None:
        progress(round(runs * done / total), runs, what)

    results: list[list[T]] = [[] for _ in groups]
    for (i, _), found in zip(parts, parallel(work, parts, workers, report), strict=True):
        results[i] += found
    return results


def _roll_out(group: Group, seeds: Sequence[int]) -> list[Rollout]:
    config = group.policy.environment(group.config)
    batch = EpisodeBatch(config, len(seeds), scenario=group.scenario, num_threads=1)
    options = {"speed_kmh": group.speed * KMH, "initial_current": group.initial_current}
    episodes = [draw_episode(config, seed, 0, options) for seed in seeds]
    steps = [assessed_steps(config, group.scenario, group.speed)] * len(seeds)
    return roll_out(batch, group.policy.make(batch), episodes, steps)
