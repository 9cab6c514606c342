"""A distribution owns one import name, and works beside a user's folders of the names that it does not own.

Three ways of having the software: a wheel, an editable install of a checkout, and a checkout on the path.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

import sayd_env

ROOT = Path(__file__).resolve().parents[1]
OUTSIDE = ("agents", "baselines", "configs")
"""Packages of the distribution that are at the top level of the repository."""
TEXTS = (
    "pyproject.toml",
    "README.md",
    "LICENSE",
    "CHANGELOG.md",
    "CITATION.cff",
    "MANIFEST.in",
    "constraints.txt",
)
SOURCES = (*TEXTS, "sayd_env", *OUTSIDE)
RIDE = "time_s,speed_kmh,frame_m_s2\n" + "".join(f"{i / 250},300,{i % 50 / 50}\n" for i in range(4000))
OF_THE_USER = "raise RuntimeError('a package of the user')\n"
USE = """
import importlib.util, pathlib, sys
import gymnasium
importlib.util.find_spec("gymnasium")
env = gymnasium.make("sayd_env:SAYD/Nominal-v1")
import sayd_env
from sayd_env import agents, baselines, configs
assert gymnasium.make("SAYD/Nominal-v1").unwrapped.interface == env.unwrapped.interface
assert baselines.make("mppt1", env).name == "mppt1"
found = {module: pathlib.Path(module.__file__).parent for module in (sayd_env, agents, baselines, configs)}
assert all(module.__name__ == "sayd_env" or module.__name__.startswith("sayd_env.") for module in found)
assert not {"agents", "baselines", "configs", "pandas", "torch"} & set(sys.modules)
for folder in sorted(found.values()):
    print(folder)
"""


def run(*command: str | Path, cwd: Path, **variables: str | Path) -> str:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [str(part) for part in command],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env=environment | {key: str(value) for key, value in variables.items()},
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def pip(*arguments: str | Path, cwd: Path) -> None:
    """Run this interpreter's pip, building with the setuptools that is here if it is new enough."""
    recent = int(metadata.version("setuptools").split(".")[0]) >= 77
    isolation = ["--no-build-isolation"] if recent else []
    run(sys.executable, "-m", "pip", *arguments, *isolation, cwd=cwd)


def copied(folder: Path) -> Path:
    """A copy of the sources, so that nothing left over in the checkout counts."""
    source = folder / "a source with spaces"
    source.mkdir(parents=True)
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source / name)
    return source


def with_our_libraries(folder: Path) -> Path:
    """An environment that has all that this one has, but not this software; its interpreter."""
    run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=ROOT)
    (packages,) = folder.glob("lib/python*/site-packages")
    # Files .pth of a directory that is named by one are not read: an editable install here does not count.
    (packages / "libraries.pth").write_text(sysconfig.get_path("purelib"))
    return folder / "bin" / "python"


def test_the_list_of_packages_is_complete() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = set()
    for place, name in (("sayd_env", "sayd_env"), *((name, f"sayd_env.{name}") for name in OUTSIDE)):
        for path in (ROOT / place).rglob("*.py"):
            found.add(".".join((name, *path.parent.relative_to(ROOT / place).parts)))
            assert (path.parent / "__init__.py").is_file(), path
    assert settings["packages"] == sorted(found)
    assert settings["package-dir"] == {f"sayd_env.{name}": name for name in OUTSIDE}


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The source distribution, of a folder in which somebody has worked."""
    source = copied(tmp_path_factory.mktemp("archive"))
    for name in ("tests/test_mine.py", "scratch.py", "results/evaluate/result.json", "build/left_over.py"):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text("")
    build = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"
    run(sys.executable, "-c", build, source.parent, cwd=source)
    (path,) = source.parent.glob("sayd_env-*.tar.gz")
    return path


@pytest.fixture(scope="module")
def wheel(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the source distribution."""
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-deps", "--wheel-dir", folder, archive, cwd=folder)
    (path,) = folder.glob("sayd_env-*.whl")
    return path


@pytest.mark.slow
def test_the_source_distribution_holds_what_the_wheel_needs_and_no_more(archive: Path, wheel: Path) -> None:
    with tarfile.open(archive) as file:
        members = [member.name.partition("/")[2] for member in file.getmembers() if member.isfile()]
    names = {name for name in members if not name.startswith("sayd_env.egg-info/")}
    made = {"PKG-INFO", "setup.cfg"}
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    outside = tuple(f"sayd_env/{name}/" for name in OUTSIDE)
    assert names - made - set(TEXTS) == {
        name.removeprefix("sayd_env/") if name.startswith(outside) else name for name in inside
    }
    assert set(TEXTS) <= names


