"""Units that several tests use: machine code is made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from sayd_env.config.damper import load_sayd
from sayd_env.fmu.unit import damper_unit
from sayd_env.studies.fmu import export


@pytest.fixture(scope="session")
def damper_units(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Files of the estimated damper as a unit, for FMI 2.0 and 3.0."""
    return export(damper_unit(load_sayd("sayd-estimate")), tmp_path_factory.mktemp("fmu")).files
