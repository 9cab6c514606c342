"""The paper's figures and what stands for them here, beside the statements that are measured from them.

    python docs/claim_figures.py results/reproduce results/compare

takes the pictures of a finished ``sayd reproduce`` and ``sayd compare`` into docs/pictures, with 128 colours:
a third of the bytes, and no colour of a thin line is lost.
"""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

from PIL import Image

from sayd_env.config.storage import write_file
from sayd_env.studies.paper.page import FIGURES

PICTURES = Path(__file__).parent / "pictures"
COLOURS = 128


def page(claims: str) -> str:
    """The page of all figures; `claims` is the page with a row for each statement."""
    rows = {row[1]: row[0] for row in re.finditer(r"^\| ([A-Z]\d+) \| .*$", claims, re.MULTILINE)}
    head = re.search(r"^\| row \| .*\n\|.*$", claims, re.MULTILINE)
    assert head is not None, "docs/claims.md has no table of rows"
    parts = [
        "# The paper's figures",
        "What `sayd reproduce` draws in the place of each figure, what the paper's shows, and the statements "
        "that are measured from it: [all rows](claims.md), and where they do not hold.",
    ]
    for number, figure in FIGURES.items():
        parts.append(f"## Figure {number}: {figure.heading} {{ #figure-{number} }}")
        parts.append(f"**The paper shows:** {figure.shows}")
        parts += [
            f"![Counterpart of figure {number}: {figure.heading}](pictures/{picture.name})"
            for picture in sorted(PICTURES.glob(f"figure_{number:02d}_*.png"))
        ]
        parts.append(f"**To compare:** {figure.compare}")
        if figure.rows:
            parts.append("\n".join([head[0], *(rows[row] for row in figure.rows)]))
    return "\n\n".join(parts) + "\n"


def with_links(claims: str) -> str:
    """The page of statements, each row with a link to the figure that it is measured from."""
    for number, figure in FIGURES.items():
        for row in figure.rows:
            claims = re.sub(
                rf"^\| {row} \|", f"| [{row}](figures.md#figure-{number}) |", claims, flags=re.MULTILINE
            )
    return claims


def take(folder: Path) -> None:
    """Put the pictures of a result beside the pages."""
    for source in sorted([*folder.glob("figure_*.png"), *folder.glob("compare.png")]):
        with Image.open(source) as picture:
            packed = io.BytesIO()
            picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
                packed, "PNG", optimize=True
            )
        write_file(PICTURES / source.name, packed.getvalue())
        print(source.name, len(packed.getvalue()))


if __name__ == "__main__":
    for each in sys.argv[1:]:
        take(Path(each))
