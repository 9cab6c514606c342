"""Learned policies among the controllers: evaluated on the same tracks, on signals of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sayd_env.agents.config import InputConfig, NetworkConfig, OutputConfig
from sayd_env.agents.policy_file import StoredPolicy, describe, save_policy
from sayd_env.config import ConfigError, DataError
from sayd_env.config.environment import load_environment
from sayd_env.config.scenario import load_scenario
from sayd_env.envs.single import SaydEnv
from sayd_env.runs.policies import policy_spec
from sayd_env.studies.evaluate import evaluate

SHORT = ["assessment.length=600", "wear=1"]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy without memory or sight, of one constant command: V = (1 - 0.4) / 2 = 0.3."""
    interface = SaydEnv(observation="features", control_period=0.05).interface
    description = describe(
        interface,
        name="learned",
        inputs={"speed": InputConfig(middle=80.0, half=20.0)},
        clip=3.0,
        output=OutputConfig(kind="command"),
        network=NetworkConfig(hidden=(), activation="tanh"),
        squash="clip",
    )
    layer = np.zeros((2, 1), np.float32), np.full(2, -0.4, np.float32)
    path = tmp_path_factory.mktemp("policies") / "learned.npz"
    save_policy(path, StoredPolicy(description, (layer,)))
    return path


def test_a_blind_policy_runs_as_the_constant_command(file: Path) -> None:
    policies = [policy_spec(str(file)), policy_spec("constant:0.3")]
    result = evaluate(load_scenario(overrides=SHORT), [350 / 3.6], range(2), policies=policies)
    learned, constant = result.runs("learned"), result.runs("constant:0.3")
    for one, other in zip(learned, constant, strict=True):
        # The clocks differ, 50 and 10 ms: the runs end a fraction of a step apart, the means over them agree.
        assert one.valve_mean == pytest.approx(0.3)
        assert pytest.approx(other.J, rel=1e-6) == one.J
        assert one.J_offline == pytest.approx(other.J_offline, rel=1e-3)
        assert one.force_rms_n == pytest.approx(other.force_rms_n, rel=1e-3)


def test_what_cannot_be_used_is_refused(file: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such policy file"):
        policy_spec("nothing.npz")
    (tmp_path / "half.npz").write_bytes(file.read_bytes()[:300])
    with pytest.raises(DataError, match="damaged"):
        policy_spec(str(tmp_path / "half.npz"))
    odd = load_environment(overrides=["episode_s=0.33"])
    with pytest.raises(ConfigError, match=r"learned.npz.*episode_s"):
        policy_spec(str(file)).environment(odd)
