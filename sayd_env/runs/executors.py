"""Who computes: threads, processes, a Ray or a Dask cluster, all as a `concurrent.futures.Executor`.

A worker that dies, a lost node, a scheduler that goes away: what is finished has been handed out, the rest is
computed again by a new executor, or the study ends with one message.
"""

from __future__ import annotations

import logging
import multiprocessing
import multiprocessing.connection
import multiprocessing.util
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import forkserver, resource_tracker
from multiprocessing.synchronize import Lock
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from sayd_env.config.errors import ConfigError, StudyError
from sayd_env.config.software import source_fingerprint
from sayd_env.physics.kernel import announced_compilation

T = TypeVar("T")
U = TypeVar("U")

THREADS, PROCESSES, RAY, DASK = KINDS = ("threads", "processes", "ray", "dask")
ATTEMPTS = 3
"""Executors in a row that may break without having finished anything."""
PROCESSES_FROM = 8
"""Pieces of work for which starting processes, some seconds each, pays."""
CONNECT_SECONDS = 20
CLUSTER = 256
"""Workers that a cluster at an address is taken to have: more than that share pieces of single runs."""


def cores() -> int:
    """Cores that this process may use: on a shared node fewer than there are."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class ExecutorChoice:
    """Which executor computes; it changes no result."""

    kind: str = THREADS
    """One of `KINDS`, or empty: processes where there is enough to do, threads otherwise."""
    address: str = ""
    """Of a running Ray or Dask cluster; empty starts one on this machine."""
    workers: int | None = None
    """Threads or processes; all cores by default."""

    @classmethod
    def parse(cls, text: str | None, workers: int | None = None) -> ExecutorChoice:
        """Read ``threads``, ``processes``, ``ray``, ``ray://ADDRESS``, ``dask`` or ``dask://ADDRESS``.

        Raises
        ------
        ConfigError
            Anything else, or a number of workers for a cluster that has its own.
        """
        kind, slashes, address = (text or "").partition("://")
        clusters = kind in {RAY, DASK}
        if text is not None and (kind not in KINDS or (slashes and not (clusters and address))):
            raise ConfigError(
                f"--executor {text}: expected threads, processes, ray, ray://ADDRESS, dask or dask://ADDRESS"
            )
        if address and workers is not None:
            raise ConfigError(f"--workers {workers}: the cluster at {address} has its own number of workers")
        return cls(kind, address, workers)

    def __str__(self) -> str:
        """As on a command line."""
        return f"{self.kind}://{self.address}" if self.address else self.kind

    @property
    def count(self) -> int:
        """Workers among which work is divided."""
        return CLUSTER if self.address else self.workers or cores()


class KeptExecutor:
    """An executor that is started when there is work and kept for more of it, until its context ends.

    Where an exception ends it, its work is abandoned.
    """

    def __init__(self, choice: ExecutorChoice) -> None:
        self.choice = choice
        self._executor: Executor | None = None
        self._kind = ""

    def __enter__(self) -> KeptExecutor:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(at_once=kind is not None)

    def get(self, pieces: int) -> Executor:
        """The executor for some pieces of work.

        Raises
        ------
        ConfigError
            Ray or Dask are not installed, or nobody answers at the address.
        """
        kind = self.choice.kind or self._kind
        if not self.choice.kind and kind != PROCESSES:
            kind = PROCESSES if pieces >= PROCESSES_FROM and self.choice.count > 1 else THREADS
        if self._executor is None or kind != self._kind:
            self.close()
            self._executor, self._kind = _STARTED[kind](self.choice), kind
        return self._executor

    def close(self, *, at_once: bool = False) -> None:
        """End the executor; at once, its work is abandoned."""
        executor, self._executor = self._executor, None
        if executor is None:
            return
        if not at_once:
            executor.shutdown()
        elif isinstance(executor, ProcessPoolExecutor):
            for process in list((executor._processes or {}).values()):  # not all children: some are others'
                process.terminate()
            executor.shutdown(cancel_futures=True)
        else:
            executor.shutdown(wait=False, cancel_futures=True)


def computed(
    work: Callable[[T], U], pieces: Sequence[T], choice: ExecutorChoice, kept: KeptExecutor | None = None
) -> Iterator[tuple[int, U]]:
    """Compute pieces of work; give each one's number and result as soon as it is finished.

    Parameters
    ----------
    work : callable
        A function of a module; it, the pieces and the results travel as pickles unless threads compute.
    kept : KeptExecutor, optional
        The executor of this choice that serves several calls.

    Raises
    ------
    StudyError
        The executor broke `ATTEMPTS` times without finishing anything.
    Exception
        The first one that `work` raises ends it all.
    """
    if kept is None:
        with KeptExecutor(choice) as own:
            yield from computed(work, pieces, choice, own)
        return
    todo = dict(enumerate(pieces))
    broken = 0
    while todo:
        try:
            for i, result in _finished(kept.get(len(todo)), work, todo):
                del todo[i]
                broken = 0
                yield i, result
        except BrokenExecutor as error:
            kept.close(at_once=True)
            broken += 1
            if broken == ATTEMPTS:
                raise StudyError(
                    f"--executor {choice}: the workers ended {ATTEMPTS} times without a result "
                    f"({' '.join(str(error).split())[:200]}); what is finished is kept"
                ) from None
        except BaseException:
            kept.close(at_once=True)
            raise


@dataclass(frozen=True)
class SameSources:
    """Work for a cluster, whose machines may have another version of this package or of a library."""

    work: Callable[[Any], Any]
    fingerprint: str
    """`source_fingerprint` of who sends it."""

    def __call__(self, piece: Any) -> Any:
        """Do it.

        Raises
        ------
        ConfigError
            The sources differ here, and so might the results.
        """
        if source_fingerprint() != self.fingerprint:
            raise ConfigError(
                f"--executor: a worker on {socket.gethostname()} has other sources of sayd_env, or of its "
                "libraries, than the process that sends it work: install the same on all machines"
            )
        return self.work(piece)


def _finished(executor: Executor, work: Callable[[T], U], pieces: dict[int, T]) -> Iterator[tuple[int, U]]:
    if isinstance(executor, _Ray | _Dask):
        work = SameSources(work, source_fingerprint())
    # Not `concurrent.futures.wait`: interrupted while it holds the futures' locks, it never gives them back.
    done: SimpleQueue[Future[U]] = SimpleQueue()
    numbers: dict[Future[U], int] = {}
    for i, piece in pieces.items():
        future = executor.submit(work, piece)
        numbers[future] = i
    for future in numbers:
        future.add_done_callback(done.put)
    for _ in range(len(numbers)):
        future = _next(done)
        try:
            result = future.result()
        except CancelledError as error:
            raise BrokenExecutor(f"work was cancelled ({error or 'the executor is gone'})") from None
        except Exception as error:
            raise (_cause(error) if isinstance(executor, _Ray | _Dask) else error) from None
        yield numbers.pop(future), result


def _next(queue: SimpleQueue[Future[U]]) -> Future[U]:
    while True:
        try:
            # A short timeout lets Ctrl-C through while all threads are in compiled code.
            return queue.get(timeout=0.2)
        except Empty:
            continue


def _cause(error: Exception) -> Exception:
    """What a cluster's exception stands for: the one that the work raised, or the loss of a worker."""
    module = type(error).__module__.partition(".")[0]
    raised = getattr(error, "cause", None)
    if isinstance(raised, Exception):  # Ray wraps what the work raises
        return raised
    if module in {RAY, "distributed"} or isinstance(error, ConnectionError | TimeoutError):
        return BrokenExecutor(str(error) or type(error).__name__)
    return error


