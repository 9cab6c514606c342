"""How the ready policies learned: their learning curves, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sayd_env.agents.pretrained import FOLDER, groups
from sayd_env.agents.table import Table
from sayd_env.config import DataError
from sayd_env.config.palette import policy_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REFERENCES = "references.csv"
"""J of the controllers on the scenarios of the learning curves."""
PICTURE = "learning_curves.png"


def curve(path: Path) -> tuple[list[int], list[float]]:
    """Steps and mean J of a training's evaluations.

    Parameters
    ----------
    path : Path
        ``evaluations.csv`` of its run.

    Raises
    ------
    DataError
        It holds no evaluations.
    """
    rows = Table(path).rows
    if not rows or any("steps" not in row or "J" not in row for row in rows):
        raise DataError(f"{path}: expected the columns 'steps' and 'J', and a row or more")
    return [int(row["steps"]) for row in rows], [float(row["J"]) for row in rows]


def draw(figure: Figure, folder: Path = FOLDER) -> None:
    """Draw a panel for each algorithm: all trainings, and the controllers that they are to beat.

    Parameters
    ----------
    figure : Figure
    folder : Path
        Where the policies are; beside ``ppo-s0.npz`` the curve ``ppo-s0.csv``.

    Raises
    ------
    DataError
        A curve that is damaged.
    """
    found = groups(folder)
    references = {str(row["policy"]): float(row["J"]) for row in Table(folder / REFERENCES).rows}
    figure.set_size_inches(10.0, 4.5)
    axes = figure.subplots(1, max(len(found), 1), sharey=True, squeeze=False)[0]
    for axis, (algorithm, files) in zip(axes, found.items(), strict=False):
        for file in files:
            steps, costs = curve(file.with_suffix(".csv"))
            millions = [step / 1e6 for step in steps]
            axis.plot(millions, costs, markersize=3, label=file.stem, **policy_style(file.stem).drawn)
        for name, cost in references.items():
            axis.axhline(cost, linewidth=1.0, label=name, **policy_style(name).plain)
        axis.set(title=algorithm.upper(), xlabel="steps of bogies (millions)")
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small", ncols=2)
    axes[0].set_ylabel("mean J of the scenarios of the evaluations")
