"""Executors: the same results whoever computes, whatever dies."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import psutil
import pytest

from sayd_env.config.environment import load_environment
from sayd_env.config.errors import ConfigError, StudyError
from sayd_env.config.scenario import load_scenario
from sayd_env.config.software import source_fingerprint
from sayd_env.runs import executors
from sayd_env.runs.cache import RunCache
from sayd_env.runs.context import Progress, RunContext, silent
from sayd_env.runs.executors import ExecutorChoice, SameSources, computed
from sayd_env.runs.metrics import Row
from sayd_env.runs.passive import sweep
from sayd_env.runs.policies import PolicySpec, policy_spec
from sayd_env.studies.evaluate import evaluate

pytestmark = pytest.mark.filterwarnings("ignore")  # of Ray's and Dask's own
os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112 - or its workers wait for all other tests

SHORT = ["assessment.run_in=200", "assessment.length=600"]
CLUSTERS = [executors.RAY, executors.DASK]
EVERY = [*executors.KINDS]


def choice(kind: str) -> ExecutorChoice:
    for name in {"ray": ["ray"], "dask": ["distributed"]}.get(kind, []):
        pytest.importorskip(name)
    return ExecutorChoice.parse(kind, 2)


def rows(kind: str, cache: RunCache | None = None, progress: Progress = silent, seeds: int = 2) -> list[Row]:
    context = RunContext(choice(kind), cache or RunCache(), progress)
    policies = [PolicySpec("passive"), PolicySpec("mppt2")]
    scenario = load_scenario("nominal", [*SHORT, "wear=1"])
    return evaluate(scenario, [80.0, 97.0], range(seeds), policies=policies, context=context).rows


def workers(kind: str) -> list[int]:
    """Pids of the processes that compute now."""
    if kind == executors.RAY:
        return [p.pid for p in psutil.Process().children(recursive=True) if "ray::_call" in p.name()]
    if kind == executors.DASK:
        busy = [p for p in psutil.Process().children() if "spawn_main" in " ".join(p.cmdline())]
        return [p.pid for p in busy]
    return [process.pid for process in multiprocessing.active_children() if process.pid is not None]


@cache
def by_threads() -> str:
    return repr(rows(executors.THREADS, seeds=6))


@pytest.mark.slow
@pytest.mark.parametrize("kind", EVERY[1:])
def test_the_bits_do_not_depend_on_the_executor_nor_on_a_worker_that_is_killed(kind: str):
    victims: list[int] = []

    def kill_one(done: float, total: float, what: str = "") -> None:
        """Kill a worker; of four pieces for two workers some are left when the first one is done."""
        if victims:
            return
        patience = time.monotonic() + 10.0
        while not victims and time.monotonic() < patience:
            victims.extend(workers(kind)[:1])  # both may be between two pieces
        with suppress(ProcessLookupError):
            os.kill(victims[0], signal.SIGKILL)

    assert repr(rows(kind, progress=kill_one, seeds=6)) == by_threads()
    assert victims


@pytest.mark.parametrize("kind", [executors.THREADS, executors.DASK])
def test_what_the_work_raises_ends_the_study_as_it_is(kind: str):
    with pytest.raises(ValueError, match=r"math domain error|nonnegative"):
        list(computed(math.sqrt, [4.0, -1.0], choice(kind)))


def without_result(future: Future[None]) -> bool:
    """Whether a piece that has ended was cancelled or failed."""
    return future.cancelled() or future.exception() is not None


def test_an_executor_is_abandoned_at_once_and_other_processes_live() -> None:
    """No piece, of a minute each, is waited for; a process that is not the executor's goes on."""
    bystander = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    bystander.start()
    kept = executors.KeptExecutor(ExecutorChoice(executors.PROCESSES, workers=2))
    futures = [kept.get(4).submit(time.sleep, 60) for _ in range(4)]
    while not any(future.running() for future in futures):
        time.sleep(0.05)
    kept.close(at_once=True)
    assert all(without_result(future) for future in futures if future.done())
    assert bystander.is_alive()
    bystander.kill()
    bystander.join()


def test_a_worker_with_other_sources_refuses_its_work():
    assert SameSources(math.sqrt, source_fingerprint())(4.0) == 2.0
    with pytest.raises(ConfigError, match="has other sources of sayd_env"):
        SameSources(math.sqrt, 16 * "0")(4.0)


def test_cores_are_those_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3, 5, 8}, raising=False)
    assert ExecutorChoice().count == 3


def test_what_ray_wraps_is_unwrapped():
    error = ValueError("as it is")
    assert executors._cause(type("RayTaskError", (Exception,), {"cause": error})()) is error


def test_workers_that_always_end_are_reported_once():
    with pytest.raises(StudyError, match="--executor processes: the workers ended 3 times"):
        list(computed(os._exit, [1, 1], ExecutorChoice(executors.PROCESSES, workers=1)))


