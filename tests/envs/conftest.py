"""An environment that starts in a moment."""

from __future__ import annotations

from pathlib import Path

import pytest

QUICK = """
base: {base}
run_in: 20.0
episode_s: 0.2
"""


def _quick(folder: Path, base: str) -> str:
    path = folder / f"{base}.yaml"
    path.write_text(QUICK.format(base=base))
    return str(path)


@pytest.fixture(scope="session")
def quick(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Path of the nominal environment with a run-in of 20 m and episodes of 20 steps."""
    return _quick(tmp_path_factory.mktemp("env"), "nominal")


@pytest.fixture(scope="session")
def quick_faults(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The same of the environment with faults, everything drawn."""
    return _quick(tmp_path_factory.mktemp("env"), "faults")
