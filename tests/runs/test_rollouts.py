"""Runs of policies: what of an environment acts in them, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sayd_env.config import ConfigError
from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import Scenario
from sayd_env.envs.draw import draw_episode
from sayd_env.runs.policies import policy_spec
from sayd_env.runs.rollouts import Run, _episode, policy_runs


def only(scenario: Scenario, environment: str, seed: int) -> Run:
    (run,) = policy_runs([policy_spec("mppt2")], [scenario], [90.0], [seed], load_environment(environment))
    return run


def test_faults_of_the_environment_are_those_of_its_episode(short_scenario: Scenario):
    """A run that brings faults of its own, or none, has these."""
    for seed in range(4):
        run = only(short_scenario, "faults", seed)
        drawn = draw_episode(load_environment("faults"), seed, 0).faults
        assert drawn
        assert _episode(run.environment, run).faults == drawn
        assert _episode(run.environment, replace(run, faults=())).faults == ()
    assert run.inputs() != replace(run, faults=()).inputs()
    plain = only(short_scenario, "nominal", 0)
    assert _episode(plain.environment, plain).faults == ()


def test_an_environment_along_lines_is_refused(short_scenario: Scenario):
    with pytest.raises(ConfigError, match="goes along lines of its own"):
        only(short_scenario, "line", 0)
