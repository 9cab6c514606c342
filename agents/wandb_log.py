"""A training's log at Weights & Biases, beside the run's own tables: only where it is asked for."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stable_baselines3.common.logger import KVWriter

from sayd_env.config import ConfigError

PROJECT = "sayd-env"


def service() -> Any:
    """The service's package.

    Raises
    ------
    ConfigError
        It is not installed.
    """
    try:
        import wandb  # noqa: PLC0415 - may be missing, and takes its time
    except ModuleNotFoundError as error:
        raise ConfigError(
            "--wandb needs Weights & Biases: install it with pip install 'sayd-env[wandb]' "
            f"(no module '{error.name}')"
        ) from None
    return wandb


class WandbWriter(KVWriter):
    """The learner's log as a run at Weights & Biases.

    Parameters
    ----------
    folder : Path
        Of the run, whose name it gets; files of the service go there.
    begun : str
        When the run began: a resumed one goes on with the same run of the service.
    config : mapping
        What was chosen.

    Raises
    ------
    ConfigError
        The package is not installed, or the service refuses.
    """

    def __init__(self, folder: Path, begun: str, config: Mapping[str, Any]) -> None:
        wandb = service()
        key = hashlib.sha256(f"{folder.resolve()} {begun}".encode()).hexdigest()[:16]
        try:
            self._run = wandb.init(
                project=PROJECT,
                id=key,
                name=folder.name,
                dir=str(folder),
                config=dict(config),
                resume="allow",
            )
        except Exception as error:  # its errors have no common base
            message = str(error).splitlines() or [type(error).__name__]
            raise ConfigError(f"--wandb: {message[0]}") from None

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, Any], step: int = 0) -> None:
        """Send a row of numbers."""
        numbers = {key: value for key, value in key_values.items() if isinstance(value, float | int)}
        self._run.log(numbers, step=step)

    def close(self) -> None:
        """End the service's run."""
        self._run.finish()
