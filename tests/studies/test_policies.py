"""The list of policies, and the names of ready ones wherever policies are named."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from sayd_env import baselines
from sayd_env.agents import pretrained
from sayd_env.agents.config import InputConfig, NetworkConfig, OutputConfig
from sayd_env.agents.policy_file import StoredPolicy, describe, save_policy
from sayd_env.agents.pretrained import cards
from sayd_env.cli import main
from sayd_env.config import ConfigError, DataError
from sayd_env.envs.single import SaydEnv
from sayd_env.runs.policies import policy_spec
from sayd_env.studies.learning import read_source
from sayd_env.studies.policies import policies


def save(path: Path, algorithm: str, seed: int) -> None:
    """Write a policy as a training leaves it."""
    made = {
        "steps": 1_000_000,
        "seconds": 1500.0,
        "J": 0.0321,
        "config": {
            "seed": seed,
            "learning": {"algorithm": algorithm},
            "environment": {"name": "training"},
        },
        "git_commit": "0123456789abcdef",
        "git_modified": True,
    }
    description = describe(
        SaydEnv(observation="features", control_period=0.05).interface,
        name=f"{algorithm}-s{seed}",
        inputs={"speed": InputConfig(middle=80.0, half=20.0)},
        clip=3.0,
        output=OutputConfig(kind="command"),
        network=NetworkConfig(hidden=(), activation="tanh"),
        squash="clip",
        made=made,
    )
    save_policy(path, StoredPolicy(description, ((np.zeros((2, 1), np.float32), np.zeros(2, np.float32)),)))


@pytest.fixture
def ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of two trainings in place of the package's."""
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    save(tmp_path / "ppo-s0.npz", "ppo", 0)
    save(tmp_path / "ppo-s1.npz", "ppo", 1)
    return tmp_path


def test_ready_policies_have_names(ready: Path) -> None:
    assert policy_spec("ppo").title == "ppo-s0"
    spec = policy_spec("ppo-s1")
    assert (spec.title, spec.name) == ("ppo-s1", "ppo-s1")
    assert spec.learned is not None
    assert read_source(Path("ppo-s1")).description == spec.learned.description
    # What is kept of a policy's runs shall not serve another one of the same name.
    save(ready / "ppo-s1.npz", "ppo", 1)
    assert policy_spec("ppo-s1").identity() == spec.identity() != policy_spec("ppo").identity()
    with pytest.raises(ConfigError, match=r"'ppo-s2': unknown, did you mean 'ppo-s[01]'\?.*mppt2.*ppo-s0"):
        policy_spec("ppo-s2")


def test_a_policy_may_not_call_itself_like_a_controller(tmp_path: Path) -> None:
    save(tmp_path / "own.npz", "ppo", 0)
    stored = read_source(tmp_path / "own.npz")
    description = stored.description.model_copy(update={"name": "passive"})
    save_policy(tmp_path / "own.npz", StoredPolicy(description, stored.layers))
    with pytest.raises(ConfigError, match=r"own.npz.*'passive', which is a controller's name"):
        policy_spec(str(tmp_path / "own.npz"))


def test_origins_are_told_by_the_files(ready: Path) -> None:
    first, second = cards.origins()
    assert (first.name, first.algorithm, first.seed, second.seed) == ("ppo-s0", "ppo", 0, 1)
    assert (first.steps, first.seconds, first.J) == (1_000_000, 1500.0, 0.0321)
    assert (first.commit, first.environment) == ("0123456789abcdef+", "training")
    assert first.sha256 == hashlib.sha256((ready / "ppo-s0.npz").read_bytes()).hexdigest()
    assert "| ppo-s1 | ppo | 1 | 0123456789ab | training | 1,000,000 | 25 min | 0.0321 |" in cards.readme()
    (ready / "ppo-s0.npz").rename(ready / "sac-s0.npz")
    with pytest.raises(DataError, match=r"sac-s0.npz: holds the training 'ppo-s0'"):
        cards.origins()


def test_the_package_s_page_is_that_of_its_files() -> None:
    """Made by ``python -m sayd_env.agents.pretrained.cards``."""
    assert (pretrained.FOLDER / cards.README).read_text(encoding="utf-8") == cards.readme()


def test_the_list(ready: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["policies", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert list(content["controllers"]) == list(baselines.NAMES)
    assert all(len(what) > 10 for what in content["controllers"].values())
    assert content["groups"] == {"ppo": ["ppo-s0", "ppo-s1"]}
    assert [each["seed"] for each in content["ready"]] == [0, 1]
    console = Console(width=200, record=True)
    policies().summary(console)
    text = console.export_text()
    assert "eq. (27) to (31)" in text
    assert re.search(r"training \(min\)\s.*\bppo-s0\b[^\n]*\b25\b", text, re.DOTALL)
    for file in ready.iterdir():
        file.unlink()
    policies().summary(console)
    assert "No ready learned policies" in console.export_text()