def second_fails(case: int) -> int:
    if case == 1:
        raise ConfigError("the second case")
    return case


def test_the_first_error_ends_the_others():
    choice = ExecutorChoice(workers=2)
    found = []
    with pytest.raises(ConfigError, match="the second case"):
        found.extend(computed(second_fails, range(1000), choice))
    assert dict(computed(second_fails, [5, 0, 3], choice)) == {0: 5, 1: 0, 2: 3}


class LosesSecond(Executor):
    """Computes the first piece of work at once; the second is lost with the executor."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if args[0][0].seed == 0:
            future.set_result(function(*args, **kwargs))
        else:
            future.set_exception(BrokenExecutor("the node is gone"))
        return future


def test_finished_runs_are_kept_when_the_executor_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scenario = load_scenario("nominal", SHORT)
    with monkeypatch.context() as patch:
        patch.setitem(executors._STARTED, executors.THREADS, lambda _: LosesSecond())
        with pytest.raises(StudyError, match="the node is gone"):
            sweep(scenario, [80.0], range(2), RunContext(ExecutorChoice(workers=2), RunCache(tmp_path)))
    cache = RunCache(tmp_path)
    sweep(scenario, [80.0], range(2), RunContext(cache=cache))
    assert cache.reused == 1


@pytest.fixture
def scheduler() -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """A Dask scheduler and one worker in processes of their own."""
    pytest.importorskip("distributed")
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert process.stderr is not None
    address = next(line.split()[-1] for line in process.stderr if "Scheduler at:" in line)
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"]
    helper = subprocess.Popen([*worker, "--no-dashboard"], stderr=subprocess.DEVNULL)
    yield address.removeprefix("tcp://"), process
    for each in (helper, process):
        each.kill()
        each.wait()
    process.stderr.close()


@pytest.mark.slow
def test_a_scheduler_that_goes_away_ends_in_one_message(
    scheduler: tuple[str, subprocess.Popen[str]], monkeypatch: pytest.MonkeyPatch
):
    address, process = scheduler
    monkeypatch.setattr(executors, "CONNECT_SECONDS", 2)
    found = computed(time.sleep, [0.2] * 20, ExecutorChoice.parse(f"dask://{address}"))
    assert next(found)
    process.kill()
    with pytest.raises((StudyError, ConfigError), match=f"--executor dask://{address}: "):
        list(found)


@pytest.mark.parametrize("kind", CLUSTERS)
def test_an_address_where_nobody_answers(kind: str, monkeypatch: pytest.MonkeyPatch):
    choice(kind)
    monkeypatch.setattr(executors, "CONNECT_SECONDS", 1)
    with pytest.raises(ConfigError, match=f"--executor {kind}://127.0.0.1:1: no connection"):
        list(computed(abs, [1], ExecutorChoice.parse(f"{kind}://127.0.0.1:1")))


@pytest.mark.parametrize(("kind", "module"), [("ray", "ray"), ("dask", "distributed")])
def test_an_extra_that_is_missing_is_named(kind: str, module: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=rf"pip install 'sayd-env\[{kind}\]'"):
        list(computed(abs, [1], ExecutorChoice.parse(kind)))


@pytest.mark.parametrize(
    ("text", "workers", "message"),
    [
        ("thread", None, "--executor thread: expected threads, processes, ray"),
        ("", None, "--executor : expected"),
        ("threads://here", None, "--executor threads://here: expected"),
        ("ray://", None, "--executor ray://: expected"),
        ("dask://host:8786", 4, "--workers 4: the cluster at host:8786 has its own"),
    ],
)
def test_executors_that_cannot_be(text: str, workers: int | None, message: str):
    with pytest.raises(ConfigError, match=message):
        ExecutorChoice.parse(text, workers)


def test_runs_that_were_made_are_not_made_again(tmp_path: Path):
    first, second = RunCache(tmp_path), RunCache(tmp_path)
    assert repr(rows(executors.THREADS, first)) == repr(rows(executors.THREADS, second))
    assert (first.reused, second.reused) == (0, 8)


@pytest.mark.usefixtures("ready")
@pytest.mark.parametrize(("policy", "most"), [("mppt2", 20_000), ("ppo", 100_000)])
def test_a_piece_of_work_is_small(policy: str, most: int):
    import pickle  # noqa: PLC0415

    from sayd_env.runs.rollouts import policy_runs  # noqa: PLC0415

    runs = list(policy_runs([policy_spec(policy)], [load_scenario()], [80.0], range(8), load_environment()))
    row = rows(executors.THREADS)[0]
    assert len(pickle.dumps(runs)) < most
    assert len(pickle.dumps(row)) < 1_000
