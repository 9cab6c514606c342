"""Runs that each executor makes in a second, and how long it takes to start."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from functools import partial

from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import load_scenario
from sayd_env.config.units import KMH
from sayd_env.runs.context import pieces
from sayd_env.runs.executors import ExecutorChoice, KeptExecutor
from sayd_env.runs.metrics import judged
from sayd_env.runs.policies import PolicySpec
from sayd_env.runs.rollouts import Run, policy_runs
from sayd_env.studies.bench.spread import Effort, Measurement, in_turn, quantities

POLICIES, SEEDS, SPEED = ("passive", "mppt2"), 16, 300.0 / KMH
SHORT = ("assessment.run_in=100", "assessment.length=600")
"""Of the runs: seven seconds and a half each, at `SPEED` (m/s)."""


def measure_executors(
    choices: Sequence[ExecutorChoice], effort: Effort, did: Callable[[], None] = lambda: None
) -> dict[str, dict[str, Measurement]]:
    """Make the same short runs with each executor in turn.

    Parameters
    ----------
    did : callable
        Called after each repetition.

    Returns
    -------
    dict
        ``runs_per_second``, metrics included, once all workers have their kernels, and ``executor_start_s``:
        how much longer the first time takes, start of the executor and its workers' kernels included.

    Raises
    ------
    ConfigError
        Ray or Dask are not installed, or nobody answers at the address.
    """
    runs = short_runs()
    first: dict[str, float] = {}
    with ExitStack() as stack:
        probes = []
        for choice in choices:
            parts = pieces(runs, range(len(runs)), choice.count)
            work = [[runs[i] for i in part] for part in parts]
            begin = time.perf_counter()
            executor = stack.enter_context(KeptExecutor(choice)).get(len(work))
            list(executor.map(judged, work))
            first[str(choice)] = time.perf_counter() - begin
            probes.append(partial(_rate, str(choice), executor, work))
        measured = in_turn(probes, effort.rounds, did)
    titles = {str(choice): f"short runs, {choice}" for choice in choices}
    rates = quantities(measured, titles, "runs/s")
    starts = {name: [first[name] - len(runs) / rate.spread.median] for name, rate in rates.items()}
    return {
        "runs_per_second": rates,
        "executor_start_s": quantities(starts, {name: f"start of {name}" for name in titles}, "s"),
    }


def short_runs() -> list[Run]:
    """The passive vehicle and MPPT2 with the same seeds."""
    specs = [PolicySpec(name) for name in POLICIES]
    scenario = load_scenario("nominal", SHORT)
    return list(policy_runs(specs, [scenario], [SPEED], range(SEEDS), load_environment()))


def _rate(name: str, executor: Executor, work: Sequence[list[Run]]) -> dict[str, float]:
    """Runs per second, by the executor's name."""
    begin = time.perf_counter()
    rows = list(executor.map(judged, work))
    return {name: sum(map(len, rows)) / (time.perf_counter() - begin)}
