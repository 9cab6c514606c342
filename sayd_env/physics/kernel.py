"""The one decorator of all compiled code."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from types import FunctionType
from typing import Any, ParamSpec, TypeVar, overload

# Threads that wait for work sleep instead of spinning: beside other busy processes (workers, a learner's own
# threads) spinning costs a small batch nine tenths of its speed. Read when numba loads OpenMP.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numba
from numba.core import event, types
from numba.core.compiler import Compiler
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic
from numba.np.ufunc import parallel as threading_layer

from sayd_env.config import ConfigError
from sayd_env.physics.kernel_cache import kernel_cache, kernel_folder, numba_config

njit: Any = numba.njit  # its annotations leave out the option that switches reference counts off
_ANNOUNCEMENTS: dict[tuple[str, str], str] = {}
REMINDED_EVERY = 15.0
"""Time after which a compilation that goes on is reported (s)."""

P = ParamSpec("P")
R = TypeVar("R")

COMPILES = not numba_config.DISABLE_JIT
"""False where ``NUMBA_DISABLE_JIT=1`` lets Python run the kernels: for debuggers, for measuring coverage."""
CACHE_DIRECTORY = kernel_folder() if COMPILES else None
"""None where nothing can be kept."""


class _DistinctArrays(Compiler):
    """Numba's compiler, which declares to LLVM that array arguments do not overlap."""

    def define_pipelines(self) -> Any:
        self.state.flags.noalias = True
        return super().define_pipelines()  # type: ignore[no-untyped-call]


class _InlinedKernel(CPUDispatcher):
    """A kernel that is merged into its callers: it has no entry from Python."""

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Refuse, where the missing entry would end the process.

        Raises
        ------
        TypeError
            Always.
        """
        raise TypeError(
            f"{self.py_func.__qualname__} is merged into the kernels that call it; call one of them"
        )


@overload
def kernel(function: Callable[P, R], /) -> Callable[P, R]: ...


@overload
def kernel(
    *,
    parallel: bool = False,
    inline: bool = False,
    distinct: bool = False,
    allocates: bool = True,
    announce: str | None = None,
) -> Callable[[Callable[P, R]], Callable[P, R]]: ...


def kernel(
    function: Callable[..., Any] | None = None,
    /,
    *,
    parallel: bool = False,
    inline: bool = False,
    distinct: bool = False,
    allocates: bool = True,
    announce: str | None = None,
) -> Any:
    """Compile a function: cached on disk, IEEE arithmetic (no fast-math), NumPy's division by zero.

    Parameters
    ----------
    function : callable
        The function; omit it to pass options.
    parallel : bool
        Allow `numba.prange` loops.
    inline : bool
        Merge the function into its callers, so that a loop that calls it can become vector instructions.
        Only kernels can call it then, not Python.
    distinct : bool
        The function's arrays never overlap in memory. A loop that reads a table at computed places becomes
        vector instructions only if the compiler may rely on that; arrays that overlap give wrong results.
    allocates : bool
        Whether the function, or one that it calls, makes arrays. If not, arrays need no reference counts,
        which for a tuple of fifty arrays cost more than many a kernel.
    announce : str, optional
        What is compiled and how long it takes, for `announced_compilation`: worth saying of kernels that take
        seconds.
    """

    def compile_(f: Callable[..., Any]) -> Any:
        if not COMPILES:
            return f
        dispatcher = njit(
            error_model="numpy",
            nogil=True,
            parallel=parallel,
            forceinline=inline,
            pipeline_class=_DistinctArrays if distinct else Compiler,
            _nrt=allocates,
            # No entry from C, and none from Python for what is merged: each takes longer than many a kernel.
            no_cfunc_wrapper=True,
            no_cpython_wrapper=inline,
        )(f)
        if inline:
            dispatcher.__class__ = _InlinedKernel
        dispatcher._cache = kernel_cache(f, CACHE_DIRECTORY)
        if announce is not None:
            _ANNOUNCEMENTS[f.__module__, f.__qualname__] = announce
        return dispatcher

    return compile_ if function is None else compile_(function)


def instructions(plain: Callable[P, R]) -> Callable[[Callable[..., Any]], Callable[P, R]]:
    """Decorate an operation of kernels that is written in LLVM's own instructions, a Numba intrinsic.

    Parameters
    ----------
    plain : callable
        The same operation, the same bits, in Python: serves where nothing is compiled.
    """

    def made(typed: Callable[..., Any]) -> Any:
        return intrinsic(typed) if COMPILES else plain

    return made


def _nothing() -> None:
    pass


@instructions(_nothing)
def gathered_reads(_context: Any) -> Any:
    """Let the loops of the kernel that calls this read tables by gathers wherever the processor has them.

    Where LLVM takes them for slow (AMD before AVX-512), a loop with many reads at computed places gets no
    vector instructions at all: the hydraulics then take three times as long.
    """

    def codegen(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        features = context.codegen().magic_tuple()[2].split(",")
        if "+avx2" in features and "+avx512f" not in features:
            own = ",".join([*features, "+fast-gather"])
            # llvmlite's own `add` knows only attributes without a value.
            set.add(builder.function.attributes, f'"target-features"="{own}"')
        return context.get_dummy_value()

    return types.void(), codegen


def specialised(function: Callable[P, R], arguments: tuple[Any, ...]) -> Callable[P, R]:
    """A kernel's machine code for arguments of these types: calling it does not look at the types again."""
    if not COMPILES:
        return function
    dispatcher: Any = function
    return dispatcher.compile(tuple(map(numba.typeof, arguments)))  # type: ignore[no-any-return]


