"""The wheel: built, installed into an empty environment, used from another directory."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "sayd_env", "agents", "baselines", "configs")
RIDE = "time_s,speed_kmh,frame_m_s2\n" + "".join(f"{i / 250},300,{i % 50 / 50}\n" for i in range(4000))


def run(*command: str | Path, cwd: Path) -> str:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, check=False, cwd=cwd, env=environment
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build from a copy of the sources, so that nothing left over in the checkout gets into the wheel."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "a source with spaces"
    source.mkdir()
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source / name)
    recent = int(metadata.version("setuptools").split(".")[0]) >= 77
    isolation = ["--no-build-isolation"] if recent else []
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        *isolation,
        "--wheel-dir",
        folder,
        source,
        cwd=folder,
    )
    (path,) = folder.glob("sayd_env-*.whl")
    return path


@pytest.mark.slow
def test_the_wheel_holds_every_module_configuration_and_policy(wheel: Path):
    names = set(zipfile.ZipFile(wheel).namelist())
    for folder, pattern in (
        ("sayd_env", "*.py"),
        ("agents", "*.py"),
        ("agents", "*.npz"),
        ("agents", "*.md"),
        ("baselines", "*.py"),
        ("configs", "*.yaml"),
    ):
        expected = {path.relative_to(ROOT).as_posix() for path in (ROOT / folder).rglob(pattern)}
        assert expected - names == set()
    assert "sayd_env/py.typed" in names
    assert not [name for name in names if name.startswith("tests/")]


@pytest.mark.slow
def test_the_wheel_works_in_an_empty_environment(wheel: Path, tmp_path: Path):
    environment = tmp_path / "an environment with spaces"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    run(sys.executable, "-m", "venv", environment, cwd=tmp_path)
    python = environment / "bin" / "python"
    constraints = ROOT / "constraints.txt"
    run(python, "-m", "pip", "install", "--quiet", "--constraint", constraints, wheel, cwd=elsewhere)
    run(python, "-m", "pip", "check", cwd=elsewhere)
    places = (
        "import agents, baselines, configs, sayd_env as s; "
        "print(agents.__file__, baselines.__file__, configs.__file__, s.__file__)"
    )
    assert run(python, "-c", places, cwd=elsewhere).count("site-packages") == 4
    run(python, "-c", "import importlib.util as u; assert u.find_spec('torch') is None", cwd=elsewhere)
    (elsewhere / "ride.csv").write_text(RIDE)
    sayd = environment / "bin" / "sayd"
    assert json.loads(run(sayd, "assess", "ride.csv", "--json", cwd=elsewhere))["stable"]
    evaluation = ["--speeds", "300", "--seeds", "1", "--set", "assessment.length=1000"]
    (row,) = json.loads(run(sayd, "evaluate", *evaluation, "--json", cwd=elsewhere))["rows"]
    assert (row["policy"], row["seed"]) == ("passive", 0)
    assert row["J"] > 0.0
    assert sorted(path.name for path in elsewhere.iterdir()) == ["ride.csv"]
