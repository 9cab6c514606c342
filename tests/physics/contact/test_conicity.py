"""Conicity against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from sayd_env.config import DataError
from sayd_env.config.units import Array
from sayd_env.physics.contact.conicity import equivalent_conicity, harmonic_conicity

Y = np.linspace(-8e-3, 8e-3, 1601)


@pytest.mark.parametrize("conicity", [0.05, 0.2, 0.4])
def test_cone(conicity: float) -> None:
    for function in (equivalent_conicity, harmonic_conicity):
        measured = function(Y, 2.0 * conicity * Y, [1e-3, 3e-3, 6e-3])
        np.testing.assert_allclose(measured, conicity, rtol=1e-6)


@pytest.mark.parametrize("stiffening", [0.0, 5e3, 5e4])
def test_cubic_rolling_radius_against_the_elliptic_integral(stiffening: float) -> None:
    """Duffing's y'' = -(k y + c y^3): quarter period K(m) / sqrt(k + c a^2), m = c a^2 / (2 (k + c a^2))."""
    k, a = 0.1, 4e-3
    total = k + stiffening * a**2
    quarter = ellipk(0.5 * stiffening * a**2 / total) / np.sqrt(total)
    expected = (0.5 * np.pi / quarter) ** 2
    measured = equivalent_conicity(Y, 2.0 * (k * Y + stiffening * Y**3), [a])
    assert measured[0] == pytest.approx(expected, rel=1e-4)
    # Harmonic balance of a cubic: k + 3/4 c a^2.
    assert harmonic_conicity(Y, 2.0 * (k * Y + stiffening * Y**3), [a])[0] == pytest.approx(
        k + 0.75 * stiffening * a**2, rel=1e-4
    )


def test_against_the_integrated_motion_of_a_wheelset() -> None:
    """The wavelength of y'' = -delta_r / (e r0), integrated by an ODE solver, gives the same conicity."""
    track_base, radius, amplitude = 1.5, 0.46, 3e-3
    delta_r = 0.2 * Y + 1.2e-3 * np.tanh((np.abs(Y) - 2e-3) / 3e-4) * np.sign(Y) + 1.2e-3 * np.sign(Y)

    def motion(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -np.interp(state[0], Y, delta_r) / (track_base * radius)]

    def centre(_: float, state: np.ndarray) -> float:
        return float(state[0])

    centre.terminal = True  # type: ignore[attr-defined]
    run = solve_ivp(
        motion, (0.0, 50.0), [amplitude, 0.0], events=centre, rtol=1e-9, atol=1e-12, max_step=0.05
    )
    wavelength = 4.0 * run.t_events[0][0]
    expected = (np.pi / wavelength) ** 2 * 2.0 * track_base * radius
    assert equivalent_conicity(Y, delta_r, [amplitude])[0] == pytest.approx(expected, rel=2e-3)


def test_wheelsets_that_do_not_centre() -> None:
    assert equivalent_conicity(Y, 0.0 * Y, [2e-3])[0] == 0.0
    assert equivalent_conicity(Y, -0.1 * Y, [2e-3])[0] == pytest.approx(-0.05, rel=1e-6)
    outward_first = -0.1 * Y + 2e5 * Y**3
    assert np.isnan(equivalent_conicity(Y, outward_first, [0.9e-3])[0])
    assert harmonic_conicity(Y, outward_first, [0.5e-3])[0] < 0.0


@pytest.mark.parametrize("amplitude", [0.0, -1e-3, 9e-3, np.nan])
def test_amplitude_outside_the_data(amplitude: float) -> None:
    with pytest.raises(DataError, match="allowed is above 0 up to 8 mm"):
        equivalent_conicity(Y, Y, [amplitude])


@pytest.mark.parametrize(
    ("y", "delta_r"),
    [(Y[::-1], Y), (np.where(Y[3] == Y, np.nan, Y), Y), (Y, Y[:-1]), (Y, np.where(Y[3] == Y, np.inf, Y))],
)
def test_data_that_are_no_function_of_the_position(y: Array, delta_r: Array) -> None:
    with pytest.raises(DataError, match=r"^conicity: "):
        equivalent_conicity(y, delta_r, [2e-3])