@contextmanager
def compiled_threads(count: int) -> Iterator[None]:
    """Number of threads of the parallel kernels that are called in this context; 1 for kernels without.

    Raises
    ------
    ConfigError
        This process is the fork of one in which such threads ran. They are not in the copy, and GNU OpenMP
        would wait for them or end it: without a word to a parent that waits for an answer.
    """
    if count == 1:
        yield
        return
    if _lost_threads:
        raise ConfigError(
            "num_threads: this process was forked from one that had started compiled threads, which a fork "
            "does not copy; start workers with 'forkserver' or 'spawn', such as AsyncVectorEnv(..., "
            "context='forkserver'), or give their batches num_threads=1"
        )
    before = numba.get_num_threads()
    numba.set_num_threads(count)
    try:
        # Vehicles differ in their steps: a thread that is free takes the next one.
        with numba.parallel_chunksize(1):
            yield
    finally:
        numba.set_num_threads(before)


_lost_threads = False


def _after_fork() -> None:
    global _lost_threads  # noqa: PLW0603 - a state of the process
    _lost_threads = threading_layer._is_initialized


if hasattr(os, "register_at_fork"):  # Windows does not fork
    os.register_at_fork(after_in_child=_after_fork)


@contextmanager
def announced_compilation(say: Callable[[str], None]) -> Iterator[None]:
    """Say, while this context is open, what is being compiled, that it goes on, and how long it took.

    Kernels that come from the cache are not mentioned: Numba tells of compilations alone.

    Parameters
    ----------
    say : callable
        Receives one line of text, from whichever thread compiles, or from one that waits beside it.
    """
    with event.install_listener("numba:compile", _Announcer(say)):
        yield


class _Announcer(event.Listener):
    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say
        self.begin: dict[tuple[str, str], tuple[float, Event]] = {}

    def on_start(self, event: Any) -> None:
        name = _kernel_name(event)
        if name in _ANNOUNCEMENTS:
            self.begin[name] = begin, done = time.perf_counter(), Event()
            self.say(f"compiling {_ANNOUNCEMENTS[name]} ...")
            Thread(target=self._remind, args=(begin, done), daemon=True).start()

    def _remind(self, begin: float, done: Event) -> None:
        while not done.wait(REMINDED_EVERY):
            self.say(f"still compiling after {time.perf_counter() - begin:.0f} s ...")

    def on_end(self, event: Any) -> None:
        begun = self.begin.pop(_kernel_name(event), None)
        if begun is not None:
            begin, done = begun
            done.set()
            self.say(f"compiled in {time.perf_counter() - begin:.1f} s")


def _kernel_name(compilation: Any) -> tuple[str, str]:
    function = compilation.data["dispatcher"].py_func
    return function.__module__, function.__qualname__


def named(function: Callable[P, None], name: str) -> Callable[P, None]:
    """The same function under another name: Numba's cache tells its kernels apart by theirs."""
    copy = FunctionType(function.__code__, function.__globals__, name)
    copy.__qualname__, copy.__doc__, copy.__module__ = name, function.__doc__, function.__module__
    return copy
