"""The semi-active damper against closed forms: stiffness, flow, relief, valve dynamics, signs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from sayd_env.config.damper import (
    EqualPercentageThrottle,
    OrificeThrottle,
    SaydDamperConfig,
    TableThrottle,
    Throttle,
    load_sayd,
)
from sayd_env.config.units import Array
from sayd_env.physics import sayd
from sayd_env.physics.plant import LANES
from sayd_env.physics.rig import steady_sayd_cycles
from sayd_env.physics.throttle import spring_valve_drop

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
        sayd.move_valves((0,), arrays.constant, line, inputs, state)
        sayd.integrate((0,), step, arrays.substeps, arrays.constant, arrays.table, inputs, state)
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
    no_leak = {"closed_area": 1e-12}
    config = changed(friction={"stiction": 0.0, "sliding": 0.0}, throttle=no_leak, bleed=0.0)
    (cycle,) = steady_sayd_cycles(config, 5e-6, 1.0, [0.0], 500)
    c = config.cylinder
    dead = 0.25 * math.pi * c.bore**2
    volumes = [0.5 * c.stroke * c.area + length * dead for length in (c.dead_length_a, c.dead_length_b)]
    oil = config.oil.bulk_modulus * c.area**2 * sum(1.0 / v for v in volumes)
    compliance = 1.0 / oil + 1.0 / config.bogie_mount.stiffness + 1.0 / config.carbody_mount.stiffness
    found = (np.max(cycle.force) - np.min(cycle.force)) / (2.0 * 5e-6)
    assert found == pytest.approx(1.0 / compliance, rel=1e-4)


ORIFICE = OrificeThrottle(
    type="orifice",
    discharge=0.65,
    density=860.0,
    closed_area=1e-7,
    open_area=7.5e-6,
    overlap=0.37,
    exponent=0.9,
)


def opening(throttle: Throttle, current: float) -> float:
    """Area of an equal-percentage or orifice throttle by formula, m2."""
    if isinstance(throttle, EqualPercentageThrottle):
        return throttle.closed_area * throttle.ratio**current
    assert isinstance(throttle, OrificeThrottle)
    travel = max(0.0, (current - throttle.overlap) / (1.0 - throttle.overlap))
    return throttle.closed_area + (throttle.open_area - throttle.closed_area) * travel**throttle.exponent


@pytest.mark.parametrize("kind", ["orifice", "equal_percentage"])
@pytest.mark.parametrize("current", [0.0, 0.5, 1.0])
def test_stiff_oil_gives_the_throttles_force(current: float, kind: str) -> None:
    """Stiff oil, rigid mounts: F = A dp(Q = A v) at every instant of a slow motion.

    So slow that the oil's compression and the rod's inertia take less than 1 % of it.
    """
    rigid = {"stiffness": 1e10, "damping": 1e6}
    config = changed(
        friction={"stiction": 0.0, "sliding": 0.0},
        oil={"bulk_modulus": 4e9},
        bogie_mount=rigid,
        carbody_mount=rigid,
        bleed=0.0,
        step=2e-5,
        throttle=ORIFICE if kind == "orifice" else load_sayd("sayd").throttle,
    )
    throttle = config.throttle
    assert throttle.type == kind
    assert not isinstance(throttle, TableThrottle)
    speed, period = {0.0: (2e-3, 40.0), 0.5: (0.02, 2.0), 1.0: (0.1, 2.0)}[current]
    omega = 2.0 * np.pi / period
    history = run(
        config,
        lambda t: (speed / omega * (1.0 - np.cos(omega * t)), speed * np.sin(omega * t)),
        period,
        current=current,
    )
    flow = config.cylinder.area * speed * np.abs(np.sin(omega * STEP * np.arange(1, len(history) + 1)))
    drop = 0.5 * throttle.density * (flow / (throttle.discharge * opening(throttle, current))) ** 2
    expected = config.cylinder.area * (drop + 2.0 * spring_valve_drop(config.rectifier, flow))
    fast = flow > 0.1 * np.max(flow)  # elsewhere the check valves close
    error = np.abs(np.abs(history[fast, sayd.FORCE_1]) - expected[fast])
    assert np.max(error) < 0.01 * np.max(expected)


@pytest.mark.parametrize("current", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("speed", [0.02, 0.2])
def test_constant_velocity_gives_the_characteristic_field(speed: float, current: float) -> None:
    """The quasi-static field is solved from eq. (24) by root finding; the damper must settle on it.

    At the lower speed it takes longer until the pressures have risen to the relief valves'.
    """
    config = load_sayd("sayd")
    history = run(config, ramp(speed), 0.5 if speed < 0.1 else 0.25, current=current)
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


def test_a_piston_that_cannot_overcome_stiction_stands_still() -> None:
    """Below F_C the stroke is exactly 0 and the mounts are two springs; above it slides against F_S."""
    config = changed(friction={"stiction": 400.0, "sliding": 300.0})
    spring = 1.0 / (1.0 / config.bogie_mount.stiffness + 1.0 / config.carbody_mount.stiffness)
    omega, hold = 2.0 * np.pi, 390.0 / spring
    still = run(
        config,
        lambda t: (hold * (1.0 - np.cos(omega * t)) / 2.0, hold * omega * np.sin(omega * t) / 2.0),
        1.0,
        current=0.5,
    )
    assert np.all(still[:, [sayd.STROKE, sayd.STROKE_RATE]] == 0.0)
    assert np.max(still[:, sayd.FORCE_1]) == pytest.approx(390.0, rel=1e-3)
    gone = run(config, ramp(1e-3), 0.5, current=1.0)
    assert gone[-1, sayd.STROKE_RATE] == pytest.approx(1e-3, rel=1e-3)
    pressure = config.cylinder.area * (gone[-1, sayd.PRESSURE_B] - gone[-1, sayd.PRESSURE_A])
    assert gone[-1, sayd.FORCE_1] - pressure == pytest.approx(300.0, rel=1e-3)


def test_the_bleed_alone_is_a_laminar_damper() -> None:
    """Throttle shut: A v leaves one chamber and enters the other through conductances B: F = 2 A^2 v / B."""
    config = changed(
        friction={"stiction": 0.0, "sliding": 0.0},
        throttle={"closed_area": 1e-14},
        bleed=2e-8,
    )
    settled = run(config, ramp(0.02), 0.4, current=0.0)[-1]
    expected = 2.0 * config.cylinder.area**2 * settled[sayd.STROKE_RATE] / config.bleed
    assert settled[sayd.FORCE_1] == pytest.approx(expected, rel=1e-4)
    assert settled[sayd.PRESSURE_A] + settled[sayd.PRESSURE_B] == pytest.approx(2e5, rel=1e-3)


def test_the_bleed_lets_the_chambers_down_to_the_tank_s_pressure() -> None:
    """Pumped up to 20 bar and left alone: p - p_tank falls as exp(-B E t / V); without a bleed it stays."""
    config = load_sayd("sayd")
    c, tank = config.cylinder, config.oil.tank_pressure
    volume = 0.5 * c.stroke * c.area + c.dead_length_a * 0.25 * math.pi * c.bore**2
    per_second = config.bleed * config.oil.bulk_modulus / volume
    for bleed, expected in ((config.bleed, tank + 19e5 * math.exp(-per_second)), (0.0, 20e5)):
        arrays = sayd.sayd_arrays(changed(bleed=bleed), STEP)
        state = sayd.rest(config, 0.0)
        state[sayd.PRESSURE_A * LANES : (sayd.PRESSURE_B + 1) * LANES] = 20e5
        for _ in range(round(1.0 / STEP)):
            inputs = np.zeros(sayd.INPUTS * LANES)
            sayd.integrate((0,), STEP, arrays.substeps, arrays.constant, arrays.table, inputs, state)
        for row in (sayd.PRESSURE_A, sayd.PRESSURE_B):
            assert state[row * LANES] == pytest.approx(expected, rel=1e-6)


def acting(history: Array) -> Array:
    return np.asarray(history[:, sayd.CURRENT])


@pytest.mark.parametrize("damping_ratio", [0.5, 1.0, 1.5])
def test_a_spool_is_a_second_order_system_behind_a_delay(damping_ratio: float) -> None:
    """Closed form of its step response; the delay is no whole number of steps, so the command arrives within
    a step as its share of the step says."""
    dynamics = {"delay": 3.3e-3, "natural_frequency": 20.0, "damping_ratio": damping_ratio, "rate": 1e6}
    history = run(changed(valve=dynamics), ramp(0.0), 0.1, current=0.0, command=lambda t: 0.6)
    times = STEP * np.arange(1, len(history) + 1)
    omega, t = 2.0 * np.pi * 20.0, np.maximum(times - 3.3e-3, 0.0)
    if damping_ratio == 1.0:
        rest = np.exp(-omega * t) * (1.0 + omega * t)
    else:
        pole = omega * (-damping_ratio + np.sqrt(complex(damping_ratio**2 - 1.0)))
        other = omega**2 / pole
        rest = np.real((other * np.exp(pole * t) - pole * np.exp(other * t)) / (other - pole))
    np.testing.assert_allclose(acting(history), 0.6 * (1.0 - rest), atol=1e-3)


def test_the_packaged_valve_is_as_fast_as_a_delay_and_a_lag() -> None:
    """A step is on average as late as behind the delay and a lag of 2 zeta / omega, its spool's."""
    config = load_sayd("sayd")
    valve, change = config.valve, 0.1  # small enough for the rate limit not to act
    history = run(config, ramp(0.0), 0.2, current=0.3, command=lambda t: 0.3 + change)
    late = (np.sum(0.3 + change - acting(history)) / change + 0.5) * STEP  # trapezia from the step at 0 on
    lag = 2.0 * valve.damping_ratio / (2.0 * math.pi * valve.natural_frequency)
    assert late == pytest.approx(valve.delay + lag, abs=1e-5)


