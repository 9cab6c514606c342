"""What killed processes left is removed, what others still write is not; a folder is kept for one work."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sayd_env.config import ConfigError, storage
from sayd_env.config.storage import reserved, uninterrupted, write_file

WRITER = """
import os, signal, sys
from pathlib import Path
from sayd_env.config import storage

def wait(*_):
    print("ready", flush=True)
    sys.stdin.read()

storage.os.replace = wait
storage.write_file(Path("result.json"), b"new")
"""
WORKER = """
import sys
from pathlib import Path
from sayd_env.config.storage import reserved

with reserved(Path("run"), "trains"):
    print("ready", flush=True)
    sys.stdin.read()
"""


needs_signals = pytest.mark.skipif(
    storage.fcntl is None, reason="Windows has neither these signals nor locks"
)


def begun(code: str, folder: Path) -> subprocess.Popen[str]:
    """A process that has come to the middle of its work."""
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


def kill(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGKILL)
    process.communicate()


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@needs_signals
def test_the_next_writer_removes_what_a_killed_one_left_and_nobody_elses(tmp_path: Path) -> None:
    alive, dead = begun(WRITER, tmp_path), begun(WRITER, tmp_path)
    kill(dead)
    assert len(files(tmp_path)) == 2
    # As a process of the same number leaves it in a container that is started again.
    (half,) = (name for name in files(tmp_path) if f".{dead.pid}." in name)
    (tmp_path / half.replace(f".{dead.pid}.", f".{os.getpid()}.")).touch()
    write_file(tmp_path / "other.csv", b"whole")
    (left,) = (name for name in files(tmp_path) if name != "other.csv")
    assert f".{alive.pid}." in left
    kill(alive)


@needs_signals
def test_a_folder_is_kept_for_one_process_until_it_ends(tmp_path: Path) -> None:
    worker = begun(WORKER, tmp_path)
    refused = rf"^{tmp_path / 'run'}: another process trains here; wait for its end, or take another folder$"
    with pytest.raises(ConfigError, match=refused), reserved(tmp_path / "run", "trains"):
        pass
    kill(worker)
    with reserved(tmp_path / "run", "trains"):
        assert files(tmp_path / "run") == []
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="file: cannot be made"), reserved(tmp_path / "file", "trains"):
        pass


def test_without_locks_and_signals_nobody_is_kept_out_and_nobody_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on Windows, where `os.kill` ends the process even if it is only asked."""
    monkeypatch.setattr(storage, "fcntl", None)
    monkeypatch.setattr(os, "kill", None)
    left = tmp_path / f".result.json.{storage._MACHINE}.0123abcd.1.tmp"
    left.touch()
    with reserved(tmp_path, "trains"), reserved(tmp_path, "trains"):
        write_file(tmp_path / "result.json", b"whole")
    assert files(tmp_path) == [left.name, "result.json"]


@needs_signals
def test_an_interrupt_waits_for_the_end_of_what_must_not_stop_halfway() -> None:
    before = signal.getsignal(signal.SIGINT)
    done = []

    @uninterrupted()
    def work() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        done.append("all of it")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["all of it"]
    assert signal.getsignal(signal.SIGINT) is before


@needs_signals
def test_who_listens_to_no_interrupt_goes_on_so() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with uninterrupted():
            os.kill(os.getpid(), signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
