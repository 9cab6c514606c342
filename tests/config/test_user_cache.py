"""Where the user's cache is: variables, a user without a place, and what others could put there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

from sayd_env.config.user_cache import cache_folder, report_once

pwd = pytest.importorskip("pwd", reason="of POSIX")
USER = os.getuid()


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user without variables, whose home and temporary files are the test's."""
    monkeypatch.delenv("SAYD_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    report_once.cache_clear()
    return tmp_path / "home"


@pytest.fixture
def blocked(tmp_path: Path) -> Path:
    """A file where a directory should be: not even root can write below it."""
    (tmp_path / "blocked").write_text("")
    return tmp_path / "blocked"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    return tmp_path / "temporary" / f"sayd-{USER}"


def test_the_first_variable_that_is_set_counts(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cache_folder("kernels") == home / ".cache" / "sayd" / "kernels"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder("kernels") == tmp_path / "xdg" / "sayd" / "kernels"
    monkeypatch.setenv("SAYD_CACHE_DIR", "relative")
    assert cache_folder("kernels") == tmp_path / "here" / "relative" / "kernels"
    assert (tmp_path / "here" / "relative" / "kernels").is_dir()


@pytest.mark.parametrize("value", ["", "relative"])
@pytest.mark.parametrize("own", ["", " "])
def test_an_empty_variable_is_one_that_is_not_set(
    home: Path, own: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The XDG Base Directory Specification has relative paths ignored as well."""
    monkeypatch.setenv("SAYD_CACHE_DIR", own)
    monkeypatch.setenv("XDG_CACHE_HOME", value)
    assert cache_folder() == home / ".cache" / "sayd"
    assert not list(Path.cwd().iterdir())


def test_a_variable_that_cannot_serve_is_reported_once(
    home: Path, blocked: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("SAYD_CACHE_DIR", str(blocked))
    for name in ("kernels", ""):
        assert cache_folder(name) == home / ".cache" / "sayd" / name
    (line,) = caplog.messages
    assert line.startswith(f"SAYD_CACHE_DIR: {blocked} cannot be written")


def test_without_a_home_a_private_directory_serves(
    own: Path, blocked: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("HOME", str(blocked))
    assert cache_folder("kernels") == own / "kernels"
    assert own.stat().st_mode & 0o777 == 0o700

    def unknown(_user: int) -> None:
        raise KeyError

    monkeypatch.delenv("HOME")
    monkeypatch.setattr(pwd, "getpwuid", unknown)
    assert cache_folder() == own
    assert not caplog.messages


@pytest.mark.parametrize("fault", ["open to others", "link", "file", "somebody else's"])
def test_no_place_at_all_is_reported_once(
    own: Path,
    blocked: Path,
    fault: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Whoever can write into the cache can run code as this user: such a directory does not serve."""
    monkeypatch.setenv("HOME", str(blocked))
    if fault == "open to others":
        own.mkdir()
        own.chmod(0o770)
    elif fault == "link":
        (tmp_path / "target").mkdir(mode=0o700)
        own.symlink_to(tmp_path / "target")
    elif fault == "file":
        own.write_text("")
    else:
        monkeypatch.setattr(os, "getuid", lambda: USER + 1)  # what it makes belongs to another user
    assert cache_folder("kernels") is None
    assert cache_folder() is None
    (line,) = caplog.messages
    assert line.startswith("no cache directory can be written")


def test_where_users_have_no_numbers_temporary_files_are_the_users_own(
    blocked: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(blocked))
    monkeypatch.delattr(os, "getuid")
    assert cache_folder("kernels") == tmp_path / "temporary" / "sayd" / "kernels"
