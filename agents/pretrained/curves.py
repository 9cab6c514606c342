"""How the ready policies learned: their learning curves, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sayd_env.agents.pretrained import FOLDER, groups
from sayd_env.agents.table import Table
from sayd_env.config import DataError
from sayd_env.config.palette import policy_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
    figure.set_size_inches(10.0, 5.2)
    axes = figure.subplots(1, max(len(found), 1), sharey=True, squeeze=False)[0]
    limits: list[tuple[float, float]] = []
    for axis, (algorithm, files) in zip(axes, found.items(), strict=False):
        draw_gains(axis, {file.stem: curve(file.with_suffix(".csv")) for file in files}, references)
        axis.set_title(algorithm.upper())
        limits.append(axis.get_ylim())
        axis.grid(alpha=0.3)
        axis.legend(fontsize="small", ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.13))
    if limits:  # the panels share their axis
        axes[0].set_ylim(min(low for low, _ in limits), max(high for _, high in limits))


def draw_gains(
    axis: Axes,
    trainings: Mapping[str, tuple[Sequence[int], Sequence[float]]],
    references: Mapping[str, float],
) -> None:
    """Draw how far below the best of the controllers the mean J of trainings falls, over their steps.

    The axis shows the second half of the trainings and the best controller whole: what differs there would be
    one line on an axis that begins at J = 0. Names say where the others are.

    Parameters
    ----------
    axis : Axes
    trainings : mapping
        Steps and mean J of the evaluations, by name.
    references : mapping
        Mean J of controllers on the same scenarios, by name; without any, the first evaluation stands for
        the best.
    """
    first = [costs[0] for _, costs in trainings.values() if costs]
    best = min(references.values() or first, default=1.0)

    def gain(cost: float) -> float:
        return 100.0 * (1.0 - cost / best)

    for name, (steps, costs) in trainings.items():
        millions = [step / 1e6 for step in steps]
        axis.plot(millions, [gain(c) for c in costs], markersize=3, label=name, **policy_style(name).drawn)
    late = [gain(cost) for _, costs in trainings.values() for cost in costs[len(costs) // 2 :]] + [0.0]
    room = 0.1 * (max(late) - min(late)) or 1.0
    lowest = min(late) - 2.0 * room
    for name, cost in references.items():
        shown = f"{name} ({gain(cost):.1f} %)"
        if gain(cost) > lowest:
            axis.axhline(gain(cost), linewidth=1.0, label=shown, **policy_style(name).plain)
        else:  # named alone: nobody is to look for its line
            axis.plot([], [], linestyle="none", label=f"below the axis: {shown}")
    axis.set_ylim(lowest, max(late) + room)
    axis.set(xlabel="steps of bogies (millions)", ylabel="mean J below the best controller's (%)")
