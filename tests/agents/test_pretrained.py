"""The policies that come with the package, found by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from sayd_env.agents import pretrained
from sayd_env.config import ConfigError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Files as the package has them, and others that are none of them; nobody reads what is in them."""
    for name in ("sac-s1.npz", "ppo-s10.npz", "ppo-s2.npz", "ppo-s1.npz", "README.md", "ppo.npz", "best.npz"):
        (tmp_path / name).touch()
    return tmp_path


def test_files_are_grouped_by_algorithm_in_the_order_of_their_seeds(folder: Path):
    found = pretrained.groups(folder)
    assert list(found) == ["ppo", "sac"]
    assert [file.name for file in found["ppo"]] == ["ppo-s1.npz", "ppo-s2.npz", "ppo-s10.npz"]
    assert found["sac"] == (folder / "sac-s1.npz",)


def test_an_algorithm_alone_is_its_first_training(folder: Path):
    assert pretrained.path("ppo", folder) == folder / "ppo-s1.npz"
    assert pretrained.path("ppo-s10", folder) == folder / "ppo-s10.npz"
    assert pretrained.names(folder) == ("ppo", "ppo-s1", "ppo-s2", "ppo-s10", "sac", "sac-s1")


def test_an_unknown_name_is_refused_with_the_nearest_one(folder: Path):
    with pytest.raises(ConfigError, match=r"'ppo-s11': unknown, did you mean 'ppo-s1.?'.*sac-s1"):
        pretrained.path("ppo-s11", folder)


def test_nothing_there_is_no_error(tmp_path: Path):
    assert pretrained.groups(tmp_path) == {}
    with pytest.raises(ConfigError, match="none come with this installation"):
        pretrained.path("ppo", tmp_path)
    for files in pretrained.groups().values():  # the package's own
        assert all(file.is_file() for file in files)