def _start_threads(choice: ExecutorChoice) -> Executor:
    return ThreadPoolExecutor(choice.count, thread_name_prefix="sayd")


def _start_processes(choice: ExecutorChoice) -> Executor:
    # A process that forks after a parallel kernel has run would abort in its own first one.
    method = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
    context = multiprocessing.get_context(method)
    if method == "forkserver":
        context.set_forkserver_preload(["sayd_env.runs.rollouts"])
        _start_server()
    announcer = context.Lock()
    return ProcessPoolExecutor(
        choice.count, mp_context=context, initializer=_prepare_process, initargs=(announcer,)
    )


def _start_server() -> None:
    """Start the process that workers are forked from, deaf to Ctrl-C from its imports on, and so are they."""
    resource_tracker.ensure_running()  # would listen again, were it started with the server
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_worker_context = ExitStack()
"""What lasts as long as a worker's process."""


def _prepare_process(announcer: Lock) -> None:
    """Let one process be one thread that ends with its parent and leaves Ctrl-C to it.

    All of them compile what is not compiled yet; whoever gets the lock says so.
    """
    if announcer.acquire(block=False):
        _worker_context.enter_context(
            announced_compilation(lambda text: print(f"sayd: {text}", file=sys.stderr, flush=True))
        )
    threadpool_limits(1)
    sys.stdout = sys.stderr  # what a policy prints is no result
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _leave(*_: object) -> None:
    # The end of a process gives back Numba's semaphore; an exception would only end this piece of work.
    multiprocessing.util._exit_function()  # type: ignore[attr-defined]
    os._exit(0)


