"""Digests of what must not change while policies are trained and compared: plant, environment, weights."""

from __future__ import annotations

import hashlib
import json
from importlib import resources
from typing import Any

from sayd_env.config.damper import load_sayd
from sayd_env.config.environment import EnvironmentConfig
from sayd_env.config.loader import packaged_names
from sayd_env.config.scenario import Scenario

_SAID = ("description", "provenance")


def digests(scenario: Scenario, environment: EnvironmentConfig) -> dict[str, Any]:
    """SHA-256 of everything that two results must share to be comparable.

    Parameters
    ----------
    scenario : Scenario
        The study on which the environment stands.
    environment : EnvironmentConfig

    Returns
    -------
    dict
        ``plant``: vehicle, both kinds of damper, wheels, rails, track, contact, integration, assessment;
        ``environment``: sensors, clock, what is drawn, charge for a derailment; ``weights``: of J;
        ``controllers``: each file of configs/control; ``sha256``: all of them together.
    """
    plant = scenario.model_dump(mode="json", exclude={"cost"})
    parts: dict[str, Any] = {
        "plant": _digest([plant, load_sayd("sayd").model_dump(mode="json")]),
        "environment": _digest(environment.model_dump(mode="json")),
        "weights": _digest(scenario.cost.model_dump(mode="json")),
        "controllers": {name: _file_digest(name) for name in packaged_names("control")},
    }
    return {"sha256": _digest(parts), **parts}


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(_bare(content), sort_keys=True).encode()).hexdigest()


def _bare(content: Any) -> Any:
    """Content without what is said about it."""
    if isinstance(content, dict):
        return {key: _bare(value) for key, value in content.items() if key not in _SAID}
    return [_bare(value) for value in content] if isinstance(content, list) else content


def _file_digest(name: str) -> str:
    file = resources.files("sayd_env.configs").joinpath("control", f"{name}.yaml")
    return hashlib.sha256(file.read_bytes()).hexdigest()
