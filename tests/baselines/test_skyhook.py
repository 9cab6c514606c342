"""Skyhook: integration without drift, signs at each damper, equations (37) and (38)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sayd_env import baselines
from sayd_env.baselines.inverse_damper import InverseDamper
from sayd_env.config.control import load_controller
from sayd_env.config.damper import load_sayd
from sayd_env.envs.interface import BOGIES, DAMPERS
from sayd_env.physics.sayd import steady_force

NAMES = ["skyhook-onoff", "skyhook-continuous"]
PERIOD = 0.01


def columns(interface, *starts):
    return [k for k, signal in enumerate(interface.signals) if signal.name.startswith(starts)]


def means(function, steps, period=PERIOD):
    """Means over control periods of a function of time, whose integral is given."""
    edges = function(period * np.arange(-1, steps))
    return np.diff(edges) / period


def drive(policy, interface, acceleration, stroke):
    """Commands and states (x', dL') of a yaw motion whose left side has this acceleration and stroke."""
    rows = np.zeros((len(acceleration), len(interface.signals)), dtype=np.float32)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for bogie in BOGIES:
            rows[:, columns(interface, f"longitudinal_acceleration.{bogie}.{side}")] = (
                sign * acceleration[:, None]
            )
            rows[:, columns(interface, f"stroke.{bogie}.{side}")] = sign * stroke[:, None]
    state, commands, velocity, rate = None, [], [], []
    for row in rows:
        action, state = policy.predict(row, state)
        commands.append(action.copy())
        velocity.append(state.velocity[0].copy())
        rate.append(state.rate[0].copy())
    return np.array(commands), np.array(velocity), np.array(rate)


def phasor(values, frequency, period=PERIOD):
    """Complex amplitude of a sine in the last second, at whose end values[-1] stands."""
    n = round(1.0 / period)
    time = period * np.arange(len(values))[-n:]
    return 2.0 / n * np.sum(values[-n:] * np.exp(-2j * math.pi * frequency * time))


def test_both_skyhooks_read_one_estimator(tmp_path):
    """What differs between them is the ends of the command; a file of one's own needs no more than these."""
    estimators = [load_controller(name).model_dump(exclude={"closed", "open"}) for name in NAMES]
    assert estimators[0] == estimators[1]
    own = tmp_path / "skyhook-onoff.yaml"
    own.write_text("base: skyhook\nclosed: 0.1\nopen: 0.9\n")
    assert load_controller(str(own)).model_dump() == {"closed": 0.1, "open": 0.9, **estimators[0]}
    own.write_text("base: skyhook\nclosed: 0.1\nopen: 0.9\ncorner: 0.5\n")
    assert load_controller(str(own)).model_dump()["corner"] == 0.5


@pytest.mark.parametrize("name", NAMES)
def test_a_constant_error_of_the_accelerometer_gives_no_drift(interface, name):
    signals = interface()
    policy = baselines.make(name, signals, corner=0.3)
    bias = np.full(2000, 0.5)  # plainly integrated, 10 m/s after 20 s
    _, velocity, _ = drive(policy, signals, bias, np.zeros(2000))
    assert np.abs(velocity[-500:]).max() < 1e-6


@pytest.mark.parametrize("frequency", [3.0, 5.0, 8.0])
@pytest.mark.parametrize("period", [0.01, 0.005])
def test_velocity_and_stroke_rate_of_a_sine(interface, frequency, period):
    """x = x0 sin(w t): the velocity's amplitude w x0 within 6 %, its phase within 10 degrees.

    With corners far from the frequencies of hunting; what the packaged ones cost in phase, they are meant to.
    The stroke rate is the response of its discrete filters, parabola and low-pass, to means over a period.
    """
    signals = interface(control_period=period)
    policy = baselines.make("skyhook-onoff", signals, corner=0.3, rate_corner=40.0)
    steps, w, x0 = round(10.0 / period), 2 * math.pi * frequency, 2e-3
    acceleration = means(lambda t: x0 * w * np.cos(w * t), steps, period)
    stroke = means(lambda t: -x0 / w * np.cos(w * t), steps, period)
    _, velocity, rate = drive(policy, signals, acceleration, stroke)
    # Row n is known at t = n T, the end of the period over which its readings are means.
    truth = phasor(x0 * w * np.cos(w * period * np.arange(steps)), frequency, period)
    ratio = phasor(velocity[:, 1], frequency, period) / truth
    assert abs(np.angle(ratio, deg=True)) < 10.0
    assert abs(abs(ratio) - 1.0) < 0.06
    back, mean = np.exp(-1j * w * period), (1.0 - np.exp(-1j * w * period)) / (1j * w * period)
    low_pass = 1.0 - math.exp(-2.0 * math.pi * 40.0 * period)
    response = (2.0 - 3.0 * back + back**2) / period * low_pass / (1.0 - (1.0 - low_pass) * back)
    ratio = phasor(rate[:, 1], frequency, period) / truth
    assert ratio == pytest.approx(response * mean / (1j * w), abs=1e-6)
    assert abs(np.angle(ratio, deg=True)) < 10.0
    assert abs(abs(ratio) - 1.0) < 0.25