def _end_with(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _connecting(choice: ExecutorChoice) -> Iterator[None]:
    """Refuse a cluster that does not answer, at once, and keep our own way to end on a signal."""
    main = threading.current_thread() is threading.main_thread()
    terminate = signal.getsignal(signal.SIGTERM)
    try:
        host, _, port = choice.address.rpartition(":")
        if host:  # Ray would try for ten minutes
            socket.create_connection((host, int(port)), CONNECT_SECONDS).close()
        yield
    except (OSError, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ConfigError(f"--executor {choice}: no connection ({reason})") from None
    if main:
        signal.signal(signal.SIGTERM, terminate)


class _Ray(Executor):
    """Ray's tasks behind the interface of the standard library."""

    def __init__(self, ray: Any, choice: ExecutorChoice) -> None:
        self._ray = ray
        quiet = {"log_to_driver": False, "logging_level": "error"}
        with _connecting(choice):
            if choice.address:
                ray.init(address=_ray_address(choice.address), **quiet)
            else:
                ray.init(num_cpus=choice.count, include_dashboard=False, **quiet)
        self._call = ray.remote(_call)

    def submit(self, function: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        future: Future[T] = self._call.remote(function, *args, **kwargs).future()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._ray.shutdown()


def _call(function: Callable[..., T], *args: Any, **kwargs: Any) -> T:
    return function(*args, **kwargs)


def _ray_address(address: str) -> str:
    """``auto`` and ``HOST:6379`` join a cluster from one of its nodes, ``HOST:10001`` is Ray's client."""
    return f"ray://{address}" if address.endswith(":10001") else address


class _Dask(Executor):
    """A client of Dask, whose executor leaves its cluster open."""

    def __init__(self, distributed: Any, choice: ExecutorChoice) -> None:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what is lost is computed again
        where = {"address": f"tcp://{choice.address}"} if choice.address else {"n_workers": choice.count}
        alone = {} if choice.address else {"threads_per_worker": 1, "dashboard_address": None}
        with _connecting(choice):
            self._client = distributed.Client(**where, **alone, timeout=CONNECT_SECONDS)

    def submit(self, function: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        future: Future[T] = self._client.get_executor(pure=False).submit(function, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._client.close()


def _start_cluster(choice: ExecutorChoice) -> Executor:
    made: dict[str, tuple[str, Callable[[Any, ExecutorChoice], Executor]]] = {
        RAY: ("ray", _Ray),
        DASK: ("distributed", _Dask),
    }
    name, executor = made[choice.kind]
    try:
        library = import_module(name)
    except ModuleNotFoundError:
        raise ConfigError(
            f"--executor {choice.kind}: {choice.kind.capitalize()} is not installed; "
            f"install it with pip install 'sayd-env[{choice.kind}]'"
        ) from None
    return executor(library, choice)


_STARTED: dict[str, Callable[[ExecutorChoice], Executor]] = {
    THREADS: _start_threads,
    PROCESSES: _start_processes,
    RAY: _start_cluster,
    DASK: _start_cluster,
}
