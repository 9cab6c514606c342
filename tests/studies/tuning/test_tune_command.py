"""`sayd tune` of a training, on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from sayd_env.cli import main

pytest.importorskip("optuna", reason="needs the extra 'train'")
pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ppo", "-o", "x.yaml"], "-o: is of controllers"),
        (["ppo", "--config", "sac"], "tune ppo: the training 'sac' is one of sac"),
        (["ppo", "--set", "ranges.discount_s.low=9.0"], "expected low below high"),
        (["ppo", "--set", "ranges.bogus={low: 1.0, high: 2.0}"], "unknown key 'bogus'"),
        (["ppo", "--config", "poo"], "did you mean 'ppo'"),
    ],
)
def test_bad_input_is_one_message(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["tune", *arguments]) == 2
    found = capsys.readouterr().err
    assert message in found
    assert found.startswith("sayd: error: ")
