"""A policy as a unit: the same commands as the policy gives in an environment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from sayd_env.config import ConfigError
from sayd_env.config.scenario import Scenario, load_scenario
from sayd_env.config.sensors import DAMPERS, SIGNALS
from sayd_env.fmu.controller import ControllerUnit, controller_content, read_policy
from sayd_env.fmu.serve import restored
from sayd_env.fmu.unit import controller_unit
from sayd_env.runs.policies import load_policy, policy_spec
from sayd_env.studies.fmu import export

PERIODS = 30


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("estimates", ['damper="sayd-estimate"'])


def readings() -> np.ndarray:
    """Sensors' signals every millisecond, (10 PERIODS, 41): a hunting bogie at 83 m/s."""
    t = 1e-3 * np.arange(10 * PERIODS)
    signals = np.zeros((len(t), len(SIGNALS)))
    for k, name in enumerate(SIGNALS):
        side = -1.0 if "right" in name else 1.0
        wave = side * np.sin(2 * np.pi * 5.0 * t + 0.3 * k)
        scale = {"longitudinal_acceleration": 3.0, "lateral_acceleration": 4.0, "stroke": 4e-3}
        signals[:, k] = scale.get(name.partition(".")[0], 0.0) * wave
    signals[:, list(SIGNALS).index("speed")] = 83.0
    return signals


def commands(unit: ControllerUnit, signals: np.ndarray) -> np.ndarray:
    """Commands (PERIODS + 1, 8) before the first period and after each."""
    value = np.zeros(len(unit.variables))
    value[1 : 1 + len(SIGNALS)] = signals[0]
    unit.begin(value)
    found = [value[-len(DAMPERS) :].copy()]
    for n, row in enumerate(signals, start=1):
        value[1 : 1 + len(SIGNALS)] = row
        unit.step(1e-3, value)
        if n % 10 == 0:
            found.append(value[-len(DAMPERS) :].copy())
    return np.array(found)


@pytest.mark.parametrize("name", ["skyhook-onoff", "mppt1", "constant:0.3"])
def test_commands_are_those_of_the_policy(name: str, scenario: Scenario) -> None:
    """It sees what an environment shows it: first what there is, then means over 10 ms."""
    signals = readings()
    found = commands(ControllerUnit(policy_spec(name), scenario), signals)
    policy, state = load_policy(name), None
    seen = np.vstack([signals[:1], signals.reshape(PERIODS, 10, -1).mean(axis=1)])
    for row, command in zip(seen, found, strict=True):
        action, state = policy.predict(row, state)
        assert command == pytest.approx(np.repeat(action, 4), abs=1e-7)
    if name == "skyhook-onoff":
        assert len(np.unique(found)) == 2


def test_its_resources_are_all_that_it_needs(scenario: Scenario, tmp_path: Path) -> None:
    parameters = tmp_path / "mine" / "skyhook-onoff.yaml"
    parameters.parent.mkdir()
    parameters.write_text("base: skyhook-onoff\nset:\n  closed: 0.11\n")
    result = export(controller_unit(str(parameters), scenario), tmp_path)
    assert [validate_fmu(str(file)) for file in result.files] == [[], []]
    parameters.unlink()
    for name, data in result.unit.resources.items():
        (tmp_path / name).write_bytes(data)
    unit = restored(tmp_path)
    assert isinstance(unit, ControllerUnit)
    assert np.unique(commands(unit, readings())) == pytest.approx([0.11, 1.0], abs=1e-7)


def test_a_step_that_does_not_divide_the_period_is_refused(scenario: Scenario) -> None:
    unit = ControllerUnit(policy_spec("constant:0.3"), scenario)
    value = np.zeros(len(unit.variables))
    unit.begin(value)
    with pytest.raises(ConfigError, match=r"divides the control period of 0\.01 s"):
        unit.step(3e-3, value)


def test_code_of_one_s_own_is_not_packed(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text("def make(interface):\n    return None\n")
    with pytest.raises(ConfigError, match="cannot be packed"):
        controller_content(f"{tmp_path / 'own.py'}:make")


def test_a_policy_in_the_fallback_is_packed(tmp_path, trained_file):
    """By name, or with its file, which lies elsewhere in the unit."""
    assert controller_content("safe:mppt2") == ({"policy": "safe:mppt2"}, {})
    trained_file(tmp_path / "own.npz")
    content, files = controller_content(f"safe:{tmp_path / 'own.npz'}")
    resources = tmp_path / "resources"
    resources.mkdir()
    for name, data in files.items():
        (resources / name).write_bytes(data)
    found, given = read_policy(content, resources), policy_spec(f"safe:{tmp_path / 'own.npz'}")
    assert (found.title, found.identity()) == (given.title, given.identity())
