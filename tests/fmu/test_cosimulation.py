"""The example of co-simulation: the damper's units drive the vehicle, the error falls with the step."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sayd_env.config.scenario import load_scenario
from sayd_env.fmu.vehicle import VehicleUnit

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("cosimulation")


def test_the_error_falls_with_the_communication_step(example: ModuleType, damper_units: list[Path]) -> None:
    """First order, for forces are held; with the vehicle's own step it is a few percent."""
    unit = VehicleUnit(load_scenario("estimates", ['damper="sayd-estimate"']))
    errors = []
    for h in (5e-4, 1e-3, 2e-3):
        one = example.alone(unit, h, 0.5)
        other = example.coupled(unit, str(damper_units[0]), h, 0.5)
        errors.append(np.sqrt(np.mean((other - one) ** 2, axis=0) / np.mean(one**2, axis=0)))
    small, middle, large = errors
    ahead = example.coupled(unit, str(damper_units[0]), 5e-4, 0.5, ahead=0.5)
    one = example.alone(unit, 5e-4, 0.5)
    better = np.sqrt(np.mean((ahead - one) ** 2, axis=0) / np.mean(one**2, axis=0))
    assert np.all(small < 0.05)
    assert np.all(better < 0.6 * small)
    assert np.all(middle / small > 1.5)
    assert np.all(large / middle > 1.5)
