"""Policies on the environment's vehicles, several runs side by side."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sayd_env.config import ConfigError
from sayd_env.config.conditions import Line
from sayd_env.config.control import load_online
from sayd_env.config.damper import SaydDamperConfig
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.fault import Fault
from sayd_env.config.scenario import Scenario
from sayd_env.config.units import KMH
from sayd_env.envs.draw import Episode, draw_episode
from sayd_env.envs.episode_batch import EpisodeBatch
from sayd_env.envs.rollout import Rollout, assessed_steps, roll_out
from sayd_env.envs.trace import TRACE
from sayd_env.physics.simulator import VehicleModel
from sayd_env.runs.policies import PASSIVE, PolicySpec, constant_spec, for_policy, refuse_duplicates


@dataclass(frozen=True, eq=False)
class Run:
    """One policy over the assessed distance of one scenario."""

    policy: PolicySpec
    scenario: Scenario
    """With the dampers that the policy needs: `for_policy`."""
    environment: EnvironmentConfig
    """Sensors and clock, as `environment_of` has them."""
    speed: float
    """m/s."""
    seed: int
    initial_current: float = 0.0
    """Valve command of the run-in."""
    line: Line | None = None
    """What lies along the way; None: nothing. The speed is that at its start."""
    faults: tuple[Fault, ...] | None = None
    """What fails on the way; None: what the environment draws."""

    def inputs(self) -> Sequence[Any]:
        """What the run depends on; the on-line filter is seen by policies, and J is taken by it."""
        numbers = (round(self.speed, 9), self.seed, self.initial_current)
        inputs = self.scenario, self.environment, self.policy.identity(), load_online(), numbers, self.line
        return *inputs, self.faults and [fault.model_dump(mode="json") for fault in self.faults]

    def companions(self) -> Hashable:
        """Runs of one batch share everything but speed, seed and faults."""
        return id(self.policy), id(self.scenario), id(self.environment), self.initial_current

    def duration(self) -> float:
        """As long as its speed is low."""
        return 1.0 / self.speed


def roll_out_runs(runs: Sequence[Run], *, episode: bool = False, keep: Sequence[int] = ()) -> list[Rollout]:
    """Run-in and assessed length of runs that are companions, on one thread.

    Parameters
    ----------
    episode : bool
        The environment's episode in place of the assessed length.
    keep : sequence of int
        Columns of `sayd_env.envs.trace` that are kept, too; from `TRACE` on the motion of the unknowns.

    Raises
    ------
    ConfigError
        A policy that does not fit.
    StudyError
        A run that diverged.
    """
    first = runs[0]
    config = first.policy.environment(first.environment)
    motion = max(keep, default=0) >= TRACE
    batch = EpisodeBatch(config, len(runs), scenario=first.scenario, num_threads=1, motion=motion)
    episodes = [_episode(config, run) for run in runs]
    steps = [batch.steps if episode else assessed_steps(config, first.scenario, run.speed) for run in runs]
    return roll_out(batch, first.policy.make(batch), episodes, steps, keep=keep)


def _episode(config: EnvironmentConfig, run: Run) -> Episode:
    """A run's episode, in an environment that draws neither vehicles' conditions nor lines."""
    options = {"speed_kmh": run.speed * KMH, "initial_current": run.initial_current}
    drawn = draw_episode(config, run.seed, 0, options)
    line = None if run.line is None or run.line.plain else run.line
    return replace(drawn, line=line, faults=drawn.faults if run.faults is None else run.faults)


def own_policy(scenario: Scenario) -> PolicySpec:
    """What the dampers of a scenario do without a controller."""
    damper = scenario.damper
    if isinstance(damper, SaydDamperConfig):
        return constant_spec(damper.current)
    return PolicySpec(PASSIVE)


def conditions(
    scenario: Scenario, wear: Sequence[float] = (), friction: Sequence[float] = ()
) -> list[Scenario]:
    """Scenarios of every wear with every friction; the scenario's own where there is none.

    Raises
    ------
    ConfigError
        No distance is assessed.
    """
    if scenario.assessment.length is None:
        raise ConfigError("assessment.length: a simulation needs a distance, found null")
    return [
        scenario.model_copy(update={"wear": w, "friction": mu})
        for w in tuple(wear) or (scenario.wear,)
        for mu in tuple(friction) or (scenario.friction,)
    ]


def policy_runs(
    policies: Iterable[PolicySpec],
    scenarios: Sequence[Scenario],
    speeds: Sequence[float],
    seeds: Sequence[int],
    environment: EnvironmentConfig,
    *,
    initial_current: float = 0.0,
) -> Iterator[Run]:
    """Runs of every policy in every scenario at every speed (m/s) with every seed, in this order.

    Raises
    ------
    ConfigError
        A duplicate policy, or one that does not fit the scenario's dampers; a speed outside the
        vehicle's range; an environment along lines, which would be left out.
    """
    if environment.line is not None or environment.lines is not None:
        raise ConfigError("environment: goes along lines of its own; expected one without, or a line by name")
    each = [*policies]
    refuse_duplicates(each)
    for policy in each:
        for scenario in scenarios:
            fitted = for_policy(scenario, policy)
            config = environment_of(fitted, environment)
            model = VehicleModel(fitted)
            for speed in speeds:
                model.check_speed(speed)  # refused before any work
                for seed in seeds:
                    yield Run(policy, fitted, config, speed, seed, initial_current)


def environment_of(scenario: Scenario, environment: EnvironmentConfig) -> EnvironmentConfig:
    """Environment whose wheels, friction, track and run-in are those of a scenario, none of them drawn.

    It is straight: a run that goes along a line brings it.
    """
    return environment.model_copy(
        update={
            "randomisation": environment.randomisation.without(),
            "damper": scenario.damper.type,
            "run_in": scenario.assessment.run_in,
            "line": None,
            "lines": None,
        }
    )
