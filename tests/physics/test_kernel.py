"""The cache of compiled kernels notices an edit of any kernel source, and does without a place to write."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import sayd_env
from sayd_env import agents, baselines
from sayd_env.physics.kernel_cache import kernel_sources

PROGRAM = "from sayd_env.physics.caller import doubled; print(repr(float(doubled(0.5))))"
CALLER = '''"""A kernel that calls a kernel of another file."""

from sayd_env.physics.contact.polach import arctangent
from sayd_env.physics.kernel import kernel


@kernel
def doubled(x):
    """Twice the arc tangent."""
    return 2.0 * arctangent(x)
'''
EDITS = {
    "baselines/skyhook.py": True,
    "agents/products.py": True,
    "stability/online.py": True,
    "envs/interface.py": True,  # no kernel in it, but a constant that kernels take over
    "physics/plant.py": True,
    "baselines/__init__.py": False,
    "envs/single.py": False,
}
"""Files, and whether an edit makes other kernels of it."""
HASHES = """
import json, sys
from pathlib import Path
from sayd_env.physics.kernel_cache import source_hash
hashes = [source_hash()]
for file in sys.argv[1:]:
    path = Path(file)
    content = path.read_bytes()
    path.write_bytes(content + b"# edited")
    hashes.append(source_hash())
    path.write_bytes(content)
print(json.dumps(hashes))
"""


def copied(target: Path, inside: bool) -> Path:
    """A copy of the packages as in a checkout, or all inside one as in a wheel."""
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(sayd_env.__file__).parent, target / "sayd_env", ignore=ignore)
    for package in (agents, baselines):
        source = Path(package.__file__ or "").parent
        shutil.copytree(source, target / ("sayd_env" if inside else "") / source.name, ignore=ignore)
    if not inside:
        (target / "pyproject.toml").write_text("")
    return target


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package with a calling kernel in it."""
    copied(tmp_path, inside=True)
    (tmp_path / "sayd_env" / "physics" / "caller.py").write_text(CALLER)
    return tmp_path


def run(package: Path, *arguments: str | Path, **variables: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a program on a copy of the package, with the cache inside the copy if nothing else is said."""
    own = {
        "SAYD_CACHE_DIR": package / "cache",
        "PYTHONPATH": package,
        "PYTHONDONTWRITEBYTECODE": "1",
        **variables,
    }
    return subprocess.run(
        [sys.executable, "-P", "-c", *map(str, arguments)],
        env=os.environ | {name: str(value) for name, value in own.items()},
        cwd=package,
        capture_output=True,
        text=True,
        check=True,
    )


def result(package: Path) -> float:
    """Result of the calling kernel in a process of its own."""
    return float(run(package, PROGRAM).stdout)


def compiled(package: Path) -> dict[str, float]:
    """Compiled files and when they were written."""
    return {str(path): path.stat().st_mtime_ns for path in (package / "cache").rglob("*.nbc")}


def test_an_edited_leaf_shows(package: Path) -> None:
    """The same sources are compiled once; a leaf edited in another file changes its caller's result."""
    first = result(package)
    files = compiled(package)
    assert files
    assert all("kernels-" in name for name in files)
    assert result(package) == first
    assert compiled(package) == files

    leaf = package / "sayd_env" / "physics" / "contact" / "polach.py"
    text = leaf.read_text()
    assert text.count("value = t * (1.0 +") == 1
    leaf.write_text(text.replace("value = t * (1.0 +", "value = t * (2.0 +"))
    assert result(package) > 1.5 * first
    assert len(list((package / "cache").iterdir())) == 2


def test_damaged_and_unfinished_files_do_no_harm(package: Path) -> None:
    """What cannot be read is compiled anew; what a killed process left unfinished is removed if it is old."""
    first = result(package)
    files = [Path(name) for name in compiled(package)]
    indices = list((package / "cache").rglob("*.nbi"))
    files[0].write_bytes(b"")
    indices[0].write_bytes(b"no index")
    indices[1].write_bytes(indices[1].read_bytes()[:-9])
    old, new = (files[0].with_suffix(f".nbc.tmp.{name}") for name in ("old", "new"))
    for path in (old, new):
        path.write_bytes(b"")
    os.utime(old, (0.0, 0.0))
    assert result(package) == first
    assert not old.exists()
    assert new.exists()
    assert files[0].stat().st_size > 0


def test_without_a_place_to_write_kernels_are_compiled_all_the_same(package: Path) -> None:
    """Files are where directories should be, so that not even root can write: one line, nothing beside."""
    blocked = package / "blocked"
    blocked.mkdir()
    (blocked / f"sayd-{os.getuid()}").write_text("")
    (blocked / "file").write_text("")
    before = sorted(package.rglob("*"))
    done = run(package, PROGRAM, SAYD_CACHE_DIR="", XDG_CACHE_HOME=blocked / "file", TMPDIR=blocked)
    assert float(done.stdout) == pytest.approx(0.927295218, rel=1e-6)  # 2 arctan(1/2)
    (line,) = done.stderr.splitlines()
    assert line.startswith("no cache directory can be written")
    assert sorted(package.rglob("*")) == before


def test_a_part_that_cannot_be_written_is_compiled_anew(package: Path) -> None:
    """The folder serves, but a module's own within it does not: nothing goes beside the sources instead."""
    result(package)
    folders = {path.parent for path in (package / "cache").rglob("*.nbi")}
    for folder in folders:
        shutil.rmtree(folder)
        folder.write_text("")
    before = sorted(package.rglob("*"))
    done = run(package, PROGRAM)
    assert float(done.stdout) == pytest.approx(0.927295218, rel=1e-6)  # 2 arctan(1/2)
    (line,) = done.stderr.splitlines()
    assert "cannot be written everywhere" in line
    assert sorted(package.rglob("*")) == before


def test_the_hash_is_of_all_kernels_alike_in_a_checkout_and_in_a_wheel(tmp_path: Path) -> None:
    found = []
    for inside in (False, True):
        package = copied(tmp_path / str(inside), inside)
        outside = ("agents", "baselines")
        files = [
            package / name if name.startswith(outside) and not inside else package / "sayd_env" / name
            for name in EDITS
        ]
        found.append(json.loads(run(package, HASHES, *files).stdout))
    assert found[0] == found[1]
    before, *edited = found[0]
    assert [h != before for h in edited] == list(EDITS.values())
    assert len(set(edited)) == 1 + sum(EDITS.values())


@pytest.mark.parametrize("package", [sayd_env, agents, baselines], ids=lambda package: package.__name__)
def test_every_kernel_is_counted(package: ModuleType) -> None:
    folder, counted = Path(package.__file__ or "").parent, kernel_sources()
    kernels = [p for p in folder.rglob("*.py") if re.search(r"^@kernel\b|= kernel\(", p.read_text(), re.M)]
    assert kernels
    for path in kernels:
        parts = path.relative_to(folder).with_suffix("").parts
        assert ".".join((package.__name__, *parts)) in counted
