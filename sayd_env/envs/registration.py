"""The ids under which Gymnasium makes the environments.

Importing Gymnasium imports NumPy, which the command line's help does without and whose BLAS threads it wants
to settle first. So the ids are registered at once where Gymnasium is loaded, and else when it gets loaded.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

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
    import gymnasium  # noqa: PLC0415 - see above

    for name, environment in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="sayd_env.envs.single:SaydEnv",
                vector_entry_point="sayd_env.envs.vector:SaydVectorEnv",
                kwargs={"environment": environment},
            )


def register_when_loaded() -> None:
    """Register the ids now, or as soon as Gymnasium has been imported."""
    if "gymnasium" in sys.modules:
        register_environments()
    elif not any(isinstance(finder, _AtImport) for finder in sys.meta_path):
        sys.meta_path.insert(0, _AtImport())


class _AtImport:
    """Lets Gymnasium be found as ever, and registers the ids behind its import.

    A finder of modules by its method alone: its base class would cost more to import than all of this.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def execute_and_register(module: ModuleType) -> None:
            execute(module)
            register_environments()

        spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
