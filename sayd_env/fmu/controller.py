"""A policy as a co-simulation unit: signals in, valve commands out, once a control period."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sayd_env.agents.policy_archive import read_bytes
from sayd_env.baselines import SAFE
from sayd_env.config import ConfigError, validate
from sayd_env.config.control import load_online
from sayd_env.config.environment import EnvironmentConfig, load_environment
from sayd_env.config.scenario import Scenario
from sayd_env.config.sensors import DAMPERS
from sayd_env.config.units import Array
from sayd_env.envs.episode_batch import make_interface
from sayd_env.fmu.variable import INPUT, OUTPUT, TIME, Variable
from sayd_env.runs.own_code import OwnPolicy
from sayd_env.runs.policies import GuardedPolicy, PolicySpec, policy_spec


def controller_content(policy: str) -> tuple[dict[str, str], Mapping[str, bytes]]:
    """What a unit's model says of a policy, and the file that it needs.

    Raises
    ------
    ConfigError
        An unknown policy, or one of one's own code, whose files nobody knows.
    DataError
        A damaged file.
    """
    spec = policy_spec(policy)
    guarded = isinstance(spec.stored, GuardedPolicy)
    inside = spec.stored.inside if isinstance(spec.stored, GuardedPolicy) else spec
    path = Path(policy.strip().removeprefix(SAFE) if guarded else policy)
    if not path.is_file():
        if isinstance(inside.stored, OwnPolicy):
            raise ConfigError(
                f"policy {policy}: code of one's own cannot be packed; export it as .npz or .onnx"
            )
        return {"policy": policy}, {}
    return {"prefix": SAFE * guarded, "file": path.name}, {path.name: read_bytes(path)}


class ControllerUnit:
    """A policy that a simulation tool steps.

    Parameters
    ----------
    spec : PolicySpec
    scenario : Scenario
        With the damper whose characteristic it may know.

    Attributes
    ----------
    variables : tuple of Variable
        In the order of the values.
    period : float
        Control period, s.

    Raises
    ------
    ConfigError
        A policy that needs features: no sensor gives them.
    """

    def __init__(self, spec: PolicySpec, scenario: Scenario) -> None:
        config = validate(EnvironmentConfig, dict(load_environment()) | dict(spec.needs), spec.title)
        if config.observation == "features":
            raise ConfigError(f"policy {spec.title}: needs features, a unit has signals of sensors")
        interface = make_interface(config, scenario, load_online())
        self._policy, self._interface = spec.make(interface), interface
        signals = interface.signals
        self.variables = (
            Variable("time", "s", "Time", TIME),
            *(
                Variable(s.name, "1" if s.unit == "-" else s.unit, "Reading of a sensor", INPUT)
                for s in signals
            ),
            *(Variable(f"command.{d}", "1", "Valve command: 0 closed, 1 open", OUTPUT) for d in DAMPERS),
        )
        self._signals = slice(1, 1 + len(signals))
        self.period = interface.control_period

    def begin(self, value: Array) -> None:
        """Take the first readings; `value` holds all variables, the commands are set."""
        self._state = None
        self._history = np.tile(value[self._signals], (self._interface.history, 1))
        self._sum, self._elapsed = np.zeros(len(self._interface.signals)), 0.0
        self._act(value)

    def step(self, h: float, value: Array) -> None:
        """Hold the commands over a communication step (s); a control period that ends gives new ones.

        Raises
        ------
        ConfigError
            A step of which a control period has no whole number.
        """
        period = self.period
        if abs(period / h - round(period / h)) > 1e-6:
            raise ConfigError(
                f"found a communication step of {h:g} s; expected one that divides the control period of "
                f"{period:g} s"
            )
        self._sum += h * value[self._signals]
        self._elapsed += h
        if self._elapsed > period - 0.5 * h:
            self._history = np.vstack([self._history[1:], self._sum / self._elapsed])
            self._sum[:], self._elapsed = 0.0, 0.0
            self._act(value)

    def _act(self, value: Array) -> None:
        whole = self._interface.observation == "history"
        seen = self._history if whole else self._history[-1]
        action, self._state = self._policy.predict(seen, self._state)
        value[self._signals.stop :] = np.repeat(action, len(DAMPERS) // self._interface.actions)


def read_policy(content: Mapping[str, str], resources: Path) -> PolicySpec:
    """The policy of a unit's model, see `controller_content`."""
    if "file" not in content:
        return policy_spec(content["policy"])
    return policy_spec(content.get("prefix", "") + str(resources / content["file"]))
