"""A training's log at Weights & Biases, with a module that stands for the service's."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

from stable_baselines3.common.logger import Logger

from sayd_env.agents.config import load_train
from sayd_env.agents.training import train
from sayd_env.agents.wandb_log import WandbWriter
from sayd_env.config import ConfigError


class Service:
    """What was asked of the service."""

    def __init__(self, refuses: bool = False) -> None:
        self.begun: list[dict[str, Any]] = []
        self.rows: list[tuple[int, dict[str, Any]]] = []
        self.finished, self._refuses = 0, refuses

    def init(self, **asked: Any) -> Any:
        if self._refuses:
            raise RuntimeError("api_key not configured\nmore")
        self.begun.append(asked)
        return SimpleNamespace(log=self._log, finish=self._finish)

    def _log(self, numbers: dict[str, Any], step: int) -> None:
        self.rows.append((step, numbers))

    def _finish(self) -> None:
        self.finished += 1


def test_numbers_go_to_a_run_that_a_resumed_training_finds_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = Service()
    monkeypatch.setitem(sys.modules, "wandb", service)
    for begun in ("2026-01-01", "2026-01-01", "2026-01-02"):
        logger = Logger(str(tmp_path), [WandbWriter(tmp_path / "run", begun, {"seed": 3})])
        logger.record("train/loss", 0.5)
        logger.record("train/name", "x")
        logger.dump(64)
        logger.close()
    assert service.rows == [(64, {"train/loss": 0.5})] * 3
    assert service.finished == 3
    first, again, other = service.begun
    assert first["id"] == again["id"] != other["id"]
    assert (first["name"], first["config"], first["resume"]) == ("run", {"seed": 3}, "allow")


def test_a_service_that_is_missing_or_refuses_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(ConfigError, match=r"--wandb needs .* pip install 'sayd-env\[wandb\]'"):
        train(load_train("ppo"), tmp_path / "run", lambda policy: policy, wandb=True)
    assert not (tmp_path / "run").exists()
    monkeypatch.setitem(sys.modules, "wandb", Service(refuses=True))
    with pytest.raises(ConfigError, match=r"--wandb: api_key not configured$"):
        WandbWriter(tmp_path, "2026", {})
