"""The Python snippets of the README and of pages that stand alone run as they stand."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = (
    "README.md",
    "docs/index.md",
    "docs/policies.md",
    "docs/conicity.md",
    "docs/en14363.md",
    "docs/recordings.md",
    "docs/robustness.md",
)


def read(place: str) -> str:
    return (ROOT / place).read_text(encoding="utf-8")


SNIPPETS = [
    (page, snippet) for page in PAGES for snippet in re.findall(r"```python\n(.*?)```", read(page), re.DOTALL)
]


@pytest.mark.parametrize(("page", "snippet"), SNIPPETS)
def test_snippet_runs(
    page: str,
    snippet: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(tmp_path)
    exec(compile(snippet, page, "exec"), {})
    assert capsys.readouterr().out


def test_the_readme_is_short():
    assert len(read("README.md").splitlines()) <= 150


def test_what_holds_is_that_of_the_table_of_claims():
    table = re.findall(
        r"^\| ([A-Z]\d+) \|.*\| (yes|\*\*no\*\*)[^|]*\|[^|]*\|$", read("docs/claims.md"), re.MULTILINE
    )
    lost = [row for row, verdict in table if verdict != "yes"]
    held = len(table) - len(lost)
    words = " ".join(read("README.md").split())
    assert f"Of the paper's {len(table)} statements that can be checked, **{held} hold**" in words
    assert f"{', '.join(lost[:-1])} and {lost[-1]} do not." in words
    assert f"{held} of {len(table)} rows hold" in " ".join(read("docs/claims.md").split())
    assert f"{held} of its {len(table)} checkable statements hold" in " ".join(read("docs/faq.md").split())
    assert set(
        re.findall(r"[A-Z]\d+", re.search(r"^OPEN = .*$", read("tests/validation/test_paper.py"), re.M)[0])
    ) == {*lost}


def test_there_are_snippets():
    assert {page for page, _ in SNIPPETS} == set(PAGES)


SHOWN = {
    "m/s": ("mm/s", 1e3),
    "N": ("kN", 1e-3),
    "N/m": ("MN/m", 1e-6),
    "m": ("mm", 1e3),
    "m2": ("mm2", 1e6),
    "Pa": ("bar", 1e-5),
    "s": ("ms", 1e3),
}
"""Units of the table of calibrated numbers, by those of the configuration."""


def test_the_calibrated_numbers_are_those_of_the_parts():
    """The table beside the comments of configs/, which `sayd calibrate` has written."""
    found = re.findall(
        r"^  # (.+): (\S+) (.+), from (\S+) to (\S+)$",
        "\n".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "configs").rglob("*.yaml"))),
        re.MULTILINE,
    )
    expected = {}
    for name, value, unit, *ends in found:
        shown, factor = SHOWN.get(unit, (unit, 1.0))
        numbers = [f"{float(number) * factor:.4g}" for number in (*ends, value)]
        label = name if shown == "-" else f"{name}, {shown}"
        expected[label] = (f"{numbers[0]} to {numbers[1]}", numbers[2])
    rows = re.findall(
        r"^\| ([^|]+) \| (\S+ to \S+) \| (\S+) \| \S* ?\| \S+ \|$", read("docs/claims.md"), re.M
    )
    assert {name: (ends, value) for name, ends, value in rows} == expected
    assert len(expected) == 27