def test_the_integration_is_the_filter_that_the_docstring_says(interface):
    """H(jw) jw = s^2 / (s^2 + sqrt(2) w0 s + w0^2): at the corner, amplitude sqrt(1/2), 90 degrees early."""
    signals = interface()
    policy = baselines.make("skyhook-onoff", signals, corner=1.0)
    w, steps = 2 * math.pi, 2000
    _, velocity, _ = drive(policy, signals, means(lambda t: w * np.cos(w * t), steps), np.zeros(steps))
    ratio = phasor(velocity[:, 0], 1.0) / phasor(w * np.cos(w * PERIOD * np.arange(steps)), 1.0)
    # A mean over the period leads to a half a period's delay, exactly made up for only by a plain integral.
    assert abs(ratio) == pytest.approx(math.sqrt(0.5), rel=0.03)
    assert np.angle(ratio, deg=True) == pytest.approx(90.0, abs=2.0)


def test_the_stroke_rate_of_a_parabola_is_exact(interface):
    signals = interface()
    policy = baselines.make("skyhook-onoff", signals, rate_corner=None)
    stroke = means(lambda t: 0.02 * t + 0.05 * t**2 + 0.1 * t**3, 50)  # L = 0.02 + 0.1 t + 0.3 t^2
    _, _, rate = drive(policy, signals, np.zeros(50), stroke)
    time = PERIOD * np.arange(50)
    assert rate[3:, 0] == pytest.approx(0.1 + 0.6 * time[3:], abs=2e-5)  # single precision of the observation


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("damper", DAMPERS)
@pytest.mark.parametrize("bogie", [0, 1])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_each_damper_resists_a_bogie_that_moves_away_from_the_carbody(
    interface, name, damper, bogie, direction
):
    """The carbody held, the damper is as fast as its mount: c_max. Against each other: c_min."""
    signals = interface()
    policy = baselines.make(name, signals, closed=0.1)
    side = damper.partition(".")[0]
    rows = np.zeros((20, len(signals.signals)), dtype=np.float32)
    velocity = direction * 0.05 * np.linspace(0.0, 1.0, 20)
    acceleration = direction * 0.05 / (19 * PERIOD)
    rows[:, signals.index(f"longitudinal_acceleration.{BOGIES[bogie]}.{side}")] = acceleration
    for towards, expected in ((1.0, 0.1), (-1.0, 1.0)):
        # One of two mounts and one of four dampers move: dL' = x' / 2 in the yaw part.
        stroke = towards * PERIOD * np.cumsum(velocity)
        rows[:, signals.index(f"stroke.{BOGIES[bogie]}.{damper}")] = stroke
        state = None
        for row in rows:
            action, state = policy.predict(row, state)
        assert action[bogie] == pytest.approx(expected)


@pytest.mark.parametrize("name", NAMES)
def test_motion_without_yaw_decides_nothing(interface, observe, name):
    """Both sides alike: x' = dL' = 0 in yaw, for which (38) and (37) say c_max."""
    signals = interface()
    policy = baselines.make(name, signals)
    state = None
    for step in range(20):
        readings = {"longitudinal_acceleration": 1.0, "stroke": 1e-3 * step}
        action, state = policy.predict(observe(signals, readings), state)
    assert action == pytest.approx(policy.parameters.closed)


