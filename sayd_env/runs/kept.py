"""Groups of runs of which an interrupted study has finished some: only the others are run."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from sayd_env.agents.policy_file import policy_bytes
from sayd_env.config.control import load_controller, load_online
from sayd_env.envs.rollout import Rollout
from sayd_env.runs.cache import RunStore
from sayd_env.report.files import Progress, silent
from sayd_env.runs.policies import PolicySpec
from sayd_env.runs.rollouts import Group, run_groups

CONSTANT = "constant"
Record = TypeVar("Record")
Place = Callable[[Group, int], tuple[RunStore[Record] | None, str]]
"""Store and name of the run of a group with a seed; None for a study that keeps nothing."""


def run_kept(
    groups: Sequence[Group],
    analyse: Callable[[Group, Rollout], Record],
    place: Place[Record],
    *,
    workers: int | None = None,
    progress: Progress = silent,
) -> list[list[Record]]:
    """Results of all runs, those that are kept from the disk, the others computed and kept.

    Parameters and errors are those of `run_groups`.

    Returns
    -------
    list of list
        The results of each group in the order of its seeds.
    """
    found: list[dict[int, Record]] = [{} for _ in groups]
    for group, results in zip(groups, found, strict=True):
        for seed in group.seeds:
            store, name = place(group, seed)
            kept = None if store is None else store.get(name)
            if kept is not None:
                results[seed] = kept
    missing = [
        replace(group, seeds=tuple(seed for seed in group.seeds if seed not in results))
        for group, results in zip(groups, found, strict=True)
    ]
    before = sum(map(len, found))

    def kept_analysis(group: Group, rollout: Rollout) -> Record:
        record = analyse(group, rollout)
        store, name = place(group, rollout.episode.seed)
        if store is not None:
            store.put(name, record)
        return record

    def report(done: float, total: float, what: str = "") -> None:
        progress(before + done, before + total, what)

    new = run_groups(missing, kept_analysis, workers=workers, progress=report)
    for group, results, records in zip(missing, found, new, strict=True):
        results.update(zip(group.seeds, records, strict=True))
    return [[results[seed] for seed in group.seeds] for group, results in zip(groups, found, strict=True)]


def constant_command(policy: PolicySpec) -> float | None:
    """Command of a policy that gives one for ever, of its own parameters or of its file; None for others.

    Raises
    ------
    ConfigError
        Parameters that cannot be read.
    """
    if policy.name != CONSTANT:
        return None
    found = load_controller(policy.name, policy.parameters)
    return float(found.model_dump()["current"])


def identity_of_constants() -> dict[str, Any]:
    """`identity` of all constant commands together; the command stands in the names of their runs."""
    return {"policy": CONSTANT, "online": load_online().model_dump(mode="json")}


def identity(policy: PolicySpec) -> dict[str, Any]:
    """What a kept run depends on because of its policy.

    Of a controller all its parameters, of a learned policy the SHA-256 of its weights and description, of
    each the on-line filter, whose output they may see and by which J is taken.

    Raises
    ------
    ConfigError
        A controller whose parameters cannot be read.
    """
    if policy.stored is not None:
        what: Any = hashlib.sha256(policy_bytes(policy.stored)).hexdigest()
    else:
        what = load_controller(policy.name, policy.parameters).model_dump(mode="json")
    return {"policy": policy.name, "is": what, "online": load_online().model_dump(mode="json")}
