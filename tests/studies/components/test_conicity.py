"""The conicity study: its keys, tables and picture."""

from __future__ import annotations

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from sayd_env.config import ConfigError
from sayd_env.config.scenario import load_scenario
from sayd_env.studies.components.conicity import ConicityResult, conicity, plot_conicity

LMB10 = ("wheel=lmb10", "rail=cn60", "wear=0", "contact.table_half_width=0.009", "contact.table_step=5e-5")


@pytest.fixture(scope="module")
def result() -> ConicityResult:
    return conicity(load_scenario("estimates", LMB10))


def test_keys_and_values(result: ConicityResult) -> None:
    data = result.as_dict()
    amplitude, rigid = data["amplitude_mm"], data["tan_gamma_e"]
    # LMB10 on CN60: 0.101 at 1 to 4 mm (computed elsewhere; the design value is 0.1).
    inner = amplitude <= 4.0
    np.testing.assert_allclose(rigid[inner], 0.101, atol=0.002)
    y, delta_r = data["y_mm"], data["delta_r_mm"]
    np.testing.assert_allclose(delta_r, -delta_r[::-1], atol=1e-12)
    assert np.interp(2.0, y, delta_r) == pytest.approx(2.0 * 0.101 * 2.0, rel=0.02)


def test_tables_are_as_long_as_the_curves(result: ConicityResult) -> None:
    for name, (header, rows) in result.tables().items():
        lines = list(rows)
        assert len(lines) == (len(result.amplitude) if name == "conicity" else len(result.delta_r()[0]))
        assert all(len(row) == len(header) for row in lines)
        json.dumps(lines)


def test_picture(result: ConicityResult) -> None:
    figure = Figure()
    plot_conicity(figure, [result, result])
    assert len(figure.axes) == 4
    figure.canvas.draw_idle()
    for draw in result.plots().values():
        draw(Figure())


def test_amplitude_beyond_the_table() -> None:
    with pytest.raises(ConfigError, match=r"contact\.table_half_width"):
        conicity(load_scenario("estimates", LMB10), np.array([0.02]))


def test_says_which_contact_a_simulation_uses(result: ConicityResult) -> None:
    data = result.as_dict()
    assert data["simulation_uses"] == "regularised"
    assert data["load_kn"] == pytest.approx(150 / 2, rel=1e-3)  # axle load of Wang et al. (2022)
    figure = Figure()
    plot_conicity(figure, [result])
    for axes in figure.axes[1:]:
        labels = [line.get_label() for line in axes.get_lines()]
        assert any(": rigid" in str(label) for label in labels)
        assert any(": regularised (simulated)" in str(label) for label in labels)
    console = Console(record=True, width=120)
    result.summary(console)
    text = console.export_text()
    assert "rigid: EN 15302" in text
    assert "regularised: mean over the patch under 75 kN a wheel, as a simulation has it." in text
