"""Which software is running: versions, commit, and a fingerprint of the sources that can change a run."""

from __future__ import annotations

import hashlib
import platform
import shutil
import subprocess
from functools import cache
from importlib import metadata, resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import sayd_env

LIBRARIES = ("numpy", "scipy", "numba", "pydantic", "matplotlib", "gymnasium")
"""Their versions are recorded in every result."""
FLOORS = ("agents", "baselines", "config", "envs", "measured", "physics", "runs", "stability")
"""Packages whose sources can change a run; the others only ask for runs and show them."""
SOURCES = (*FLOORS, "configs")
"""The same and the packaged configurations, some of which are read by name while a run is made."""


def provenance(command: str | None) -> dict[str, Any]:
    """What made a result: command, versions, commit of the checkout, whether it was modified."""
    commit, modified = git_state()
    return {"command": command, "versions": versions(), "git_commit": commit, "git_modified": modified}


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that may change a number."""
    libraries = {name: metadata.version(name) for name in LIBRARIES}
    return {"sayd_env": sayd_env.__version__, "python": platform.python_version(), **libraries}


def git_state(root: Path | None = None) -> tuple[str | None, bool | None]:
    """Commit of a checkout and whether it is modified; (None, None) outside a checkout.

    Parameters
    ----------
    root : Path, optional
        Of the checkout; by default the one that this software runs from.
    """
    root = Path(sayd_env.__file__).resolve().parents[1] if root is None else root
    # An installed package may lie inside somebody's other checkout: only our own root counts.
    git = shutil.which("git")
    if git is None or not (root / ".git").exists():
        return None, None

    def answer(*arguments: str) -> str:
        return subprocess.run(
            [git, "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=10
        ).stdout.strip()

    try:
        return answer("rev-parse", "HEAD"), bool(answer("status", "--porcelain", "--untracked-files=no"))
    except (OSError, subprocess.SubprocessError):
        return None, None


@cache
def source_fingerprint() -> str:
    """Hash (16 hexadecimal digits) of all sources that can change a run, and of the libraries' versions."""
    return fingerprint_of([resources.files(f"sayd_env.{floor}") for floor in SOURCES])


@cache
def floor_fingerprint(module: str) -> str:
    """Fingerprint of a module's floor; empty for those of `source_fingerprint`, and for code of others."""
    package, _, rest = module.partition(".")
    floor = rest.partition(".")[0]
    if package != "sayd_env" or not floor or floor in FLOORS:
        return ""
    return fingerprint_of([resources.files(f"sayd_env.{floor}")])


def fingerprint_of(folders: list[Traversable]) -> str:
    """Hash (16 hexadecimal digits) of Python and YAML files in some folders, and of libraries' versions."""
    digest = hashlib.sha256(repr(sorted(versions().items())).encode())
    for folder in folders:
        root = Path(str(folder))
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.yaml"))):
            digest.update(f"{root.name}/{path.relative_to(root).as_posix()}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
