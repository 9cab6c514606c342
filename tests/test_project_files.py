"""What several files say about the project is the same in all of them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

import sayd_env

ROOT = Path(__file__).resolve().parents[1]
HEADINGS = ("Added", "Changed", "Deprecated", "Removed", "Fixed", "Security", "Results-affecting")
"""Those of Keep a Changelog, and ours."""


def read(name: str) -> Any:
    """Content of a YAML or TOML file of the repository; the key ``on`` of a workflow is True in YAML."""
    text = (ROOT / name).read_text(encoding="utf-8")
    return tomllib.loads(text) if name.endswith(".toml") else yaml.safe_load(text)


def project() -> dict[str, Any]:
    found: dict[str, Any] = read("pyproject.toml")["project"]
    return found


def pinned() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pairs = (line.split("==") for line in lines if not line.startswith("#"))
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in pairs}


def test_the_version_stands_in_one_place_and_the_citation_follows_it() -> None:
    assert "version" not in project()
    assert (
        read("pyproject.toml")["tool"]["setuptools"]["dynamic"]["version"]["attr"] == "sayd_env.__version__"
    )
    assert read("CITATION.cff")["version"] == sayd_env.__version__


def test_the_citation_names_licence_and_authors_of_the_distribution() -> None:
    citation = read("CITATION.cff")
    assert citation["license"] == project()["license"]
    assert citation["authors"] == project()["authors"]


def test_the_workflow_tests_the_versions_of_python_that_are_promised() -> None:
    promised = re.findall(r"Python :: (3\.\d+)", "\n".join(project()["classifiers"]))
    jobs = read(".github/workflows/ci.yml")["jobs"]
    for job in ("linux", "elsewhere"):
        assert jobs[job]["strategy"]["matrix"]["python"] == promised
    assert project()["requires-python"] == f">={promised[0]}"


def test_the_workflow_runs_tests_that_are_there() -> None:
    texts = [(ROOT / name).read_text() for name in (".github/workflows/ci.yml", "Makefile")]
    named = {word for text in texts for word in re.findall(r"\btests/[\w/]+(?:\.py)?", text)}
    assert len(named) > 10
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_only_a_tag_publishes() -> None:
    release = read(".github/workflows/release.yml")
    publish = release["jobs"]["publish"]
    assert publish["if"] == "github.event_name == 'push' && github.ref_type == 'tag'"
    assert publish["needs"] == "checks"
    rights = [job.get("permissions") for name, job in release["jobs"].items() if name != "publish"]
    assert not any(rights)
    assert release["permissions"] == {"contents": "read"}


def test_hooks_use_the_tools_that_are_installed() -> None:
    """No versions of their own, nothing to fetch."""
    for repository in read(".pre-commit-config.yaml")["repos"]:
        assert repository["repo"] == "local"
        for hook in repository["hooks"]:
            assert hook["language"] in ("system", "pygrep", "fail")
            assert "additional_dependencies" not in hook


@pytest.mark.parametrize(
    "extra", ["test", "lint", "train", "onnx", "ray", "dask", "clients", "video", "coverage", "release"]
)
def test_what_make_installs_has_a_tested_version(extra: str) -> None:
    wanted = [*project()["dependencies"], *project()["optional-dependencies"][extra]]
    names = {re.sub(r"[-_.]+", "-", re.split(r"[\[<>=~ ]", each)[0]).lower() for each in wanted}
    assert sorted(names - {"sayd-env"} - set(pinned())) == []


def test_every_release_in_the_changelog_has_headings_of_the_agreed_kinds_and_order() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    releases = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    assert releases[0].startswith("[Unreleased]\n")
    for release in releases:
        title, *_ = release.splitlines()
        assert re.fullmatch(r"\[Unreleased\]|\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", title)
        found = re.findall(r"^### (.*)$", release, flags=re.MULTILINE)
        assert found == [heading for heading in HEADINGS if heading in found], title
        assert "Results-affecting" in found, title
