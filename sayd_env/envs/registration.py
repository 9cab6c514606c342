"""The ids under which Gymnasium makes the environments."""

from __future__ import annotations

import gymnasium

IDS = {
    "SAYD/Nominal-v0": "nominal",
    "SAYD/Randomized-v0": "randomized",
    "SAYD/Faults-v0": "faults",
}
"""Environments by their ids."""


def register_environments() -> None:
    """Register the ids, unless they are registered already.

    No `max_episode_steps`: the environments truncate their episodes themselves.
    """
    for name, environment in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="sayd_env.envs.single:SaydEnv",
                vector_entry_point="sayd_env.envs.vector:SaydVectorEnv",
                kwargs={"environment": environment},
            )
