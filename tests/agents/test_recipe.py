"""The recipe of docs/learning.md with some thousand steps: train, go on, evaluate, export."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from sayd_env.agents.policy_file import read_policy
from sayd_env.cli import main

pytestmark = pytest.mark.slow
FEW = {
    "ppo": ("environment.vehicles=8", "learning.n_steps=64", "learning.batch_size=256"),
    "sac": ("environment.vehicles=16", "learning.gradient_steps=1", "learning.learning_starts=256"),
}
SHORT = (
    "checkpoint.every=1024",
    "evaluation.every=2048",
    "evaluation.episode_s=2.0",
    "evaluation.speeds_kmh=[350.0]",
    "evaluation.wear=[1.0]",
    "evaluation.seeds=[500]",
    "evaluation.references=[mppt2]",
    "evaluation.beside_seeds=[]",
    "environment.beside=[]",
)


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    """Result of a command."""
    status = main([*arguments, "--json"])
    printed = capsys.readouterr()
    assert status == 0, printed.err
    return json.loads(printed.out)


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_the_recipe(
    algorithm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text("base: training\nrun_in: 20.0\nepisode_s: 2.0\n")
    changes = [*FEW[algorithm], *SHORT, "environment.name=short.yaml", "environment.episode_s=2.0"]
    settings = [part for change in changes for part in ("--set", change)]

    def train(steps: int, *where: str) -> Any:
        return answer(capsys, "train", *where, "--set", f"total_steps={steps}")

    first = train(2048, algorithm, *settings, "--out", "run")
    assert first["steps"] == 2048
    before = read_policy(Path("run/last.npz"))
    resumed = train(4096, "--resume", "run")
    assert resumed["steps"] == 4096
    after = read_policy(Path("run/last.npz"))
    assert (before.description.made["steps"], after.description.made["steps"]) == (2048, 4096)
    assert any(np.any(a != b) for (a, _), (b, _) in zip(before.layers, after.layers, strict=True))

    conditions = ("--speeds", "300", "--seeds", "1", "--set", "assessment.length=600")
    judged = answer(capsys, "evaluate", "--policies", "run/last.npz,constant:0.40", *conditions)
    learned, constant = (row["J"] for row in judged["rows"])
    assert learned == pytest.approx(constant, rel=0.5)  # its commands are about 0.40 from the beginning
    assert learned != constant
    (policy, model) = answer(capsys, "export", "run", "--onnx", "--out", "here")["files"]
    assert read_policy(policy).description == read_policy(Path("run/best.npz")).description
    assert Path(model).stat().st_size > 1000
