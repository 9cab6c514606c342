"""Environments that start in a moment; what needs Stable-Baselines3 is skipped where it is not installed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sayd_env.envs.interface import Interface

QUICK = """
base: {base}
run_in: 20.0
episode_s: {seconds}
"""


def _quick(folder: Path, base: str, seconds: float) -> str:
    path = folder / f"{base}_{seconds:g}.yaml"
    path.write_text(QUICK.format(base=base, seconds=seconds))
    return str(path)


@pytest.fixture(scope="session")
def quick(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of the nominal environment with a run-in of 20 m and episodes of 20 steps."""
    return _quick(tmp_path_factory.mktemp("env"), "nominal", 0.2)


@pytest.fixture(scope="session")
def quick_faults(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The same of the environment with faults, everything drawn."""
    return _quick(tmp_path_factory.mktemp("env"), "faults", 0.2)


@pytest.fixture(scope="session")
def two_seconds(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of the nominal environment with a run-in of 20 m and episodes of 2 s."""
    return _quick(tmp_path_factory.mktemp("env"), "nominal", 2.0)


@pytest.fixture(scope="module")
def mirrored(interface: Interface) -> Callable[[np.ndarray], np.ndarray]:
    """Observations of the same motion seen in a mirror: sides exchanged, lateral accelerations reversed."""

    def turned(block: np.ndarray) -> np.ndarray:
        found = block.copy()
        for i, signal in enumerate(interface.signals):
            quantity, *place = signal.name.split(".")
            other = [{"left": "right", "right": "left"}.get(part, part) for part in place]
            source = interface.index(".".join([quantity, *other]))
            found[..., i] = block[..., source] * (-1.0 if quantity == "lateral_acceleration" else 1.0)
        return found

    return turned
