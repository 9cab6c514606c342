"""The policies that come with the package, found by name."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from sayd_env.agents import pretrained
from sayd_env.agents.policy_file import read_policy
from sayd_env.agents.pretrained.curves import draw_gains
from sayd_env.config import ConfigError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Files as the package has them, and others that are none of them; nobody reads what is in them."""
    for name in ("sac-s1.npz", "ppo-s10.npz", "ppo-s2.npz", "ppo-s1.npz", "README.md", "ppo.npz", "best.npz"):
        (tmp_path / name).touch()
    return tmp_path


def test_files_are_grouped_by_algorithm_in_the_order_of_their_seeds(folder: Path):
    found = pretrained.groups(folder)
    assert list(found) == ["ppo", "sac"]
    assert [file.name for file in found["ppo"]] == ["ppo-s1.npz", "ppo-s2.npz", "ppo-s10.npz"]
    assert found["sac"] == (folder / "sac-s1.npz",)


def test_an_algorithm_alone_is_its_first_training(folder: Path):
    assert pretrained.path("ppo", folder) == folder / "ppo-s1.npz"
    assert pretrained.path("ppo-s10", folder) == folder / "ppo-s10.npz"
    assert pretrained.names(folder) == ("ppo", "ppo-s1", "ppo-s2", "ppo-s10", "sac", "sac-s1")


def test_an_unknown_name_is_refused_with_the_nearest_one(folder: Path):
    with pytest.raises(ConfigError, match=r"'ppo-s11': unknown, did you mean 'ppo-s1.?'.*sac-s1"):
        pretrained.path("ppo-s11", folder)


def test_nothing_there_is_no_error(tmp_path: Path):
    assert pretrained.groups(tmp_path) == {}
    with pytest.raises(ConfigError, match="none come with this installation"):
        pretrained.path("ppo", tmp_path)


def test_the_package_s_own_files_can_be_read():
    groups = pretrained.groups()
    assert groups
    for name, files in groups.items():
        assert [read_policy(file).algorithm for file in files] == [name] * len(files)


def test_the_leaderboard_says_what_the_comparison_found():
    """Every row of the page is a row of the table that lies beside the policies."""
    with (Path(pretrained.__file__).parent / "scores.csv").open() as stream:
        own = {"filter": "online", "force_weight": "1.0"}
        rows = [row for row in csv.DictReader(stream) if own.items() <= row.items()]
    found = {(row["part"], row["policy"]): row for row in rows}
    page = (Path(__file__).parents[2] / "docs" / "leaderboard.md").read_text()
    table = re.findall(r"^\| `([\w-]+)` \| (\d+) \| (.*) \|$", page, re.MULTILINE)
    assert {name for name, *_ in table} == {row["policy"] for row in rows}
    for name, trainings, cells in table:
        row = found["together", name]
        shown = []
        for part in ("stationary", "lines", "together"):
            numbers = [float(found[part, name][f"geometric{end}"]) for end in ("", "_low", "_high")]
            shown.append("{:.3f} ({:.3f} to {:.3f})".format(*numbers))
        shown += [f"{float(row['J']):.4f}", f"{float(row['worst_vs_passive']):.2f}"]
        assert cells == " | ".join(shown)
        assert trainings == row["training_seeds"]


def test_a_learning_curve_shows_the_gain():
    """3 % below the best controller take a good part of the axis; one at 22 % above is named, not drawn."""
    axes = Figure().subplots()
    draw_gains(
        axes, {"ppo-s0": ([0, 10, 20, 30], [0.05, 0.0303, 0.0294, 0.0291])}, {"a": 0.03, "mppt2": 0.0366}
    )
    np.testing.assert_allclose(axes.lines[0].get_ydata()[1:], [-1.0, 2.0, 3.0])
    low, high = axes.get_ylim()
    assert low < 0.0
    assert high > 3.0
    assert 0.5 * (high - low) < 3.0
    assert axes.get_legend_handles_labels()[1] == [
        *("ppo-s0", "a (0.0 %)", "below the axis: mppt2 (-22.0 %)")
    ]
    assert len(axes.lines[-1].get_xdata()) == 0  # a line of the legend that is nowhere would be looked for


def test_a_learning_curve_without_controllers_begins_at_its_first_evaluation():
    axes = Figure().subplots()
    draw_gains(axes, {"ppo-s0": ([0, 10], [0.05, 0.04])}, {})
    np.testing.assert_allclose(axes.lines[0].get_ydata(), [0.0, 20.0])
    draw_gains(axes, {"ppo-s1": ([], [])}, {})