def test_the_rate_limit_acts() -> None:
    """A fast spool closes at its largest rate; the packaged one in a whole step, and in no small one.

    Critically damped, it moves at up to omega / e times the step where the limit does not act.
    """
    fast = {"delay": 0.0, "natural_frequency": 500.0, "damping_ratio": 1.0, "rate": 25.0}
    history = run(changed(valve=fast), ramp(0.0), 0.06, current=1.0, command=lambda t: 0.0)
    times = STEP * np.arange(1, len(history) + 1)
    np.testing.assert_allclose(acting(history), np.maximum(1.0 - 25.0 * times, 0.0), atol=0.03)
    config = load_sayd("sayd")
    rate, omega = config.valve.rate, 2.0 * math.pi * config.valve.natural_frequency
    assert config.valve.damping_ratio == 1.0
    reached = rate * math.e / omega  # the step whose largest rate is the limit
    assert 0.0 < reached < 0.9
    for size in (1.0, 1.05 * reached, 0.95 * reached, 0.5 * reached):
        history = run(config, ramp(0.0), 0.1, current=1.0, command=lambda t, s=size: 1.0 - s)
        largest = np.max(-np.diff(acting(history)))
        if size > reached:
            assert largest == pytest.approx(rate * STEP, rel=1e-9)
        else:
            assert largest == pytest.approx(size * omega / math.e * STEP, rel=5e-3)


