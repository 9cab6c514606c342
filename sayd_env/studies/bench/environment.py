"""How fast are the environments: control steps per second, single and batched, and what Python adds to them.

The environments are those of ``gymnasium.make`` and ``make_vec`` with all their wrappers, measured by
`gymnasium.utils.performance`. Within an episode nothing is reset; the rate over whole episodes follows from
that rate and the time of a reset, since a window of fixed length would hold now one reset more, now one less.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.performance import benchmark_step, benchmark_vector_step

from sayd_env.envs.registration import IDS
from sayd_env.studies.bench.spread import Effort, Measurement, Spread, Timed, in_turn, quantities

ID = next(name for name in IDS if name.startswith("SAYD/Nominal-"))
"""Of whatever version: an earlier commit is measured by this file, too."""
BATCH = 64
"""Vehicles of the batch environment."""
LONG_EPISODE = 200.0
"""Episodes of the single environment so long that none ends in a window (s)."""
YARDSTICK = "Ant-v5"
RATES = {
    "single": "one environment, whole episodes",
    "single_without_resets": "one environment, without resets",
    "batch": "batch environment, whole episodes",
    "batch_without_resets": "batch environment, without resets",
    "ant_v5": f"{YARDSTICK} of MuJoCo, whole episodes",
}
"""Rates of control steps and what they are called."""
TIMES = {"overhead_us": "step minus compiled call", "compiled_us": "compiled call"}
"""Median times of a step of the single environment."""


def measure_environments(
    effort: Effort, threads: int, did: Callable[[], None] = lambda: None
) -> dict[str, dict[str, Measurement]]:
    """Measure the environments on this machine.

    Parameters
    ----------
    threads : int
        Threads of the batch.
    did : callable
        Called after each repetition.

    Returns
    -------
    dict
        ``control_steps_per_second`` by `RATES` and `TIMES`, without the yardstick's where it cannot be made,
        and ``reset_s``: wall time of a reset of ``single`` and of all vehicles of ``batch``.
    """
    single: Any = gym.make(ID)
    batch, yardstick = make_batch(threads), make_yardstick()
    running = gym.make(ID, episode_s=LONG_EPISODE)
    window: Any = effort.window  # gymnasium asks for an int, and compares

    def measure() -> dict[str, float]:
        found = {
            "single_reset": reset_time(single),
            **step_times(single, effort.pairs),
            "single_without_resets": benchmark_step(running, window, seed=0),
            "batch_reset": reset_time(batch),
            "batch_without_resets": benchmark_vector_step(batch, window, seed=0),
        }
        episodes = {"single": single.unwrapped.batch.steps, "batch": batch.batch.steps * BATCH}
        for name, steps in episodes.items():
            found[name] = whole_episodes(found[f"{name}_without_resets"], steps, found[f"{name}_reset"])
        return found | ({} if yardstick is None else {"ant_v5": benchmark_step(yardstick, window, seed=0)})

    try:
        measured = in_turn([measure], effort.rounds, did)
    finally:
        for env in (single, running, batch, yardstick):
            if env is not None:
                env.close()
    steps = quantities(measured, RATES, "steps/s") | quantities(measured, TIMES, "us")
    return {
        "control_steps_per_second": steps,
        "reset_s": {
            "single": Measurement("reset of one environment", "s", Spread.of(measured["single_reset"])),
            "batch": Measurement(f"reset of {BATCH} at once", "s", Spread.of(measured["batch_reset"])),
        },
    }


def make_batch(threads: int) -> Any:
    """The batch environment of `BATCH` vehicles."""
    return gym.make_vec(ID, num_envs=BATCH, vectorization_mode="vector_entry_point", num_threads=threads)


def make_yardstick() -> Any:
    """Gymnasium's Ant-v5, or None where MuJoCo is not installed."""
    try:
        return gym.make(YARDSTICK)
    except (gym.error.DependencyNotInstalled, ImportError):
        return None


def reset_time(env: Any, clock: Callable[[], float] = time.perf_counter) -> float:
    """Time of the reset to the next episodes by a clock (s)."""
    begin = clock()
    env.reset()
    return clock() - begin


def whole_episodes(rate: float, episode: int, reset: float) -> float:
    """Steps per second over episodes of so many steps, each behind a reset (s), from the rate within them."""
    return episode / (episode / rate + reset)


def step_times(env: Any, count: int) -> dict[str, float]:
    """Times of a step of a single environment by `TIMES`: medians of steps of the next episode (us)."""
    env.reset()
    env.step(env.action_space.sample())  # finds the compiled loop of the new vehicle
    # Looked into on purpose: what is outside the compiled loop is the overhead.
    compiled, steps = Timed(env.unwrapped.batch.vehicles, "_compiled"), Timed(env, "step")
    try:
        for _ in range(min(count, env.unwrapped.batch.steps - 1)):
            env.step(env.action_space.sample())
    finally:
        compiled.stop()
        steps.stop()
    overhead = np.median(np.subtract(steps.seconds, compiled.seconds))
    return {"overhead_us": 1e6 * float(overhead), "compiled_us": 1e6 * float(np.median(compiled.seconds))}
