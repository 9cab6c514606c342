"""The notebooks of the examples run from their first cell to their last, whose assertions hold."""

from __future__ import annotations

from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")

pytestmark = pytest.mark.slow
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
NEEDS = {"train_and_compare": ("stable_baselines3", "torch")}
LONGEST = 900
"""Seconds after which a cell is given up: the first start compiles."""


def names(paths: list[Path]) -> list[str]:
    return [path.stem for path in paths]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=names(NOTEBOOKS))
@pytest.mark.filterwarnings("default")  # of the machinery between the processes, which are not ours
def test_it_runs(path: Path) -> None:
    for module in NEEDS.get(path.stem, ()):
        pytest.importorskip(module, exc_type=ImportError)
    notebook = nbformat.read(path, as_version=4)
    assert any("assert " in cell.source for cell in notebook.cells if cell.cell_type == "code")
    client = nbclient.NotebookClient(
        notebook, timeout=LONGEST, kernel_name="python3", resources={"metadata": {"path": str(EXAMPLES)}}
    )
    client.execute()  # raises what a cell raises
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            assert output.get("name") != "stderr", output.get("text")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=names(NOTEBOOKS))
def test_it_is_kept_without_results(path: Path) -> None:
    """Numbers of an earlier plant do not stand in it, and a change is one of text."""
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


def test_there_are_five() -> None:
    assert len(NOTEBOOKS) == 5
