"""How a study has its runs made: who computes, where finished runs are kept, where progress is reported."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np

from sayd_env.config.errors import ConfigError
from sayd_env.config.software import floor_fingerprint
from sayd_env.physics.formation import WIDTH
from sayd_env.runs.cache import RunCache, fingerprint
from sayd_env.runs.executors import ExecutorChoice, KeptExecutor, computed

Record = TypeVar("Record")


class Progress(Protocol):
    """How a study reports how far it is; called from the thread that started it."""

    def __call__(self, done: float, total: float, what: str = "") -> None:
        """Report `done` of `total` steps; `what` names the current one."""


def refuse_empty(**given: Sequence[Any]) -> None:
    """Refuse to make a study of nothing.

    Raises
    ------
    ConfigError
        A sequence has no elements; the message has its keyword.
    """
    for name, values in given.items():
        if len(values) == 0:
            raise ConfigError(f"{name}: found none; expected at least one")


def silent(done: float, total: float, what: str = "") -> None:
    """Report no progress: the default of every study."""


class RunSpec(Protocol):
    """All that a run depends on; it travels to the worker as a pickle."""

    def inputs(self) -> Sequence[Any]:
        """What the run's result depends on, as `fingerprint` takes it; equal objects may be shared."""

    def companions(self) -> Hashable:
        """Key of the runs with which this one can be computed in one piece; by default it has none."""
        return id(self)

    def duration(self) -> float:
        """How long it takes beside its companions, in any unit: those about as long run side by side."""
        return 0.0


Spec = TypeVar("Spec", bound=RunSpec)


@dataclass(frozen=True)
class RunContext:
    """How runs are made. It changes no result."""

    executor: ExecutorChoice = field(default_factory=ExecutorChoice)
    cache: RunCache = field(default_factory=RunCache)
    """By default one in memory."""
    progress: Progress = silent
    kept: KeptExecutor | None = None
    """The executor, where it is to serve several of the study's parts."""

    def part(self, before: float, whole: float, name: str = "") -> RunContext:
        """The same for a part of a study: its progress counts from `before` on, of a `whole`."""
        progress = self.progress

        def report(done: float, total: float, what: str = "") -> None:
            progress(before + done, whole, name or what)

        return replace(self, progress=report)

    def records(
        self,
        work: Callable[[list[Spec]], list[Record]],
        specs: Sequence[Spec],
        kind: type[Record],
        what: str = "",
    ) -> list[Record]:
        """Records of runs, in their order: what is kept from the cache, the others computed and kept.

        Parameters
        ----------
        work : callable
            Makes the runs of one piece of work and returns their records; a function of a module, because it
            may be called in another process.
        specs : sequence
            What is to be run.
        kind : type
            Dataclass of the records, see `RunCache.get`.
        what : str
            Names the runs where progress is reported.

        Raises
        ------
        StudyError
            See `computed` and `RunCache.put`.
        Exception
            The first one that `work` raises.
        """
        keys = _keys(work, specs)
        found = {i: record for i, key in enumerate(keys) if (record := self.cache.get(key, kind)) is not None}
        missing = [i for i in range(len(specs)) if i not in found]
        parts = pieces(specs, missing, self.executor.count)
        how = self.executor, self.kept
        for number, records in computed(work, [[specs[i] for i in part] for part in parts], *how):
            for i, record in zip(parts[number], records, strict=True):
                self.cache.put(keys[i], record)
                found[i] = record
            self.progress(len(found), len(specs), what)
        return [found[i] for i in range(len(specs))]


def _keys(work: Callable[..., Any], specs: Sequence[RunSpec]) -> list[str]:
    """Names of the runs in the cache; an object that many specs share is read once."""
    known: dict[int, str] = {}

    def digest(value: Any) -> str:
        if id(value) not in known:
            known[id(value)] = fingerprint(value)
        return known[id(value)]

    inputs = [spec.inputs() for spec in specs]  # all of them live until the end: no id is used twice
    # What makes the runs may stand on a floor that the others do not depend on.
    maker = f"{work.__module__}.{work.__qualname__} {floor_fingerprint(work.__module__)}"
    return [fingerprint(maker, [digest(value) for value in each]) for each in inputs]


def pieces(specs: Sequence[RunSpec], which: Sequence[int], workers: int) -> list[list[int]]:
    """Numbers of the specs of each piece of work: equal pieces, and one for each worker where that can be.

    None is of more runs than the simulator advances side by side. The longest runs of a group come first, so
    that those of a piece end together, and no worker begins a long one when the others are done.
    """
    groups: dict[Hashable, list[int]] = {}
    for i in sorted(which, key=lambda i: -specs[i].duration()):
        groups.setdefault(specs[i].companions(), []).append(i)
    widest = min(WIDTH, max(1, math.ceil(len(which) / workers)))
    return [
        part.tolist()
        for group in groups.values()
        for part in np.array_split(group, math.ceil(len(group) / widest))
    ]
