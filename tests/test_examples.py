"""The examples run, each in a process of its own as a user starts it, where the library is installed."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
NEEDS = {
    "sb3": ("stable_baselines3",),
    "cleanrl": ("torch",),
    "skrl": ("skrl",),
    "torchrl": ("torchrl",),
    "rllib": ("torch", "ray.rllib"),
}


@pytest.fixture
def judge(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("judge")


@pytest.mark.parametrize("name", NEEDS)
def test_it_learns_a_moment_and_is_judged(name: str) -> None:
    for module in NEEDS[name]:
        pytest.importorskip(module, exc_type=ImportError)
    done = subprocess.run(
        [sys.executable, f"ppo_{name}.py", "--steps", "2048", "--episodes", "2"],
        cwd=EXAMPLES,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = re.search(r"^J = (\d+\.\d{4})$", done.stdout, re.MULTILINE)
    assert found, done.stdout
    assert 0.001 < float(found[1]) < 6.0  # the largest J of a second is 6.0, see configs/env/nominal.yaml


def test_j_is_minus_the_return_a_second(judge: ModuleType) -> None:
    env = gym.make_vec(judge.ID, num_envs=2, **judge.FEATURES)
    env.reset(seed=judge.SEED)
    total = np.zeros(2)
    for _ in range(400):
        total += env.step(np.full((2, 2), 0.25, np.float32))[1]
    found = judge.mean_cost(judge.controller("constant:0.25"), 2, **judge.FEATURES)
    assert found == pytest.approx(-total.mean() / 20.0, rel=1e-9)
    # The same commands as a learner gives them.
    scaled = judge.mean_cost(lambda seen: np.full((len(seen), 2), -0.5), 2)
    assert scaled == pytest.approx(found, rel=1e-12)


def test_a_derailed_run_costs_what_its_reward_is_charged(judge: ModuleType) -> None:
    """Valves that stand open let one of two vehicles derail; k_F = 2 makes the charge four times as large."""
    keywords: dict[str, Any] = judge.FEATURES | {"reward": "low-force", "speed_kmh": 400.0}
    env = gym.make_vec(judge.ID, num_envs=2, **keywords)
    env.reset(seed=judge.SEED)
    ended, total = np.zeros(2, dtype=bool), np.zeros(2)
    for _ in range(400):
        _, reward, terminated, _, _ = env.step(np.ones((2, 2), np.float32))
        total += np.where(ended, 0.0, reward)
        ended |= terminated
    assert ended.any()
    assert judge.mean_cost(judge.controller("constant:1", **keywords), 2, **keywords) == pytest.approx(
        -total.mean() / 20.0, rel=1e-9
    )


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.[pi][yp]*")), ids=lambda path: path.name)
def test_the_list_names_every_example_once(path: Path) -> None:
    page = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert page.count(f"| [{path.name}]({path.name}) |") == 1


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("ppo_*.py")), ids=lambda path: path.stem)
def test_every_client_is_listed(path: Path) -> None:
    page = (EXAMPLES.parent / "docs" / "clients.md").read_text(encoding="utf-8")
    assert f"python examples/{path.name}" in page
    assert path.stem.removeprefix("ppo_") in NEEDS
