"""How fast are the environments: control steps per second, single and batched, and what Python adds to them.

The environments are those of ``gymnasium.make`` and ``make_vec`` with all their wrappers, measured by
`gymnasium.utils.performance`. Within an episode nothing is reset; the rate over whole episodes follows from
that rate and the time of a reset, since a window of fixed length would hold now one reset more, now one less.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.performance import benchmark_step, benchmark_vector_step

from sayd_env.envs.registration import register_environments
from sayd_env.studies.bench.spread import Spread, in_turn

ID = "SAYD/Nominal-v0"
BATCH = 64
"""Vehicles of the batch environment."""
LONG_EPISODE = 200.0
"""Episodes of the single environment so long that none ends in a window (s)."""
YARDSTICK = "Ant-v5"


@dataclass(frozen=True)
class EnvironmentEffort:
    """How much is measured."""

    repetitions: int
    window: float
    """Wall time of a measured rate (s): some thousand steps, less than an episode of the batch."""
    pairs: int
    """Steps of which the compiled call is timed too, at most one episode's."""


@dataclass(frozen=True)
class ControlSteps:
    """Figures of the environments."""

    rates: dict[str, Spread]
    """Control steps per second, by `RATES`; the yardstick's is left out where it cannot be made."""
    overhead_us: Spread
    """A step of the single environment minus its compiled call, median of many steps (us)."""
    compiled_us: Spread
    """The compiled call (us)."""
    reset_s: dict[str, Spread]
    """Wall time of a reset of ``single`` and of all vehicles of ``batch`` (s)."""
    vehicles: int
    """Vehicles of the batch."""

    def as_dict(self) -> dict[str, float | None]:
        """Medians by their keys; null is what could not be measured."""
        rates = {name: self.rates[name].median if name in self.rates else None for name in RATES}
        return {**rates, "overhead_us": self.overhead_us.median, "compiled_us": self.compiled_us.median}

    def spreads(self) -> dict[str, Spread]:
        """All that was measured, with the names of `as_dict`."""
        return {**self.rates, "overhead_us": self.overhead_us, "compiled_us": self.compiled_us}


RATES = {
    "single": "one environment, whole episodes",
    "single_without_resets": "one environment, without resets",
    "batch": "batch environment, whole episodes",
    "batch_without_resets": "batch environment, without resets",
    "ant_v5": f"{YARDSTICK} of MuJoCo, whole episodes",
}
"""Rates of control steps and what they are called."""


def measure_environments(
    effort: EnvironmentEffort, threads: int, did: Callable[[], None] = lambda: None
) -> ControlSteps:
    """Measure the environments on this machine.

    Parameters
    ----------
    effort : EnvironmentEffort
    threads : int
        Threads of the batch.
    did : callable
        Told after each repetition.
    """
    register_environments()
    single = gym.make(ID)
    running = gym.make(ID, episode_s=LONG_EPISODE)
    batch: Any = gym.make_vec(
        ID, num_envs=BATCH, vectorization_mode="vector_entry_point", num_threads=threads
    )
    yardstick = make_yardstick()
    timer = StepTimer(single, effort.pairs)
    window: Any = effort.window  # gymnasium asks for an int, and compares
    probes: dict[str, Callable[[], float]] = {
        "single_reset": lambda: reset_time(single),
        "overhead_us": timer.overhead,
        "compiled_us": lambda: timer.compiled,
        "single_without_resets": lambda: benchmark_step(running, window, seed=0),
        "batch_reset": lambda: reset_time(batch),
        "batch_without_resets": lambda: benchmark_vector_step(batch, window, seed=0),
    }
    if yardstick is not None:
        probes["ant_v5"] = lambda: benchmark_step(yardstick, window, seed=0)
    try:
        measured = in_turn(probes, effort.repetitions, did)
        steps = {"single": _episode_steps(single.unwrapped), "batch": _episode_steps(batch) * BATCH}
    finally:
        for env in (single, running, batch, yardstick):
            if env is not None:
                env.close()
    for name, episode in steps.items():
        pairs = zip(measured[f"{name}_without_resets"], measured[f"{name}_reset"], strict=True)
        measured[name] = [whole_episodes(rate, episode, reset) for rate, reset in pairs]
    return ControlSteps(
        rates={name: Spread.of(measured[name]) for name in RATES if name in measured},
        overhead_us=Spread.of(measured["overhead_us"]),
        compiled_us=Spread.of(measured["compiled_us"]),
        reset_s={name: Spread.of(measured[f"{name}_reset"]) for name in steps},
        vehicles=BATCH,
    )


def make_yardstick() -> Any:
    """Gymnasium's Ant-v5, or None where MuJoCo is not installed."""
    try:
        return gym.make(YARDSTICK)
    except (gym.error.DependencyNotInstalled, ImportError):
        return None


def reset_time(env: Any) -> float:
    """Wall time of the reset to the next episodes (s)."""
    begin = time.perf_counter()
    env.reset()
    return time.perf_counter() - begin


def whole_episodes(rate: float, episode: int, reset: float) -> float:
    """Steps per second over episodes of so many steps, each behind a reset (s), from the rate within them."""
    return episode / (episode / rate + reset)


def _episode_steps(env: Any) -> int:
    steps: int = env.batch.steps
    return steps


class StepTimer:
    """Times steps of a single environment together with their compiled calls.

    Parameters
    ----------
    env : gymnasium.Env
        A `SaydEnv` in its wrappers, not reset in between.
    pairs : int
        Steps in one measurement.

    Attributes
    ----------
    compiled : float
        Median time of the compiled call in the last measurement (us).
    """

    def __init__(self, env: Any, pairs: int) -> None:
        self.env = env
        self.pairs = min(pairs, _episode_steps(env.unwrapped) - 1)
        self.compiled = float("nan")

    def overhead(self) -> float:
        """Median of step minus compiled call, with the episode that begins now (us)."""
        env = self.env
        env.reset()
        env.step(env.action_space.sample())  # finds the compiled loop of the new vehicle
        vehicles, calls, steps = env.unwrapped.batch.vehicles, [], []
        loop = vehicles._compiled  # looked into on purpose: what is outside it is the overhead

        def timed(*arguments: Any) -> None:
            begin = time.perf_counter_ns()
            loop(*arguments)
            calls.append(time.perf_counter_ns() - begin)

        vehicles._compiled = timed
        try:
            for _ in range(self.pairs):
                action = env.action_space.sample()
                begin = time.perf_counter_ns()
                env.step(action)
                steps.append(time.perf_counter_ns() - begin)
        finally:
            vehicles._compiled = loop
        self.compiled = 1e-3 * float(np.median(calls))
        return 1e-3 * float(np.median(np.subtract(steps, calls)))
