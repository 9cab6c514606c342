"""The semi-active damper against closed forms: stiffness, flow, relief, valve dynamics, signs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from sayd_env.config.damper import OrificeThrottle, SaydDamperConfig, load_sayd
from sayd_env.physics import sayd
from sayd_env.physics.plant import LANES
from sayd_env.physics.rig import steady_sayd_cycles
from sayd_env.physics.throttle import spring_valve_drop

Array = npt.NDArray[np.float64]
STEP = 5e-4


def changed(**sections: Any) -> SaydDamperConfig:
    """The packaged damper with other numbers, given as whole fields or as keys of a section."""
    config = load_sayd("sayd")
    updates = {
        key: getattr(config, key).model_copy(update=value) if isinstance(value, dict) else value
        for key, value in sections.items()
    }
    return config.model_copy(update=updates)


def run(
    config: SaydDamperConfig,
    bogie: Callable[[Array], tuple[Array, Array]],
    duration: float,
    *,
    current: float | None = None,
    command: Callable[[float], float] | None = None,
    step: float = STEP,
) -> Array:
    """States (t, STATES) of a damper whose end on the carbody is held, at the end of each step."""
    arrays = sayd.sayd_arrays(config, step)
    state, inputs = sayd.rest(config, current), np.zeros(sayd.INPUTS * LANES)
    rows, ends = state.reshape(-1, LANES), inputs.reshape(-1, LANES)
    line = np.full(sayd.line_length(config, step) * LANES, rows[sayd.COMMAND, 0])
    times = step * np.arange(round(duration / step) + 1)
    position, velocity = bogie(times)
    history = np.empty((len(times) - 1, sayd.STATES))
    for n in range(1, len(times)):
        if command is not None:
            rows[sayd.COMMAND] = command(times[n - 1])
        ends[sayd.END_1], ends[sayd.RATE_1], ends[sayd.OLD_RATE_1] = (
            position[n],
            velocity[n],
            velocity[n - 1],
        )
        sayd.move_valves(arrays.constant, line, inputs, state)
        sayd.integrate(step, arrays.substeps, arrays.constant, arrays.table, inputs, state)
        history[n - 1] = rows[:, 0]
    return history


def ramp(speed: float, rise: float = 0.02) -> Callable[[Array], tuple[Array, Array]]:
    """Motion that reaches a constant velocity in `rise` seconds."""

    def motion(t: Array) -> tuple[Array, Array]:
        velocity = speed * np.minimum(t / rise, 1.0)
        return np.where(t < rise, 0.5 * speed * t**2 / rise, speed * (t - 0.5 * rise)), velocity

    return motion


def test_closed_valve_is_an_oil_spring_between_two_mounts() -> None:
    """Small motion, no leak, no friction: E A^2 (1/V_A + 1/V_B) in series with c_b1 and c_b2."""
    no_leak = {"closed_area": 1e-12, "open_area": 1e-12}
    config = changed(friction={"stiction": 0.0, "sliding": 0.0}, throttle=no_leak)
    (cycle,) = steady_sayd_cycles(config, 5e-6, 1.0, [0.0], 500)
    c = config.cylinder
    dead = 0.25 * math.pi * c.bore**2
    volumes = [0.5 * c.stroke * c.area + length * dead for length in (c.dead_length_a, c.dead_length_b)]
    oil = config.oil.bulk_modulus * c.area**2 * sum(1.0 / v for v in volumes)
    compliance = 1.0 / oil + 1.0 / config.bogie_mount.stiffness + 1.0 / config.carbody_mount.stiffness
    found = (np.max(cycle.force) - np.min(cycle.force)) / (2.0 * 5e-6)
    assert found == pytest.approx(1.0 / compliance, rel=1e-4)


@pytest.mark.parametrize("current", [0.0, 0.5, 1.0])
def test_incompressible_oil_gives_the_orifices_force(current: float) -> None:
    """E to infinity, rigid mounts: F = A dp(Q = A v) at every instant of a slow motion."""
    rigid = {"stiffness": 1e10, "damping": 1e6}
    config = changed(
        friction={"stiction": 0.0, "sliding": 0.0},
        oil={"bulk_modulus": 1e12},
        bogie_mount=rigid,
        carbody_mount=rigid,
        step=4e-6,
    )
    speed, omega = {0.0: 2e-3, 0.5: 0.02, 1.0: 0.05}[current], 2.0 * np.pi
    history = run(
        config,
        lambda t: (speed / omega * (1.0 - np.cos(omega * t)), speed * np.sin(omega * t)),
        1.0,
        current=current,
    )
    flow = config.cylinder.area * speed * np.abs(np.sin(omega * STEP * np.arange(1, len(history) + 1)))
    throttle = config.throttle
    assert isinstance(throttle, OrificeThrottle)
    travel = max(0.0, (current - throttle.overlap) / (1.0 - throttle.overlap))
    area = throttle.closed_area + (throttle.open_area - throttle.closed_area) * travel**throttle.exponent
    drop = 0.5 * throttle.density * (flow / (throttle.discharge * area)) ** 2
    expected = config.cylinder.area * (drop + 2.0 * spring_valve_drop(config.rectifier, flow))
    fast = flow > 0.1 * np.max(flow)  # elsewhere the check valves close
    error = np.abs(np.abs(history[fast, sayd.FORCE_1]) - expected[fast])
    assert np.max(error) < 0.01 * np.max(expected)


@pytest.mark.parametrize("current", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("speed", [0.02, 0.2])
def test_constant_velocity_gives_the_characteristic_field(speed: float, current: float) -> None:
    """The quasi-static field is solved from eq. (24) by root finding; the damper must settle on it."""
    config = load_sayd("sayd")
    history = run(config, ramp(speed), 0.25, current=current)
    settled = history[-1]
    expected = sayd.steady_force(config, settled[sayd.STROKE_RATE], current)
    assert settled[sayd.FORCE_1] == pytest.approx(float(expected), rel=5e-3)
    assert settled[sayd.STROKE_RATE] == pytest.approx(speed, rel=0.05)


def test_relief_valve_caps_the_force() -> None:
    """However fast: A times what relief and suction leave of the pressures, and the friction."""
    config = load_sayd("sayd")
    speed = 0.3
    history = run(config, ramp(speed, 0.01), 0.2, current=0.0)
    high = spring_valve_drop(config.relief, config.cylinder.area * speed * 1.01)
    cap = config.cylinder.area * (high + config.oil.tank_pressure) + config.friction.stiction
    assert np.max(history[:, sayd.FORCE_1]) < 1.01 * cap
    assert history[-1, sayd.FORCE_1] > 0.9 * cap


def test_no_pressure_falls_below_vapour_pressure() -> None:
    config = load_sayd("sayd")
    omega = 2.0 * np.pi * 10.0
    history = run(config, lambda t: (6e-3 * np.sin(omega * t), 6e-3 * omega * np.cos(omega * t)), 0.5)
    least = np.min(history[:, [sayd.PRESSURE_A, sayd.PRESSURE_B]])
    assert least == config.oil.vapour_pressure


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stretched_damper_pulls_its_ends_together(sign: float) -> None:
    """Bogie end ahead (along +x) of the carbody's: -F_1 draws the bogie back, -F_2 the carbody on."""
    history = run(load_sayd("sayd"), ramp(sign * 0.05), 0.1)
    on_bogie, on_carbody = -history[-1, sayd.FORCE_1], -history[-1, sayd.FORCE_2]
    assert sign * on_bogie < -1e3
    assert on_carbody == pytest.approx(-on_bogie, rel=1e-2)