@pytest.mark.slow
def test_the_wheel_has_licence_and_version(wheel: Path) -> None:
    (metadata_file,) = (n for n in zipfile.ZipFile(wheel).namelist() if n.endswith(".dist-info/METADATA"))
    about = zipfile.ZipFile(wheel).read(metadata_file).decode()
    assert f"\nVersion: {sayd_env.__version__}\n" in about
    assert "\nLicense-Expression: MIT\n" in about
    licence = metadata_file.replace("METADATA", "licenses/LICENSE")
    assert zipfile.ZipFile(wheel).read(licence) == (ROOT / "LICENSE").read_bytes()


PACKED = (
    "*.py",
    "*.c",
    "*.h",
    "*.yaml",
    "*.npz",
    "page.*",
    "pretrained/*.md",
    "pretrained/*.csv",
    "pretrained/*.png",
)


@pytest.mark.slow
def test_the_wheel_holds_every_module_configuration_and_policy(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    expected = {"sayd_env/py.typed"}
    for place, inside in (("sayd_env", ""), *((name, "sayd_env/") for name in OUTSIDE)):
        for pattern in PACKED:
            found = (path.relative_to(ROOT) for path in (ROOT / place).rglob(pattern))
            expected |= {inside + path.as_posix() for path in found if "__pycache__" not in path.parts}
    information = {name for name in names if ".dist-info/" in name}
    assert names - information == expected
    (top,) = (name for name in information if name.endswith("/top_level.txt"))
    assert zipfile.ZipFile(wheel).read(top).decode().split() == ["sayd_env"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wheel", "editable install", "checkout"])
def test_a_user_s_folders_of_the_same_names_are_no_trouble(
    kind: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    python = with_our_libraries(tmp_path / "environment")
    command: list[str | Path] = [python.parent / "sayd"]
    path = {}
    if kind == "wheel":
        source = request.getfixturevalue("wheel")
        pip("--python", python, "install", "--no-deps", "--no-index", source, cwd=tmp_path)
        (home,) = tmp_path.glob("environment/lib/python*/site-packages")
    else:
        home = copied(tmp_path)
        if kind == "editable install":
            pip("--python", python, "install", "--no-deps", "--no-index", "--editable", home, cwd=tmp_path)
        else:
            command, path = [python, "-m", "sayd_env"], {"PYTHONPATH": home}
    inside = home / "sayd_env" if kind == "wheel" else home
    places = sorted([home / "sayd_env", *(inside / name for name in OUTSIDE)])
    for content in (None, OF_THE_USER):
        work = tmp_path / f"work {content is None}"
        for name in OUTSIDE:
            (work / name).mkdir(parents=True)
            (work / name / "something.py").write_text(OF_THE_USER)
            if content is not None:
                (work / name / "__init__.py").write_text(content)
        assert run(python, "-c", USE, cwd=work, **path).splitlines() == list(map(str, places))
    shown = json.loads(run(*command, "policies", "--json", cwd=work, **path))
    assert {"passive", "mppt2"} <= set(shown["controllers"])
    assert {entry.name for entry in work.iterdir()} == set(OUTSIDE)


@pytest.mark.slow
def test_a_checkout_works_from_within(tmp_path: Path) -> None:
    python = with_our_libraries(tmp_path / "environment")
    found = run(python, "-c", USE, cwd=ROOT, PYTHONDONTWRITEBYTECODE="1").splitlines()
    assert found == [str(ROOT / name) for name in sorted(("sayd_env", *OUTSIDE))]


@pytest.mark.slow
def test_the_wheel_works_in_an_empty_environment(wheel: Path, tmp_path: Path) -> None:
    environment = tmp_path / "an environment with spaces"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    run(sys.executable, "-m", "venv", environment, cwd=tmp_path)
    python = environment / "bin" / "python"
    constraints = ROOT / "constraints.txt"
    run(
        python,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-compile",
        "--constraint",
        constraints,
        wheel,
        cwd=elsewhere,
    )
    run(python, "-m", "pip", "check", cwd=elsewhere)
    extras = "import importlib.util as u; print(*map(u.find_spec, ('torch', 'ray', 'distributed', 'pygame')))"
    assert set(run(python, "-c", extras, cwd=elsewhere).split()) == {"None"}
    (elsewhere / "ride.csv").write_text(RIDE)
    sayd = environment / "bin" / "sayd"
    assert json.loads(run(sayd, "assess", "ride.csv", "--bogie-mass", "5600", "--json", cwd=elsewhere))[
        "stable"
    ]
    modes = json.loads(run(sayd, "modes", "--speeds", "300", "--json", cwd=elsewhere))
    assert 100.0 < modes["linear_critical_speed_kmh"] < 500.0  # by the compiled contact laws
    assert sorted(path.name for path in elsewhere.iterdir()) == ["ride.csv"]
