"""Equivalent linear dampers: closed forms, the compiled damper on the rig, characteristic field, power."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sayd_env.config import ConfigError, StudyError
from sayd_env.config.damper import SaydDamperConfig, load_sayd
from sayd_env.config.units import ComplexArray
from sayd_env.physics import sayd
from sayd_env.physics.equivalent_damper import (
    EquivalentSayd,
    Stroke,
    equivalent_sayd,
    equivalent_slope,
    fundamental,
)
from sayd_env.physics.rig import steady_sayd_states

POINTS = 800


@pytest.fixture(scope="module")
def config() -> SaydDamperConfig:
    return load_sayd("sayd-estimate")


def two_port(found: EquivalentSayd, frequency: float) -> ComplexArray:
    """Complex (F_1, F_2) over the displacements (x_1, x_2) of the ends, N/m."""
    omega = 2j * math.pi * frequency
    whole = found.c @ np.linalg.solve(omega * np.eye(len(found.a)) - found.a, found.b) + found.d
    return np.asarray(whole[:, [0, 2]] + omega * whole[:, [1, 3]])


@pytest.mark.parametrize("amplitude", [2e-3, 6e-3, 20e-3])
def test_slope_of_a_curve_with_a_knee_is_that_of_a_saturation(amplitude: float) -> None:
    """Textbook describing function of a saturation at +-d, with the second slope going on beyond it."""
    knee, first, second = 6e-3, 7e5, 2e4
    curve = np.array([[0.0, 0.0], [knee, first * knee], [1.0, first * knee + second * (1.0 - knee)]])
    share = min(1.0, knee / amplitude)
    saturation = 2.0 / math.pi * (math.asin(share) + share * math.sqrt(1.0 - share**2))
    expected = second + (first - second) * saturation
    found = equivalent_slope(curve, amplitude / math.sqrt(2.0))
    assert found == pytest.approx(expected, rel=1e-4)
    assert equivalent_slope(curve, 0.0) == pytest.approx(first)


@pytest.mark.parametrize(("speed", "current"), [(5e-3, 0.05), (20e-3, 0.05), (20e-3, 0.6)])
def test_stiffness_is_that_of_the_compiled_damper_at_this_stroke_speed(
    config: SaydDamperConfig, speed: float, current: float
) -> None:
    """Driven with the elongation that the linear damper asks for, on a finer grid of time."""
    frequency = 5.0
    found = equivalent_sayd(config, Stroke(speed, frequency, current))
    omega = 2.0 * math.pi * frequency
    # Stroke rate over the elongation, the carbody's end held.
    states = np.linalg.solve(1j * omega * np.eye(6) - found.a, found.b[:, 0] + 1j * omega * found.b[:, 1])
    amplitude = math.sqrt(2.0) * speed / abs(states[1])
    cycle = steady_sayd_states(config, amplitude, frequency, [current], POINTS)[:, :, 0]
    stiffness = fundamental(cycle[:, sayd.FORCE_1]) / (-1j * amplitude)  # of a sine
    assert two_port(found, frequency)[0, 0] == pytest.approx(stiffness, rel=0.01)
    assert abs(fundamental(cycle[:, sayd.STROKE_RATE])) == pytest.approx(math.sqrt(2.0) * speed, rel=0.01)
    assert np.mean(cycle[:, sayd.PRESSURE_A]) == pytest.approx(found.mean_pressure[0], rel=0.02)


def test_sliding_friction_is_that_of_a_sine(config: SaydDamperConfig) -> None:
    """4 F_S / (pi w^): an open valve leaves the piston's motion a sine."""
    speed = 50e-3
    found = equivalent_sayd(config, Stroke(speed, 5.0, 1.0))
    expected = 4.0 * config.friction.sliding / (math.pi * math.sqrt(2.0) * speed)
    assert found.damping == pytest.approx(expected, rel=0.01)


def test_command_changes_the_force_as_the_characteristic_field_does(config: SaydDamperConfig) -> None:
    """dF/du of the fundamental at a slow sine of stroke rate, where pressures follow at once."""
    speed, current, step = 60e-3, 0.6, 0.01
    sine = np.abs(np.sin(2.0 * np.pi * (np.arange(200) + 0.5) / 200))
    low, high = (
        2.0 * np.mean(sayd.steady_force(config, math.sqrt(2.0) * speed * sine, i) * sine)
        for i in (current - step, current + step)
    )
    found = equivalent_sayd(config, Stroke(speed, 0.5, current))
    assert found.force_per_command == pytest.approx((high - low) / (2.0 * step), rel=0.03)
    # A unit of r, alternating with the pressure drop, changes that by this much at a held stroke.
    omega = 2j * math.pi * 0.5
    held = [4, 5]  # pressures
    drop = np.linalg.solve(omega * np.eye(2) - found.a[np.ix_(held, held)], found.command[held])
    force = config.cylinder.area * (drop[0] - drop[1])
    assert force.real == pytest.approx(found.force_per_command, rel=0.02)


@pytest.mark.parametrize("stroke", [None, Stroke(5e-3, 5.0, 0.05), Stroke(20e-3, 6.0, 0.5)])
def test_it_gives_no_power_and_its_ends_are_alike(config: SaydDamperConfig, stroke: Stroke | None) -> None:
    """Reciprocity, and a dissipated power that no motion of the ends makes negative, at all frequencies."""
    found = equivalent_sayd(config, stroke)
    for frequency in np.geomspace(0.01, 500.0, 30):
        port = two_port(found, frequency)
        assert port[0, 1] == pytest.approx(port[1, 0], rel=1e-9)
        impedance = port / (2j * math.pi * frequency)
        power = np.linalg.eigvalsh(0.5 * (impedance + impedance.conj().T))
        assert power[0] > -1e-9 * power[-1]


def test_at_rest_the_mounts_remain_and_a_command_moves_nothing(config: SaydDamperConfig) -> None:
    found = equivalent_sayd(config, None)
    one, two = config.bogie_mount.stiffness, config.carbody_mount.stiffness
    series = one * two / (one + two)
    assert two_port(found, 1e-3) == pytest.approx(series * np.array([[1.0, -1.0], [-1.0, 1.0]]), rel=1e-4)
    assert not np.any(found.command)


def test_a_stroke_that_the_cylinder_does_not_have_is_refused(config: SaydDamperConfig) -> None:
    with pytest.raises(ConfigError, match=r"stroke speed of 500 mm/s \(RMS\) at 0.5 Hz"):
        equivalent_sayd(config, Stroke(0.5, 0.5))


def test_a_stroke_speed_at_which_friction_holds_is_refused(config: SaydDamperConfig) -> None:
    with pytest.raises(StudyError, match="friction holds it, or it breaks away to more"):
        equivalent_sayd(config, Stroke(1e-6, 5.0, 0.3))