def test_on_off_commands_the_two_ends_alone(interface):
    signals = interface()
    policy = baselines.make("skyhook-onoff", signals, closed=0.02, open=0.9)
    generator = np.random.default_rng(2)
    commands, velocity, rate = drive(
        policy, signals, generator.normal(size=500), 1e-3 * generator.normal(size=500)
    )
    assert np.unique(commands) == pytest.approx([0.02, 0.9])
    assert commands == pytest.approx(np.where(velocity * rate >= 0.0, 0.02, 0.9))


@pytest.mark.parametrize("share", [-0.5, 0.05, 0.2, 0.6, 0.95, 1.5])
def test_eq_37_through_the_damper_s_characteristic(interface, share):
    """The damper at the commanded current resists with min(x' / dL', 1) of the closed one's force."""
    signals = interface()
    policy = baselines.make("skyhook-continuous", signals, closed=0.1, rate_corner=None)
    steps, w = 400, 2 * math.pi * 5.0
    acceleration = means(lambda t: 0.03 * np.sin(w * t), steps)
    stroke = means(lambda t: -0.03 / share / w**2 * np.sin(w * t), steps)
    commands, velocity, rate = drive(policy, signals, acceleration, stroke)
    damper = signals.damper
    speed = np.abs(rate[200:, 0])
    wanted = np.clip(velocity[200:, 0] / rate[200:, 0], 0.0, 1.0) * steady_force(damper, speed, 0.1)
    least = steady_force(damper, speed, 1.0)
    expected = np.maximum(wanted, least)
    # At its opening the relief valve's flow first has to open the suction valve: no current gives the forces
    # in between, 37 N wide.
    opening = damper.relief.opening * damper.cylinder.area + damper.friction.sliding
    reached = ~((expected > opening - 1.0) & (expected < opening + 60.0))
    force = steady_force(damper, speed, commands[200:, 0])
    assert force[reached] == pytest.approx(expected[reached], rel=1e-3)
    assert force == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("closed", [0.0, 0.1, 0.4])
def test_the_characteristic_is_the_inverse_of_the_steady_force(closed):
    damper = load_sayd("sayd")
    speed, share = (
        part.copy() for part in np.meshgrid(np.geomspace(1e-4, 0.3, 60), np.linspace(0.02, 0.99, 40))
    )
    current = InverseDamper(damper, closed, 1.0).currents(speed, share)
    wanted = share * steady_force(damper, speed, closed)
    opening = damper.relief.opening * damper.cylinder.area + damper.friction.sliding
    reached = ~((wanted > opening - 1.0) & (wanted < opening + 60.0))
    inside = reached & (wanted > steady_force(damper, speed, 1.0))
    assert inside.sum() > 500
    assert steady_force(damper, speed, current)[inside] == pytest.approx(wanted[inside], rel=1e-3)
    assert np.all(current[wanted < steady_force(damper, speed, 1.0)] == 1.0)


def test_extreme_wishes_stay_in_the_range_of_currents():
    characteristic = InverseDamper(load_sayd("sayd"), 0.1, 0.8)
    rate = np.array([0.0, 1e-300, 1e-9, 5.0, 1e3, -0.1, np.nan, 0.1])
    for share in (-1.0, 0.0, 0.5, 1.0, np.inf, np.nan):
        current = characteristic.currents(rate, np.full(rate.shape, share))
        assert np.all((current >= 0.1) & (current <= 0.8))


@pytest.mark.parametrize("name", NAMES)
def test_a_dead_band_holds_the_command(interface, name):
    signals = interface()
    steps, w = 300, 2 * math.pi * 2.0
    acceleration = means(lambda t: 0.05 * np.cos(w * t), steps)
    stroke = means(lambda t: 0.05 / w**2 * np.cos(w * t + 2.0), steps)
    free = drive(baselines.make(name, signals), signals, acceleration, stroke)[0]
    policy = baselines.make(name, signals, dead_band=0.02)
    commands, velocity, rate = drive(policy, signals, acceleration, stroke)
    still = np.minimum(np.abs(velocity), np.abs(rate)) < 0.02
    assert still[:, 0].any()
    assert np.all(commands[1:][still[1:]] == commands[:-1][still[1:]])
    assert np.all(commands[~still] == free[~still])
    assert np.all(commands[0] == np.float32(policy.parameters.closed))
