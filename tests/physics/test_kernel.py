"""The cache of compiled kernels notices an edit of any kernel source."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sayd_env

PROGRAM = "from sayd_env.physics.caller import doubled; print(repr(float(doubled(0.5))))"
CALLER = '''"""A kernel that calls a kernel of another file."""

from sayd_env.physics.contact.polach import arctangent
from sayd_env.physics.kernel import kernel


@kernel
def doubled(x):
    """Twice the arc tangent."""
    return 2.0 * arctangent(x)
'''


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package with a calling kernel in it."""
    source = Path(sayd_env.__file__).parent
    shutil.copytree(source, tmp_path / "sayd_env", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "sayd_env" / "physics" / "caller.py").write_text(CALLER)
    return tmp_path


def run(package: Path) -> float:
    """Result of the calling kernel in a process of its own, with the cache inside the copy."""
    environment = os.environ | {
        "SAYD_CACHE_DIR": str(package / "cache"),
        "PYTHONPATH": str(package),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM],
        env=environment,
        cwd=package,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


def compiled(package: Path) -> dict[str, float]:
    """Compiled files and when they were written."""
    return {str(path): path.stat().st_mtime_ns for path in (package / "cache").rglob("*.nbc")}


def test_an_edited_leaf_shows(package: Path) -> None:
    """The same sources are compiled once; a leaf edited in another file changes its caller's result."""
    first = run(package)
    files = compiled(package)
    assert files
    assert all("kernels-" in name for name in files)
    assert run(package) == first
    assert compiled(package) == files

    leaf = package / "sayd_env" / "physics" / "contact" / "polach.py"
    text = leaf.read_text()
    assert text.count("value = t * (1.0 +") == 1
    leaf.write_text(text.replace("value = t * (1.0 +", "value = t * (2.0 +"))
    assert run(package) > 1.5 * first
    assert len(list((package / "cache").iterdir())) == 2
