"""Pages of the site that are made from the code or from files elsewhere, when MkDocs builds it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import mkdocs_gen_files

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(DOCS))

import api_pages  # noqa: E402 - beside this file
import claim_figures  # noqa: E402
import command_pages  # noqa: E402
import configuration_tables  # noqa: E402

LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!https?:|#)([^)#]+)(#[^)]*)?\)")
ELSEWHERE = {
    ROOT / "CHANGELOG.md": "changelog.md",
    ROOT / "CONTRIBUTING.md": "contributing.md",
    ROOT / "examples" / "README.md": "examples.md",
    ROOT / "agents" / "pretrained" / "README.md": "ready_policies.md",
}
"""Pages that do not lie in docs/."""
PICTURES = (ROOT / "agents" / "pretrained" / "learning_curves.png",)
"""Pictures on those, beside them."""


def write(place: str, text: str) -> None:
    """Make a page, or put another text in its place."""
    with mkdocs_gen_files.open(place, "w") as file:
        file.write(text)


def read(path: Path) -> str:
    """Text of a file."""
    return path.read_text(encoding="utf-8")


def for_the_site(source: Path) -> str:
    """A page as MkDocs reads it, with links that say where they lead, and none to files that are no pages."""

    def link(found: re.Match[str]) -> str:
        label, target, anchor = found[1], (source.parent / found[2]).resolve(), found[3] or ""
        place = ELSEWHERE.get(target) or (target.name if target.parent == DOCS else "")
        if not place and not target.exists():
            raise FileNotFoundError(f"{source}: there is no {found[2]}")
        if not place:
            return label
        if label.endswith(".md") and target.is_file():
            label = read(target).partition("\n")[0].removeprefix("# ")
        return f"[{label}]({place}{anchor})"

    # A bar inside code needs its backslash on other renderers only.
    bare = re.sub(r"`[^`\n]+`", lambda code: code[0].replace("\\|", "|"), read(source))
    return LINK.sub(link, bare)


def with_links(text: str) -> str:
    """The table of commands, each name with a link to its page."""

    def linked(row: re.Match[str]) -> str:
        return re.sub(r"`sayd ([a-z-]+)[^`]*`", r"[\g<0>](commands/\1.md)", row[0])

    return re.sub(r"^\| `sayd .*? \| ", linked, text, flags=re.MULTILINE)


for page in DOCS.glob("*.md"):
    write(page.name, for_the_site(page))
for page, place in ELSEWHERE.items():
    if page.is_file():
        write(place, for_the_site(page))
for picture in PICTURES:
    with mkdocs_gen_files.open(picture.name, "wb") as file:
        file.write(picture.read_bytes())
write("claims.md", claim_figures.with_links(for_the_site(DOCS / "claims.md")))
write("commands.md", with_links(for_the_site(DOCS / "commands.md")))
write("figures.md", claim_figures.page(read(DOCS / "claims.md")))

commands = command_pages.pages()
for name, text in commands.items():
    write(f"commands/{name}.md", text)
for name, text in configuration_tables.pages().items():
    write(f"configuration/{name}", text)
write("configuration/index.md", configuration_tables.index())
for name, text in api_pages.pages().items():
    write(f"api/{name}", text)