def test_a_limited_spool_converges() -> None:
    """Rate limit and a stop at 1, against a step of 1/64: what is left, of order 1, is from the stop."""
    dynamics = {"delay": 4e-3, "natural_frequency": 20.0, "damping_ratio": 0.3, "rate": 60.0}

    def positions(divided: int) -> Array:
        history = run(
            changed(valve=dynamics),
            ramp(0.0),
            0.1,
            step=STEP / divided,
            current=0.1,
            command=lambda t: 0.9,
        )
        return acting(history)[divided - 1 :: divided]

    fine = positions(64)
    coarse, eighth = (np.max(np.abs(positions(k) - fine)) for k in (1, 8))
    assert np.max(fine) > 0.999
    assert coarse < 5e-3
    assert eighth < 0.25 * coarse


def test_vehicles_side_by_side_do_not_see_one_another() -> None:
    """Dampers with other constants, throttle tables and delays in one call: the same bits as alone."""
    configs = [
        load_sayd("sayd"),
        changed(throttle={"closed_area": 2e-7}, valve={"delay": 2.2e-3}, oil={"bulk_modulus": 0.7e9}),
        changed(friction={"stiction": 300.0}, valve={"delay": 0.0, "natural_frequency": 50.0}),
    ]
    w, rng = len(configs), np.random.default_rng(5)
    n = LANES * w
    arrays = [sayd.sayd_arrays(c, STEP) for c in configs]
    states = [sayd.rest(c, 0.2) for c in configs]
    lines = [np.full(sayd.line_length(c, STEP) * LANES, 0.2) for c in configs]
    longest = max(len(line) for line in lines) // LANES

    def side_by_side(parts: list[Array]) -> Array:
        return np.stack([p.reshape(-1, LANES) for p in parts], axis=2).ravel()

    constant = side_by_side([a.constant for a in arrays])
    size = arrays[0].table.size
    starts = constant.reshape(-1, LANES, w)[sayd.TABLE_START]
    starts += size * np.arange(w)
    table = np.concatenate([a.table for a in arrays])
    state, inputs = side_by_side(states), np.zeros(sayd.INPUTS * n)
    padded = [np.r_[np.full((longest * LANES) - len(line), np.nan), line] for line in lines]
    line = side_by_side(padded)
    alone = [np.zeros(sayd.INPUTS * LANES) for _ in configs]
    for _ in range(200):
        command, rates = rng.uniform(0.0, 1.0, (LANES, w)), rng.normal(0.0, 0.05, (2, LANES, w))
        state.reshape(-1, LANES, w)[sayd.COMMAND] = command
        given = inputs.reshape(-1, LANES, w)
        for row, rate in zip((sayd.END_1, sayd.END_2), rates, strict=True):
            given[row + 2] = given[row + 1]
            given[row + 1] = rate
            given[row] += 0.5 * STEP * (given[row + 1] + given[row + 2])
        for k in range(w):
            alone[k][: sayd.OLD_CURRENT * LANES] = given[: sayd.OLD_CURRENT, :, k].ravel()
            states[k].reshape(-1, LANES)[sayd.COMMAND] = command[:, k]
            sayd.move_valves((0,), arrays[k].constant, lines[k], alone[k], states[k])
            a = arrays[k]
            sayd.integrate((0,), STEP, a.substeps, a.constant, a.table, alone[k], states[k])
        sayd.move_valves((0,) * w, constant, line, inputs, state)
        sayd.integrate((0,) * w, STEP, arrays[0].substeps, constant, table, inputs, state)
    for k in range(w):
        np.testing.assert_array_equal(state.reshape(-1, LANES, w)[:, :, k].ravel(), states[k])


def test_a_command_that_is_no_number_closes_the_valve() -> None:
    history = run(load_sayd("sayd"), ramp(0.05), 0.2, current=0.5, command=lambda t: math.nan)
    assert np.all(np.isfinite(history[:, : sayd.COMMAND]))
    assert acting(history)[-1] == pytest.approx(0.0, abs=1e-6)
