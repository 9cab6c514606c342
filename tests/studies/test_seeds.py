"""Several seeds side by side: who starts, goes on, fails and is ended; a script stands for the training."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from sayd_env.agents.config import load_train
from sayd_env.cli import main
from sayd_env.config import ConfigError, StudyError
from sayd_env.config.errors import Interrupted
from sayd_env.studies.seeds import train_seeds

SCRIPT = """
import os, shutil, signal, sys, time
from pathlib import Path

def ended(*_):
    (folder / "saved").write_text("")
    sys.exit(130)

signal.signal(signal.SIGTERM, ended)
words = sys.argv[1:]
folder = Path(words[words.index("--resume" if "--resume" in words else "--out") + 1])
folder.mkdir(exist_ok=True)
if "--config" in words:
    shutil.copy(words[words.index("--config") + 1], folder / "config.yaml")
threads = [os.environ["OMP_NUM_THREADS"], os.environ["NUMBA_NUM_THREADS"]]
(folder / "said").write_text(" ".join([*words, *threads]))
if Path("hang").exists():
    time.sleep(600)
if Path("fail").exists() and folder.name == "s3":
    sys.exit("sayd: error: no such thing")
seed = int(folder.name[1:])
rows = ["steps,J,J_geometric,seconds", "0,1.0,9.0,0.0", f"64,{0.5 + seed},{0.1 + seed},60.0", ""]
(folder / "evaluations.csv").write_text(chr(10).join(rows))
(folder / "progress.csv").write_text(chr(10).join(["steps", "48", "96", ""]))
"""


@pytest.fixture(autouse=True)
def _program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "program.py").write_text(SCRIPT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sayd_env.studies.seeds.PROGRAM", (sys.executable, str(tmp_path / "program.py")))
    monkeypatch.setattr("sayd_env.studies.seeds.POLL_SECONDS", 0.01)


def test_each_seed_is_a_run_of_its_own_with_one_thread(tmp_path: Path) -> None:
    config, folder, shares = load_train("ppo"), tmp_path / "runs", list[float]()

    def progress(done: float, total: float, what: str = "") -> None:
        shares.append(done / total)

    result = train_seeds(config, [1, 3], folder, parallel=1, progress=progress)
    assert result.best == {1: 1.1, 3: 3.1}
    assert result.as_dict()["mean_best_J"] == pytest.approx(2.1)
    assert load_train(str(folder / "s3.yaml")) == config.model_copy(update={"seed": 3})
    said = (folder / "s3" / "said").read_text()
    assert said == f"train --config {folder / 's3.yaml'} --out {folder / 's3'} --workers 1 1 1"
    assert shares == sorted(shares)
    assert shares[-1] == 2 * 96 / (2 * config.total_steps)  # of the log, which is ahead of the evaluations
    again = train_seeds(config, [1, 3], folder, parallel=2)
    assert again.best == result.best
    assert (folder / "s1" / "said").read_text().startswith(f"train --resume {folder / 's1'} --set total_")


def test_a_run_that_began_otherwise_is_not_taken_up(tmp_path: Path) -> None:
    config, folder = load_train("ppo"), tmp_path / "runs"
    train_seeds(config, [1], folder, parallel=1)
    with pytest.raises(ConfigError, match=r"s1: discount_s: the run has 2.0, found 3.0\. Only total_steps"):
        train_seeds(load_train("ppo", ["discount_s=3"]), [1, 2], folder, parallel=1)
    assert not (folder / "s2").exists()
    train_seeds(load_train("ppo", ["total_steps=2_000_000"]), [1], folder, parallel=1)
    assert "total_steps=2000000" in (folder / "s1" / "said").read_text()


def test_one_that_fails_is_reported_when_the_others_are_done(tmp_path: Path) -> None:
    Path("fail").write_text("")
    with pytest.raises(StudyError, match=r"seed 3: sayd: error: no such thing \(.*s3-output.txt\)"):
        train_seeds(load_train("ppo"), [3, 1, 2], tmp_path / "runs", parallel=2)
    assert all((tmp_path / "runs" / f"s{seed}" / "evaluations.csv").exists() for seed in (1, 2))


def test_an_interruption_lets_all_save(tmp_path: Path) -> None:
    Path("hang").write_text("")
    runs = tmp_path / "runs"

    def interrupt(done: float, total: float, what: str = "") -> None:
        if all((runs / f"s{seed}" / "said").exists() for seed in (1, 2)):
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match="go on with the same command"):
        train_seeds(load_train("ppo"), [1, 2, 3], runs, parallel=2, progress=interrupt)
    assert all((runs / f"s{seed}" / "saved").exists() for seed in (1, 2))
    assert not (runs / "s3").exists()


def test_trainings_do_not_outlive_a_failure(tmp_path: Path) -> None:
    """As when nobody reads the progress any more."""
    Path("hang").write_text("")
    runs = tmp_path / "runs"

    def fail(done: float, total: float, what: str = "") -> None:
        if all((runs / f"s{seed}" / "said").exists() for seed in (1, 2)):
            raise SystemExit(1)

    with pytest.raises(SystemExit):
        train_seeds(load_train("ppo"), [1, 2], runs, parallel=2, progress=fail)
    assert all((runs / f"s{seed}" / "saved").exists() for seed in (1, 2))


def test_the_command_line_says_what_came_of_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    assert main(["train", "ppo", "--seed", "2", "--seeds", "2", "--out", "runs", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["best_J"] == {"2": 2.1, "3": 3.1}
    names = {path.name for path in Path("runs").iterdir()}
    assert names >= {"s2", "s3", "s2.yaml", "s3-output.txt", "seeds.csv", "learning.png", "result.json"}
