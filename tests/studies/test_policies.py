"""The list of policies, and the names of ready ones wherever policies are named."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from sayd_env import baselines
from sayd_env.agents import pretrained
from sayd_env.agents.policy_file import StoredPolicy, load_policy, read_policy, save_policy
from sayd_env.agents.pretrained import cards
from sayd_env.cli import main
from sayd_env.config import ConfigError, DataError
from sayd_env.envs.registration import VERSION
from sayd_env.envs.single import SaydEnv
from sayd_env.runs.policies import policy_spec
from sayd_env.studies.comparison.entrants import read_entrants
from sayd_env.studies.learning import read_source
from sayd_env.studies.policies import policies

Save = Callable[..., None]


@pytest.fixture
def ready(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trained_file: Save) -> Path:
    """A folder of two trainings, of this test alone, in place of the package's."""
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    trained_file(tmp_path / "ppo-s0.npz", "ppo", 0)
    trained_file(tmp_path / "ppo-s1.npz", "ppo", 1)
    return tmp_path


def test_ready_policies_have_names(ready: Path, trained_file: Save) -> None:
    assert policy_spec("ppo").title == "ppo-s0"
    spec = policy_spec("ppo-s1")
    assert (spec.title, spec.name) == ("ppo-s1", "ppo-s1")
    assert spec.learned is not None
    assert read_source(Path("ppo-s1")).description == spec.learned.description
    # What is kept of a policy's runs shall not serve another one of the same name.
    trained_file(ready / "ppo-s1.npz", "ppo", 1)
    assert policy_spec("ppo-s1").identity() == spec.identity() != policy_spec("ppo").identity()
    with pytest.raises(ConfigError, match=r"'ppo-s2': unknown, did you mean 'ppo-s[01]'\?.*mppt2.*ppo-s0"):
        policy_spec("ppo-s2")


def test_a_policy_may_not_call_itself_like_a_controller(tmp_path: Path, trained_file: Save) -> None:
    trained_file(tmp_path / "own.npz", "ppo", 0)
    stored = read_source(tmp_path / "own.npz")
    description = stored.description.model_copy(update={"name": "passive"})
    save_policy(tmp_path / "own.npz", StoredPolicy(description, stored.layers))
    with pytest.raises(ConfigError, match=r"own.npz.*'passive', which is a controller's name"):
        policy_spec(str(tmp_path / "own.npz"))


def test_without_its_file_a_name_says_how_to_train_one(ready: Path) -> None:
    """Until it is there."""
    for name in ("sac", "sac-s2"):
        with pytest.raises(ConfigError, match=rf"'{name}': no learned policy.*'sayd train sac'.*best.npz"):
            policy_spec(name)
    (ready / "ppo-s0.npz").rename(ready / "sac-s2.npz")
    assert policy_spec("sac").title == policy_spec("sac-s2").title == "sac-s2"


@pytest.mark.parametrize("version", [VERSION - 1, VERSION + 1, None])
def test_a_policy_of_another_plant_is_refused(
    version: int | None, ready: Path, tmp_path: Path, trained_file: Save
) -> None:
    """Under its path or its name; a file of before there were versions counts as of version 0."""
    path = ready / "ppo-s0.npz"
    trained_file(path, environment_version=version)
    if version is None:
        stored = read_policy(path)
        made = {key: value for key, value in stored.description.made.items() if key != "environment_version"}
        description = stored.description.model_copy(update={"made": made})
        save_policy(path, StoredPolicy(description, stored.layers))
    for name in (str(path), "ppo"):
        with pytest.raises(
            ConfigError, match=rf"ppo-s0.npz: was trained on version {version or 0} of the env"
        ):
            policy_spec(name)
    with pytest.raises(ConfigError, match="Train it again"):
        read_entrants(["ppo"])
    policy = read_policy(path)
    assert load_policy(path, SaydEnv(**policy.needs).interface).name == "ppo-s0"  # on purpose


def test_origins_are_read_from_the_files(ready: Path) -> None:
    first, second = cards.origins()
    assert (first.name, first.algorithm, first.seed, second.seed) == ("ppo-s0", "ppo", 0, 1)
    assert (first.steps, first.seconds, first.J) == (1_000_000, 1500.0, 0.0321)
    assert (first.commit, first.environment) == ("0123456789abcdef+", "training")
    assert first.sha256 == hashlib.sha256((ready / "ppo-s0.npz").read_bytes()).hexdigest()
    assert (
        "| ppo-s1 | ppo | 1 | 0123456789ab | training | 000000000000 | 1,000,000 | 25 min | 0.0321 |"
        in cards.readme()
    )
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
