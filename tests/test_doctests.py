"""The examples in docstrings say what happens."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import sayd_env
from sayd_env import agents, baselines


def modules_with_examples() -> list[str]:
    """Names of modules with a prompt in them: the others need not be imported."""
    found = []
    for package in (sayd_env, agents, baselines):
        folder = Path(package.__file__ or "").parent
        for path in folder.rglob("*.py"):
            if ">>> " in path.read_text():
                parts = path.relative_to(folder).with_suffix("").parts
                found.append(".".join((package.__name__, *parts)).removesuffix(".__init__"))
    return sorted(found)


@pytest.mark.parametrize("name", modules_with_examples())
def test_examples_are_right(name: str) -> None:
    failed, tried = doctest.testmod(importlib.import_module(name))
    assert tried > 0
    assert failed == 0
