"""Pages of the site that are made from the code or from files elsewhere, when MkDocs builds it."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import mkdocs_gen_files

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS))

import api_pages  # noqa: E402 - beside this file
import claim_figures  # noqa: E402
import command_pages  # noqa: E402
import configuration_tables  # noqa: E402

OUTSIDE = re.compile(r"\[([^\]]*)\]\((?:\.\./)+[^)]*\)")
"""A link to a file of the repository that is no page."""


def write(place: str, text: str) -> None:
    """Make a page, or put another text in its place."""
    with mkdocs_gen_files.open(place, "w") as file:
        file.write(text)


def read(path: Path) -> str:
    """Text of a file."""
    return path.read_text(encoding="utf-8")


def as_in_a_wheel() -> None:
    """Copy the packages to where a wheel has them, so that their docstrings are found under their names."""
    copy = ROOT / "build" / "packages" / "sayd_env"
    shutil.rmtree(copy, ignore_errors=True)
    for source, target in (("sayd_env", "."), ("agents", "agents"), ("baselines", "baselines")):
        for module in (ROOT / source).rglob("*.py"):
            place = copy / target / module.relative_to(ROOT / source)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(module, place)


def for_the_site(text: str) -> str:
    """A page as MkDocs reads it, with links that say where they lead, and none to files of the repository."""

    def titled(link: re.Match[str]) -> str:
        title = read(DOCS / link[1]).partition("\n")[0].removeprefix("# ")
        return f"[{title}]({link[2]})"

    text = OUTSIDE.sub(r"\1", re.sub(r"\[([a-z0-9_]+\.md)\]\((\1[^)]*)\)", titled, text))
    # A bar inside code needs its backslash on other renderers only.
    return re.sub(r"`[^`\n]+`", lambda code: code[0].replace("\\|", "|"), text)


def with_links(text: str) -> str:
    """The table of commands, each name with a link to its page."""

    def linked(row: re.Match[str]) -> str:
        return re.sub(r"`sayd ([a-z-]+)[^`]*`", r"[\g<0>](commands/\1.md)", row[0])

    return re.sub(r"^\| `sayd .*? \| ", linked, text, flags=re.MULTILINE)


as_in_a_wheel()
for page in DOCS.glob("*.md"):
    text = for_the_site(read(page))
    if text != read(page):
        write(page.name, text)
write("changelog.md", read(ROOT / "CHANGELOG.md"))
write("contributing.md", read(ROOT / "CONTRIBUTING.md"))
write("figures.md", claim_figures.page(read(DOCS / "claims.md")))

commands = command_pages.pages()
for name, text in commands.items():
    write(f"commands/{name}.md", text)
write("claims.md", claim_figures.with_links(for_the_site(read(DOCS / "claims.md"))))
write("commands.md", with_links(for_the_site(read(DOCS / "commands.md"))))
for name, text in configuration_tables.pages().items():
    write(f"configuration/{name}", text)
write("configuration/index.md", configuration_tables.index())
for name, text in api_pages.pages().items():
    write(f"api/{name}", text)
