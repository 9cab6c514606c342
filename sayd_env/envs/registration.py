"""The ids under which Gymnasium makes the environments, and what loads policies that are no controllers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
from gymnasium.envs.registration import load_env_creator

VERSION = 1
"""Of the ids. It goes up when vehicle, dampers or track behind them change: an id stands for one plant."""
IDS = {
    f"SAYD/Nominal-v{VERSION}": "nominal",
    f"SAYD/Randomized-v{VERSION}": "randomized",
    f"SAYD/Faults-v{VERSION}": "faults",
}
"""Environments by their ids; Gymnasium refuses an older version by the name of this one."""


def id_of(environment: str) -> str:
    """The id of a packaged environment; of one's own, the first, whose keyword names it."""
    return next((name for name, packaged in IDS.items() if packaged == environment), next(iter(IDS)))


def register_environments() -> None:
    """Register the ids, unless they are registered already.

    No `max_episode_steps`: the environments truncate their episodes themselves; their `spec` says when.
    """
    for name, environment in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="sayd_env.envs.single:SaydEnv",
                vector_entry_point="sayd_env.envs.vector:SaydVectorEnv",
                kwargs={"environment": environment},
            )


_policy_loaders: list[str] = []


def register_policy_loader(entry_point: str) -> None:
    """Register what makes policies that are no controllers.

    Parameters
    ----------
    entry_point : str
        ``module:function``, as Gymnasium has entry points: it is imported when it is needed. The function
        takes a policy's name and an environment.
    """
    _policy_loaders[:] = [entry_point]


def policy_loader() -> Callable[..., Any]:
    """The function that was registered."""
    return load_env_creator(_policy_loaders[0])