def test_force_does_not_depend_on_the_width_of_standstill() -> None:
    """Half and a quarter of the regularisation's width change the force by less than 0.2 % of its RMS."""
    omega = 2.0 * np.pi * 3.0

    def force(width: float) -> Array:
        config = changed(friction={"width": width}, step=2.5e-5)
        motion = run(
            config,
            lambda t: (1e-3 * np.sin(omega * t), 1e-3 * omega * np.cos(omega * t)),
            0.7,
            current=0.3,
        )
        return np.asarray(motion[:, sayd.FORCE_1])

    width = load_sayd("sayd").friction.width
    wide, half, quarter = (force(width * share) for share in (1.0, 0.5, 0.25))
    rms = np.sqrt(np.mean(quarter**2))
    assert np.sqrt(np.mean((wide - quarter) ** 2)) < 2e-3 * rms
    assert np.sqrt(np.mean((half - quarter) ** 2)) < 2e-3 * rms


def acting(history: Array) -> Array:
    return np.asarray(history[:, sayd.CURRENT])


def test_valve_delays_and_lags() -> None:
    """A step of the command: nothing for the delay, then 1 - exp(-(t - delay) / lag); the delay is no whole
    number of steps, so the command arrives within a step as its share of the step says."""
    config = changed(valve={"delay": 3.3e-3, "lag": 10e-3, "rate": 1e6})
    history = run(config, ramp(0.0), 0.06, current=0.0, command=lambda t: 0.8)
    times = STEP * np.arange(1, len(history) + 1)
    expected = 0.8 * np.where(times > 3.3e-3, 1.0 - np.exp(-(times - 3.3e-3) / 10e-3), 0.0)
    np.testing.assert_allclose(acting(history), expected, atol=1e-3)


def test_valve_rate_is_limited() -> None:
    config = changed(valve={"delay": 0.0, "lag": 0.0, "rate": 25.0})
    history = run(config, ramp(0.0), 0.06, current=1.0, command=lambda t: 0.0)
    times = STEP * np.arange(1, len(history) + 1)
    np.testing.assert_allclose(acting(history), np.maximum(1.0 - 25.0 * times, 0.0), atol=1e-12)


def test_a_command_that_is_no_number_closes_the_valve() -> None:
    history = run(load_sayd("sayd"), ramp(0.05), 0.2, current=0.5, command=lambda t: math.nan)
    assert np.all(np.isfinite(history[:, : sayd.COMMAND]))
    assert acting(history)[-1] == pytest.approx(0.0, abs=1e-6)
